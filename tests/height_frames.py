"""Frames without triangles, from a function of height or from planes: what closed forms of visibility are held against."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from rtgi_addon.core.frame import Frame, GBuffer, World
from rtgi_addon.core.transforms import Camera, Projection, normalized

WHITE = World(np.ones((1, 1, 3), np.float32))


def frame_from(camera: Camera, depth: np.ndarray, normal_ws: np.ndarray, albedo: float = 0.5, world: World = WHITE) -> Frame:
    """A frame of one matt grey under a world; `normal_ws` (H, W, 3) or (3,)."""
    depth = np.asarray(depth, np.float32)
    colour = np.full((*depth.shape, 3), np.float32(albedo))
    normal = np.ascontiguousarray(np.broadcast_to(normal_ws, colour.shape), np.float32)
    seen = GBuffer(depth, camera.positions_ws(depth), normal, colour, np.zeros_like(colour), np.ones_like(depth),
                   np.zeros_like(colour))
    return Frame(camera, seen, world=world)


def height_frame(height: Callable[[np.ndarray, np.ndarray], np.ndarray], size_px: int, half_m: float, place: float = 50.0,
                 **kwargs) -> Frame:
    """z = height(x, y) seen straight from above by an orthographic camera, with the normals of its slope.

    The middle of the picture is the middle of a pixel for an odd `size_px`. Steps are walls: pixels beside one have the
    normal of the side that they lie on, taken from the neighbour of like height.
    """
    above = np.eye(4)
    above[2, 3] = place
    camera = Camera(Projection.ORTHOGRAPHIC, above, size_px, size_px, -half_m, half_m, -half_m, half_m)
    x, y = np.meshgrid(*camera.pixel_centres())
    z = height(x, y)
    eps = 1e-4 * half_m / size_px
    slopes = []
    for dx, dy in ((eps, 0), (0, eps)):
        ahead, behind = (height(x + dx, y + dy) - z) / eps, (z - height(x - dx, y - dy)) / eps
        slopes.append(np.where(np.abs(ahead) < np.abs(behind), ahead, behind))
    normal = normalized(np.stack([-slopes[0], -slopes[1], np.ones_like(z)], -1))
    return frame_from(camera, place - z, normal, **kwargs)


def planes_frame(camera: Camera, planes: list[tuple[np.ndarray, np.ndarray]], **kwargs) -> Frame:
    """The union of the solids below planes (point, outward normal), as the camera sees it: nearest boundary from outside.

    A ray meets the union's boundary where it first is below any plane.
    """
    origin_vs, direction_vs = camera.rays_vs()
    rotation = camera.world_from_view[:3, :3]
    origin, direction = origin_vs @ rotation.T + camera.position_ws, direction_vs @ rotation.T
    depth, normal = np.full(origin.shape[:2], np.inf), np.tile(np.array([0.0, 0.0, 1.0]), (*origin.shape[:2], 1))
    for point, n in planes:
        n = normalized(np.asarray(n, float))
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (np.asarray(point) - origin) @ n / (direction @ n)
        hit = (t > 0) & (direction @ n < 0) & (t < depth)
        depth[hit], normal[hit] = t[hit], n
    return frame_from(camera, depth, normal, **kwargs)
