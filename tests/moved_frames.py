"""A frame turned, mirrored, shifted or scaled as a whole, and split into two parts of its light: what laws are tried on."""

from __future__ import annotations

import dataclasses

import numpy as np

from rtgi_addon.core.frame import Frame, GBuffer, Light, LightKind, LightView, World
from rtgi_addon.core.radiometry import texel_directions
from rtgi_addon.core.transforms import Camera, Projection

MIRROR = np.diag([-1.0, 1.0, 1.0])
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
NOWHERE = np.zeros(3)


def turn(axis: tuple[float, float, float], angle_rad: float) -> np.ndarray:
    """(3, 3) rotation about an axis."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle_rad) * k + (1 - np.cos(angle_rad)) * k @ k


def _turned_world(world: World, motion: np.ndarray) -> World:
    """The map in turned or mirrored axes: exact for what maps its texels to each other."""
    if world.is_constant:
        return world
    height, width = world.radiance.shape[:2]
    here, _ = texel_directions(height, width)
    there = here @ motion                                       # motion^T d: where the light came from
    longitude, latitude = np.arctan2(there[..., 0], there[..., 1]), np.arcsin(np.clip(there[..., 2], -1, 1))
    column = np.floor((longitude / np.pi + 1) / 2 * width + 1e-6).astype(int) % width
    row = np.clip(np.floor((0.5 - latitude / np.pi) * height), 0, height - 1).astype(int)
    return World(np.ascontiguousarray(world.radiance[row, column]))


def moved(frame: Frame, motion: np.ndarray, shift: np.ndarray = NOWHERE, scale: float = 1.0) -> Frame:
    """The frame turned or mirrored by `motion` (3, 3), scaled, then shifted by (3,) m; every irradiance stays.

    Lamps send `scale`^2 of their flux, so that what arrives on a surface is the same. A mirror also turns every picture
    from left to right, since cameras stay right-handed.
    """
    is_mirror = np.linalg.det(motion) < 0
    flip = MIRROR if is_mirror else np.eye(3)

    def matrix(m: np.ndarray) -> np.ndarray:
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = motion @ m[:3, :3] @ flip, scale * motion @ m[:3, 3] + shift
        return out

    def image(values: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(values[:, ::-1] if is_mirror else values, np.float32)

    def points(values: np.ndarray) -> np.ndarray:
        return (scale * values.astype(float) @ motion.T + shift).astype(np.float32)

    def eye(c: Camera) -> Camera:
        flat = scale if c.projection is Projection.ORTHOGRAPHIC else 1.0
        left, right = (-c.right, -c.left) if is_mirror else (c.left, c.right)
        return dataclasses.replace(c, world_from_view=matrix(c.world_from_view), left=flat * left, right=flat * right,
                                   bottom=flat * c.bottom, top=flat * c.top)

    def seen(g: GBuffer) -> GBuffer:
        return GBuffer(image(scale * g.depth), image(np.where(g.mask[..., None], points(g.position_ws), 0)),
                       image(g.normal_ws.astype(float) @ motion.T), image(g.albedo), image(g.specular), image(g.roughness),
                       image(g.emission))

    def lamp(x: Light) -> Light:
        is_intensity = x.kind in (LightKind.POINT, LightKind.SPOT)
        return dataclasses.replace(
            x, world_from_light=matrix(x.world_from_light), power=x.power * (scale**2 if is_intensity else 1.0),
            radius_m=scale * x.radius_m, size_x_m=scale * x.size_x_m, size_y_m=scale * x.size_y_m)

    views = tuple(LightView(v.light_index, eye(v.camera), seen(v.gbuffer), image(scale**2 * v.incident_flux))
                  for v in frame.views)
    geometry = dataclasses.replace(frame.geometry, corners_ws=points(frame.geometry.corners_ws))
    return dataclasses.replace(frame, camera=eye(frame.camera), gbuffer=seen(frame.gbuffer), views=views, geometry=geometry,
                               lights=tuple(map(lamp, frame.lights)), world=_turned_world(frame.world, motion))
