"""Directional occlusion in float64, as the integrals and the paper read: every direction followed through the triangles.

`seen_light` is what both forms approximate where the screen shows all that matters; `published_light` is the estimator of
Ritschel, Grosch and Seidel (2009), sample by sample.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from rtgi_addon.core.frame import Frame
from rtgi_addon.core.synthetic import cast_view, nearest_hit
from rtgi_addon.core.transforms import Camera, Projection
from rtgi_addon.kernels.sampling import r2_sequence, uniform
from tests.plane_frames import geometry_of, looking, quad, view_from

RINGS, TURNS = 48, 96       # directions of the hemisphere: their sum is off by 0.1 % where a wall cuts it


def upright(corner: tuple[float, float], along: tuple[float, float], height_m: float) -> np.ndarray:
    """(2, 3, 3) triangles of a wall over the edge from `corner` by `along` in the plane z = 0."""
    (x, y), (a, b) = corner, along
    corners = np.array([[x, y, 0], [x + a, y + b, 0], [x + a, y + b, height_m], [x, y, height_m]], float)
    return corners[[[0, 1, 2], [0, 2, 3]]]


def corner_frame(kind: str, width: int = 96, height: int = 64) -> tuple[Frame, np.ndarray]:
    """A floor of 2 m by 2 m with two walls of 1.2 m, all of it seen, and what light falls on each pixel, (H, W, 3) W/m2.

    The floor gets white light, one wall red, the other green; `kind` is "perspective", "orthographic" or "shifted".
    """
    floor = quad((1, 1, 0), 1, 1)
    geometry = geometry_of(floor, upright((0, 0), (2, 0), 1.2), upright((0, 2), (0, -2), 1.2))
    eye, aim = np.array([4.0, 5.0, 4.2]), np.array([0.8, 0.8, 0.35])
    if kind == "orthographic":
        half = 2.3
        camera = Camera(Projection.ORTHOGRAPHIC, looking(eye, aim, (0, 0, 1)), width, height, -half, half,
                        -half * height / width, half * height / width)
    else:
        camera = view_from(eye, aim, 0.36, width, height, (0, 0, 1))
    if kind == "shifted":
        turned = view_from(eye, (1.6, 0.4, 0.5), 0.36, width, height, (0, 0, 1))
        camera = dataclasses.replace(turned, left=-0.28, right=0.56, bottom=-0.30, top=0.26)
    seen = cast_view(camera, geometry)
    seen = dataclasses.replace(seen, albedo=np.where(seen.mask[..., None], np.full(3, 0.5, np.float32), np.float32(0)))
    corners = camera.project(np.array(geometry.corners_ws.reshape(-1, 3), float))
    assert all((c > 0).all() and (c < size).all() for c, size in zip(corners, (width, height), strict=False))
    light = np.ones((height, width, 3), np.float32)
    light[np.abs(seen.normal_ws[..., 1]) > 0.5] = (2.0, 0.2, 0.2)
    light[np.abs(seen.normal_ws[..., 0]) > 0.5] = (0.2, 2.0, 0.2)
    return Frame(camera, seen, (), (), geometry), light * seen.mask[..., None]


def hemisphere(normal: np.ndarray) -> tuple[np.ndarray, float]:
    """Unit directions (N, 3) of equal cosine-weighted measure around `normal`, and that measure: pi / N."""
    radius, phi = np.meshgrid(np.sqrt((np.arange(RINGS) + 0.5) / RINGS), 2 * np.pi * (np.arange(TURNS) + 0.5) / TURNS)
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    x = np.cross(normal, helper)
    x /= np.linalg.norm(x)
    y = np.cross(normal, x)
    out = ((radius * np.cos(phi))[..., None] * x + (radius * np.sin(phi))[..., None] * y
           + np.sqrt(1 - radius**2)[..., None] * normal)
    return out.reshape(-1, 3), np.pi / (RINGS * TURNS)


def seen_light(frame: Frame, radiance: np.ndarray, pixel: tuple[int, int], radius_m: float) -> tuple[np.ndarray, float]:
    """(irradiance (3,) W/m2 from surfaces within `radius_m`, share of the hemisphere that they leave open) of a pixel.

    A surface sends `radiance` (H, W, 3) of the pixel that shows it, if one does and it faces the receiver.
    """
    g = frame.gbuffer
    position, normal = g.position_ws[pixel].astype(float), g.normal_ws[pixel].astype(float)
    direction, measure = hemisphere(normal)
    start = np.broadcast_to(position + 1e-5 * normal, direction.shape)
    distance, _ = nearest_hit(start, direction, frame.geometry.corners_ws)
    near = distance <= radius_m
    hit = position + distance[near, None] * direction[near]
    column, row, depth = frame.camera.project(hit)
    height, width = g.shape
    inside = (depth > 0) & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    j, i = np.where(inside, column, 0).astype(int), np.where(inside, row, 0).astype(int)
    shown = inside & (np.abs(g.depth[i, j] - depth) < 0.02 * depth)
    facing = np.einsum("ij,ij->i", g.normal_ws[i, j].astype(float), direction[near]) < 0
    return measure * radiance[i, j][shown & facing].sum(0), float(1 - near.mean())


def published_light(frame: Frame, radiance: np.ndarray, pixel: tuple[int, int], radius_m: float, samples: int, seed: int,
                    ) -> tuple[np.ndarray, float, float]:
    """(bounce (3,) W/m2, world's irradiance per unit of its radiance, least distance of a sample to a pixel's edge in px).

    Ritschel, Grosch and Seidel 2009, Eq. 1 and 2, with the paper's d clamped to where a patch fills the hemisphere.
    """
    g = frame.gbuffer
    height, width = g.shape
    number = pixel[0] * width + pixel[1]
    position, normal = g.position_ws[pixel].astype(float), g.normal_ws[pixel].astype(float)
    sign = 1.0 if normal[2] >= 0 else -1.0
    a = -1 / (sign + normal[2])
    b = normal[0] * normal[1] * a
    x = np.array([1 + sign * normal[0] ** 2 * a, sign * b, -sign * normal[0]])
    y = np.array([b, sign + normal[1] ** 2 * a, -normal[1]])
    area = np.pi * radius_m**2 / samples
    bounce, world, edge = np.zeros(3), 0.0, 1.0
    for k in range(samples):
        u, v = (float(n) for n in r2_sequence(k, uniform(number, seed, 0), uniform(number, seed, 1)))
        direction = np.sqrt(1 - u * u) * (np.cos(2 * np.pi * v) * x + np.sin(2 * np.pi * v) * y) + u * normal
        column, row, depth = frame.camera.project(position + radius_m * float(uniform(number, seed, 2 + k)) * direction)
        edge = min(edge, abs(column - round(float(column))), abs(row - round(float(row))))
        inside = depth > 0 and 0 <= column < width and 0 <= row < height
        i, j = (int(row), int(column)) if inside else (0, 0)
        if not inside or g.depth[i, j] >= depth:
            world += 2 * np.pi / samples * u
            continue
        away = g.position_ws[i, j].astype(float) - position
        d2 = away @ away
        if d2 == 0:                              # the pixel itself: edge on
            continue
        cos_r, cos_s = normal @ away / np.sqrt(d2), -g.normal_ws[i, j].astype(float) @ away / np.sqrt(d2)
        bounce += radiance[i, j] * area * max(cos_r, 0) * max(cos_s, 0) / max(d2, area / np.pi)
    return bounce, world, edge
