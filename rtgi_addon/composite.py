"""Adding up light without counting any of it twice."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from .core.frame import GBuffer
from .errors import InputError
from .passes.base import PassResult, Transport


def merge(results: Iterable[tuple[str, PassResult]]) -> dict[Transport, np.ndarray]:
    """Each transport with the light of its one owner; InputError where two techniques supply the same one.

    A later technique that took the earlier light into its own (`PassResult.takes_over`) becomes the owner.
    """
    light, owner = {}, {}
    for name, result in results:
        for transport, values in result.light.items():
            if transport in owner and transport not in result.takes_over:
                raise InputError(f"{owner[transport]} and {name} both supply the {transport.value} light and would count it "
                                 "twice; switch one of them off")
            light[transport], owner[transport] = values, name
    return light


def combine(gbuffer: GBuffer, light: dict[Transport, np.ndarray], film_transparent: bool = False) -> np.ndarray:
    """(H, W, 4) float32 linear RGBA: emission + albedo / pi * irradiance + glossy radiance, with alpha.

    Behind everything stands the visible world with alpha 1, or nothing with alpha 0 on a transparent film. Colour is
    premultiplied, as Blender keeps it.
    """
    irradiance = np.zeros_like(gbuffer.albedo)
    out = np.empty((*gbuffer.shape, 4), np.float32)
    glossy = gbuffer.emission.copy()
    for transport, values in light.items():
        if transport.is_diffuse:
            irradiance += values
        else:
            glossy += values
    irradiance *= gbuffer.albedo
    irradiance *= np.float32(1 / np.pi)
    np.add(irradiance, glossy, out=out[..., :3])
    out[..., 3] = 1.0
    if film_transparent:
        out[~gbuffer.mask] = 0.0
    return out
