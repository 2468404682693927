"""Blender's lamp settings to SI units, and what a light sends into a texel of its own view.

Derivations are in docs/radiometry.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .frame import Geometry, Light, LightKind
from .transforms import Camera, Projection


def brightest(colour: np.ndarray) -> np.ndarray:
    """(...) the largest of the three numbers of `colour` (..., 3); along so short an axis numpy takes 25 times as long."""
    return np.maximum(np.maximum(colour[..., 0], colour[..., 1]), colour[..., 2])


def mean_of(colour: np.ndarray) -> np.ndarray:
    """(...) the mean of the three numbers of `colour` (..., 3), for the same reason."""
    return (colour[..., 0] + colour[..., 1] + colour[..., 2]) * np.float32(1 / 3)


def point_intensity(power_w: float, radius_m: float, normalize: bool) -> float:
    """Radiant intensity W/sr of a POINT or SPOT of `power_w`.

    A point radiates evenly over 4 pi sr; a spot is the same point behind a shade, so its cone does not enter. Without
    `normalize` Blender's number is per square metre of the sphere's surface.
    """
    return power_w / (4 * math.pi) * (1.0 if normalize or radius_m <= 0 else 4 * math.pi * radius_m**2)


def sun_irradiance(strength: float, angle_rad: float, normalize: bool) -> float:
    """Irradiance W/m2 on a plane that faces a SUN; without `normalize` the strength is the radiance of its disk."""
    return strength * (1.0 if normalize or angle_rad <= 0 else math.pi * math.sin(min(angle_rad, math.pi) / 2) ** 2)


def area_radiance(power_w: float, area_m2: float, normalize: bool) -> float:
    """Radiance W/(m2 sr) of an area light: a Lambertian emitter of radiance L gives pi L A watts."""
    return power_w / (math.pi * (area_m2 if normalize else 1.0))


def area_of(kind: LightKind, size_x_m: float, size_y_m: float) -> float:
    """Area in m2 of a RECTANGLE or DISK (an ellipse with these axes)."""
    return size_x_m * size_y_m * (math.pi / 4 if kind is LightKind.DISK else 1.0)


def spot_falloff(cos_angle: np.ndarray, spot_size_rad: float, spot_blend: float) -> np.ndarray:
    """Share of the axis intensity that a spot sends at an angle off its axis, as Cycles' smoothstep of the cosine."""
    edge = math.cos(spot_size_rad / 2)
    t = np.clip((cos_angle - edge) / max((1 - edge) * spot_blend, 1e-6), 0, 1)
    return t * t * (3 - 2 * t)


def spread_factor(cos_angle: np.ndarray, spread_rad: float) -> np.ndarray:
    """Radiance of an area light at an angle off its normal, relative to a Lambertian one of the same power.

    Cycles narrows an emitter with a grid of infinitely many small tubes: tan(spread / 2) - tan(angle), normalised so
    that the power stays.
    """
    if spread_rad >= math.pi - 1e-4:
        return np.where(cos_angle > 0, 1.0, 0.0)
    half = max(spread_rad / 2, math.radians(0.5))
    cos_angle = np.maximum(cos_angle, 1e-6)
    tan_angle = np.sqrt(np.maximum(0, 1 - cos_angle**2)) / cos_angle
    return np.maximum(math.tan(half) - tan_angle, 0) / (math.tan(half) - half)


class Emitters(NamedTuple):
    """Emissive triangles of a scene, float64: corners (E, 3, 3) m; across (E, 3) m2, the vector product of two edges;
    radiance (E, 3) W/(m2 sr); power (E,) W/sr, its mean over the colours times the area."""

    corners: np.ndarray
    across: np.ndarray
    radiance: np.ndarray
    power: np.ndarray


def find_emitters(geometry: Geometry) -> Emitters:
    """The triangles that shine; what is not finite gives nothing."""
    index = np.flatnonzero(geometry.emission.any(1))
    corners, radiance = geometry.corners_ws[index].astype(np.float64), geometry.emission[index].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    power = np.nan_to_num(radiance.mean(1) * 0.5 * np.linalg.norm(across, axis=1), nan=0.0, posinf=0.0)
    return Emitters(corners, across, radiance, power)


def texel_directions(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions (H, W, 3) and solid angles (H, W) sr of an equirectangular map's texels, float64, in world axes."""
    edge = np.pi / 2 - np.pi * np.arange(height + 1) / height
    latitude = (np.pi / 2 - np.pi * (np.arange(height) + 0.5) / height)[:, None]
    longitude = -np.pi + 2 * np.pi * (np.arange(width) + 0.5) / width
    solid_angle = np.repeat((np.sin(edge[:-1]) - np.sin(edge[1:]))[:, None] * 2 * np.pi / width, width, 1)
    direction = [np.cos(latitude) * np.sin(longitude), np.cos(latitude) * np.cos(longitude),
                 np.repeat(np.sin(latitude), width, 1)]
    return np.stack(direction, -1), solid_angle


def texel_solid_angle(camera: Camera) -> np.ndarray:
    """(H, W) float64 sr that each texel of a perspective or equirectangular view covers.

    Perspective: dx dy / (1 + x^2 + y^2)^(3/2) on the plane at distance 1. Equirectangular: longitude step times the
    difference of the latitudes' sines, which is exact.
    """
    step_x, step_y = camera.pixel_size
    x, y = camera.pixel_centres()
    if camera.projection is Projection.PERSPECTIVE:
        return step_x * step_y / (1 + x[None, :] ** 2 + y[:, None] ** 2) ** 1.5
    band = step_x * (np.sin(y + step_y / 2) - np.sin(y - step_y / 2))
    return np.broadcast_to(band[:, None], (camera.height_px, camera.width_px))


def texel_flux(light: Light, camera: Camera) -> np.ndarray:
    """(H, W, 3) float32 W that `light` sends into each texel of its own view `camera`.

    A sun's texel takes E A whatever it falls on: the cosine of the surface cancels against its larger area. Point-like
    lights give I(direction) dOmega. An area light is taken as a point in its centre with intensity L A cos(angle).
    """
    if light.kind is LightKind.SUN:
        step_x, step_y = camera.pixel_size
        shape = np.full((camera.height_px, camera.width_px), step_x * step_y)
    else:
        _, direction = camera.rays_vs()
        cosine = -direction[..., 2] / np.linalg.norm(direction, axis=-1)
        shape = np.array(texel_solid_angle(camera))
        if light.kind is LightKind.SPOT:
            shape *= spot_falloff(cosine, light.spot_size_rad, light.spot_blend)
        elif light.kind.is_area:
            shape *= area_of(light.kind, light.size_x_m, light.size_y_m) * np.maximum(cosine, 0) * spread_factor(
                cosine, light.spread_rad)
    return (shape[..., None] * light.power).astype(np.float32)
