"""The errors of one render against a reference, part by part: numbers as they go into JSON."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..passes.base import Transport
from ..pipeline import Result
from . import metrics
from .halves import PARTS, Reference

# transports of each part of the reference; Cycles counts light of the world and of emissive surfaces as direct
TRANSPORTS_OF: dict[str, tuple[Transport, ...]] = {
    "direct": (Transport.DIRECT_DIFFUSE, Transport.WORLD_DIFFUSE, Transport.EMISSION_DIFFUSE, Transport.DIRECT_GLOSSY,
               Transport.WORLD_GLOSSY),
    "direct diffuse": (Transport.DIRECT_DIFFUSE, Transport.WORLD_DIFFUSE, Transport.EMISSION_DIFFUSE),
    "direct glossy": (Transport.DIRECT_GLOSSY, Transport.WORLD_GLOSSY),
    "bounce": (Transport.BOUNCE_DIFFUSE, Transport.NEAR_DIFFUSE, Transport.WORLD_BOUNCE_DIFFUSE),
    "glossy bounce": (Transport.BOUNCE_GLOSSY,),
}
BLACK = 1e-9                # a part with less than this share of the picture's light is not there


def part_of(transports: dict[Transport, np.ndarray], part: str, albedo: np.ndarray) -> np.ndarray:
    """(H, W, 3) float64 radiance of a part, colour included: E albedo / pi of diffuse transports plus the glossy ones."""
    total = np.zeros(albedo.shape, np.float64)
    for transport in TRANSPORTS_OF[part]:
        if transport in transports:
            light = transports[transport].astype(np.float64)
            total += light * albedo / math.pi if transport.is_diffuse else light
    return total


def picture_errors(combined: np.ndarray, reference: Reference) -> dict[str, float]:
    """Errors of a whole picture (H, W, 3 or 4) over surfaces, by the names of docs/comparison.md."""
    return _errors(combined[..., :3], *reference.halves("picture"), reference.mask)


def _errors(test: np.ndarray, half_a: np.ndarray, half_b: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    mean = (half_a.astype(np.float64) + half_b) / 2
    scale, scaled_block = metrics.after_best_scale(test, mean, mask)
    return {"block": metrics.block_relative_l1(test, mean, mask),
            "nrmse": metrics.noise_free_nrmse(test, half_a, half_b, mask),
            "relmse": metrics.smoothed_relmse(test, half_a, half_b, mask),
            "block_95": metrics.block_percentile(test, mean, mask),
            "energy": metrics.energy_ratio(test, mean, mask),
            "luminance_bias": metrics.luminance_bias(test, mean, mask),
            "best_scale": scale, "block_after_scale": scaled_block,
            "within_1_percent": metrics.share_within(test, mean, mask)}


def errors_of(result: Result, reference: Reference) -> dict[str, Any]:
    """Errors of an RTGI render: {"picture": {...}, part: {...}}.

    Each part has "of_picture", its summed block error over the light of the whole picture: what it adds to the picture's
    error when everything else is right. The other numbers are relative to the part itself and missing where the reference
    has none of it. InputError for sizes that differ and for values that are not finite.
    """
    mask = reference.mask
    errors: dict[str, Any] = {"picture": picture_errors(result.combined, reference)}
    light_of_picture = float(reference.mean("picture")[mask].sum())
    for part in PARTS:
        test = part_of(result.transports, part, reference.albedo)
        halves = reference.halves(part)
        mean = reference.mean(part)
        difference = np.abs(metrics.block_sums(test, mask) - metrics.block_sums(mean, mask)).sum()
        errors[part] = {"of_picture": float(difference / light_of_picture)}
        if not mean[mask].sum() <= BLACK * light_of_picture:       # NaN too: it has to be named
            errors[part] |= _errors(test, *halves, mask)
    return errors


def noise_of(reference: Reference) -> dict[str, float]:
    """The block error that the reference's own noise gives a perfect render, for the picture and each part that is there."""
    mask, noise = reference.mask, {}
    light_of_picture = float(reference.mean("picture")[mask].sum())
    for part in ("picture", *PARTS):
        if not reference.mean(part)[mask].sum() <= BLACK * light_of_picture:
            noise[part] = metrics.block_noise(*reference.halves(part), mask)
    return noise


def floors_of(reference: Reference) -> dict[str, float]:
    """The picture's noise floors: what the noise of the reference's mean alone makes of an error, by the error's name.

    "block" holds for errors that have the reference's noise in them, "nrmse" and "relmse" stand beside errors freed of it:
    far below the floor such an error is an estimate with a spread of its own.
    """
    halves, mask = reference.halves("picture"), reference.mask
    return {"block": metrics.block_noise(*halves, mask), "nrmse": metrics.nrmse_noise(*halves, mask),
            "relmse": metrics.smoothed_relmse_noise(*halves, mask)}
