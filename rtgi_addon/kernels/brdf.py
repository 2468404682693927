"""The glossy lobe: GGX with Smith's height-correlated shadowing and Schlick's rise, normalised to a known reflectance.

Cycles' passes tell how much a glossy surface reflects towards the viewer ("Glossy Color": Fresnel, multiple scattering
and colour are in it), but not where to. `ggx_lobe` gives the shape, `lobe_gain` makes its hemispherical integral 1, and
the pass's colour scales it. By reciprocity one function serves both uses: light arrives along `fixed` and leaves along
`other` (a reflective shadow map's texel), or leaves along `fixed` and arrives along `other` (a camera's pixel).

Whether Fresnel rises (a dielectric) or not (a metal) is told by the colour too: `normal_reflectance` solves it for the
reflectance at normal incidence. Without it every surface is taken as a dielectric of index 1.5.
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
GAIN_STEPS = 32             # cells of the tables of albedos, along cosine and along alpha
_QUADRATURE = 48            # nodes an axis of the integral over the hemisphere
_LEAST_ALPHA = 0.05         # below it the quadrature misses the peak, and the albedo has long reached that of a mirror


@device_jit
def schlick(cosine, f0=F0):
    """Schlick's Fresnel reflectance of a surface that reflects `f0` at normal incidence."""
    m = ONE - cosine
    return f0 + (ONE - f0) * m * m * m * m * m


@device_jit
def ggx_lobe(normal, fixed, other, alpha2, f0=F0):
    """BRDF times the cosine of `other`, 1/sr, up to the gain; all vectors unit, both directions away from the surface.

    `alpha2` is the fourth power of the perceptual roughness. Fresnel is relative to its value at `fixed`, since the
    colour that scales the lobe holds that already. GGX: Walter et al. 2007, Eq. 33; shadowing: Heitz 2014, Eq. 99.
    """
    h = normalized_or(add(fixed, other), normal)
    cos_h, cos_d = dot(normal, h), max(dot(h, fixed), ZERO)
    cos_f, cos_o = max(dot(normal, fixed), f32(0.02)), max(dot(normal, other), ZERO)
    t = cos_h * cos_h * (alpha2 - ONE) + ONE
    shadow = (cos_o * math.sqrt(cos_f * cos_f * (ONE - alpha2) + alpha2)
              + cos_f * math.sqrt(cos_o * cos_o * (ONE - alpha2) + alpha2))
    return (alpha2 * INV_PI / (t * t + f32(1e-12)) * HALF / (shadow + f32(1e-9)) * cos_o
            * schlick(cos_d, f0) / schlick(cos_f, f0))


@device_jit
def _albedos(steps, quadrature, least_alpha):
    """(steps, steps, 2) float32: hemispherical integrals of the lobe without Fresnel, and with Fresnel's rise alone."""
    out = np.zeros((steps, steps, 2), np.float32)
    up = Vec3(ZERO, ZERO, ONE)
    for i in range(steps):
        for j in range(steps):
            cos_f, alpha, flat, rise = (i + 0.5) / steps, max((j + 0.5) / steps, least_alpha), 0.0, 0.0
            fixed = Vec3(f32(math.sqrt(1 - cos_f * cos_f)), ZERO, f32(cos_f))
            for u in range(quadrature):
                cos_o = math.sqrt((u + 0.5) / quadrature)
                sin_o = math.sqrt(1 - cos_o * cos_o)
                for v in range(quadrature):
                    phi = (v + 0.5) / quadrature * math.pi
                    other = Vec3(f32(sin_o * math.cos(phi)), f32(sin_o * math.sin(phi)), f32(cos_o))
                    lobe = ggx_lobe(up, fixed, other, f32(alpha * alpha), ONE) / cos_o
                    cos_d = dot(normalized_or(add(fixed, other), up), fixed)
                    flat += lobe
                    rise += lobe * (1 - cos_d) ** 5
            out[i, j, 0] = flat * math.pi / (quadrature * quadrature)
            out[i, j, 1] = rise * math.pi / (quadrature * quadrature)
    return out


@functools.cache
def albedo_table() -> np.ndarray:
    """(GAIN_STEPS, GAIN_STEPS, 2) float32: the lobe's albedo without Fresnel and by Fresnel's rise, over cosine and alpha."""
    return _albedos(GAIN_STEPS, _QUADRATURE, _LEAST_ALPHA)


def _albedos_at(cos_fixed: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    row = np.clip((cos_fixed * GAIN_STEPS).astype(np.int32), 0, GAIN_STEPS - 1)
    column = np.clip((alpha * GAIN_STEPS).astype(np.int32), 0, GAIN_STEPS - 1)
    both = albedo_table()[row, column]
    return both[..., 0], both[..., 1]


def lobe_gain(cos_fixed: np.ndarray, alpha: np.ndarray, f0: np.ndarray | float = float(F0)) -> np.ndarray:
    """1 / (hemispherical integral of `ggx_lobe`) for cosines of `fixed` and GGX alphas (squared roughness), any shape."""
    flat, rise = _albedos_at(cos_fixed, alpha)
    at_fixed = f0 + (1 - f0) * (1 - np.clip(cos_fixed, 0.02, 1)) ** 5
    return (at_fixed / np.maximum(f0 * flat + (1 - f0) * rise, 0.02 * at_fixed)).astype(np.float32)


def normal_reflectance(reflectance: np.ndarray, cos_fixed: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Schlick's F0 of surfaces whose directional reflectance towards `fixed` is known; float32 in [0.02, 1].

    With r the share of the lobe that Fresnel's rise takes, reflectance = F0 + (1 - F0) r.
    """
    flat, rise = _albedos_at(cos_fixed, alpha)
    r = np.minimum(rise / np.maximum(flat, 1e-3), 0.95)
    return np.clip((reflectance - r) / (1 - r), 0.02, 1).astype(np.float32)


@device_jit
def fit_lobe(reflectance, cos_fixed, alpha, albedos):
    """(F0, gain) of a lobe whose reflectance towards `fixed` is known; kernels' form of the two functions above."""
    row = min(max(int(cos_fixed * f32(GAIN_STEPS)), 0), GAIN_STEPS - 1)
    column = min(max(int(alpha * f32(GAIN_STEPS)), 0), GAIN_STEPS - 1)
    flat, rise = albedos[row, column, 0], albedos[row, column, 1]
    r = min(rise / max(flat, f32(1e-3)), f32(0.95))
    f0 = min(max((reflectance - r) / (ONE - r), f32(0.02)), ONE)
    at_fixed = schlick(min(max(cos_fixed, f32(0.02)), ONE), f0)
    return f0, at_fixed / max(f0 * flat + (ONE - f0) * rise, f32(0.02) * at_fixed)
