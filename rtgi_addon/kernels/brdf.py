"""The glossy lobe: GGX with Smith's height-correlated shadowing and Schlick's rise, normalised to a known reflectance.

Cycles' passes tell how much a glossy surface reflects towards the viewer ("Glossy Color": Fresnel, multiple scattering
and colour are in it), but not where to. `ggx_lobe` gives the shape, `lobe_gain` makes its hemispherical integral 1, and
the pass's colour scales it. By reciprocity one function serves both uses: light arrives along `fixed` and leaves along
`other` (a reflective shadow map's texel), or leaves along `fixed` and arrives along `other` (a camera's pixel).
"""

from __future__ import annotations

import functools
import math

import numpy as np

from .jit import device_jit
from .vec3 import ONE, ZERO, Vec3, add, dot, f32, normalized_or

INV_PI = f32(1 / math.pi)
HALF = f32(0.5)
F0 = f32(0.04)              # Schlick's reflectance at normal incidence of a dielectric of index 1.5
GAIN_STEPS = 32             # cells of the table of gains, along cosine and along alpha


@device_jit
def schlick(cosine):
    """Schlick's Fresnel reflectance of a dielectric of index 1.5."""
    m = ONE - cosine
    return F0 + (ONE - F0) * m * m * m * m * m


@device_jit
def ggx_lobe(normal, fixed, other, alpha2):
    """BRDF times the cosine of `other`, 1/sr, up to the gain; all vectors unit, both directions away from the surface.

    `alpha2` is the fourth power of the perceptual roughness. Fresnel is relative to its value at `fixed`, since the
    colour that scales the lobe holds that already. GGX: Walter et al. 2007, Eq. 33; shadowing: Heitz 2014, Eq. 99.
    """
    h = normalized_or(add(fixed, other), normal)
    cos_h, cos_d = dot(normal, h), max(dot(h, fixed), ZERO)
    cos_f, cos_o = max(dot(normal, fixed), f32(0.02)), max(dot(normal, other), ZERO)
    t = cos_h * cos_h * (alpha2 - ONE) + ONE
    shadow = cos_o * math.sqrt(cos_f * cos_f * (ONE - alpha2) + alpha2) + cos_f * math.sqrt(cos_o * cos_o * (ONE - alpha2) + alpha2)
    return (alpha2 * INV_PI / (t * t + f32(1e-12)) * HALF / (shadow + f32(1e-9)) * cos_o
            * schlick(cos_d) / schlick(cos_f))


@device_jit
def _gains(steps, quadrature):
    out = np.zeros((steps, steps), np.float32)
    up = Vec3(ZERO, ZERO, ONE)
    for i in range(steps):
        for j in range(steps):
            cos_f, alpha, total = (i + 0.5) / steps, max((j + 0.5) / steps, 0.05), 0.0
            fixed = Vec3(f32(math.sqrt(1 - cos_f * cos_f)), ZERO, f32(cos_f))
            for u in range(quadrature):
                cos_o = math.sqrt((u + 0.5) / quadrature)
                sin_o = math.sqrt(1 - cos_o * cos_o)
                for v in range(quadrature):
                    phi = (v + 0.5) / quadrature * math.pi
                    other = Vec3(f32(sin_o * math.cos(phi)), f32(sin_o * math.sin(phi)), f32(cos_o))
                    total += ggx_lobe(up, fixed, other, f32(alpha * alpha)) / cos_o
            out[i, j] = 1 / max(total * math.pi / (quadrature * quadrature), 0.02)
    return out


@functools.cache
def gain_table() -> np.ndarray:
    """(GAIN_STEPS, GAIN_STEPS) float32 gains over the cosine of `fixed` and GGX alpha, cell centres at + 0.5."""
    return _gains(GAIN_STEPS, 48)


def lobe_gain(cos_fixed: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """1 / (hemispherical integral of `ggx_lobe`) for cosines of `fixed` and GGX alphas (squared roughness), (N,) each."""
    row = np.clip((cos_fixed * GAIN_STEPS).astype(np.int32), 0, GAIN_STEPS - 1)
    column = np.clip((alpha * GAIN_STEPS).astype(np.int32), 0, GAIN_STEPS - 1)
    return gain_table()[row, column]
