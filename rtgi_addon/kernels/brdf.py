"""The glossy lobe: GGX with Smith's height-correlated shadowing and Fresnel's rise, normalised to a known reflectance.

Cycles' passes tell about how much a glossy surface reflects towards the viewer ("Glossy Color": Fresnel, multiple scattering
and colour are in it; `reflected_share` makes it exact), but not where to. `ggx_lobe` gives the shape, `fit_lobe` makes its
hemispherical integral 1, and the colour scales it. By reciprocity one function serves both uses: light arrives along `fixed`
and leaves along `other` (a reflective shadow map's texel), or leaves along `fixed` and arrives along `other` (a camera's
pixel).

Whether reflectance rises (a dielectric) or not (a metal) is told by the material, or else by the colour too: `fit_lobe`
solves it for the reflectance at normal incidence. Without either a surface is taken as a dielectric of index 1.5.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from .fastmath import on_circle
from .jit import device_jit, inline_jit
from .vec3 import ONE, ZERO, Vec3, add, dot, f32, normalized_or, scaled, tangent_frame, to_world

INV_PI = f32(1 / math.pi)
HALF = f32(0.5)
F0 = f32(0.04)              # reflectance at normal incidence of a dielectric of index 1.5
F0_DENSE, F0_METAL = f32(0.1), f32(0.2)     # of index 1.9; only metals reflect more than the latter
GAIN_STEPS = 32             # cells of the tables of albedos, along cosine and along alpha
_QUADRATURE = 32            # nodes an axis of the integral over half vectors


@inline_jit
def fresnel_rise(cosine):
    """How far reflectance has risen from normal incidence (0) to grazing (1), by Fresnel's equations for index 1.5.

    Schlick's fifth power is up to a quarter below this where most highlights lie.
    """
    g = math.sqrt(max(cosine * cosine + f32(1.25), ZERO))
    a, b = (g - cosine) / (g + cosine), (cosine * (g + cosine) - ONE) / (cosine * (g - cosine) + ONE)
    return max(HALF * a * a * (ONE + b * b) - F0, ZERO) / (ONE - F0)


@inline_jit
def rise_of(rise, f0):
    """Fresnel's rise where index 1.5 has `rise`, for the index that reflects `f0` at normal incidence.

    Denser surfaces rise earlier: with r (1 - k (1 - r)^2) the reflectance is within 3 % of Fresnel's equations up to 80
    degrees for indices of 1.33 to 1.8, with r alone up to 19 % off. Metals keep the shape of index 1.5; what lies between
    fades, so that a textured F0 shows no edge.
    """
    k = (f32(0.122) if f0 < F0 else f32(0.08)) * (ONE / math.sqrt(min(max(f0, f32(0.015)), F0_DENSE)) - f32(5))
    k *= min(max((F0_METAL - f0) / (F0_METAL - F0_DENSE), ZERO), ONE)
    return rise * (ONE - k * (ONE - rise) * (ONE - rise))


@inline_jit
def fresnel(cosine, f0=F0):
    """Reflectance of a surface that reflects `f0` at normal incidence and everything at grazing."""
    return f0 + (ONE - f0) * rise_of(fresnel_rise(cosine), f0)


@inline_jit
def ggx_lobe(normal, fixed, other, alpha2, f0=F0):
    """BRDF times the cosine of `other`, 1/sr, up to the gain; all vectors unit, both directions away from the surface.

    `alpha2` is the fourth power of the perceptual roughness. Fresnel is relative to its value at `fixed`, since the
    colour that scales the lobe holds that already. GGX: Walter et al. 2007, Eq. 33; shadowing: Heitz 2014, Eq. 99.
    No branch, so that loops over it are vectorised; directions that cancel have a half vector of 0.
    """
    h = add(fixed, other)
    h = scaled(h, ONE / math.sqrt(max(dot(h, h), f32(1e-12))))
    cos_h, cos_d = dot(normal, h), max(dot(h, fixed), ZERO)
    cos_f, cos_o = max(dot(normal, fixed), f32(0.02)), max(dot(normal, other), ZERO)
    t = cos_h * cos_h * (alpha2 - ONE) + ONE
    shadow = (cos_o * math.sqrt(cos_f * cos_f * (ONE - alpha2) + alpha2)
              + cos_f * math.sqrt(cos_o * cos_o * (ONE - alpha2) + alpha2))
    return (alpha2 * INV_PI / (t * t + f32(1e-12)) * HALF / (shadow + f32(1e-9)) * cos_o
            * fresnel(cos_d, f0) / fresnel(cos_f, f0))


@device_jit
def sample_lobe(normal, fixed, alpha, u, v):
    """(direction, weight): a direction drawn from the lobe without Fresnel, and the lobe over its density, at most about 1.

    Half vectors that `fixed` sees, of those only what reflects above the surface ("bounded VNDF", Eto and Tokuyoshi 2023,
    Eqs. 5 to 7; drawn on a spherical cap as in Dupuy and Benyoub 2023). D cancels in the weight, so that alpha may be 0:
    then it is the mirror direction. `fixed` must be on the surface's side.
    """
    tangent, bitangent = tangent_frame(normal)
    x, y, z = dot(fixed, tangent), dot(fixed, bitangent), min(max(dot(fixed, normal), f32(1e-4)), ONE)
    alpha2, sin2 = alpha * alpha, x * x + y * y
    size = math.sqrt(alpha2 * sin2 + z * z)
    standard = Vec3(alpha * x / size, alpha * y / size, z / size)
    spread = (ONE + math.sqrt(sin2)) * (ONE + math.sqrt(sin2))
    k = (ONE - alpha2) * spread / (spread + alpha2 * z * z)
    (x_cap, y_cap), lowest = on_circle(u), k * standard.z
    cap_z = (ONE - v) * (ONE + lowest) - lowest
    cap_r = math.sqrt(min(max(ONE - cap_z * cap_z, ZERO), ONE))
    h = normalized_or(Vec3(alpha * (cap_r * x_cap + standard.x), alpha * (cap_r * y_cap + standard.y),
                           cap_z + standard.z), Vec3(ZERO, ZERO, ONE))
    twice = f32(2) * (h.x * x + h.y * y + h.z * z)
    out = Vec3(twice * h.x - x, twice * h.y - y, max(twice * h.z - z, f32(1e-5)))
    shadow = out.z * math.sqrt(z * z * (ONE - alpha2) + alpha2) + z * math.sqrt(out.z * out.z * (ONE - alpha2) + alpha2)
    return normalized_or(to_world(out, tangent, bitangent, normal), normal), out.z * (k * z + size) / shadow


@device_jit
def lobe_density(normal, fixed, other, alpha):
    """1/sr with which `sample_lobe` draws the direction `other`: its lobe over its weight, in which shadowing cancels."""
    z, alpha2 = min(max(dot(normal, fixed), f32(1e-4)), ONE), alpha * alpha
    sin2 = ONE - z * z
    spread = (ONE + math.sqrt(sin2)) * (ONE + math.sqrt(sin2))
    k = (ONE - alpha2) * spread / (spread + alpha2 * z * z)
    cos_h = dot(normal, normalized_or(add(fixed, other), normal))
    t = cos_h * cos_h * (alpha2 - ONE) + ONE
    return alpha2 * INV_PI / (t * t + f32(1e-12)) * HALF / (k * z + math.sqrt(alpha2 * sin2 + z * z))


@functools.cache
def albedo_table() -> np.ndarray:
    """(GAIN_STEPS, GAIN_STEPS, 3) float32 of a lobe's reflectance.

    The hemispherical integrals of the lobe without Fresnel and of Fresnel's rise alone, and the rise that Cycles' Glossy
    Color tells. Rows are cosines of `fixed`, columns alphas, at the middles of even cells of [0, 1]. Half vectors are drawn
    with the density D cos: then the integrand is shadowing x Fresnel x 4 cos_other (v.h) / cos_h, and smooth for every
    alpha; more of them stand at grazing. Each row is turned a little further than the last, since the mean over visible
    normals ends abruptly at the horizon.
    """
    steps = (np.arange(GAIN_STEPS) + 0.5) / GAIN_STEPS
    cos_f, alpha2 = steps[:, None, None, None], (steps**2)[None, :, None, None]
    left = 1 - (np.arange(_QUADRATURE)[:, None] + 0.5) / _QUADRATURE
    u = 1 - left**2
    turn = np.arange(_QUADRATURE)[:, None] * (math.sqrt(5) - 1) / 2
    phi = (turn + np.arange(_QUADRATURE) + 0.5) / _QUADRATURE * 2 * math.pi
    cos_h = np.sqrt((1 - u) / (1 + (alpha2 - 1) * u))
    cos_d = np.maximum(np.sqrt(1 - cos_f**2) * np.sqrt(1 - cos_h**2) * np.cos(phi) + cos_f * cos_h, 0)
    cos_o = np.maximum(2 * cos_d * cos_h - cos_f, 0)
    hidden_f = np.sqrt(cos_f**2 * (1 - alpha2) + alpha2)
    shadow = cos_o * hidden_f + cos_f * np.sqrt(cos_o**2 * (1 - alpha2) + alpha2)
    lobe = 2 * cos_o * cos_d / (shadow * cos_h)
    visible = 2 * cos_d / ((cos_f + hidden_f) * cos_h) * (cos_o > 0)     # their density (Heitz 2018, Eq. 3) over D cos
    g = np.sqrt(cos_d**2 + 1.25)
    b = (cos_d * (g + cos_d) - 1) / (cos_d * (g - cos_d) + 1)
    rise = (0.5 * ((g - cos_d) / (g + cos_d)) ** 2 * (1 + b * b) - 0.04) / 0.96
    table = [(2 * left * weight).mean((2, 3)) for weight in (lobe, lobe * rise, visible * rise)]
    return np.stack(table, -1).astype(np.float32)


@inline_jit
def _interpolated(table, cos_fixed, alpha, column):
    x = min(max(cos_fixed * f32(GAIN_STEPS) - HALF, ZERO), f32(GAIN_STEPS - 1.001))
    y = min(max(alpha * f32(GAIN_STEPS) - HALF, ZERO), f32(GAIN_STEPS - 1.001))
    i, j = int(x), int(y)
    s, t = x - f32(i), y - f32(j)
    return ((ONE - s) * ((ONE - t) * table[i, j, column] + t * table[i, j + 1, column])
            + s * ((ONE - t) * table[i + 1, j, column] + t * table[i + 1, j + 1, column]))


@device_jit
def lobe_albedos(table, cos_fixed, alpha):
    """(integral of the lobe without Fresnel, of Fresnel's rise alone), interpolated in `albedo_table()`."""
    return _interpolated(table, cos_fixed, alpha, 0), _interpolated(table, cos_fixed, alpha, 1)


@inline_jit
def lobe_reflectance(flat, rise, f0):
    """Hemispherical integral of a lobe with its Fresnel term, from `lobe_albedos`."""
    return flat * (f0 + (ONE - f0) * rise_of(min(rise / max(flat, f32(1e-3)), ONE), f0))


@device_jit
def reflected_share(colour, cos_fixed, alpha, known_f0, keeps_energy, table):
    """What a lobe reflects towards `fixed` over `colour`, what Cycles' Glossy Color says that it does.

    That colour takes the mean of Fresnel's reflectance over the normals that `fixed` sees, whether or not what they reflect
    gets out between the other microfacets: up to 5 % too much at roughness 0.5. And it leaves out what a lobe of single
    scattering (`keeps_energy` 0) loses to them, 9 to 15 % at that roughness, about 40 at 0.8.
    """
    flat, rise = lobe_albedos(table, cos_fixed, alpha)
    told = _interpolated(table, cos_fixed, alpha, 2)
    f0 = known_f0 if known_f0 > ZERO else _solved_f0(colour, told)
    colourless = (f0 + (ONE - f0) * rise_of(told, f0)) * (flat if keeps_energy else ONE)
    return lobe_reflectance(flat, rise, f0) / max(colourless, f32(1e-6))


@functools.cache
def mean_albedo_table() -> np.ndarray:
    """(GAIN_STEPS, 3) float32: what `albedo_table` holds, averaged over all directions of `fixed` by their cosine."""
    cosine = (np.arange(GAIN_STEPS) + 0.5) / GAIN_STEPS
    return (2 * (albedo_table() * cosine[:, None, None]).mean(0)).astype(np.float32)


@device_jit
def mean_of_lobe(cos_fixed, alpha, f0, albedos, means):
    """What a lobe reflects in the mean over all directions, over what it reflects towards `fixed`.

    `albedos` is `albedo_table()` and `means` `mean_albedo_table()`.
    """
    flat, rise = lobe_albedos(albedos, cos_fixed, alpha)
    y = min(max(alpha * f32(GAIN_STEPS) - HALF, ZERO), f32(GAIN_STEPS - 1.001))
    j = int(y)
    t = y - f32(j)
    flat_mean, rise_mean = ((ONE - t) * means[j, 0] + t * means[j + 1, 0], (ONE - t) * means[j, 1] + t * means[j + 1, 1])
    return lobe_reflectance(flat_mean, rise_mean, f0) / max(lobe_reflectance(flat, rise, f0), f32(1e-4))


@device_jit
def matt_share(reflectance, cos_fixed, alpha, f0, albedos, means):
    """What lies under a dielectric's lobe gets towards all directions, over what it gets towards `fixed`.

    A surface that reflects E leaves 1 - E for what is below, and E rises towards grazing: a colour seen from `fixed` is that
    much too dark, or too bright, for the others. `means` is `mean_albedo_table()`. Metals have nothing below: 1.
    """
    reflectance = min(reflectance, f32(0.9))
    mean = reflectance * mean_of_lobe(cos_fixed, alpha, f0, albedos, means)
    dielectric = min(max((f32(0.2) - f0) / f32(0.12), ZERO), ONE)
    return ONE + dielectric * ((ONE - min(mean, f32(0.9))) / (ONE - reflectance) - ONE)


@inline_jit
def relative_reflectance(cosine, alpha, f0, table):
    """What a colourless lobe reflects towards a direction at `cosine`, over what it would without Fresnel."""
    flat, rise = lobe_albedos(table, cosine, alpha)
    return lobe_reflectance(flat, rise, f0) / max(flat, f32(1e-3))


@inline_jit
def _solved_f0(reflectance, rise):
    """F0 of a lobe that reflects `reflectance`, Fresnel's rise being `rise`: reflectance = F0 + (1 - F0) rise.

    The two terms are hard to tell apart, so what comes out like a dielectric is taken as one of index 1.5 (measured: closer
    to Cycles than the solution); above an F0 of 0.2, which only metals have, it stands.
    """
    rise = min(rise, f32(0.9))
    solved = min(max((reflectance - rise) / (ONE - rise), F0), ONE)
    t = min(max((solved - f32(0.08)) / f32(0.12), ZERO), ONE)
    return F0 + t * (solved - F0)


@device_jit
def fit_lobe(reflectance, cos_fixed, alpha, albedos, known=ZERO):
    """(F0, gain) of a lobe that reflects `reflectance` towards `fixed`; `albedos` is `albedo_table()`.

    The gain is 1 / (hemispherical integral of `ggx_lobe`). F0 is `known` where that is above 0, else the reflectance has to
    tell it.
    """
    flat, rise = lobe_albedos(albedos, cos_fixed, alpha)
    f0 = known if known > ZERO else _solved_f0(reflectance, rise / max(flat, f32(1e-3)))
    at_fixed = fresnel(min(max(cos_fixed, f32(0.02)), ONE), f0)
    return f0, at_fixed / max(lobe_reflectance(flat, rise, f0), f32(0.02) * at_fixed)
