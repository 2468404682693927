"""Direct light in float64, as the equations read: a lamp cut into many patches, each a point with its own shadow ray.

    E(x) = sum over patches of dE_facing max(0, n . w) V(x, patch)

with dE_facing = I f(w) / N cos_lamp / r^2 for a disk that turns towards x, E / N for a sun, L dA cos_lamp / r^2 for an area.
"""

from __future__ import annotations

import numpy as np

from rtgi_addon.core.frame import Frame, Light, LightKind
from rtgi_addon.core.radiometry import spot_falloff, spread_factor
from rtgi_addon.core.synthetic import nearest_hit


def _disk_points(rings: int) -> np.ndarray:
    """(N, 2) points that share the unit disk evenly: ring k of 6 k + 3 points at the middle radius of its area."""
    out = []
    for k in range(rings):
        count, radius = 6 * k + 3, (k + 0.5) / rings
        inner, outer = k / rings, (k + 1) / rings
        radius = np.sqrt((inner**2 + outer**2) / 2)
        phi = 2 * np.pi * (np.arange(count) + 0.5 * (k % 2)) / count
        share = (outer**2 - inner**2) / count
        out.append(np.stack([radius * np.cos(phi), radius * np.sin(phi), np.full(count, share)], 1))
    return np.concatenate(out)


def _square_points(steps: int) -> np.ndarray:
    centre = (np.arange(steps) + 0.5) / steps * 2 - 1
    x, y = np.meshgrid(centre, centre)
    return np.stack([x.ravel(), y.ravel(), np.full(steps * steps, 1 / steps**2)], 1)


def patches(light: Light, x: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Vectors (N, 3) from the point x to patches of the lamp (unit for a sun), and the irradiance (N,) each brings to a
    plane that faces it, for a lamp of unit power."""
    axis_x, axis_y, axis_z = light.world_from_light[:3, 0], light.world_from_light[:3, 1], light.world_from_light[:3, 2]
    if light.kind is LightKind.SUN:
        points = _disk_points(steps)
        # radiance E / (pi sin^2) over the cone, cut into parts of equal projection along its axis
        side = np.sin(light.angle_rad / 2) * points[:, :2]
        rise = np.sqrt(1 - (side**2).sum(1))
        d = rise[:, None] * axis_z + side[:, :1] * axis_x + side[:, 1:] * axis_y
        return d, points[:, 2] / rise
    to = light.position_ws - x
    if light.kind.is_area:
        points = _square_points(steps) if light.kind is LightKind.RECTANGLE else _disk_points(steps)
        area = light.size_x_m * light.size_y_m * (1.0 if light.kind is LightKind.RECTANGLE else np.pi / 4)
        d = to + points[:, :1] * axis_x * light.size_x_m / 2 + points[:, 1:2] * axis_y * light.size_y_m / 2
        r2 = (d * d).sum(1)
        cosine = d @ axis_z / np.sqrt(r2)
        shape = np.where(cosine > 0, cosine * spread_factor(cosine, light.spread_rad), 0)
        return d, shape * area * points[:, 2] / r2
    distance = np.linalg.norm(to)
    towards = to / distance
    points = _disk_points(steps) if light.radius_m > 0 else np.array([[0.0, 0.0, 1.0]])
    u = np.cross(towards, [0.0, 0.0, 1.0] if abs(towards[2]) < 0.9 else [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    d = to + light.radius_m * (points[:, :1] * u + points[:, 1:2] * np.cross(towards, u))
    r2 = (d * d).sum(1)
    unit = d / np.sqrt(r2)[:, None]
    share = points[:, 2]
    if light.kind is LightKind.SPOT:
        share = share * spot_falloff(unit @ axis_z, light.spot_size_rad, light.spot_blend)
    return d, share * (unit @ towards) / r2


def irradiance(light: Light, x: np.ndarray, n: np.ndarray, corners: np.ndarray | None, steps: int = 12) -> np.ndarray:
    """(3,) irradiance at the point x with unit normal n; `corners` (T, 3, 3) are the triangles that cast shadows."""
    d, facing = patches(light, x, steps)
    unit = d / np.linalg.norm(d, axis=1, keepdims=True)
    part = facing * np.maximum(unit @ n, 0)
    if corners is not None and len(corners):
        start = np.repeat((x + 1e-6 * n)[None], len(d), 0)
        reach = d * 1e3 if light.kind is LightKind.SUN else d
        t, _ = nearest_hit(start, reach, corners)
        part = part * (t >= 1 - 1e-6)
    return light.power * part.sum()


def image(frame: Frame, steps: int = 12) -> np.ndarray:
    """(H, W, 3) irradiance of all lamps of `frame`."""
    g = frame.gbuffer
    out = np.zeros(g.albedo.shape)
    corners = None if frame.geometry is None else frame.geometry.corners_ws.astype(np.float64)
    for i, j in np.argwhere(g.mask):
        for light in frame.lights:
            x, n = g.position_ws[i, j].astype(float), g.normal_ws[i, j].astype(float)
            out[i, j] += irradiance(light, x, n, corners, steps)
    return out
