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
from .bvh import BIG, STACK, closest_hit, triangle_normal, visibility
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
    FADE,
    GLOSSY,
    LEAST_COSINE,
    MEAN_DIFFUSE,
    MEAN_GLOSSY,
    NO_LOBE,
    NORMAL,
    RADIUS,
    TO_LIGHT,
    find_by_flux,
)
from .jit import borrowed, inline_jit, pixel_jit, scratch
from .sampling import disk, dither, near_weight, uniform
from .vec3 import ONE, ZERO, Vec3, add, along, begun, dot, f32, lifted, load, load_column, scaled, sub, tangent_frame

HALF, THIRD = f32(0.5), f32(1 / 3)
LEAST = f32(0.25)           # a cosine counts at least this share of the most that any texel of the cluster may have
NEAR = f32(1)               # a cluster nearer than its radius is summed texel by texel (squares): 15 % less noise than 0.25
MAX_SHARES = f32(8)         # a ray may give at most this many times its fair share: bounds rare bright rays
SPREAD2 = f32(16)           # distance over a texel's radius, squared, below which it is no point
SAME_SURFACE = f32(0.9)     # cosine of the triangle's normal and the texel's, which may be bumped, on one surface
CANDIDATES = 4              # texels of a far cluster that compete for a ray
SHARP2 = f32(0.04)          # squared alpha from which a texel competes as if its lobe were matt: any weights will do
NEAR_TEXELS = 8192          # texels of near clusters that a point weighs one by one; clusters beyond count as far


@inline_jit
def _record_factors(p, n, R, k, place, m, eps2):
    """(diffuse, glossy): irradiance at p, normal n is diffuse * R[k, DIFFUSE] + glossy * R[k, GLOSSY]; 1/m2.

    Light leaves the texel k at `place`, of normal m.
    """
    d = sub(place, p)
    cos_r, cos_e = dot(d, n), -dot(d, m)
    if cos_r <= ZERO or cos_e <= ZERO:
        return ZERO, ZERO
    r2, glossy = dot(d, d) + eps2, ZERO
    if R[k, ALPHA2] < NO_LOBE:
        inv, to_light = ONE / math.sqrt(r2), Vec3(R[k, TO_LIGHT], R[k, TO_LIGHT + 1], R[k, TO_LIGHT + 2])
        glossy = cos_r * inv / r2 * ggx_lobe(m, to_light, scaled(d, -inv), R[k, ALPHA2], R[k, F0])
    return cos_r * cos_e / (r2 * r2) * INV_PI, glossy


@inline_jit
def _weigh(p, n, C, has_glossy, w):
    """Unshadowed weight of every cluster: 0 only where no texel of it can be above both horizons.

    With radius R and spread s of the normals no texel's product -d.n exceeds the mean's by more than R + s |d|. Weights
    of 0 for clusters that straddle a horizon lose up to 5 % of the light.
    """
    for c in range(C.shape[1]):                  # without a branch, so that it is vectorised
        d, radius2 = Vec3(C[0, c] - p.x, C[1, c] - p.y, C[2, c] - p.z), C[C_RADIUS2, c]
        m = load_column(C, C_NORMAL, c)
        radius, dist2 = math.sqrt(radius2), dot(d, d)
        towards, from_there = dot(d, n), -dot(d, m)
        cos_r = max(towards + HALF * radius, LEAST * max(towards + radius, ZERO))
        cos_e = max(from_there + HALF * radius,
                    LEAST * max(from_there + radius + math.sqrt(dist2) * C[C_SPREAD, c], ZERO))
        r2 = dist2 + radius2 * f32(0.25) + f32(1e-30)
        w[c] = C[C_DIFFUSE, c] * cos_r * cos_e / (r2 * r2 + f32(1e-30)) * INV_PI
        if has_glossy:
            inv = ONE / math.sqrt(r2)
            wide = min(ONE, C[C_ALPHA2, c] + radius2 / r2)
            # lift the direction by the cluster's size: part of it sees the point even where its centre does not
            to_point = along(scaled(d, -inv), m, radius * HALF * inv)
            lobe = ggx_lobe(m, load_column(C, C_TO_LIGHT, c), to_point, wide, C[C_F0, c])
            # a cluster without a lobe has an F0 of 0 too, and its lobe may be 0 / 0
            w[c] += (C[C_GLOSSY, c] * cos_r * inv / r2 * lobe) if min(C[C_GLOSSY, c], cos_e) > ZERO else ZERO


@inline_jit
def _weigh_texels(p, n, T, has_glossy, eps2, first, number, out, at):
    """Mean over the colours of what each of `number` texels gives unshadowed, to out[at:]; returns their sum.

    About: a near texel's disk may reach above a horizon, or closer, where its middle does not.
    """
    total = ZERO
    for i in range(number):                      # without a branch and with unsigned indices: vectorised
        k = np.uint64(first) + np.uint64(i)
        d = Vec3(T[0, k] - p.x, T[1, k] - p.y, T[2, k] - p.z)
        m = Vec3(T[NORMAL, k], T[NORMAL + 1, k], T[NORMAL + 2, k])
        lift = f32(0.25) * T[RADIUS, k]
        cos_r, cos_e = dot(d, n), -dot(d, m)
        r2 = dot(d, d) + f32(4) * lift * lift + eps2
        gives = (cos_r + lift) * (cos_e + lift) / (r2 * r2) * INV_PI * T[MEAN_DIFFUSE, k]
        if has_glossy:
            inv, to_light = ONE / math.sqrt(r2), Vec3(T[TO_LIGHT, k], T[TO_LIGHT + 1, k], T[TO_LIGHT + 2, k])
            gives += (cos_r * inv / r2 * T[MEAN_GLOSSY, k]
                      * ggx_lobe(m, to_light, scaled(d, -inv), min(T[ALPHA2, k], ONE), T[F0, k]))
        gives = gives if min(cos_r, cos_e) > ZERO else ZERO
        out[np.uint64(at) + np.uint64(i)] = gives
        total += gives
    return total


@inline_jit
def _pick_near(gives, first, number, goal):
    """(index, what it gives): the first of gives[first:first + number] at which their running sum passes `goal`."""
    run, found, gives_found = ZERO, -1, ZERO
    for q in range(number):
        g = gives[first + q]
        if g > ZERO:
            run, found, gives_found = run + g, q, g
            if run >= goal:
                break
    return found, gives_found


@inline_jit
def _pick_far(p, n, R, running, guide, eps2, first, last, u, v):
    """(texel, share) by resampling: CANDIDATES texels drawn by flux, one of them kept by what it gives here.

    `share` is what the texel gives over the estimate of what the cluster gives (Talbot et al. 2005, Eq. 5).
    """
    span = running[last] - running[first]
    number = min(CANDIDATES, last - first)
    total, k, gives_k = ZERO, -1, ZERO
    for j in range(number):
        q = find_by_flux(running, guide, first, last, (f32(j) + u) / f32(number))
        normal = Vec3(R[q, NORMAL], R[q, NORMAL + 1], R[q, NORMAL + 2])
        if R[q, ALPHA2] < SHARP2:
            diffuse, glossy = _record_factors(p, n, R, q, load(R, q), normal, eps2)
            gives = diffuse * R[q, MEAN_DIFFUSE] + glossy * R[q, MEAN_GLOSSY]
        else:
            d = sub(load(R, q), p)
            cos_r, cos_e, r2 = max(dot(d, n), ZERO), max(-dot(d, normal), ZERO), dot(d, d) + eps2
            gives = cos_r * cos_e / (r2 * r2) * INV_PI * (R[q, MEAN_DIFFUSE] + R[q, MEAN_GLOSSY])
        weight = gives * f32(span / (running[q + 1] - running[q]))
        total += weight
        if weight > ZERO and v * total < weight:         # keep it with probability weight / total (Chao 1982)
            v = v * total / weight
            k, gives_k = q, gives
        elif total > ZERO:
            v = (v * total - weight) / max(total - weight, f32(1e-30))
    return k, gives_k * f32(number) / max(total, f32(1e-30))


@inline_jit
def _place_in(p, R, k, bvh, stack, u, v):
    """(place, normal) where the light of texel k comes from: its middle, for near points p what the lamp hits beside it.

    A texel's light falls on all that its square of the lamp's view holds. Near it that matters: in a corner, on a ledge that
    is narrower than a texel, at the edge of a shadow. One ray of the lamp, drawn in the disk of the square's area, finds the
    triangle.
    """
    middle, radius, to_light = load(R, k), R[k, RADIUS], Vec3(R[k, TO_LIGHT], R[k, TO_LIGHT + 1], R[k, TO_LIGHT + 2])
    normal, d = Vec3(R[k, NORMAL], R[k, NORMAL + 1], R[k, NORMAL + 2]), sub(middle, p)
    if dot(d, d) >= SPREAD2 * radius * radius:
        return middle, normal
    tangent, bitangent = tangent_frame(to_light)
    x, y = disk(u, v)
    # the radius is that on the surface, which grows as the lamp's square falls flatter on it
    across = radius * math.sqrt(max(dot(normal, to_light), LEAST_COSINE))
    off = add(scaled(tangent, across * x), scaled(bitangent, across * y))
    start = along(add(middle, off), to_light, f32(2) * radius)
    t, slot, _, _ = closest_hit(bvh, stack, start, scaled(to_light, -ONE), BIG)
    if slot < 0:
        return middle, normal
    face = triangle_normal(bvh, slot)
    if dot(face, to_light) < ZERO:
        face = scaled(face, -ONE)
    return along(start, to_light, -t), normal if dot(face, normal) > SAME_SURFACE else face


@inline_jit
def _gather_at(p, n, place, clusters, eps2, bvh, rays, offset_m, seed, w, at, gives_near, stack):
    """(r, g, b, unshadowed mean, variance of the mean) at one point.

    w, at (C,), gives_near (NEAR_TEXELS,) and stack are scratch: weights of clusters, where in `gives_near` the texels of a
    near cluster stand (-1: far), and what they give.
    """
    C, R, start, end = clusters.table, clusters.records, clusters.start, clusters.end
    n_clusters, has_glossy = C.shape[1], clusters.has_glossy
    _weigh(p, n, C, has_glossy, w)
    total, used = ZERO, 0
    for c in range(n_clusters):
        at[c] = -1
        if w[c] > ZERO:
            dx, dy, dz, number = C[0, c] - p.x, C[1, c] - p.y, C[2, c] - p.z, end[c] - start[c]
            if dx * dx + dy * dy + dz * dz < NEAR * C[C_RADIUS2, c] and used + number <= NEAR_TEXELS:
                at[c] = used
                w[c] = _weigh_texels(p, n, clusters.texels, has_glossy, eps2, start[c], number, gives_near, used)
                used += number
            total += w[c]
    red, green, blue, squares = ZERO, ZERO, ZERO, ZERO
    if not total > ZERO:
        return red, green, blue, ZERO, ZERO
    origin, c, reached = lifted(p, n, offset_m), -1, ZERO
    for j in range(rays):
        target = (f32(j) + dither(place, seed, 3 * j)) / f32(rays) * total
        while c < n_clusters - 1 and (reached <= target or c < 0):
            c += 1
            reached += w[c]
        if w[c] <= ZERO:
            continue
        u = uniform(place, seed, 2 * j)
        if at[c] >= 0:
            k, gives = _pick_near(gives_near, at[c], end[c] - start[c], u * w[c])
            share = gives / w[c]
            k += start[c] if k >= 0 else 0
        else:
            k, share = _pick_far(p, n, R, clusters.running, clusters.guide, eps2, start[c], end[c], u,
                                 uniform(place, seed, 2 * j + 1))
        if k < 0 or share <= ZERO:
            continue
        sender, facing = _place_in(p, R, k, bvh, stack, uniform(place, seed + 1, 2 * j), uniform(place, seed + 1, 2 * j + 1))
        diffuse, glossy = _record_factors(p, n, R, k, sender, facing, eps2)
        if R[k, FADE] > ZERO:
            d = sub(sender, p)
            diffuse *= ONE - near_weight(dot(d, d), R[k, FADE])
        gives = diffuse * R[k, MEAN_DIFFUSE] + glossy * R[k, MEAN_GLOSSY]
        if gives <= ZERO:
            continue
        target_point = lifted(sender, facing, offset_m)
        start_point = begun(origin, sub(target_point, origin), offset_m)
        arrives = visibility(bvh, stack, start_point, sub(target_point, start_point))
        if arrives == ZERO:
            continue
        s = total / (w[c] * share * f32(rays))
        s *= arrives * min(ONE, MAX_SHARES * total / f32(rays) / (gives * s))
        red += s * (diffuse * R[k, DIFFUSE] + glossy * R[k, GLOSSY])
        green += s * (diffuse * R[k, DIFFUSE + 1] + glossy * R[k, GLOSSY + 1])
        blue += s * (diffuse * R[k, DIFFUSE + 2] + glossy * R[k, GLOSSY + 2])
        squares += s * s * gives * gives
    mean = THIRD * (red + green + blue)
    return red, green, blue, total, max(squares - mean * mean / f32(rays), ZERO)


@pixel_jit
def _gather_visible(begin, end, position, normal, places, clusters, eps2, bvh, rays, offset_m, seed, out):
    clusters, bvh = borrowed((clusters, bvh))
    n_clusters = clusters.table.shape[1]
    w, at, stack = np.empty(n_clusters, np.float32), np.empty(n_clusters, np.int32), scratch(STACK, np.int32)
    gives_near = scratch(NEAR_TEXELS, np.float32)
    for m in range(begin, end):
        p, n = load(position, m), load(normal, m)
        out[m, 0], out[m, 1], out[m, 2], out[m, 3], out[m, 4] = _gather_at(
            p, n, places[m], clusters, eps2, bvh, rays, offset_m, seed, w, at, gives_near, stack)


def gather_visible(position, normal, places, clusters, eps2, bvh, rays, offset_m, seed):
    """Irradiance at points (M, 3) with unit normals (M, 3) by `rays` shadow rays each, as (M, 5) float32.

    Columns: irradiance by colour; what the clusters would give unshadowed (mean over colours); variance of the mean. W/m2.
    `places` (M,) int64, see `sampling.place_ids`, seed each point's random numbers; `eps2` m2 keeps 1 / r^2 finite on the
    texel itself; `offset_m` lifts both ends of a ray off their surfaces.
    """
    out = np.zeros((len(position), 5), np.float32)
    _gather_visible(len(position), position, normal, places, clusters, eps2, bvh, rays, offset_m, seed, out)
    return out
