"""A bounding volume hierarchy over triangles: visibility of segments and closest hits.

Where Blender's Embree is at hand (`embree`), it holds the triangles: 1.5 to 3 times as many rays a second. Elsewhere a tree
of our own does: binned SAH build, two children a node, both boxes in the parent (Aila and Laine 2009), so that a ray visits
a node only after it has met its box. 262,000 triangles build in 0.1 to 0.2 s on one core. Triangles are two-sided (Moeller
and Trumbore 1997).

Where a triangle that is no opaque one is met, its opacity a is looked up (`core.frame.Cutouts`). A segment goes on with the
share 1 - a of its light, as in Cycles, which is exact, has no noise and does not depend on the order of the hits. A closest
hit must be one point: there the triangle counts with the chance a, by a hash of the place, the same for every ray.
"""

from __future__ import annotations

import math
import weakref
from typing import Any, NamedTuple

import numpy as np

from .embree import build_scene, intersect, occluded
from .jit import device_jit
from .sampling import uniform
from .vec3 import ONE, ZERO, Vec3, cross, dot, f32, sub

BINS = 12
LEAF_TRIANGLES = 4          # a leaf may hold up to 7 where no split pays
STACK = 96                  # depth of the traversal stack: a SAH tree over 2^24 triangles stays below 64
BIG = f32(1e30)
SEGMENT_END = f32(0.9999)   # a segment ends a hair before its target, which lies on a surface itself
LEAST_SHARE = f32(1 / 512)  # what gets through is taken as nothing below this, half of what a byte of opacity resolves
PLACES = f32(1 << 20)       # barycentric steps that the hash of a place tells apart


class Bvh(NamedTuple):
    """The tree, as kernels take it.

    boxes (n, 2, 6) float32: lowest and highest corner of each child; kids (n, 2) int32: a node, or a leaf coded as
    -(first * 8 + count) - 1; corners (T, 9) float32: corner and two edges, in leaf order; source (T,) int32: index of
    the triangle in the geometry; rays (3 or 9,) uint64: addresses of Embree's scene and functions, zeros for a tree of our
    own; with cutouts those of the scenes of opaque triangles and of the others follow. With Embree there is one node, with
    the bounds of all triangles, and no leaf.

    veil (V,) int32: `core.frame.Cutouts` in one array, without a length where every triangle is opaque. One, because each
    array more in this tuple costs every ray 3 to 10 %. veil[0]: most_layers; veil[1 + slot]: where in `veil` the record of
    the triangle in this slot begins, 0 for an opaque one; then the slots of those with a record. A record: where the texels
    of its map begin, its height, its width, and as bits of float32 the map's coordinates of the corner and of the two edges
    (6). Texels: rows of bytes, four in a number, the lowest first.
    """

    boxes: np.ndarray
    kids: np.ndarray
    corners: np.ndarray
    source: np.ndarray
    rays: np.ndarray
    veil: np.ndarray


RECORD = 9


def build_bvh(corners_ws: np.ndarray, cutouts: Any = None, use_embree: bool = True) -> Bvh:
    """BVH over (T, 3, 3) float32 triangles; those with a coordinate that is not finite are left out.

    `cutouts` is the `core.frame.Cutouts` of the same triangles, None where all are opaque. `use_embree` False grows our own
    tree also where Embree is there.
    """
    finite = np.isfinite(corners_ws).all((1, 2))
    kept = np.flatnonzero(finite).astype(np.int32)
    triangles = np.ascontiguousarray(corners_ws[kept], np.float32)
    if use_embree:
        packed = np.concatenate([triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]], 1)
        rays = build_scene(triangles)
        if rays.any():
            return with_cutouts(
                Bvh(_whole_box(triangles), np.full((1, 2), -1, np.int32), packed, kept, rays, np.zeros(0, np.int32)),
                cutouts)
    boxes, kids, packed, order = _build(triangles)
    return with_cutouts(Bvh(boxes, kids, packed, kept[order].astype(np.int32), np.zeros(3, np.uint64),
                            np.zeros(0, np.int32)), cutouts)


def _whole_box(triangles: np.ndarray) -> np.ndarray:
    """(1, 2, 6) float32: a node whose children both span all triangles."""
    flat = triangles.reshape(-1, 3)
    whole = np.concatenate([flat.min(0, initial=BIG), flat.max(0, initial=-BIG)])
    return np.tile(whole.astype(np.float32), (1, 2, 1))


def with_cutouts(bvh: Bvh, cutouts: Any) -> Bvh:
    """A tree of opaque triangles with the opacities of a `core.frame.Cutouts`; the same for None."""
    if cutouts is None:
        return bvh
    bvh = bvh._replace(veil=_veil_of(bvh.source, cutouts))
    if not bvh.rays.any():
        return bvh
    corner, edge1, edge2 = np.split(bvh.corners, 3, axis=1)
    triangles, is_sieve = np.stack([corner, corner + edge1, corner + edge2], 1), bvh.veil[1:1 + len(bvh.source)] > 0
    scenes = [bvh.rays[:3], build_scene(triangles[~is_sieve]), build_scene(triangles[is_sieve])]
    rays = np.concatenate(scenes)
    weakref.finalize(rays, scenes.clear).atexit = False      # a scene is freed with its own array: keep those as long
    return bvh._replace(rays=rays)


def _veil_of(source: np.ndarray, cutouts: Any) -> np.ndarray:
    """`Bvh.veil` of cutouts for a tree whose slots hold the triangles `source`."""
    maps, which = np.unique(cutouts.place, axis=0, return_inverse=True)
    numbers = -(-maps[:, 1] * maps[:, 2] // 4)               # that hold each map's bytes
    row = cutouts.row[source]
    slots = np.flatnonzero(row >= 0)
    first_record = 1 + len(source) + len(slots)
    end = first_record + RECORD * len(cutouts.uv)
    first_texel = end + np.cumsum(numbers) - numbers
    veil = np.zeros(end + int(numbers.sum()), np.int32)
    veil[0] = cutouts.most_layers
    veil[1:1 + len(source)] = np.where(row >= 0, first_record + RECORD * row, 0)
    veil[1 + len(source):first_record] = slots
    records = veil[first_record:end].reshape(-1, RECORD)
    records[:, 0], records[:, 1:3] = first_texel[which.ravel()], cutouts.place[:, 1:]
    uv = np.asarray(cutouts.uv, np.float32)
    records[:, 3:] = np.concatenate([uv[:, 0], uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]], 1).view(np.int32)
    for (start, height, width), begin, number in zip(maps, first_texel, numbers, strict=True):
        texels = np.zeros(4 * number, np.uint8)
        texels[:height * width] = cutouts.texels[start:start + height * width]
        veil[begin:begin + number] = texels.view("<i4")
    return veil


@device_jit
def _half_area(b):
    x, y, z = b[3] - b[0], b[4] - b[1], b[5] - b[2]
    return x * y + y * z + z * x


@device_jit
def _grow(b, c):
    for a in range(3):
        b[a], b[a + 3] = min(b[a], c[a]), max(b[a + 3], c[a + 3])


@device_jit
def _sah_cut(box, index, start, end, axis, low, scale, count, bins, right, run):
    """Bin after which to cut, by the surface area heuristic, or -1."""
    for q in range(BINS):
        count[q] = 0
        _clear(bins[q])
    for k in range(start, end):
        b = box[index[k]]
        q = int((b[axis] + b[axis + 3] - low) * scale)
        count[q] += 1
        _grow(bins[q], b)
    _clear(run)
    number = 0
    for q in range(BINS - 1, 0, -1):
        _grow(run, bins[q])
        number += count[q]
        right[q] = _half_area(run) * f32(number) if number else ZERO
    _clear(run)
    number, best, cut = 0, BIG * BIG, -1
    for q in range(BINS - 1):
        _grow(run, bins[q])
        number += count[q]
        if 0 < number < end - start:
            cost = np.float64(_half_area(run) * f32(number) + right[q + 1])
            if cost < best:
                best, cut = cost, q
    return cut


@device_jit
def _clear(b):
    b[0], b[1], b[2], b[3], b[4], b[5] = BIG, BIG, BIG, -BIG, -BIG, -BIG


@device_jit
def _build(tris):
    n = tris.shape[0]
    index = np.arange(n)
    box = np.empty((n, 6), np.float32)
    for i in range(n):
        for a in range(3):
            box[i, a] = min(tris[i, 0, a], min(tris[i, 1, a], tris[i, 2, a]))
            box[i, a + 3] = max(tris[i, 0, a], max(tris[i, 1, a], tris[i, 2, a]))
    boxes, kids = np.empty((2 * n + 2, 2, 6), np.float32), np.zeros((2 * n + 2, 2), np.int32)
    count, bins, right = np.zeros(BINS, np.int64), np.empty((BINS, 6), np.float32), np.empty(BINS, np.float32)
    run, whole, centres = np.empty(6, np.float32), np.empty(6, np.float32), np.empty(6, np.float32)
    _clear(boxes[0, 0])
    _clear(boxes[0, 1])
    kids[0, 0] = kids[0, 1] = -1                 # an empty leaf: a tree of no triangles meets nothing
    todo = [(0, n, -1, 0)]
    nodes = 0
    while len(todo) > 0:
        start, end, parent, side = todo.pop()
        _clear(whole)
        _clear(centres)
        for k in range(start, end):
            b = box[index[k]]
            _grow(whole, b)
            for a in range(3):
                c = b[a] + b[a + 3]
                centres[a], centres[a + 3] = min(centres[a], c), max(centres[a + 3], c)
        if parent >= 0:
            for a in range(6):
                boxes[parent, side, a] = whole[a]
        axis = 0
        for a in range(1, 3):
            if centres[a + 3] - centres[a] > centres[axis + 3] - centres[axis]:
                axis = a
        low, extent, middle = centres[axis], centres[axis + 3] - centres[axis], -1
        if end - start > LEAF_TRIANGLES and extent > ZERO:
            scale = f32(BINS * 0.9999) / extent
            cut = _sah_cut(box, index, start, end, axis, low, scale, count, bins, right, run)
            if cut >= 0:
                i, j = start, end - 1
                while i <= j:
                    t = index[i]
                    if int((box[t, axis] + box[t, axis + 3] - low) * scale) <= cut:
                        i += 1
                    else:
                        index[i], index[j] = index[j], t
                        j -= 1
                middle = i
        if middle < 0 and end - start > 7:
            middle = (start + end) // 2          # all centres in one place: any halves will do
        if middle >= 0 or (parent < 0 and n > 0):
            me = nodes
            nodes += 1
            middle = middle if middle >= 0 else start + (end - start + 1) // 2
            todo.append((middle, end, me, 1))
            todo.append((start, middle, me, 0))
        else:
            me = -(start * 8 + end - start) - 1
        if parent >= 0:
            kids[parent, side] = me
    nodes = max(nodes, 1)
    packed = np.empty((n, 9), np.float32)
    for k in range(n):
        for a in range(3):
            packed[k, a] = tris[index[k], 0, a]
            packed[k, 3 + a] = tris[index[k], 1, a] - tris[index[k], 0, a]
            packed[k, 6 + a] = tris[index[k], 2, a] - tris[index[k], 0, a]
    return boxes[:nodes].copy(), kids[:nodes].copy(), packed, index


@device_jit
def _safe_rcp(x):
    return ONE / x if abs(x) > f32(1e-20) else (f32(1e20) if x >= ZERO else f32(-1e20))


@device_jit
def _enter(b, n, s, o, inv, reach):
    """(does the ray meet child box s of node n before `reach`, parameter of entry)."""
    p, q = (b[n, s, 0] - o.x) * inv.x, (b[n, s, 3] - o.x) * inv.x
    near, far = min(p, q), max(p, q)
    p, q = (b[n, s, 1] - o.y) * inv.y, (b[n, s, 4] - o.y) * inv.y
    near, far = max(near, min(p, q)), min(far, max(p, q))
    p, q = (b[n, s, 2] - o.z) * inv.z, (b[n, s, 5] - o.z) * inv.z
    near, far = max(near, min(p, q)), min(far, max(p, q))
    # slabs of flat boxes meet in a point that rounding may open: widen by four ulps (Ize 2013)
    return max(near, ZERO) <= min(far * f32(1.0000005), reach), near


@device_jit
def _meet(c, k, o, d):
    """(t, u, v) of the ray o + t d with triangle k; t is -1 for a miss."""
    e1, e2 = Vec3(c[k, 3], c[k, 4], c[k, 5]), Vec3(c[k, 6], c[k, 7], c[k, 8])
    p = cross(d, e2)
    det = dot(e1, p)
    if det == ZERO:
        return -ONE, ZERO, ZERO
    inv = ONE / det
    s = sub(o, Vec3(c[k, 0], c[k, 1], c[k, 2]))
    u = dot(s, p) * inv
    if u < ZERO or u > ONE:
        return -ONE, ZERO, ZERO
    q = cross(s, e1)
    v = dot(d, q) * inv
    if v < ZERO or u + v > ONE:
        return -ONE, ZERO, ZERO
    return dot(e2, q) * inv, u, v


@device_jit
def _float(bits):
    return np.int32(bits).view(np.float32)


@device_jit
def _texel(veil, record, i, j):
    """Opacity of texel (i, j) of the map of a record, in 255ths; the map repeats."""
    height, width = veil[record + 1], veil[record + 2]
    k = i % height * width + j % width
    return f32((veil[veil[record] + (k >> 2)] >> ((k & 3) << 3)) & 255)


@device_jit
def opacity(veil, slot, u, v):
    """Share of the surface that is there at barycentric (u, v) of the triangle in `slot`, in [0, 1]; veil: `Bvh.veil`."""
    record = veil[1 + slot] if len(veil) > 0 else 0
    if record == 0:
        return ONE
    height, width = f32(veil[record + 1]), f32(veil[record + 2])
    x = (_float(veil[record + 3]) + u * _float(veil[record + 5]) + v * _float(veil[record + 7])) * width - f32(0.5)
    y = (_float(veil[record + 4]) + u * _float(veil[record + 6]) + v * _float(veil[record + 8])) * height - f32(0.5)
    j, i = int(math.floor(x)), int(math.floor(y))
    x, y = x - f32(j), y - f32(i)
    low = (ONE - x) * _texel(veil, record, i, j) + x * _texel(veil, record, i, j + 1)
    high = (ONE - x) * _texel(veil, record, i + 1, j) + x * _texel(veil, record, i + 1, j + 1)
    return ((ONE - y) * low + y * high) / f32(255)


@device_jit
def _through_leaf(corners, veil, leaf, o, d, share, layers):
    """(share, layers) behind the triangles of a leaf: of the light, and of triangles that let part of it through."""
    code = -leaf - 1
    for k in range(code >> 3, (code >> 3) + (code & 7)):
        t, u, v = _meet(corners, k, o, d)
        if t > ZERO and t < SEGMENT_END:
            if len(veil) == 0:
                return ZERO, layers
            share *= ONE - opacity(veil, k, u, v)
            layers += 1
            if share < LEAST_SHARE or layers > veil[0]:
                return ZERO, layers
    return share, layers


@device_jit
def _behind(t):
    """A hair behind t, so that the next hit is another triangle."""
    return t * f32(1.000001) + f32(1e-7)


@device_jit
def _visibility_by_embree(rays, veil, slots, o, d):
    """`visibility` through Embree; `slots` is the number of triangles."""
    if len(veil) == 0:
        return ZERO if occluded(rays, o.x, o.y, o.z, d.x, d.y, d.z, SEGMENT_END) else ONE
    if occluded(rays[3:6], o.x, o.y, o.z, d.x, d.y, d.z, SEGMENT_END):
        return ZERO
    sieve, share, layers, near = rays[6:9], ONE, 0, ZERO
    while True:
        t, k, u, v = intersect(sieve, o.x, o.y, o.z, d.x, d.y, d.z, near, SEGMENT_END)
        if k < 0:
            return share
        share *= ONE - opacity(veil, veil[1 + slots + k], u, v)
        layers += 1
        if share < LEAST_SHARE or layers > veil[0]:
            return ZERO
        near = _behind(t)


@device_jit
def visibility(bvh, stack, o, d):
    """Share of light that gets along the open segment from o to o + d, in [0, 1]. `stack` is (STACK,) int32 scratch."""
    boxes, kids, corners, veil = bvh.boxes, bvh.kids, bvh.corners, bvh.veil
    if bvh.rays[0] != 0:
        return _visibility_by_embree(bvh.rays, veil, len(corners), o, d)
    inv = Vec3(_safe_rcp(d.x), _safe_rcp(d.y), _safe_rcp(d.z))
    depth, node, share, layers = 0, 0, ONE, 0
    while True:
        hit0, t0 = _enter(boxes, node, 0, o, inv, ONE)
        hit1, t1 = _enter(boxes, node, 1, o, inv, ONE)
        kid0, kid1 = kids[node, 0], kids[node, 1]
        if hit0 and kid0 < 0:
            share, layers = _through_leaf(corners, veil, kid0, o, d, share, layers)
            if share == ZERO:
                return ZERO
            hit0 = False
        if hit1 and kid1 < 0:
            share, layers = _through_leaf(corners, veil, kid1, o, d, share, layers)
            if share == ZERO:
                return ZERO
            hit1 = False
        if hit0 and hit1:
            node, stack[depth] = (kid0, kid1) if t0 <= t1 else (kid1, kid0)
            depth += 1
        elif hit0:
            node = kid0
        elif hit1:
            node = kid1
        elif depth == 0:
            return share
        else:
            depth -= 1
            node = stack[depth]


@device_jit
def is_occluded(bvh, stack, o, d):
    """Does a triangle meet the open segment from o to o + d? Where some light gets through, no with that share's chance."""
    share = visibility(bvh, stack, o, d)
    if share == ZERO:
        return True
    return share < ONE and uniform(_bits(o.x) ^ _bits(d.x), _bits(o.y) ^ _bits(d.y), _bits(o.z) ^ _bits(d.z)) >= share


@device_jit
def _bits(x):
    return f32(x).view(np.uint32)


@device_jit
def _is_there(veil, k, u, v):
    """Whether triangle k counts at (u, v): with the chance of its opacity, by a hash of the place."""
    return len(veil) == 0 or uniform(k, int(u * PLACES), int(v * PLACES)) < opacity(veil, k, u, v)


@device_jit
def _leaf_closest(corners, veil, leaf, o, d, best, found, bu, bv):
    code = -leaf - 1
    for k in range(code >> 3, (code >> 3) + (code & 7)):
        t, u, v = _meet(corners, k, o, d)
        if t > ZERO and t < best and _is_there(veil, k, u, v):
            best, found, bu, bv = t, k, u, v
    return best, found, bu, bv


@device_jit
def closest_hit(bvh, stack, o, d, reach):
    """(t, slot, u, v) of the nearest triangle along o + t d with 0 < t < reach; slot is -1 where there is none.

    `slot` indexes `bvh.corners` and `bvh.source`. A triangle that lets light through is met with the chance of its opacity.
    """
    return _closest(bvh.boxes, bvh.kids, bvh.corners, bvh.veil, bvh.rays, stack, o, d, reach)


@device_jit
def closest_triangle(bvh, stack, o, d, reach):
    """As `closest_hit`, with every triangle taken as opaque."""
    return _closest(bvh.boxes, bvh.kids, bvh.corners, bvh.veil[:0], bvh.rays, stack, o, d, reach)


@device_jit
def _closest(boxes, kids, corners, veil, rays, stack, o, d, reach):
    """Nearer children come first; a stacked node that has fallen behind the best hit fails its box tests at once, because
    both children are tested against the shortened reach."""
    if rays[0] != 0:
        near = ZERO
        while True:
            t, k, u, v = intersect(rays, o.x, o.y, o.z, d.x, d.y, d.z, near, reach)
            if k < 0 or _is_there(veil, k, u, v):
                return t, k, u, v
            near = _behind(t)
    inv = Vec3(_safe_rcp(d.x), _safe_rcp(d.y), _safe_rcp(d.z))
    depth, node = 0, 0
    best, found, bu, bv = reach, -1, ZERO, ZERO
    while True:
        hit0, t0 = _enter(boxes, node, 0, o, inv, best)
        hit1, t1 = _enter(boxes, node, 1, o, inv, best)
        kid0, kid1 = kids[node, 0], kids[node, 1]
        if hit0 and kid0 < 0:
            best, found, bu, bv = _leaf_closest(corners, veil, kid0, o, d, best, found, bu, bv)
            hit0 = False
        if hit1 and kid1 < 0:
            best, found, bu, bv = _leaf_closest(corners, veil, kid1, o, d, best, found, bu, bv)
            hit1 = False
        if hit0 and hit1:
            node, stack[depth] = (kid0, kid1) if t0 <= t1 else (kid1, kid0)
            depth += 1
        elif hit0:
            node = kid0
        elif hit1:
            node = kid1
        elif depth == 0:
            return best, found, bu, bv
        else:
            depth -= 1
            node = stack[depth]


@device_jit
def triangle_normal(bvh, slot):
    """Unit geometric normal of the triangle in `slot`, by its winding; (0, 0, 1) for one without area."""
    c = bvh.corners
    n = cross(Vec3(c[slot, 3], c[slot, 4], c[slot, 5]), Vec3(c[slot, 6], c[slot, 7], c[slot, 8]))
    size = math.sqrt(dot(n, n))
    if size > ZERO:
        return Vec3(n.x / size, n.y / size, n.z / size)
    return Vec3(ZERO, ZERO, ONE)
