"""Frames of a few triangles seen from above, made by hand: what tests of direct light look at."""

from __future__ import annotations

import dataclasses

import numpy as np

from rtgi_addon.core.frame import Frame, GBuffer, Geometry, Light, LightKind, LightView
from rtgi_addon.core.radiometry import texel_flux
from rtgi_addon.core.synthetic import cast_view
from rtgi_addon.core.transforms import Camera, Projection


def looking(position: np.ndarray, towards: np.ndarray, up: tuple[float, float, float] = (0.0, 1.0, 0.0)) -> np.ndarray:
    """(4, 4) world_from_view of something at `position` whose -Z looks at `towards`."""
    z = np.asarray(position, float) - np.asarray(towards, float)
    z /= np.linalg.norm(z)
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    out = np.eye(4)
    out[:3, 0], out[:3, 1], out[:3, 2], out[:3, 3] = x, np.cross(z, x), z, position
    return out


def with_matt_views(frame: Frame) -> Frame:
    """`frame` as lamps see it without any gloss."""
    views = (dataclasses.replace(view, gbuffer=dataclasses.replace(
        view.gbuffer, specular=np.zeros_like(view.gbuffer.specular))) for view in frame.views)
    return dataclasses.replace(frame, views=tuple(views))


def quad(centre: tuple[float, float, float], half_x: float, half_y: float) -> np.ndarray:
    """(2, 3, 3) two triangles of a horizontal rectangle."""
    x, y, z = centre
    corner = np.array([[x - half_x, y - half_y, z], [x + half_x, y - half_y, z], [x + half_x, y + half_y, z],
                       [x - half_x, y + half_y, z]])
    return corner[[[0, 1, 2], [0, 2, 3]]]


def geometry_of(*meshes: np.ndarray) -> Geometry:
    """Triangles of a matt grey."""
    corners = np.concatenate(meshes).astype(np.float32)
    return Geometry(corners, np.full(corners.shape, 0.5, np.float32), np.zeros((len(corners), 3), np.float32),
                    np.zeros(len(corners), np.int32))


def view_from(position: np.ndarray, towards: np.ndarray, half_tangent: float, width: int, height: int,
              up: tuple[float, float, float] = (0.0, 1.0, 0.0)) -> Camera:
    """A perspective camera."""
    half_y = half_tangent * height / width
    return Camera(Projection.PERSPECTIVE, looking(position, towards, up), width, height, -half_tangent, half_tangent,
                  -half_y, half_y)


def frame_of(geometry: Geometry | None, seen: GBuffer, camera: Camera, *lights: Light, map_px: int = 0,
             map_half: float = 1.5) -> Frame:
    """A frame; `map_px` > 0 gives every light a square view of that size towards the geometry."""
    views = []
    for index, light in enumerate(lights if map_px else ()):
        edges = (-map_half, map_half, -map_half, map_half)
        if light.kind is LightKind.POINT:
            edges = (-np.pi, np.pi, -np.pi / 2, np.pi / 2)
        projection = {LightKind.POINT: Projection.EQUIRECTANGULAR, LightKind.SUN: Projection.ORTHOGRAPHIC}.get(
            light.kind, Projection.PERSPECTIVE)
        eye = Camera(projection, light.world_from_light, map_px, map_px, *edges)
        views.append(LightView(index, eye, cast_view(eye, geometry), texel_flux(light, eye)))
    return Frame(camera, seen, lights, tuple(views), geometry)


def plane_frame(*lights: Light, width: int = 33, height: int = 33, half_m: float = 2.0, **kwargs) -> Frame:
    """The floor z = 0, looked at from 3 m above."""
    geometry = geometry_of(quad((0, 0, 0), 4 * half_m, 4 * half_m))
    camera = view_from((0, 0, 3), (0, 0, 0), half_m / 3, width, height)
    return frame_of(geometry, cast_view(camera, geometry), camera, *lights, **kwargs)
