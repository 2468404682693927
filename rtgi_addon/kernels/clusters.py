"""Texels of reflective shadow maps as one table, grouped into clusters that stand for them at a distance.

The texel table is (17, N) float32, N innermost: position (3), normal (3), diffuse reflected flux W (3), unit direction to
the light (3), glossy reflected flux W (3, the lobe's gain in it), GGX alpha squared (NO_LOBE marks a texel without a
glossy lobe), Schlick's F0 of the lobe. Each cluster is a contiguous run of columns.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .brdf import INV_PI, fit_lobe, matt_share
from .jit import device_jit, inline_jit, pixel_jit
from .vec3 import ONE, ZERO, along, dot, f32, load_pixel, normalized_or, scaled, sub

# rows of the texel table
POSITION, NORMAL, DIFFUSE, TO_LIGHT, GLOSSY, ALPHA2, F0 = 0, 3, 6, 9, 12, 15, 16
ROWS = 17
# clustered texels have three more: mean over the colours of each flux, which is what draws go by, and the radius of the disk
# that has the texel's area
MEAN_DIFFUSE, MEAN_GLOSSY, RADIUS = 17, 18, 19
FADE = 20                   # only where it is read whole: `near_weight` of senders that another technique takes, else 0
RECORD = 21                 # numbers a texel takes where it is read whole
NO_LOBE = f32(2)
# rows of the cluster table
C_POSITION, C_NORMAL, C_DIFFUSE, C_RADIUS2, C_TO_LIGHT, C_GLOSSY, C_ALPHA2, C_SPREAD, C_F0 = 0, 3, 6, 7, 8, 11, 12, 13, 14
CLUSTER_ROWS = 15
MIN_ALPHA = f32(0.1)        # sharper lobes are widened: in a gather their noise costs more than their blur
LOBE_SHARE = f32(1e-3)      # a glossy lobe below this share of the texel's flux is dropped
LEAST_COSINE = f32(0.1)     # of a texel's normal to its lamp: on flatter ones its disk grows no longer
SAME_NORMAL = f32(0.99999)  # cosine above which the shading normal is that of the triangle, but for rounding
MOST_LIT = f32(4)           # of what arrives at a triangle: where only the shading normal faces the lamp
TIE = 1 + 1e-4              # what lies less apart is equal: in even scenes rounding would choose the cuts, and a kilometre
                            # off the origin places lose 6e-5 m
NORMAL_WEIGHT = 0.15        # how far apart in scene sizes two opposite normals count, when clusters are split


class Clusters(NamedTuple):
    """Texels in cluster order and their means, as the gather takes them.

    texels (20, N) float32, for loops over runs, and the same as records (N, 21), for texels drawn here and there (a fifth of
    the memory traffic); has_glossy: whether any texel has a lobe;
    table (15, C) float32: mean position, mean unit normal, mean diffuse flux (summed), largest
    squared distance of a texel, mean direction to the light, mean glossy flux, alpha squared widened by the spread,
    largest difference of a texel's normal to the mean, mean F0;
    start, end (C,) int64: the columns of each cluster; running (N + 1,) float64: flux summed over the columns before;
    guide (N,) int32: of a cluster's n columns the one at which its flux passes the share i / n, see `find_by_flux`.
    """

    texels: np.ndarray
    records: np.ndarray
    has_glossy: bool
    table: np.ndarray
    start: np.ndarray
    end: np.ndarray
    running: np.ndarray
    guide: np.ndarray


@inline_jit
def _as_if_from(w, n, m):
    """Direction from which light has to come for a surface of normal m to mirror it where normal n mirrors that along w."""
    mirrored = along(scaled(w, -ONE), n, f32(2) * dot(n, w))
    return along(scaled(mirrored, -ONE), m, f32(2) * dot(m, mirrored)) if dot(m, mirrored) > LEAST_COSINE else w


@pixel_jit
def fill_texels(begin, end, table, first, reflects, position, normal, face, albedo, specular, roughness, known_f0, flux,
                origin, to_sun, is_sun, albedos, means, use_glossy, sharpest, across, radius):
    """Write the texels of one view that `reflects` (H, W) marks to columns first[row] + ... of `table`, row by row.

    A surface of shading normal `normal` (H, W, 3) is lit as that says, over the area that its triangle, of normal `face`,
    turns to the lamp, and sends from there. The light comes from the places `origin` (H, W, 3), or from `to_sun`. Lobes of
    an alpha below `sharpest` are left out. `radius` (N,) gets the radius in m of the disk that has the texel's area on the
    surface; `across` (H, W) is the texel's solid angle, or its area in m2 where the lamp is a sun.
    """
    height, width = roughness.shape
    for i in range(begin, end):
        k = first[i]
        for j in range(width):
            if not reflects[i, j]:
                continue
            p, n, m = load_pixel(position, i, j), load_pixel(normal, i, j), load_pixel(face, i, j)
            is_flat = dot(n, m) > SAME_NORMAL
            if is_flat:                          # then the receivers' normals are the same to the last digit
                m = n
            w = to_sun if is_sun else normalized_or(sub(load_pixel(origin, i, j), p), n)
            alpha = roughness[i, j] * roughness[i, j]
            has_lobe = use_glossy and alpha >= sharpest
            alpha = min(max(alpha, MIN_ALPHA), ONE)
            d, cosine = sub(load_pixel(origin, i, j), p), min(max(dot(n, w), ZERO), f32(0.999))
            of_face = max(dot(m, w), LEAST_COSINE)
            radius[k] = math.sqrt(across[i, j] * (ONE if is_sun else dot(d, d)) * INV_PI / of_face)
            lit = min(max(dot(n, w), ZERO) / of_face, MOST_LIT) if not is_flat else ONE
            reflectance = (specular[i, j, 0] + specular[i, j, 1] + specular[i, j, 2]) * f32(1 / 3)
            f0, gain = fit_lobe(reflectance, cosine, alpha, albedos, known_f0[i, j])
            below, diffuse, glossy = matt_share(reflectance, cosine, alpha, f0, albedos, means), ZERO, ZERO
            for a in range(3):
                table[DIFFUSE + a, k] = lit * flux[i, j, a] * min(albedo[i, j, a] * below, ONE)
                table[GLOSSY + a, k] = lit * flux[i, j, a] * specular[i, j, a] * gain if has_lobe else ZERO
                diffuse += table[DIFFUSE + a, k]
                glossy += table[GLOSSY + a, k]
            table[POSITION, k], table[POSITION + 1, k], table[POSITION + 2, k] = p.x, p.y, p.z
            table[NORMAL, k], table[NORMAL + 1, k], table[NORMAL + 2, k] = m.x, m.y, m.z
            table[ALPHA2, k] = alpha * alpha if glossy > LOBE_SHARE * (diffuse + glossy) else NO_LOBE
            if lit != ONE and table[ALPHA2, k] < NO_LOBE:
                w = _as_if_from(w, n, m)
            table[TO_LIGHT, k], table[TO_LIGHT + 1, k], table[TO_LIGHT + 2, k] = w.x, w.y, w.z
            table[F0, k] = f0
            k += 1


@device_jit
def _moments(feature, weight, order, start, end, m1, m2):
    """Total weight; m1 and m2 get the weighted sums of the features and of their squares."""
    total = 0.0
    for a in range(6):
        m1[a] = m2[a] = 0.0
    for k in range(start, end):
        t = order[k]
        w = np.float64(weight[t])
        total += w
        for a in range(6):
            x = np.float64(feature[t, a])
            m1[a] += w * x
            m2[a] += w * x * x
    return total


@device_jit
def _partition(feature, order, start, end, axis, cut):
    """Columns up to `cut` first; returns where the second part starts."""
    i, j = start, end - 1
    while i <= j:
        t = order[i]
        if feature[t, axis] <= cut:
            i += 1
        else:
            order[i], order[j] = order[j], t
            j -= 1
    return i


@device_jit
def _split(feature, weight, order, first, last, number, start, end, cost):
    """Best-first split of order[first:last] into at most `number` runs, written to start and end; returns how many.

    `cost` gets the weighted variance of each run.

    Each step halves the cluster of largest weighted variance at the weighted mean of its widest feature. Of equal ones the
    first is taken, and what lies on the mean goes to the first part.
    """
    cut, axis = np.zeros(number), np.zeros(number, np.int64)
    m1, m2 = np.zeros(6), np.zeros(6)
    start[0], end[0], used = first, last, 1
    changed0, changed1 = 0, -1
    while True:
        for c in (changed0, changed1):
            if c < 0:
                continue
            total = _moments(feature, weight, order, start[c], end[c], m1, m2)
            cost[c] = 0.0
            if total > 0 and end[c] - start[c] > 1:
                widest, sum_spread = -1.0, 0.0
                for a in range(6):
                    spread = m2[a] - m1[a] * m1[a] / total
                    sum_spread += max(0.0, spread)
                    if spread > TIE * widest:
                        widest, axis[c] = spread, a
                        cut[c] = m1[a] / total + (TIE - 1.0) * math.sqrt(max(spread, 0.0) / total)
                cost[c] = sum_spread
        worst = 0
        for c in range(1, used):
            if cost[c] > TIE * cost[worst]:
                worst = c
        if used == number or cost[worst] <= 0.0:
            return used
        middle = _partition(feature, order, start[worst], end[worst], axis[worst], cut[worst])
        if middle == start[worst] or middle == end[worst]:
            cost[worst] = 0.0                    # equal to the last digit: nothing to split
            changed0, changed1 = -1, -1
            continue
        start[used], end[used], end[worst] = middle, end[worst], middle
        changed0, changed1 = worst, used
        used += 1


@pixel_jit
def _split_each(begin, stop, feature, weight, order, group_start, group_end, budget, first, start, end, used):
    for g in range(begin, stop):
        a, b = first[g], first[g] + budget[g]
        used[g] = _split(feature, weight, order, group_start[g], group_end[g], budget[g], start[a:b], end[a:b],
                         np.zeros(budget[g]))


def _split_groups(feature, weight, order, group_start, group_end, budget, first, start, end):
    """Split each group into at most budget[g] clusters, written from index first[g]; returns how many each got."""
    used = np.zeros(group_start.shape[0], np.int64)
    _split_each(group_start.shape[0], feature, weight, order, group_start, group_end, budget, first, start, end, used)
    return used


GROUPS = 16                 # parts that are split side by side; their number must not follow the number of threads


def _split_texels(feature: np.ndarray, weight: np.ndarray, number: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(order, start, end): texel indices in cluster order, and each cluster's run in it."""
    order = np.arange(len(weight))
    groups = min(GROUPS, number)
    start, end, variance = np.zeros(groups, np.int64), np.zeros(groups, np.int64), np.zeros(groups)
    used = _split(feature, weight, order, 0, len(weight), groups, start, end, variance)
    start, end = start[:used], end[:used]
    if number <= groups:
        return order, start, end
    # with n clusters a part's variance falls about as n^-2 in one dimension and n^-1 in two: share by the square root
    root = np.sqrt(variance[:used])
    share = root / root.sum() if root.sum() > 0 else np.full(used, 1 / used)
    budget = np.maximum(1, np.floor(share * (number - used))).astype(np.int64)
    first = np.concatenate([[0], np.cumsum(budget)[:-1]])
    all_start, all_end = np.zeros(budget.sum(), np.int64), np.zeros(budget.sum(), np.int64)
    got = _split_groups(feature, weight, order, start, end, budget, first, all_start, all_end)
    kept = np.concatenate([np.arange(a, a + n) for a, n in zip(first, got, strict=True)])
    by_column = kept[np.argsort(all_start[kept], kind="stable")]
    return order, all_start[by_column], all_end[by_column]


@pixel_jit
def _summarise_each(begin, stop, T, start, end, out):
    for c in range(begin, stop):
        px = py = pz = nx = ny = nz = lx = ly = lz = total = diffuse = glossy = alpha2 = f0 = 0.0
        for k in range(start[c], end[c]):
            d = np.float64(T[DIFFUSE, k]) + T[DIFFUSE + 1, k] + T[DIFFUSE + 2, k]
            g = np.float64(T[GLOSSY, k]) + T[GLOSSY + 1, k] + T[GLOSSY + 2, k]
            w = d + g
            total, diffuse, glossy = total + w, diffuse + d, glossy + g
            alpha2 += g * min(T[ALPHA2, k], ONE)
            f0 += g * T[F0, k]
            px, py, pz = px + w * T[0, k], py + w * T[1, k], pz + w * T[2, k]
            nx, ny, nz = nx + w * T[NORMAL, k], ny + w * T[NORMAL + 1, k], nz + w * T[NORMAL + 2, k]
            lx, ly, lz = lx + w * T[TO_LIGHT, k], ly + w * T[TO_LIGHT + 1, k], lz + w * T[TO_LIGHT + 2, k]
        inv = 1 / max(total, 1e-300)
        n_length = max(math.sqrt(nx * nx + ny * ny + nz * nz) * inv, 1e-9)
        l_length = max(math.sqrt(lx * lx + ly * ly + lz * lz) * inv, 1e-9)
        out[0, c], out[1, c], out[2, c] = px * inv, py * inv, pz * inv
        out[C_NORMAL, c], out[C_NORMAL + 1, c], out[C_NORMAL + 2, c] = (
            nx * inv / n_length, ny * inv / n_length, nz * inv / n_length)
        out[C_TO_LIGHT, c], out[C_TO_LIGHT + 1, c], out[C_TO_LIGHT + 2, c] = (
            lx * inv / l_length, ly * inv / l_length, lz * inv / l_length)
        radius2, spread2 = ZERO, ZERO
        for k in range(start[c], end[c]):
            dx, dy, dz = T[0, k] - out[0, c], T[1, k] - out[1, c], T[2, k] - out[2, c]
            radius2 = max(radius2, dx * dx + dy * dy + dz * dz)
            ex, ey = T[NORMAL, k] - out[C_NORMAL, c], T[NORMAL + 1, k] - out[C_NORMAL + 1, c]
            ez = T[NORMAL + 2, k] - out[C_NORMAL + 2, c]
            spread2 = max(spread2, ex * ex + ey * ey + ez * ez)
        out[C_RADIUS2, c], out[C_SPREAD, c] = radius2, math.sqrt(spread2)
        out[C_DIFFUSE, c], out[C_GLOSSY, c] = diffuse / 3, glossy / 3
        spread = max(2 * (2 - n_length - l_length), 0.0)    # rounding makes means of unit vectors longer than 1
        out[C_ALPHA2, c] = min(1.0, alpha2 / max(glossy, 1e-300) + spread)
        out[C_F0, c] = f0 / max(glossy, 1e-300)


def _summarise(T, start, end):
    """The cluster table of texels in cluster order."""
    out = np.zeros((CLUSTER_ROWS, start.shape[0]), np.float32)
    _summarise_each(start.shape[0], T, start, end, out)
    return out


@device_jit
def _lay_guide(running, start, end, guide):
    for c in range(len(start)):
        first, last = start[c], end[c]
        base, span, k = running[first], running[last] - running[first], first
        for i in range(first, last):
            goal = base + span * (i - first) / (last - first)
            while k < last - 1 and running[k + 1] <= goal:
                k += 1
            guide[i] = k


@inline_jit
def find_by_flux(running, guide, first, last, u):
    """The column of [first, last), a cluster's, at which its flux passes the share u of [0, 1).

    The guide knows the place to a column or two (Chen and Asmus 1974); bisection guesses wrong at every other step.
    """
    goal = running[first] + u * (running[last] - running[first])
    k = guide[min(first + int(u * f32(last - first)), last - 1)]
    while k < last - 1 and running[k + 1] <= goal:
        k += 1
    return k


def cluster_texels(table: np.ndarray, number: int, scale_m: float, fade: np.ndarray | None = None,
                   radius_m: np.ndarray | None = None) -> Clusters:
    """Group the columns of a (17, N) texel table, N >= 1, into at most `number` clusters; `scale_m` is the scene's size.

    `radius_m` (N,): of the disk of each texel's area; without it texels are points.
    `fade` (N,) 1/m2: the diffuse light of a texel counts 1 - near_weight(distance^2, fade) where it is not 0.
    """
    feature = np.empty((table.shape[1], 6), np.float32)
    feature[:, :3] = table[POSITION:POSITION + 3].T
    np.multiply(table[NORMAL:NORMAL + 3].T, np.float32(NORMAL_WEIGHT * scale_m), out=feature[:, 3:])
    weight = table[DIFFUSE:DIFFUSE + 3].sum(0) + table[GLOSSY:GLOSSY + 3].sum(0)
    order, start, end = _split_texels(feature, weight, min(number, table.shape[1]))
    texels = np.zeros((RADIUS + 1, table.shape[1]), np.float32)
    np.take(table, order, axis=1, out=texels[:ROWS])
    for mean, row in ((MEAN_DIFFUSE, DIFFUSE), (MEAN_GLOSSY, GLOSSY)):
        np.mean(texels[row:row + 3], axis=0, out=texels[mean])
    if radius_m is not None:
        texels[RADIUS] = radius_m[order]
    records = np.zeros((table.shape[1], RECORD), np.float32)
    records[:, :len(texels)] = texels.T
    if fade is not None:
        records[:, FADE] = fade[order]
    running = np.concatenate([[0.0], np.cumsum(weight[order], dtype=np.float64)])
    guide = np.empty(len(order), np.int32)
    _lay_guide(running, start, end, guide)
    return Clusters(texels, records, bool(texels[MEAN_GLOSSY].any()), _summarise(texels, start, end), start, end, running,
                    guide)
