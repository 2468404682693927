"""Light of emissive surfaces that reaches a pixel straight: points on them as lamps, drawn by what they give, with rays.

Points lie on the emissive triangles as evenly as their power does, on both sides, each a Lambertian sender of its share of
the flux pi L A. They are clustered and gathered as the texels of reflective shadow maps are (`kernels.gather`): the sum over
the clusters tells what all of them would give, and the rays which of it arrives.
"""

from __future__ import annotations

import math

import numpy as np

from ..core.frame import Frame, Geometry
from ..core.radiometry import find_emitters
from ..core.techniques import EmissionParams
from ..kernels.clusters import ALPHA2, DIFFUSE, F0, GLOSSY, NO_LOBE, NORMAL, POSITION, ROWS, TO_LIGHT, cluster_texels
from ..kernels.gather import gather_visible
from ..kernels.vec3 import f32
from .base import Context, PassResult, Technique, Transport
from .lattice import gather_on_lattice
from .rsm import MIN_DISTANCE2

POINTS = 16384              # on each side of all emissive surfaces together: a panel of 1 m2 gets one for each 8 mm


def emitter_table(geometry: Geometry, points: int = POINTS) -> np.ndarray:
    """(17, 2 * points) float32 table of senders on both sides of the emissive triangles (rows: `kernels.clusters`).

    Without emissive triangles it has no columns. Triangles are drawn by radiance times area, in order, so that each gets the
    points that its power asks for; a point's place in its triangle is the next of an even sequence.
    """
    corners, across, radiance, power = find_emitters(geometry)
    total = power.sum()
    if not total > 0:
        return np.empty((ROWS, 0), np.float32)
    index = np.arange(points)
    of = np.minimum(np.searchsorted(np.cumsum(power), (index + 0.5) / points * total), len(power) - 1)
    # an even sequence on the square, folded to the triangle: a parallelogram's far half is its near one turned
    a, b = 0.7548776662466927 * index % 1, 0.5698402909980532 * index % 1
    folded = a + b > 1
    a, b = np.where(folded, 1 - a, a), np.where(folded, 1 - b, b)
    first, second, third = corners[of].swapaxes(0, 1)
    place = first + a[:, None] * (second - first) + b[:, None] * (third - first)
    normal = across[of] / np.linalg.norm(across[of], axis=1, keepdims=True)
    flux = radiance[of] / radiance[of].mean(1, keepdims=True) * (math.pi * total / points)
    table = np.zeros((ROWS, 2 * points), np.float32)
    table[POSITION:POSITION + 3] = np.concatenate([place, place]).T
    table[NORMAL:NORMAL + 3] = np.concatenate([normal, -normal]).T
    table[TO_LIGHT:TO_LIGHT + 3] = table[NORMAL:NORMAL + 3]
    table[DIFFUSE:DIFFUSE + 3] = np.concatenate([flux, flux]).T
    table[GLOSSY:GLOSSY + 3], table[ALPHA2], table[F0] = 0, NO_LOBE, 0.04
    return table


def compute_emission(frame: Frame, params: EmissionParams, context: Context, seed: int = 0) -> PassResult:
    """Irradiance from emissive surfaces, with visibility through the scene's triangles.

    Parameters
    ----------
    frame : Frame
        With `geometry`, whose triangles tell their emission.
    params : EmissionParams
    context : Context
    seed : int

    Returns
    -------
    PassResult
        EMISSION_DIFFUSE: (H, W, 3) float32 W/m2. Diagnostics: share of the pixels gathered.

    Raises
    ------
    Cancelled
        When the user asked to stop.

    Notes
    -----
    Holds exactly: linear in the emission; zero without any; the same bits on any number of threads. Ignores how a texture's
    emission varies inside of a triangle. Both sides of a triangle send, as in Cycles.
    """
    geometry = frame.geometry if frame.geometry is not None else Geometry.empty()
    table = emitter_table(geometry)
    if not table.shape[1]:
        return PassResult({Transport.EMISSION_DIFFUSE: np.zeros_like(frame.gbuffer.albedo)})
    bvh = context.bvh(geometry)
    clusters = cluster_texels(table, params.clusters, frame.scale_m)
    offset_m, eps2 = f32(frame.ray_offset_m), f32(MIN_DISTANCE2 * frame.scale_m**2)

    def gather(position: np.ndarray, normal: np.ndarray, _: np.ndarray, places: np.ndarray, salt: int) -> np.ndarray:
        return gather_visible(position, normal, places, clusters, eps2, bvh, params.rays, offset_m, salt)

    irradiance, diagnostics = gather_on_lattice(frame, gather, params.lattice_px, 2 * seed + 5, context, "Emissive surfaces")
    return PassResult({Transport.EMISSION_DIFFUSE: irradiance}, diagnostics=diagnostics)


TECHNIQUE = Technique("emission", "Emissive Surfaces", EmissionParams, compute_emission,
                      frozenset({Transport.EMISSION_DIFFUSE}), needs_geometry=True)
