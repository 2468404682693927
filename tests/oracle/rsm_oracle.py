"""Reflective shadow maps in float64 numpy, as the papers write them: slow, and sharing no formula with the kernels.

Tables of texels are (17, N): position, normal, diffuse flux, direction to the light, glossy flux (gain in it), alpha
squared (2: no lobe), reflectance at normal incidence.
"""

from __future__ import annotations

import numpy as np

PI = np.pi


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.sum(a * b, axis=-1)


def _unit(a: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(a, axis=-1, keepdims=True)
    return a / np.where(length > 0, length, 1)


def ggx_distribution(cos_h: np.ndarray, alpha2: np.ndarray) -> np.ndarray:
    """Walter et al. 2007, Eq. 33, in the half vector's cosine."""
    tan2 = (1 - cos_h**2) / cos_h**2
    return alpha2 / (PI * cos_h**4 * (alpha2 + tan2) ** 2)


def smith_lambda(cosine: np.ndarray, alpha2: np.ndarray) -> np.ndarray:
    """Heitz 2014, Eq. 72."""
    return (np.sqrt(1 + alpha2 * (1 - cosine**2) / cosine**2) - 1) / 2


def fresnel(cosine: np.ndarray, f0: np.ndarray) -> np.ndarray:
    """Fresnel's equations of a dielectric of index 1.5, by Snell's law, stretched so that normal incidence gives f0.

    The rise r is bent to r (1 - k (1 - r)^2) for other indices, as `brdf.rise_of` defines it; how near that is to their own
    equations is another test.
    """
    n = 1.5
    cos_t = np.sqrt(1 - (1 - cosine**2) / n**2)
    s = ((cosine - n * cos_t) / (cosine + n * cos_t)) ** 2
    p = ((cos_t - n * cosine) / (cos_t + n * cosine)) ** 2
    rise = ((s + p) / 2 - 0.04) / 0.96
    k = np.where(f0 < 0.04, 0.122, 0.08) * (1 / np.sqrt(np.clip(f0, 0.015, 0.1)) - 5)
    return f0 + (1 - f0) * rise * (1 - k * np.clip((0.2 - f0) / 0.1, 0, 1) * (1 - rise) ** 2)


def glossy_lobe(normal: np.ndarray, fixed: np.ndarray, other: np.ndarray, alpha2: np.ndarray, f0: np.ndarray) -> np.ndarray:
    """BRDF times the cosine of `other`: D G2 / (4 cos_f cos_o) cos_o, Fresnel relative to that at `fixed`.

    The cosine of `fixed` is at least 0.02, which the kernels define so.
    """
    half = _unit(fixed + other)
    cos_h, cos_d = _dot(normal, half), np.maximum(_dot(half, fixed), 0)
    cos_f, cos_o = np.maximum(_dot(normal, fixed), 0.02), _dot(normal, other)
    seen = cos_o > 0
    cos_o = np.where(seen, cos_o, 1.0)
    cos_h = np.where(np.abs(cos_h) > 0, cos_h, 1e-6)
    g2 = 1 / (1 + smith_lambda(cos_f, alpha2) + smith_lambda(cos_o, alpha2))
    value = ggx_distribution(cos_h, alpha2) * g2 / (4 * cos_f) * fresnel(cos_d, f0) / fresnel(cos_f, f0)
    return np.where(seen, value, 0.0)


def irradiance_of_each(position: np.ndarray, normal: np.ndarray, table: np.ndarray, eps2: float = 0.0) -> np.ndarray:
    """(N, 3): what each texel gives one point, unshadowed. Reflective Shadow Maps, Eq. 1, with flux in watts."""
    table = table.astype(np.float64)
    x_p, n_p, flux, to_light, glossy_flux, alpha2, f0 = (
        table[0:3].T, table[3:6].T, table[6:9].T, table[9:12].T, table[12:15].T, table[15], table[16])
    away = position - x_p
    dist2 = _dot(away, away) + eps2
    dist2 = np.where(dist2 > 0, dist2, np.inf)                  # a texel on the point itself is edge on
    to_point = away / np.sqrt(dist2)[:, None]
    cos_texel, cos_point = np.maximum(_dot(n_p, to_point), 0), np.maximum(_dot(normal, -to_point), 0)
    diffuse = flux / PI * (cos_texel * cos_point / dist2)[:, None]
    lobe = glossy_lobe(n_p, to_light, to_point, np.minimum(alpha2, 1.0), f0)
    facing = (alpha2 < 2) & (cos_texel > 0)
    return diffuse + np.where(facing, lobe * cos_point / dist2, 0.0)[:, None] * glossy_flux


def is_blocked(origin: np.ndarray, target: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N,): is a triangle of (T, 3, 3) between the points (N, 3)? By signed volumes, each triangle against each segment."""
    blocked = np.zeros(len(origin), bool)
    end = origin + 0.9999 * (target - origin)                   # a target lies on a surface itself
    for a, b, c in corners.astype(np.float64):
        plane = np.cross(b - a, c - a)
        side_o, side_e = (origin - a) @ plane, (end - a) @ plane
        direction = end - origin
        u = _dot(np.cross(direction, a - origin), b - origin)
        v = _dot(np.cross(direction, b - origin), c - origin)
        w = _dot(np.cross(direction, c - origin), a - origin)
        inside = ((u >= 0) & (v >= 0) & (w >= 0)) | ((u <= 0) & (v <= 0) & (w <= 0))
        blocked |= inside & (side_o * side_e < 0)
    return blocked


def irradiance(position: np.ndarray, normal: np.ndarray, table: np.ndarray, eps2: float = 0.0,
               corners: np.ndarray | None = None, offset_m: float = 0.0) -> np.ndarray:
    """(M, 3) irradiance at points (M, 3) from all texels; with `corners` only from those that the point sees."""
    position, normal = position.astype(np.float64), normal.astype(np.float64)
    out = np.zeros((len(position), 3))
    for i in range(len(position)):
        gives = irradiance_of_each(position[i], normal[i], table, eps2)
        if corners is not None:
            lit = np.flatnonzero(gives.sum(1) > 0)
            target = (table[0:3].T + offset_m * table[3:6].T).astype(np.float64)[lit]
            origin = np.broadcast_to(position[i] + offset_m * normal[i], target.shape)
            gives[lit[is_blocked(origin, target, corners)]] = 0
        out[i] = gives.sum(0)
    return out


def polar_samples(radius_px: float, xi: np.ndarray, published: bool) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (S, 2) px and the texels (S,) that each sample stands for, from numbers xi (S, 2) in [0, 1)."""
    angle = 2 * PI * xi[:, 1]
    offset = radius_px * xi[:, :1] * np.stack([np.sin(angle), np.cos(angle)], 1)
    if published:
        return offset, PI * radius_px**2 * xi[:, 0] ** 2 / np.sum(xi[:, 0] ** 2)
    return offset, 2 * PI * radius_px**2 * xi[:, 0] / len(xi)


def irradiance_polar(position: np.ndarray, normal: np.ndarray, centre_px: np.ndarray, map_position: np.ndarray,
                     map_normal: np.ndarray, map_flux: np.ndarray, radius_px: float, xi: np.ndarray, published: bool,
                     wrap: bool) -> tuple[np.ndarray, float]:
    """(3,) irradiance at one point by samples around `centre_px`, and how near a texel's edge any sample came, px."""
    height, width = map_flux.shape[:2]
    offset, weight = polar_samples(radius_px, xi, published)
    at = centre_px + offset
    if wrap:
        weight = np.where(np.abs(offset[:, 0]) <= width / 2, weight, 0.0)
        at[:, 0] %= width
    edge = np.abs(at - np.round(at)).min()
    inside = (at >= 0).all(1) & (at[:, 0] < width) & (at[:, 1] < height)
    column, row = np.floor(at[inside]).astype(int).T
    table = np.zeros((17, len(column)))
    table[0:3], table[3:6], table[6:9] = map_position[row, column].T, map_normal[row, column].T, map_flux[row, column].T
    table[15] = 2
    return weight[inside] @ irradiance_of_each(position, normal, table), float(edge)
