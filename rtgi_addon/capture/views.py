"""Views of the scene through Cycles: the camera's, and each light's, on one session, read from memory.

Cycles renders whatever the engine's evaluated camera looks at. `ViewCapture` moves that copy, renders, reads the passes
and puts everything back; the user's own camera is never written. A view asks Cycles for one sample at the pixel's
centre and for no light at all (see `lights.lights_out`).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ..core.frame import GBuffer
from ..core.radiometry import mean_of
from ..core.transforms import Camera, Projection, ViewFormat
from ..errors import CaptureError, InputError
from .lights import rigid
from .materials import MaterialTable
from .needs import ROUGHNESS_PASS
from .versions import pass_name

_CAMERA_FIELDS = ("type", "lens", "sensor_width", "sensor_height", "sensor_fit", "shift_x", "shift_y", "ortho_scale",
                  "clip_start", "clip_end", "panorama_type", "latitude_min", "latitude_max", "longitude_min",
                  "longitude_max")
_SIZE_FIELDS = ("use_border", "border_min_x", "border_max_x", "border_min_y", "border_max_y", "resolution_percentage")
_SENSOR_M = 36.0            # any width serves: only its ratio to the focal length matters
OWN_PASSES = "RTGI "          # how the names of the passes begin that RTGI fills itself
_VEIL_PX = 2                # pixels around one that tell what it lets through, each way
_VEIL_DEPTH = 0.02          # relative difference of depth up to which they show the same surface
_MOST_ROUGHNESS = 1.001     # of one surface, and rounding
_NOTHING_M = 0.99e10        # Cycles writes 1e10 where a ray meets nothing


@dataclass(frozen=True)
class Window:
    """The part of the full frame that is rendered: all of it, or the border.

    Fractions of the full frame's width and height, y upwards; `aspect` is the full frame's width over its height as
    shown (pixel aspect included).
    """

    left: float
    right: float
    bottom: float
    top: float
    aspect: float

    def window_edges(self, left: float, right: float, bottom: float, top: float) -> tuple[float, float, float, float]:
        """Edges of the window in a full frame with the given edges."""
        width, height = right - left, top - bottom
        return (left + self.left * width, left + self.right * width,
                bottom + self.bottom * height, bottom + self.top * height)


def read_window(render: bpy.types.RenderSettings) -> Window:
    """The window of a scene's render settings, with Blender's own rounding of the border to pixels."""
    width = max(1, render.resolution_x * render.resolution_percentage // 100)
    height = max(1, render.resolution_y * render.resolution_percentage // 100)
    aspect = width * render.pixel_aspect_x / (height * render.pixel_aspect_y)
    if not render.use_border:
        return Window(0.0, 1.0, 0.0, 1.0, aspect)
    left, right = int(render.border_min_x * width), int(render.border_max_x * width)
    bottom, top = int(render.border_min_y * height), int(render.border_max_y * height)
    if right <= left or top <= bottom:
        raise InputError("the render border is smaller than one pixel; draw a larger one or switch it off")
    return Window(left / width, right / width, bottom / height, top / height, aspect)


def main_camera(camera: bpy.types.Object, window: Window, size: tuple[int, int], origin_ws: np.ndarray) -> Camera:
    """The evaluated main camera as it looks through `window`; InputError for a panoramic one."""
    data = camera.data
    if data.type not in {"PERSP", "ORTHO"}:
        raise InputError(f"camera {camera.name!r} is panoramic, which RTGI cannot render; set its type to Perspective or "
                         "Orthographic in the camera's Lens panel")
    by_width = data.sensor_fit == "HORIZONTAL" or (data.sensor_fit == "AUTO" and window.aspect >= 1)
    if data.type == "ORTHO":
        extent = data.ortho_scale
    else:
        sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
        extent = sensor / data.lens
    # the fitted edge has the full extent; shifts count in it on both axes
    half_x = extent / 2 if by_width else extent / 2 * window.aspect
    half_y = extent / 2 / window.aspect if by_width else extent / 2
    shift_x, shift_y = data.shift_x * extent, data.shift_y * extent
    edges = window.window_edges(shift_x - half_x, shift_x + half_x, shift_y - half_y, shift_y + half_y)
    world_from_view, _ = rigid(np.array(camera.matrix_world, np.float64))
    world_from_view[:3, 3] -= origin_ws
    projection = Projection.ORTHOGRAPHIC if data.type == "ORTHO" else Projection.PERSPECTIVE
    return Camera(projection, world_from_view, *size, *edges)


class ViewCapture:
    """Renders views on one Cycles session.

    Parameters
    ----------
    engine : the running RenderEngine, whose `session` is a Cycles session.
    data, depsgraph : as Blender hands them to `update` and `render`.
    origin_ws : (3,) float64 m, taken off every position.
    materials : MaterialTable or None
        Of the depsgraph, its materials numbered if the frame's `Needs` have the pass "Material Index".
    """

    def __init__(self, engine: bpy.types.RenderEngine, data: bpy.types.BlendData, depsgraph: bpy.types.Depsgraph,
                 origin_ws: np.ndarray, materials: MaterialTable | None = None):
        self.engine, self.data, self.depsgraph = engine, data, depsgraph
        self.origin_ws, self.materials = origin_ws, materials

    def passes(self, camera: Camera | None = None) -> dict[str, np.ndarray]:
        """Render the view and read its passes: (H, W, C) float32 with row 0 at the top.

        `camera` is what `looking_through` was told; without it the view is the frame's own.
        """
        from cycles import engine as cycles_engine

        cycles_engine.reset(self.engine, self.data, self.depsgraph)
        cycles_engine.render(self.engine, self.depsgraph)
        result = self.engine.get_result()
        if result is None:
            raise CaptureError("Cycles returned no render result; look at its messages above")
        width, height, out = result.resolution_x, result.resolution_y, {}
        part = (slice(None),) if camera is None else (slice(height - camera.height_px, None), slice(camera.width_px))
        for render_pass in result.layers[self.depsgraph.view_layer.name].passes:
            if render_pass.name == "Combined" or render_pass.name.startswith(OWN_PASSES):
                continue
            flat = np.empty(width * height * render_pass.channels, np.float32)
            render_pass.rect.foreach_get(flat)
            out[render_pass.name] = flat.reshape(height, width, render_pass.channels)[::-1][part]
        return out

    def format_of_views(self, texels: int) -> ViewFormat:
        """What `looking_through` can give: Cycles writes every view into the frame's own result.

        A flat view is a border in the frame's lower left corner and so takes the pixels' shape; a panorama cannot be cut
        by a border and takes the frame's own proportions.
        """
        render, result = self.engine.render, self.engine.get_result()
        limit = result.resolution_x, result.resolution_y
        percentage = int(100 * math.sqrt(texels / (render.resolution_x * render.resolution_y)))
        percentage = max(1, min(percentage, *(100 * most // full for most, full in zip(
            limit, (render.resolution_x, render.resolution_y), strict=True))))
        panorama = tuple(max(1, full * percentage // 100) for full in (render.resolution_x, render.resolution_y))
        return ViewFormat(texels, limit, render.pixel_aspect_x / render.pixel_aspect_y, panorama)

    @contextlib.contextmanager
    def looking_through(self, camera: Camera, clip_start_m: float, clip_end_m: float) -> Iterator[None]:
        """Move the evaluated camera to `camera`, whose size `format_of_views` allowed, for the time of the context.

        The render settings that are set for it are the running render's own copy. Of those only border and percentage can be
        set: the others' update looks for a scene that the copy does not belong to, and crashes.
        """
        place, render = self.engine.camera_override, self.engine.render
        data = place.data
        world = place.matrix_world.copy()
        saved = {name: getattr(data, name) for name in _CAMERA_FIELDS}
        saved_size = {name: getattr(render, name) for name in _SIZE_FIELDS}
        left, right, bottom, top = camera.left, camera.right, camera.bottom, camera.top
        try:
            matrix = camera.world_from_view.copy()
            matrix[:3, 3] += self.origin_ws
            place.matrix_world = Matrix(matrix)
            data.clip_start, data.clip_end = clip_start_m, clip_end_m
            if camera.projection is Projection.EQUIRECTANGULAR:
                render.use_border = False
                # the smallest percentage whose rounding down gives the width
                render.resolution_percentage = -(-100 * camera.width_px // render.resolution_x)
                data.type, data.panorama_type, data.shift_x, data.shift_y = "PANO", "EQUIRECTANGULAR", 0.0, 0.0
                data.longitude_min, data.longitude_max = left, right
                data.latitude_min, data.latitude_max = bottom, top
            else:
                width, height = (max(1, full * render.resolution_percentage // 100)
                                 for full in (render.resolution_x, render.resolution_y))
                render.use_border = True
                render.border_min_x = render.border_min_y = 0.0
                # half a pixel more, since Cycles rounds down
                render.border_max_x = min((camera.width_px + 0.5) / width, 1.0)
                render.border_max_y = min((camera.height_px + 0.5) / height, 1.0)
                # edges of the full frame whose lower left corner is the view
                right = left + (right - left) * width / camera.width_px
                top = bottom + (top - bottom) * height / camera.height_px
                extent = right - left
                data.sensor_fit, data.sensor_width = "HORIZONTAL", _SENSOR_M
                data.shift_x, data.shift_y = (left + right) / 2 / extent, (bottom + top) / 2 / extent
                if camera.projection is Projection.PERSPECTIVE:
                    data.type, data.lens = "PERSP", _SENSOR_M / extent
                else:
                    data.type, data.ortho_scale = "ORTHO", extent
            yield
        finally:
            place.matrix_world = world
            for owner, values in ((data, saved), (render, saved_size)):
                for name, value in values.items():
                    setattr(owner, name, value)

    def environment(self, camera: Camera) -> np.ndarray:
        """(H, W, 3) float32 radiance of the world alone: the view starts behind everything."""
        with self.looking_through(camera, 1e6, 2e6):
            return np.nan_to_num(self.passes(camera)[pass_name("Environment")], posinf=0.0, neginf=0.0)

    def to_gbuffer(self, passes: dict[str, np.ndarray], camera: Camera) -> GBuffer:
        depth = passes["Depth"][..., 0]
        seen = (depth > 0) & (depth < _NOTHING_M)
        depth = np.where(seen, depth, np.float32(np.inf))
        clean = {name: _finite(values) for name, values in passes.items() if name != "Depth"}
        albedo = clean[pass_name("Diffuse Color")]
        black = np.zeros_like(albedo)
        specular = clean.get(pass_name("Glossy Color"), black)
        emission = clean.get(pass_name("Emission"), black)
        normal = clean["Normal"]
        length = np.sqrt(np.einsum("hwc,hwc->hw", normal, normal))
        # an emissive or holdout surface has no closure to give a normal: let it face the viewer
        faceless = seen & (length <= 0.1)
        normal = normal / np.maximum(length, np.float32(1e-6))[..., None]
        normal[faceless] = camera.world_from_view[:3, 2]
        roughness = self._roughness(clean, albedo, specular)
        nothing, world = ~seen, clean.get(pass_name("Environment"), black)
        if nothing.any():
            albedo, specular, emission = albedo.copy(), specular.copy(), emission.copy()
            normal[nothing], albedo[nothing], specular[nothing] = (0, 0, 1), 0, 0
            emission[nothing] = world[nothing]
        if world[seen].any():
            emission = emission + _seen_through(world, depth)
        specular = np.array(specular, np.float32, order="C")            # a copy: the compositor gets the pass as it is
        arrays = (depth, camera.positions_ws(depth), normal, albedo, specular, roughness, emission,
                  self._of_materials(clean, "f0", 0.0))
        gbuffer = GBuffer(*(np.ascontiguousarray(a, np.float32) for a in arrays))
        if specular.any():
            _correct_colours(gbuffer, self._of_materials(clean, "keeps_energy", 1.0), camera)
        return gbuffer

    def _roughness(self, passes: dict[str, np.ndarray], albedo: np.ndarray, specular: np.ndarray) -> np.ndarray:
        """(H, W) perceptual roughness.

        Blender 5.2's denoising pass is the mean over the lobes weighted by their albedo, with the diffuse lobe as 1:
        R = (d + g r) / (d + g) gives r. Before that the material's own number serves, and where R is above 1: it is the sum
        over all surfaces that a ray has met, if those before the last let part of the light through.
        """
        if ROUGHNESS_PASS not in passes:
            return self._of_materials(passes, "roughness", 1.0)
        mean, d, g = passes[ROUGHNESS_PASS][..., 0], mean_of(albedo), mean_of(specular)
        rough = np.where(g > 1e-4, np.clip((mean * (d + g) - d) / np.maximum(g, 1e-4), 0, 1), 1.0)
        is_sum = mean > _MOST_ROUGHNESS
        return np.where(is_sum, self._of_materials(passes, "roughness", 1.0), rough) if is_sum.any() else rough

    def _of_materials(self, passes: dict[str, np.ndarray], name: str, nothing: float) -> np.ndarray:
        """(H, W) of the table's numbers `name` by each pixel's material; `nothing` where no pass tells it."""
        index = passes.get(pass_name("Material Index"))
        if index is None or self.materials is None:
            return np.full(passes["Normal"].shape[:2], nothing, np.float32)
        numbers = getattr(self.materials, name)
        return numbers[np.clip(index[..., 0].astype(np.int32), 0, len(numbers) - 1)]


def _correct_colours(gbuffer: GBuffer, keeps_energy: np.ndarray, camera: Camera) -> None:
    """Turn the G-buffer's `specular` from Glossy Color into what the lobes reflect, in place."""
    # here: whoever only switches the add-on on needs no numba
    from ..kernels.brdf import albedo_table
    from ..kernels.glossy_colour import correct_colours

    g, eye, backwards = gbuffer, camera.position_ws.astype(np.float32), camera.world_from_view[:3, 2].astype(np.float32)
    correct_colours(len(g.specular), g.specular, g.normal_ws, g.position_ws, g.roughness, g.f0, keeps_energy, eye, backwards,
                    camera.projection is Projection.ORTHOGRAPHIC, albedo_table())


def _finite(values: np.ndarray) -> np.ndarray:
    """`values` with 0 for what is not finite: Cycles divides by colours that may be black."""
    return values if np.isfinite(values).all() else np.nan_to_num(values, posinf=0.0, neginf=0.0)


def _seen_through(world: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """(H, W, 3) radiance of the world as it shows through surfaces, of depth (H, W) m, that let part of it through.

    Cycles' one sample of a pixel gets through or does not, so each takes the mean over those around it at about its depth.
    """
    height, width = depth.shape
    through = np.where(np.isfinite(depth)[..., None], world, 0)
    rows, columns = np.nonzero(through.any(-1))
    near = np.zeros(depth.shape, bool)
    steps = [(i, j) for i in range(-_VEIL_PX, _VEIL_PX + 1) for j in range(-_VEIL_PX, _VEIL_PX + 1)]
    for i, j in steps:
        near[np.clip(rows + i, 0, height - 1), np.clip(columns + j, 0, width - 1)] = True
    rows, columns = np.nonzero(near & np.isfinite(depth))
    total, count = np.zeros((len(rows), 3), np.float32), np.zeros((len(rows), 1), np.float32)
    for i, j in steps:
        y, x = np.clip(rows + i, 0, height - 1), np.clip(columns + j, 0, width - 1)
        is_like = np.abs(depth[y, x] - depth[rows, columns]) < _VEIL_DEPTH * depth[rows, columns]
        total += through[y, x] * is_like[:, None]
        count[:, 0] += is_like
    out = np.zeros_like(world)
    out[rows, columns] = total / count           # it is like itself
    return out


def full_sphere(width_px: int, height_px: int, world_from_view: np.ndarray) -> Camera:
    """The equirectangular view of all directions."""
    return Camera(Projection.EQUIRECTANGULAR, world_from_view, width_px, height_px, -math.pi, math.pi, -math.pi / 2,
                  math.pi / 2)


def world_axes() -> np.ndarray:
    """world_from_view (4, 4) of a view whose centre looks along +Y with +Z up: the axes of `core.frame.World`."""
    out = np.eye(4)
    out[:3, :3] = np.stack([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]], 1)
    return out
