"""The glossy bounce in float64, as the equation reads: the lobe cut into many directions, each followed through triangles.

    L = F integral f(w) L_hit(w) dw / integral f(w) dw,   f = D G F(h) / (4 cos) with D and G of GGX,
    L_hit = albedo / pi * sum over lamps of I cos / r^2 V

for matt surroundings and point-like spots.
"""

from __future__ import annotations

import numpy as np

from rtgi_addon.core.frame import Frame
from rtgi_addon.core.radiometry import spot_falloff
from rtgi_addon.core.synthetic import nearest_hit


def fresnel(cosine: np.ndarray, index: float = 1.5) -> np.ndarray:
    """Reflectance of a dielectric by Fresnel's equations, unpolarised."""
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (inside - index * cosine) / (inside + index * cosine)
    return (s**2 + p**2) / 2


def directions(normal: np.ndarray, viewer: np.ndarray, alpha: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions (N, 3) of the lobe and their weights (N,): half vectors spread evenly by D cos, f cos over density."""
    u = (np.arange(steps) + 0.5) / steps
    u, phi = (a.ravel() for a in np.meshgrid(u, 2 * np.pi * (np.arange(steps) + 0.5) / steps))
    cos_h = np.sqrt((1 - u) / (1 + (alpha**2 - 1) * u))
    sin_h = np.sqrt(1 - cos_h**2)
    tangent = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.9 else [0.0, 1.0, 0.0])
    tangent /= np.linalg.norm(tangent)
    half = (sin_h * np.cos(phi))[:, None] * tangent + (sin_h * np.sin(phi))[:, None] * np.cross(normal, tangent)
    half += cos_h[:, None] * normal
    cos_d = half @ viewer
    out = 2 * cos_d[:, None] * half - viewer
    cos_o, cos_v = out @ normal, normal @ viewer

    def smith(cosine):
        return np.sqrt(1 + alpha**2 * (1 / np.maximum(cosine, 1e-9) ** 2 - 1))

    g = 2 / (smith(cos_o) + smith(cos_v))
    weight = g * fresnel(np.clip(cos_d, 0, 1)) * cos_d / (cos_v * cos_h)
    return out, np.where((cos_o > 0) & (cos_d > 0), weight, 0)


def sent_back(position: np.ndarray, normal: np.ndarray, albedo: np.ndarray, frame: Frame) -> np.ndarray:
    """(N, 3) radiance that matt points send out of the light of the frame's lamps, shadows by every triangle."""
    total = np.zeros((len(position), 3))
    for light in frame.lights:
        to = light.position_ws - position
        r2 = (to**2).sum(1)
        cosine = (to * normal).sum(1) / np.sqrt(r2)
        t, _ = nearest_hit(position + 1e-6 * normal, to, frame.geometry.corners_ws)
        axis = -(to @ light.direction_ws) / np.sqrt(r2)
        shine = spot_falloff(axis, light.spot_size_rad, light.spot_blend)
        arrives = np.where((cosine > 0) & ~(t < 1 - 1e-6), shine * cosine / r2, 0)
        total += arrives[:, None] * light.power
    return albedo / np.pi * total


def reflected(frame: Frame, i: int, j: int, steps: int = 48) -> np.ndarray:
    """(3,) radiance that pixel (i, j) reflects towards the camera after one bounce."""
    g = frame.gbuffer
    position, normal = g.position_ws[i, j].astype(np.float64), g.normal_ws[i, j].astype(np.float64)
    viewer = frame.camera.position_ws - position
    viewer /= np.linalg.norm(viewer)
    alpha = max(float(g.roughness[i, j]) ** 2, 1e-6)
    d, weight = directions(normal, viewer, alpha, steps)
    corners = frame.geometry.corners_ws.astype(np.float64)
    t, triangle = nearest_hit(np.broadcast_to(position + 1e-6 * normal, d.shape), d, corners)
    light = np.zeros((len(d), 3))
    hit = np.flatnonzero(triangle >= 0)
    of = corners[triangle[hit]]
    face = np.cross(of[:, 1] - of[:, 0], of[:, 2] - of[:, 0])
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    face *= -np.sign((face * d[hit]).sum(1))[:, None]
    light[hit] = sent_back(position + t[hit, None] * d[hit], face, frame.geometry.albedo[triangle[hit], 0], frame)
    return g.specular[i, j] * (weight @ light) / weight.sum()
