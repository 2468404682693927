"""Where a lamp's view looks, and views that rays through the triangles give without Cycles."""

from __future__ import annotations

import math

import numpy as np

from .core.frame import Frame, GBuffer, Light, LightKind, LightView
from .core.radiometry import texel_flux
from .core.transforms import Camera, Projection, ViewFormat
from .kernels.bvh import Bvh
from .kernels.pilot import lit_hits
from .kernels.scene_light import Surroundings
from .kernels.vec3 import f32, vector
from .passes.surroundings import seen_by_rays

PILOT_PIXELS, PILOT_RAYS = 2048, 12
TRIM = 0.0015               # share of the pilot's points cut off at each edge of a sun's view
WIDE_SPOT_RAD = math.radians(150)   # beyond this a flat image plane wastes its texels at the rim
TURNS = 36                  # directions tried for the long edge of a sun's view, over half a turn
MARGIN = 1.02               # a sun's view is this much larger than its points
LONGEST = 4.0               # longer edge of a sun's view over the shorter one, at most


def spot_camera(light: Light, form: ViewFormat) -> Camera:
    """Perspective view around the cone of a SPOT; for very wide cones an equirectangular one."""
    half = light.spot_size_rad / 2
    if light.spot_size_rad > WIDE_SPOT_RAD:
        return Camera(Projection.EQUIRECTANGULAR, light.world_from_light, *form.panorama(1.0), -half, half, -half, half)
    width, height = form.flat_px(1.0)
    texel = math.tan(half) * 1.001 / min(width * form.texel_aspect, height)
    half_x, half_y = texel * width * form.texel_aspect, texel * height
    return Camera(Projection.PERSPECTIVE, light.world_from_light, width, height, -half_x, half_x, -half_y, half_y)


def sphere_camera(light: Light, form: ViewFormat) -> Camera:
    """Equirectangular view of all that a POINT (the sphere) or an area light (the half sphere before it) can reach."""
    half = math.pi / 2 if light.kind.is_area else math.pi
    return Camera(Projection.EQUIRECTANGULAR, light.world_from_light, *form.panorama(half / (math.pi / 2)), -half, half,
                  -math.pi / 2, math.pi / 2)


def sun_camera(light: Light, points_ws: np.ndarray, bounds_ws: tuple[np.ndarray, np.ndarray], form: ViewFormat) -> Camera:
    """Orthographic view along a SUN that holds nearly all of `points_ws` (N, 3), turned and shaped to waste least."""
    rotation = light.world_from_light[:3, :3]
    in_light = points_ws @ rotation
    scale = max(float(np.linalg.norm(bounds_ws[1] - bounds_ws[0])), 1e-9)
    best = None
    for angle in np.linspace(0, math.pi, TURNS, endpoint=False):
        x_axis, y_axis = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
        x, y = in_light[:, :2] @ x_axis, in_light[:, :2] @ y_axis
        low, high = np.quantile([x, y], [TRIM, 1 - TRIM], axis=1)
        extent = np.maximum(high - low, 1e-3 * scale)
        width, height = form.flat_px(min(max(extent[0] / extent[1], 1 / LONGEST), LONGEST))
        texel_m = max(extent[0] / (width * form.texel_aspect), extent[1] / height) * MARGIN
        if best is None or texel_m < best[0]:
            best = texel_m, width, height, x_axis, y_axis, (low + high) / 2
    texel_m, width, height, x_axis, y_axis, centre = best
    turned = np.eye(4)
    turned[:3, :3] = rotation @ np.array([[x_axis[0], y_axis[0], 0], [x_axis[1], y_axis[1], 0], [0, 0, 1.0]])
    corners = np.array([[bounds_ws[i][0], bounds_ws[j][1], bounds_ws[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    top = float((corners @ rotation[:, 2]).max()) + 0.01 * scale
    turned[:3, 3] = turned[:3, :3] @ np.array([centre[0], centre[1], top])
    half_x, half_y = texel_m * width * form.texel_aspect / 2, texel_m * height / 2
    return Camera(Projection.ORTHOGRAPHIC, turned, width, height, -half_x, half_x, -half_y, half_y)


def points_that_matter(frame: Frame, light: Light, bvh: Bvh, seed: int = 0) -> np.ndarray:
    """(N, 3) points whose sunlight reaches the picture: by one bounce, found by pilot rays, or straight."""
    surface = np.flatnonzero(frame.gbuffer.mask)
    if not len(surface):
        return np.zeros((0, 3), np.float32)
    chosen = surface[np.linspace(0, len(surface) - 1, min(PILOT_PIXELS, len(surface))).astype(np.int64)]
    position = frame.gbuffer.position_ws.reshape(-1, 3)[chosen]
    normal = frame.gbuffer.normal_ws.reshape(-1, 3)[chosen]
    low, high = frame.geometry.bounds_ws
    reach = 2 * float(np.linalg.norm(high - low)) + float(np.abs(position).max())
    offset_m = f32(frame.ray_offset_m)
    hits, lit = lit_hits(position, normal, bvh, vector(-light.direction_ws), PILOT_RAYS, offset_m, f32(reach), seed)
    return hits[lit]


def camera_of(light: Light, frame: Frame, bvh: Bvh, form: ViewFormat) -> Camera | None:
    """The view of a lamp; None for a sun whose light reaches nothing that matters."""
    if light.kind is LightKind.SPOT:
        return spot_camera(light, form)
    if light.kind is not LightKind.SUN:
        return sphere_camera(light, form)
    points = points_that_matter(frame, light, bvh)
    return sun_camera(light, points.astype(np.float64), frame.geometry.bounds_ws, form) if len(points) else None


def clip_range_m(light: Light, camera: Camera, frame: Frame) -> tuple[float, float]:
    """Near and far clip of a lamp's view: from a hair before the lamp to behind everything."""
    low, high = (v.astype(np.float64) for v in frame.geometry.bounds_ws)
    scale = float(np.linalg.norm(high - low))
    farthest = float(np.linalg.norm(np.maximum(np.abs(low - camera.position_ws), np.abs(high - camera.position_ws))))
    # a power of two, so that it does not follow all that moves: depths are rounded with it
    hair = 2.0 ** math.floor(math.log2(max(1e-5 * scale, 1e-6)))
    near = max(light.radius_m, hair) if light.kind in (LightKind.POINT, LightKind.SPOT) else hair
    return near, 2 * farthest + scale + 1e-3


def cast_view(light: Light, camera: Camera, frame: Frame, bvh: Bvh, around: Surroundings) -> GBuffer:
    """What a lamp sees, by rays through the triangles: geometric normals, colours as sampled at the corners.

    `around`: the frame's, by `passes.surroundings`; the same for all lamps.
    """
    rotation = camera.world_from_view[:3, :3].T
    origin, direction = (rays @ rotation for rays in camera.rays_vs())
    return seen_by_rays(origin + camera.position_ws, direction, frame, bvh, around, clip_range_m(light, camera, frame))


def view_of(light_index: int, light: Light, camera: Camera, gbuffer: GBuffer) -> LightView:
    """A captured G-buffer as a light's view, with the flux that each texel takes."""
    flux = texel_flux(light, camera) * gbuffer.mask[..., None]
    return LightView(light_index, camera, gbuffer, flux)
