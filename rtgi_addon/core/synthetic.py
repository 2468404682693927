"""A small room as a complete frame, made without Blender: for warming up kernels and for tests.

The room is a closed box with a smaller box standing in it: 4 m wide, 4 m deep, 3 m high, a red wall to the left, a green
one to the right, a glossy floor. The views are ray-cast in float64 here, so they owe nothing to the kernels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from . import radiometry
from .frame import Frame, GBuffer, Geometry, Light, LightKind, LightView, Material, World
from .transforms import Camera, Projection, normalized

ROOM_LOW, ROOM_HIGH = np.array([-2.0, -2.0, 0.0]), np.array([2.0, 2.0, 3.0])
BOX_LOW, BOX_HIGH = np.array([-1.0, 0.2, 0.0]), np.array([-0.1, 1.1, 1.4])
LAMP_POSITION = np.array([0.4, -0.3, 2.8])

_MATERIALS = (
    Material("white", (0.75, 0.75, 0.75), (0.0, 0.0, 0.0), 1.0),
    Material("red", (0.7, 0.1, 0.1), (0.0, 0.0, 0.0), 1.0),
    Material("green", (0.1, 0.6, 0.15), (0.0, 0.0, 0.0), 1.0),
    Material("glossy floor", (0.5, 0.5, 0.5), (0.05, 0.05, 0.05), 0.3),
)
_WHITE, _RED, _GREEN, _FLOOR = range(4)


def box_triangles(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(12, 3, 3) float64 corners of an axis-aligned box: two triangles for each of -x, +x, -y, +y, -z, +z."""
    quads = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (low, high):
            corner = np.empty((4, 3))
            corner[:, axis] = side[axis]
            corner[:, u] = [low[u], high[u], high[u], low[u]]
            corner[:, v] = [low[v], low[v], high[v], high[v]]
            quads += [corner[[0, 1, 2]], corner[[0, 2, 3]]]
    return np.array(quads)


def _rotation(x: Sequence[float], y: Sequence[float], z: Sequence[float], position: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, 0], out[:3, 1], out[:3, 2], out[:3, 3] = x, y, z, position
    return out


def _room_geometry(has_ceiling: bool) -> Geometry:
    room, box = box_triangles(ROOM_LOW, ROOM_HIGH), box_triangles(BOX_LOW, BOX_HIGH)
    material = np.array([_RED] * 2 + [_GREEN] * 2 + [_WHITE] * 4 + [_FLOOR] * 2 + [_WHITE] * 2 + [_WHITE] * 12, np.int32)
    if not has_ceiling:
        room, material = room[:10], np.delete(material, [10, 11])
    corners = np.ascontiguousarray(np.concatenate([room, box]), np.float32)
    albedo = np.array([m.albedo for m in _MATERIALS], np.float32)[material]
    return Geometry(corners, np.ascontiguousarray(np.repeat(albedo[:, None], 3, 1)),
                    np.zeros((len(corners), 3), np.float32), material)


def nearest_hit(origin: np.ndarray, direction: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First triangle along each ray by the test of Moeller and Trumbore (1997), two-sided.

    `origin` and `direction` are (N, 3), `corners` (T, 3, 3). Returns t (N,) in units of `direction`, +inf for none, and
    the triangle (N,), -1 for none.
    """
    best = np.full(len(origin), np.inf)
    triangle = np.full(len(origin), -1)
    for index, (a, b, c) in enumerate(np.asarray(corners, np.float64)):
        edge1, edge2 = b - a, c - a
        p = np.cross(direction, edge2)
        det = p @ edge1
        with np.errstate(divide="ignore", invalid="ignore"):
            offset = origin - a
            u = np.einsum("ij,ij->i", offset, p) / det
            q = np.cross(offset, edge1)
            v = np.einsum("ij,ij->i", direction, q) / det
            t = q @ edge2 / det
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9) & (t < best)
        best[hit], triangle[hit] = t[hit], index
    return best, triangle


def cast_view(camera: Camera, geometry: Geometry, materials: Sequence[Material] = _MATERIALS,
              background: np.ndarray | None = None) -> GBuffer:
    """What `camera` sees of flat-shaded triangles; `background` (3,) is the world's radiance, None for black."""
    origin_vs, direction_vs = camera.rays_vs()
    rotation = camera.world_from_view[:3, :3]
    origin = origin_vs.reshape(-1, 3) @ rotation.T + camera.position_ws
    direction = direction_vs.reshape(-1, 3) @ rotation.T
    depth, triangle = nearest_hit(origin, direction, geometry.corners_ws)
    seen = triangle >= 0
    corners = np.asarray(geometry.corners_ws, np.float64)
    face = normalized(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    normal = face[triangle]
    normal *= np.where(np.einsum("ij,ij->i", normal, direction) > 0, -1.0, 1.0)[:, None]
    kind = geometry.material[triangle]
    shape = (camera.height_px, camera.width_px)

    def image(values: np.ndarray, nothing: np.ndarray | float) -> np.ndarray:
        mask = seen if values.ndim == 1 else seen[:, None]
        return np.ascontiguousarray(np.where(mask, values, nothing).reshape(shape + values.shape[1:]), np.float32)

    depth_image = depth.reshape(shape).astype(np.float32)
    return GBuffer(
        depth=depth_image, position_ws=camera.positions_ws(depth_image), normal_ws=image(normal, np.array([0.0, 0, 1])),
        albedo=image(np.array([m.albedo for m in materials])[kind], 0.0),
        specular=image(np.array([m.specular for m in materials])[kind], 0.0),
        roughness=image(np.array([m.roughness for m in materials])[kind], 1.0),
        emission=image(geometry.emission[triangle].astype(np.float64), np.zeros(3) if background is None else background))


def room_light(kind: LightKind, radius_m: float = 0.05) -> Light:
    """A lamp of about 100 W under the room's ceiling, shining down; `radius_m` 0 makes it hard."""
    down = _rotation([1, 0, 0], [0, 1, 0], [0, 0, 1], LAMP_POSITION)
    size = 2 * radius_m
    white = np.ones(3)
    if kind is LightKind.SUN:
        return Light("Sun", kind, down, white * radiometry.sun_irradiance(3.0, 2 * radius_m, True), angle_rad=2 * radius_m)
    if kind.is_area:
        size = size or 0.1
        power = radiometry.area_radiance(100.0, radiometry.area_of(kind, size, size), True)
        return Light("Area", kind, down, white * power, size_x_m=size, size_y_m=size)
    power = white * radiometry.point_intensity(100.0, radius_m, True)
    if kind is LightKind.SPOT:
        return Light("Spot", kind, down, power, radius_m, spot_size_rad=math.radians(110), spot_blend=0.2)
    return Light("Point", kind, down, power, radius_m)


def light_camera(light: Light, width_px: int, height_px: int) -> Camera:
    """A view from the lamp that holds all it can light of the room."""
    size = (width_px, height_px)
    if light.kind is LightKind.POINT:
        edges = (-math.pi, math.pi, -math.pi / 2, math.pi / 2)
        return Camera(Projection.EQUIRECTANGULAR, light.world_from_light, *size, *edges)
    if light.kind is LightKind.SUN:
        above = light.world_from_light.copy()
        above[:3, 3] = [0.0, 0.0, 10.0]
        return Camera(Projection.ORTHOGRAPHIC, above, *size, -2.05, 2.05, -2.05, 2.05)
    half = math.tan(light.spot_size_rad / 2 if light.kind is LightKind.SPOT else math.radians(75))
    return Camera(Projection.PERSPECTIVE, light.world_from_light, *size, -half, half, -half, half)


def make_room_frame(width_px: int = 32, height_px: int = 24, kinds: Sequence[LightKind] = (LightKind.SPOT,),
                    light_radius_m: float = 0.05, world_radiance: float = 0.0, has_ceiling: bool | None = None) -> Frame:
    """The room with one lamp of each of `kinds`, each with its view, and a constant grey world.

    Without a word about the ceiling it is left off exactly when a sun or the world has to shine in. Views of lamps are
    square, as high as the picture.
    """
    if has_ceiling is None:
        has_ceiling = world_radiance == 0 and LightKind.SUN not in kinds
    geometry = _room_geometry(has_ceiling)
    tangent = math.tan(math.radians(35))
    camera = Camera(Projection.PERSPECTIVE, _rotation([1, 0, 0], [0, 0, 1], [0, -1, 0], np.array([0.0, -1.9, 1.5])),
                    width_px, height_px, -tangent, tangent, -tangent * height_px / width_px, tangent * height_px / width_px)
    lights = tuple(room_light(kind, light_radius_m) for kind in kinds)
    sky = np.full(3, world_radiance)
    views = []
    for index, light in enumerate(lights):
        view = light_camera(light, height_px, height_px)
        views.append(LightView(index, view, cast_view(view, geometry), radiometry.texel_flux(light, view)))
    world = World(np.full((1, 1, 3), world_radiance, np.float32))
    return Frame(camera, cast_view(camera, geometry, background=sky), lights, tuple(views), geometry, _MATERIALS, world)
