"""Suns in the world: small bright parts of it, taken out of its map and lit with as lamps.

A sky's sun, or that of a photographed environment, casts shadows that a map of light from everywhere cannot give: rays that
meet it by chance leave noise, and its patches on the floor are as sharp as those of a lamp. As a lamp it has a view of its
own and every technique that lamps have.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from .frame import Light, LightKind
from .radiometry import texel_directions, texel_solid_angle
from .transforms import Camera, Projection, ViewFormat

MOST_SUNS = 2
PEAK = 30                   # times the mean radiance that a sun's brightest texel has at least
LEAST_SHARE = 0.03          # of the light of the whole world that a sun gives at least
WIDEST_RAD = math.radians(8)        # angular diameter from which a bright part is no sun
CLOSE_RAD = math.radians(7)         # half the angle of the view that is taken of a sun: it shows the sky around it too
CLOSE_PX = 160              # and its size: a twelfth of a degree, a sixth of the sun's diameter
SMALL = 0.15                # radius of a sun over half the angle of its view, below which a second view is taken
FILLS = 1.5                 # and half the angle of that, over the radius that the first one shows
FAINT = 0.01                # of the excess at the peak: less is the sky's own gradient

Look = Callable[[Camera], np.ndarray]


def _frame_towards(direction: np.ndarray) -> np.ndarray:
    """(4, 4) world_from_view of a view along a unit vector."""
    up = np.array([0.0, 0.0, 1.0]) if abs(direction[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(direction, up)
    right /= np.linalg.norm(right)
    out = np.eye(4)
    out[:3, 0], out[:3, 1], out[:3, 2] = right, np.cross(right, direction), -direction
    return out


class _Sun(NamedTuple):
    """A sun as a lamp, the radiance (3,) of the sky around it, and the radius of what it takes of the sky."""

    lamp: Light
    around: np.ndarray
    radius_rad: float


class _View(NamedTuple):
    """A view of the sky: unit directions (H, W, 3), solid angles (H, W) sr, radiance (H, W, 3), and its rim (H, W) bool."""

    ways: np.ndarray
    solid_angle: np.ndarray
    radiance: np.ndarray
    is_rim: np.ndarray


def _view_towards(direction: np.ndarray, half_angle_rad: float, look: Look, form: ViewFormat) -> _View:
    edge, (width, height) = math.tan(half_angle_rad), form.flat_px(1.0)
    camera = Camera(Projection.PERSPECTIVE, _frame_towards(direction), width, height, -edge, edge, -edge, edge)
    rays = camera.rays_vs()[1]
    length = np.linalg.norm(rays, axis=-1)
    return _View(rays / length[..., None] @ camera.world_from_view[:3, :3].T,
                 np.broadcast_to(texel_solid_angle(camera), length.shape), look(camera).astype(np.float64),
                 np.hypot(rays[..., 0], rays[..., 1]) > 0.85 * edge)


def _sun_in(view: _View, around: np.ndarray, name: str) -> _Sun | None:
    """What stands out of the sky's radiance `around` (3,) in a view, as a lamp; None where nothing does."""
    excess = np.maximum(view.radiance - around, 0)
    brightness = excess.mean(-1)
    excess[(brightness <= FAINT * brightness.max()) | view.is_rim] = 0
    weight = excess.mean(-1) * view.solid_angle
    if not weight.sum() > 0:
        return None
    centre = np.einsum("hwc,hw->c", view.ways, weight)
    centre /= np.linalg.norm(centre)
    off = np.linalg.norm(np.cross(view.ways, centre), axis=-1)
    # an even disk's mean square is half its radius squared
    radius = math.sqrt(2 * float((off**2 * weight).sum() / weight.sum()))
    lamp = Light(name, LightKind.SUN, _frame_towards(-centre), np.einsum("hwc,hw->c", excess, view.solid_angle),
                 angle_rad=2 * math.asin(min(radius, 1.0)))
    return _Sun(lamp, around, math.asin(min(float(off[weight > 0].max()), 1.0)))


def _sun_at(direction: np.ndarray, half_angle_rad: float, look: Look, form: ViewFormat, name: str) -> _Sun | None:
    """The sun within an angle of a direction; None where nothing stands out."""
    wide = _view_towards(direction, half_angle_rad, look, form)
    if not wide.is_rim.any():                    # a picture of few pixels, whose views have no more
        return None
    sun = _sun_in(wide, np.median(wide.radiance[wide.is_rim], axis=0), name)
    if sun is None or sun.lamp.angle_rad > WIDEST_RAD:
        return None
    if sun.radius_rad > SMALL * half_angle_rad:
        return sun
    # it covers few pixels, and those at its edge count whole
    half_angle_rad = min(FILLS * (sun.radius_rad + 2 * half_angle_rad / CLOSE_PX), half_angle_rad)
    return _sun_in(_view_towards(-sun.lamp.direction_ws, half_angle_rad, look, form), sun.around, name) or sun


def _take_sun(radiance: np.ndarray, direction: np.ndarray, solid_angle: np.ndarray, found: _Sun | None,
              suns: list[Light]) -> np.ndarray:
    """The map without a sun, which goes to `suns`; the map itself for one that is too wide or gives too little."""
    if found is None:
        return radiance
    covered = direction @ -found.lamp.direction_ws >= math.cos(found.radius_rad + math.pi / radiance.shape[0])
    rest = radiance.copy()
    rest[covered] = np.minimum(rest[covered], found.around)
    given = float(found.lamp.power.mean())
    if not given > LEAST_SHARE * (given + float((rest.mean(-1, dtype=np.float64) * solid_angle).sum())):
        return radiance
    suns.append(found.lamp)
    return rest


def part_suns(radiance: np.ndarray, look: Look, form: ViewFormat, name: str,
              known: Sequence[tuple[np.ndarray, float]] = ()) -> tuple[np.ndarray, tuple[Light, ...]]:
    """A world's map without its suns, and these as lamps.

    Parameters
    ----------
    radiance : (H, W, 3) float32
        W/(m2 sr), laid out as `frame.World`.
    look : callable
        Radiance (h, w, 3) that a view of the world alone shows: a texel may be wider than a sun.
    form : ViewFormat
        Of such views, about CLOSE_PX wide.
    name : str
        Of the lamps.
    known : sequence of ((3,) array, float)
        Unit vectors to look at besides the map's brightest texels, and angular diameters in rad of what stands there.

    Returns
    -------
    radiance : (H, W, 3) float32
        With the sky around them in the places of suns; the array itself where there is none.
    suns : tuple of Light
        At most MOST_SUNS, each a SUN of the light that it stands out by.
    """
    direction, solid_angle = texel_directions(*radiance.shape[:2])
    suns: list[Light] = []
    for towards, angle_rad in known[:MOST_SUNS]:
        half_angle_rad = min(FILLS * angle_rad, CLOSE_RAD)
        radiance = _take_sun(radiance, direction, solid_angle, _sun_at(towards, half_angle_rad, look, form, name), suns)
    while len(suns) < MOST_SUNS:
        brightness, before = radiance.mean(-1, dtype=np.float64), len(suns)
        peak = int(brightness.argmax())
        if not brightness.flat[peak] * 4 * math.pi > PEAK * float((brightness * solid_angle).sum()):
            break
        radiance = _take_sun(radiance, direction, solid_angle,
                             _sun_at(direction.reshape(-1, 3)[peak], CLOSE_RAD, look, form, name), suns)
        if len(suns) == before:
            break
    return radiance, tuple(suns)
