"""Visibility from a depth image in float64, one pixel and one direction at a time, as the papers write it.

Everything is done in the world, with positions and normals from the frame and the projection of `core.transforms`; lines of
the screen are walked in small steps, and angles are summed over a fine grid.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from rtgi_addon.core.frame import Frame
from rtgi_addon.core.synthetic import cast_view, make_room_frame
from rtgi_addon.core.transforms import Camera, Projection, normalized
from tests.plane_frames import looking

ANGLES = 360                # of a half circle in which a slice's directions are summed


CAMERAS = ("plain", "shifted", "orthographic")


def room_seen_by(kind: str) -> Frame:
    """The room under a grey sky, 32x24: its own camera, one shifted far with pixels that are not square, or a tilted one."""
    room = make_room_frame(32, 24, kinds=(), world_radiance=1.0)
    camera = room.camera
    if kind == "shifted":
        camera = dataclasses.replace(camera, left=-1.0, right=0.2, bottom=-0.6, top=0.1)
    elif kind == "orthographic":
        place = looking(np.array([1.0, -1.2, 2.4]), np.array([-0.6, 0.8, 0.3]), (0.0, 0.0, 1.0))
        camera = Camera(Projection.ORTHOGRAPHIC, place, 32, 24, -1.2, 1.2, -0.9, 0.9)
    return dataclasses.replace(room, camera=camera, gbuffer=cast_view(camera, room.geometry))


def to_viewer(frame: Frame, point: np.ndarray) -> np.ndarray:
    """Unit vector from a point to the camera."""
    if frame.camera.projection is Projection.ORTHOGRAPHIC:
        return frame.camera.world_from_view[:3, 2]
    return normalized(frame.camera.position_ws - point)


def seen_along(frame: Frame, start: np.ndarray, line: np.ndarray, length: float) -> list[np.ndarray]:
    """Points that the picture shows where a line of the screen crosses columns of pixel centres, or rows if it meets more.

    Such a point lies between two pixels, on the straight line through what they see; beside the sky it lies far off.
    """
    height, width = frame.gbuffer.shape
    camera, depth = frame.camera, frame.gbuffer.depth.astype(float)
    is_parallel = camera.projection is Projection.ORTHOGRAPHIC
    out = []
    for n in range(1, int(length * np.abs(line).max() + 0.5) + 1):
        column, row = start + n / np.abs(line).max() * line - 0.5
        if min(column, row) < -1e-6 or column > width - 1 + 1e-6 or row > height - 1 + 1e-6:
            break
        j0, i0 = int(column + 1e-6), int(row + 1e-6)
        j1, i1 = min(j0 + 1, width - 1), min(i0 + 1, height - 1)
        first, second, part = depth[i0, j0], depth[i0, j1], column - j0
        if abs(line[0]) >= abs(line[1]):
            first, second, part = depth[i0, j0], depth[i1, j0], row - i0
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (1 - part) * first + part * second if is_parallel else 1 / ((1 - part) / first + part / second)
        if np.isfinite(z):
            x, y = camera.left + (column + 0.5) * camera.pixel_size[0], camera.top - (row + 0.5) * camera.pixel_size[1]
            scale = 1.0 if is_parallel else z
            out.append(camera.world_from_view[:3, :3] @ [x * scale, y * scale, -z] + camera.world_from_view[:3, 3])
    return out


def line_of(frame: Frame, point: np.ndarray, side: np.ndarray) -> np.ndarray:
    """(2,) unit direction (columns, rows) in which the screen sees the point move along `side`."""
    eps = 1e-4 * np.linalg.norm(point - frame.camera.position_ws)
    ahead, behind = (np.array(frame.camera.project(point + t * side)[:2]) for t in (eps, -eps))
    return normalized(np.append(ahead - behind, 0.0))[:2]


def exit_of(frame: Frame, start: np.ndarray, line: np.ndarray) -> float:
    """Pixels from `start` to the picture's edge."""
    height, width = frame.gbuffer.shape
    with np.errstate(divide="ignore"):
        ways = [(width - start[0]) / line[0], -start[0] / line[0], (height - start[1]) / line[1], -start[1] / line[1]]
    return min(w for w in ways if w > 0)


def farthest_px(frame: Frame, point: np.ndarray, viewer: np.ndarray, side: np.ndarray, radius: float) -> float:
    """Pixels to the farthest point of the half circle around `point` in the slice, on the side of `side`."""
    angle = np.linspace(0, np.pi, 2001)[:, None]
    circle = point + radius * (np.cos(angle) * viewer + np.sin(angle) * side)
    column, row, depth = frame.camera.project(circle)
    start = frame.camera.project(point)
    if (depth <= 0).any() and frame.camera.projection is Projection.PERSPECTIVE:
        return math.inf
    return float(np.hypot(column - start[0], row - start[1]).max())


def sector_visibility(frame: Frame, i: int, j: int, radius: float, thickness: float,
                      slices: int) -> tuple[float, np.ndarray]:
    """(cosine-weighted visibility of pixel (i, j), its mean open direction times that) by slices around the viewer.

    A direction of a slice is closed where it enters a sheet: a point seen on the slice's line and what lies up to
    `thickness` behind it on the camera's ray, inside the sphere of `radius`.
    Slices weigh what of their taps lies in the picture, for taps at distances (on + on^2) / 2 of the way to the rim.
    """
    p, n = frame.gbuffer.position_ws[i, j].astype(float), frame.gbuffer.normal_ws[i, j].astype(float)
    start, viewer = np.array([j + 0.5, i + 0.5]), to_viewer(frame, p)
    first = normalized(np.cross(viewer, [0.36, 0.48, 0.8]))
    second = np.cross(viewer, first)
    light, open_light, bent = 0.0, 0.0, np.zeros(3)
    for k in range(slices):
        phi = math.pi * (k + 0.5) / slices
        side = math.cos(phi) * first + math.sin(phi) * second
        n_p = np.array([n @ viewer, n @ side])
        g = math.atan2(n_p[1], n_p[0])
        t = g + np.pi * ((np.arange(ANGLES) + 0.5) / ANGLES - 0.5)
        weight = np.linalg.norm(n_p) * np.cos(t - g) * np.abs(np.sin(t)) * np.pi / ANGLES
        is_open = np.ones(ANGLES, bool)
        known = 0.0
        for way in (-1.0, 1.0):
            line = line_of(frame, p, way * side)
            reach, end = farthest_px(frame, p, viewer, way * side, radius), exit_of(frame, start, line)
            known += (math.sqrt(0.25 + 2 * min(1.0, end / reach)) - 0.5) / 2
            for q in seen_along(frame, start, line, min(reach, end)):
                d = q - p
                if np.linalg.norm(d) >= radius:
                    continue
                flat = np.array([d @ viewer, d @ side])
                ray = np.array([-1.0, 0.0])
                if frame.camera.projection is Projection.PERSPECTIVE:
                    ray = normalized(flat - [np.linalg.norm(p - frame.camera.position_ws), 0.0], (0.0, 0.0))
                b = flat @ ray
                inside = math.sqrt(max(b * b + radius**2 - flat @ flat, 0.0)) - b
                rear = flat + min(thickness, inside) * ray
                a0, a1 = math.atan2(flat[1], flat[0]), math.atan2(rear[1], rear[0])
                if flat @ n_p <= 0:
                    a0 = g + way * np.pi / 2
                if rear @ n_p <= 0:
                    a1 = g + way * np.pi / 2
                is_open &= ~((t > min(a0, a1)) & (t < max(a0, a1)))
        open_light += known * weight.sum()
        light += known * weight[is_open].sum()
        open_t, open_w = t[is_open], known * weight[is_open]
        bent += (open_w @ np.cos(open_t)) * viewer + (open_w @ np.sin(open_t)) * side
    return light / open_light, bent / open_light


def published_visibility(frame: Frame, i: int, j: int, radius: float, bias: float, has_falloff: bool,
                         directions: int) -> float:
    """Visibility of pixel (i, j) by horizons: 1 - 1 / (2 pi) sum (sin h_m - sin h_{m-1}) W_m dtheta (Bavoil et al. 2008).

    Elevations over the view's XY plane, along evenly turned lines of the image plane.
    """
    to_view = frame.camera.view_from_world
    g, camera = frame.gbuffer, frame.camera
    p = to_view[:3, :3] @ g.position_ws[i, j].astype(float) + to_view[:3, 3]
    n = to_view[:3, :3] @ g.normal_ws[i, j].astype(float)
    start = np.array([j + 0.5, i + 0.5])
    step_x, step_y = camera.pixel_size
    is_parallel = camera.projection is Projection.ORTHOGRAPHIC

    def on_plane(place: np.ndarray, height: float) -> np.ndarray:
        """The view-space point seen at a place of the screen that lies `height` over the tangent plane."""
        x, y = camera.left + place[0] * step_x, camera.top - place[1] * step_y
        origin, ray = np.array([x, y, 0.0]), np.array([0, 0, -1.0])
        if not is_parallel:
            origin, ray = np.zeros(3), np.array([x, y, -1.0])
        return origin + (n @ p + height - n @ origin) / (n @ ray) * ray

    total, known = 0.0, 0.0
    for k in range(directions):
        theta = 2 * math.pi * (k + 0.5) / directions
        line = np.array([math.cos(theta) / step_x, -math.sin(theta) / step_y]) / (1.0 if is_parallel else -p[2])
        rate = np.linalg.norm(line)
        line = line / rate
        reach, end = radius * rate, exit_of(frame, start, line)
        tangent = on_plane(start + 1e-4 * line, 0.0) - p
        horizon = math.sin(math.atan2(tangent[2], np.hypot(tangent[0], tangent[1])) + bias)
        closed = 0.0
        for q in seen_along(frame, start, line, min(reach, end)):
            d = to_view[:3, :3] @ q + to_view[:3, 3] - p
            r = np.linalg.norm(d)
            if r < radius and d[2] / r > horizon:
                closed += (d[2] / r - horizon) * (1 - (r / radius)**2 if has_falloff else 1.0)
                horizon = d[2] / r
        total += min(1.0, end / reach) * closed
        known += min(1.0, end / reach)
    return 1 - total / known


def ball_visibility(frame: Frame, i: int, j: int, radius: float, points: np.ndarray) -> float:
    """min(1, 2 x share of `points` (N, 3) of the unit ball around pixel (i, j) that the picture shows) (Mittring 2007)."""
    at = frame.gbuffer.position_ws[i, j].astype(float) + radius * points
    column, row, depth = frame.camera.project(at)
    height, width = frame.gbuffer.shape
    inside = (depth > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    shown = frame.gbuffer.depth[row[inside].astype(int), column[inside].astype(int)]
    return min(1.0, 2 * float(np.mean(shown >= depth[inside])))
