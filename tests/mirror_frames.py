"""Frames with glossy surfaces, made without Blender, and the light that reflections take from earlier techniques."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from rtgi_addon.core.frame import NORMAL_STEPS, Frame, GBuffer, Geometry, Light, LightKind, Material
from rtgi_addon.core.synthetic import cast_view, make_room_frame
from rtgi_addon.core.techniques import DirectParams
from rtgi_addon.core.transforms import Camera, Projection
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.direct import compute_direct
from tests.plane_frames import looking


def room_from_above(width: int, height: int, kinds: Sequence[LightKind] = (LightKind.SPOT,), **room) -> Frame:
    """The room of `core.synthetic`, seen such that most of the picture is floor; lamps have no views."""
    whole = make_room_frame(24, 16, kinds, **room)
    camera = camera_at((0.6, -1.8, 1.6), (0.3, 0.9, 0.0), width, height, half=0.5)
    frame = scene_frame(camera, whole.geometry, *whole.lights, materials=whole.materials)
    return dataclasses.replace(frame, world=whole.world)


def glossy(frame: Frame, where: np.ndarray, roughness: float, specular: float = 1.0) -> Frame:
    """The frame with glossy pixels where `where` (H, W) is True, and none elsewhere."""
    g = frame.gbuffer
    colour = np.where(where[..., None], np.float32(specular), np.float32(0)) * np.ones(3, np.float32)
    return dataclasses.replace(frame, gbuffer=dataclasses.replace(
        g, specular=np.ascontiguousarray(colour, np.float32),
        roughness=np.where(where, np.float32(roughness), np.float32(1)).astype(np.float32)))


def on_floor(frame: Frame) -> np.ndarray:
    """(H, W) bool: the pixels of the plane z = 0."""
    g = frame.gbuffer
    return g.mask & (np.abs(g.position_ws[..., 2]) < 1e-3) & (g.normal_ws[..., 2] > 0.99)


def lit(frame: Frame) -> Context:
    """A context that holds the direct light of the frame's lamps."""
    context = Context()
    context.light = dict(compute_direct(frame, DirectParams(soft_shadow_rays=64), context, 0).light)
    return context


def painted(frame: Frame, image: np.ndarray) -> Context:
    """A context whose pixels send out `image` (H, W, 3) and nothing else."""
    context = Context()
    albedo = np.maximum(frame.gbuffer.albedo, 1e-6)
    context.light = {Transport.EMISSION_DIFFUSE: np.ascontiguousarray(image * np.pi / albedo, np.float32)}
    return context


def pixel_places(frame: Frame) -> np.ndarray:
    """(H, W, 3): column and row of each pixel's centre, and 1: what a reflection shows then tells where its ray hit."""
    height, width = frame.gbuffer.shape
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack([column, row, np.ones_like(row)], -1)


def wall(x_range: tuple[float, float], y: float, z_range: tuple[float, float]) -> np.ndarray:
    """(2, 3, 3) triangles of an upright rectangle that faces -Y."""
    (x0, x1), (z0, z1) = x_range, z_range
    corner = np.array([[x0, y, z0], [x1, y, z0], [x1, y, z1], [x0, y, z1]])
    return corner[[[0, 1, 2], [0, 2, 3]]]


def coarse_ball(centre: tuple[float, float, float], radius: float, sides: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3, 3) triangles of a ball of `sides` by half as many facets, and (T, 3, 3) the ball's normals at their corners."""
    rows = sides // 2
    across, down = 2 * np.pi * np.arange(sides + 1) / sides, np.pi * np.arange(rows + 1) / rows
    out = np.stack([np.outer(np.sin(down), np.cos(across)), np.outer(np.sin(down), np.sin(across)),
                    np.outer(np.cos(down), np.ones(sides + 1))], -1)
    quads = np.stack([out[:-1, :-1], out[1:, :-1], out[1:, 1:], out[:-1, 1:]], 2).reshape(-1, 4, 3)
    normals = np.concatenate([quads[sides:, [0, 2, 3]], quads[:-sides, [0, 1, 2]]])       # at the poles there is one each
    return np.array(centre) + radius * normals, normals


def shaded_smooth(geometry: Geometry, normals_ws: np.ndarray) -> Geometry:
    """The triangles with unit normals (T, 3, 3) at their corners; zeros are flat."""
    return dataclasses.replace(geometry, normals_ws=np.rint(NORMAL_STEPS * normals_ws).astype(np.int16))


def camera_at(position: tuple[float, float, float], towards: tuple[float, float, float], width: int, height: int,
              half: float = 0.6, projection: Projection = Projection.PERSPECTIVE,
              shift: tuple[float, float] = (0.0, 0.0)) -> Camera:
    """A camera with Z up; `half` is half its width, a tangent or for an orthographic one metres."""
    half_y = half * height / width
    return Camera(projection, looking(position, towards, (0.0, 0.0, 1.0)), width, height, shift[0] - half, shift[0] + half,
                  shift[1] - half_y, shift[1] + half_y)


def scene_frame(camera: Camera, geometry: Geometry, *lights: Light, materials: tuple[Material, ...] = ()) -> Frame:
    """A frame of flat triangles in a black world."""
    kinds = materials or (Material("matt", (0.5, 0.5, 0.5), (0.0, 0.0, 0.0), 1.0),)
    seen: GBuffer = cast_view(camera, geometry, kinds)
    return Frame(camera, seen, lights, (), geometry, kinds)
