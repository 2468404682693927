"""Irradiance at points from clusters of texels: resampled shadow rays through the BVH.

Each point weighs every cluster by what it would give unshadowed, draws rays from the clusters in proportion (stratified),
a texel in the cluster, and traces one segment to it (Talbot et al. 2005 with one candidate set: the weights are summed, not
sampled, so the estimate has no bias but for the bound on a single ray). Clusters too near for a mean are weighed texel by
texel.
"""

from __future__ import annotations

import math

import numpy as np

from .brdf import INV_PI, ggx_lobe
from .bvh import STACK, visibility
from .clusters import (
    ALPHA2,
    C_ALPHA2,
    C_DIFFUSE,
    C_F0,
    C_GLOSSY,
    C_NORMAL,
    C_RADIUS2,
    C_SPREAD,
    C_TO_LIGHT,
    DIFFUSE,
    F0,
    GLOSSY,
    NO_LOBE,
    NORMAL,
    TO_LIGHT,
)
from .jit import device_jit, pixel_jit, prange
from .sampling import uniform
from .vec3 import ONE, ZERO, Vec3, along, begun, dot, f32, lifted, load, load_column, scaled, sub

HALF, THIRD = f32(0.5), f32(1 / 3)
LEAST = f32(0.25)           # a cosine counts at least this share of the most that any texel of the cluster may have
NEAR = f32(1)               # a cluster nearer than its radius is summed texel by texel (squares): 15 % less noise than 0.25
MAX_SHARES = f32(8)         # a ray may give at most this many times its fair share: bounds rare bright rays
CANDIDATES = 4              # texels of a far cluster that compete for a ray
POINTS_A_BLOCK = 32         # points that one thread takes at a time, so that scratch is allocated once for them


@device_jit
def texel_factors(p, n, T, k, eps2):
    """(diffuse, glossy): irradiance at point p, normal n is diffuse * T[DIFFUSE, k] + glossy * T[GLOSSY, k]; 1/m2."""
    d = Vec3(T[0, k] - p.x, T[1, k] - p.y, T[2, k] - p.z)
    m = load_column(T, NORMAL, k)
    cos_r, cos_e = dot(d, n), -dot(d, m)
    if cos_r <= ZERO or cos_e <= ZERO:
        return ZERO, ZERO
    r2, glossy = dot(d, d) + eps2, ZERO
    if T[ALPHA2, k] < NO_LOBE:
        inv = ONE / math.sqrt(r2)
        glossy = cos_r * inv / r2 * ggx_lobe(m, load_column(T, TO_LIGHT, k), scaled(d, -inv), T[ALPHA2, k], T[F0, k])
    return cos_r * cos_e / (r2 * r2) * INV_PI, glossy


@device_jit
def _mean_given(T, k, diffuse, glossy):
    """Mean over the colours of what texel k gives with these factors."""
    return THIRD * (diffuse * (T[DIFFUSE, k] + T[DIFFUSE + 1, k] + T[DIFFUSE + 2, k])
                    + glossy * (T[GLOSSY, k] + T[GLOSSY + 1, k] + T[GLOSSY + 2, k]))


@device_jit
def _weigh(p, n, C, w):
    """Unshadowed weight of every cluster: 0 only where no texel of it can be above both horizons.

    With radius R and spread s of the normals no texel's product -d.n exceeds the mean's by more than R + s |d|. Weights
    of 0 for clusters that straddle a horizon lose up to 5 % of the light.
    """
    for c in range(C.shape[1]):                  # diffuse alone: this loop is vectorised
        dx, dy, dz, radius2 = C[0, c] - p.x, C[1, c] - p.y, C[2, c] - p.z, C[C_RADIUS2, c]
        radius, dist2 = math.sqrt(radius2), dx * dx + dy * dy + dz * dz
        cos_r = dx * n.x + dy * n.y + dz * n.z
        cos_e = -(dx * C[C_NORMAL, c] + dy * C[C_NORMAL + 1, c] + dz * C[C_NORMAL + 2, c])
        cos_r = max(cos_r + HALF * radius, LEAST * max(cos_r + radius, ZERO))
        cos_e = max(cos_e + HALF * radius, LEAST * max(cos_e + radius + math.sqrt(dist2) * C[C_SPREAD, c], ZERO))
        r2 = dist2 + radius2 * f32(0.25)
        w[c] = C[C_DIFFUSE, c] * cos_r * cos_e / (r2 * r2 + f32(1e-30)) * INV_PI + (
            f32(1e-30) if C[C_GLOSSY, c] > ZERO and cos_r > ZERO and cos_e > ZERO else ZERO)
    for c in range(C.shape[1]):
        if C[C_GLOSSY, c] > ZERO and w[c] > ZERO:
            d, radius2 = Vec3(C[0, c] - p.x, C[1, c] - p.y, C[2, c] - p.z), C[C_RADIUS2, c]
            slack = math.sqrt(radius2) * HALF
            r2 = dot(d, d) + radius2 * f32(0.25) + f32(1e-30)
            inv = ONE / math.sqrt(r2)
            wide = min(ONE, C[C_ALPHA2, c] + radius2 / r2)
            m = load_column(C, C_NORMAL, c)
            # lift the direction by the cluster's size: part of it sees the point even where its centre does not
            to_point = along(scaled(d, -inv), m, slack * inv)
            cos_r = max(dot(d, n) + slack, LEAST * (dot(d, n) + slack + slack))
            w[c] += C[C_GLOSSY, c] * cos_r * inv / r2 * ggx_lobe(
                m, load_column(C, C_TO_LIGHT, c), to_point, wide, C[C_F0, c])


@device_jit
def _pick_near(p, n, T, eps2, first, last, goal):
    """(texel, share): the texel of [first, last) where the running sum of what each gives here passes `goal`."""
    run, k, gives_k = ZERO, -1, ZERO
    for q in range(first, last):
        diffuse, glossy = texel_factors(p, n, T, q, eps2)
        gives = _mean_given(T, q, diffuse, glossy)
        if gives > ZERO:
            run, k, gives_k = run + gives, q, gives
            if run >= goal:
                break
    return k, gives_k


@device_jit
def _by_flux(running, first, last, u):
    """The column of [first, last) in proportion to flux, by bisection."""
    base, span = running[first], running[last] - running[first]
    lo, hi = first, last - 1
    while lo < hi:
        middle = (lo + hi) >> 1
        if running[middle + 1] > base + u * span:
            hi = middle
        else:
            lo = middle + 1
    return lo


@device_jit
def _pick_far(p, n, T, running, eps2, first, last, u, v):
    """(texel, share) by resampling: CANDIDATES texels drawn by flux, one of them kept by what it gives here.

    `share` is what the texel gives over the estimate of what the cluster gives (Talbot et al. 2005, Eq. 5).
    """
    span = running[last] - running[first]
    number = min(CANDIDATES, last - first)
    total, k, gives_k = ZERO, -1, ZERO
    for j in range(number):
        q = _by_flux(running, first, last, (f32(j) + u) / f32(number))
        diffuse, glossy = texel_factors(p, n, T, q, eps2)
        gives = _mean_given(T, q, diffuse, glossy)
        weight = gives * f32(span / (running[q + 1] - running[q]))
        total += weight
        if weight > ZERO and v * total < weight:         # keep it with probability weight / total (Chao 1982)
            v = v * total / weight
            k, gives_k = q, gives
        elif total > ZERO:
            v = (v * total - weight) / max(total - weight, f32(1e-30))
    return k, gives_k * f32(number) / max(total, f32(1e-30))


@device_jit
def _gather_at(p, n, point, clusters, eps2, bvh, rays, offset_m, seed, w, near, stack):
    """(r, g, b, unshadowed mean, variance of the mean) at one point."""
    C, T, start, end, running = clusters.table, clusters.texels, clusters.start, clusters.end, clusters.running
    n_clusters = C.shape[1]
    _weigh(p, n, C, w)
    total = ZERO
    for c in range(n_clusters):
        dx, dy, dz = C[0, c] - p.x, C[1, c] - p.y, C[2, c] - p.z
        near[c] = dx * dx + dy * dy + dz * dz < NEAR * C[C_RADIUS2, c]
        if near[c] and w[c] > ZERO:
            w[c] = ZERO
            for k in range(start[c], end[c]):
                diffuse, glossy = texel_factors(p, n, T, k, eps2)
                w[c] += _mean_given(T, k, diffuse, glossy)
        total += w[c]
    red, green, blue, squares = ZERO, ZERO, ZERO, ZERO
    if not total > ZERO:
        return red, green, blue, ZERO, ZERO
    origin, c, reached = lifted(p, n, offset_m), -1, ZERO
    for j in range(rays):
        target = (f32(j) + uniform(point, seed, 2 * j)) / f32(rays) * total
        while c < n_clusters - 1 and (reached <= target or c < 0):
            c += 1
            reached += w[c]
        if w[c] <= ZERO:
            continue
        u = uniform(point, seed, 2 * j + 1)
        if near[c]:
            k, gives = _pick_near(p, n, T, eps2, start[c], end[c], u * w[c])
            share = gives / w[c]
        else:
            k, share = _pick_far(p, n, T, running, eps2, start[c], end[c], u, uniform(point, seed ^ 0x5BD1, j))
        if k < 0 or share <= ZERO:
            continue
        diffuse, glossy = texel_factors(p, n, T, k, eps2)
        gives = _mean_given(T, k, diffuse, glossy)
        if gives <= ZERO:
            continue
        target_point = lifted(load_column(T, 0, k), load_column(T, NORMAL, k), offset_m)
        start_point = begun(origin, sub(target_point, origin), offset_m)
        arrives = visibility(bvh, stack, start_point, sub(target_point, start_point))
        if arrives == ZERO:
            continue
        s = total / (w[c] * share * f32(rays))
        s *= arrives * min(ONE, MAX_SHARES * total / f32(rays) / (gives * s))
        red += s * (diffuse * T[DIFFUSE, k] + glossy * T[GLOSSY, k])
        green += s * (diffuse * T[DIFFUSE + 1, k] + glossy * T[GLOSSY + 1, k])
        blue += s * (diffuse * T[DIFFUSE + 2, k] + glossy * T[GLOSSY + 2, k])
        squares += s * s * gives * gives
    mean = THIRD * (red + green + blue)
    return red, green, blue, total, max(squares - mean * mean / f32(rays), ZERO)


@pixel_jit
def gather_visible(position, normal, ids, clusters, eps2, bvh, rays, offset_m, seed):
    """Irradiance at points (M, 3) with unit normals (M, 3) by `rays` shadow rays each, as (M, 5) float32.

    Columns: irradiance by colour; what the clusters would give unshadowed (mean over colours); variance of the mean. W/m2.
    `ids` (M,) int64 seeds each point's random numbers; `eps2` m2 keeps 1 / r^2 finite on the texel itself; `offset_m`
    lifts both ends of a ray off their surfaces.
    """
    number, n_clusters = position.shape[0], clusters.table.shape[1]
    out = np.zeros((number, 5), np.float32)
    for block in prange((number + POINTS_A_BLOCK - 1) // POINTS_A_BLOCK):
        w, near, stack = np.empty(n_clusters, np.float32), np.empty(n_clusters, np.bool_), np.empty(STACK, np.int32)
        for m in range(block * POINTS_A_BLOCK, min(number, (block + 1) * POINTS_A_BLOCK)):
            out[m, 0], out[m, 1], out[m, 2], out[m, 3], out[m, 4] = _gather_at(
                load(position, m), load(normal, m), ids[m], clusters, eps2, bvh, rays, offset_m, seed, w, near, stack)
    return out
