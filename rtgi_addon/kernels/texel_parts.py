"""The triangles that a lamp sees through its view's texels, and through parts of those that hold more than one surface."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .bvh import STACK, closest_hit, closest_triangle, triangle_normal
from .clusters import SAME_NORMAL
from .jit import borrowed, device_jit, inline_jit, pixel_jit, scratch
from .shadow import ORTHOGRAPHIC, PERSPECTIVE
from .vec3 import ONE, ZERO, Vec3, add, along, dot, f32, load_pixel, normalized_or, scaled, sub, turned_by

PARTS = 4                   # of an uneven texel; two quarters on a diagonal err 2 to 5 % more on five of sixteen scenes
ASIDE_X, ASIDE_Y = f32(1e-3), f32(3e-4)     # texels from a quarter's middle: in even scenes edges pass through middles
OFF_PX = f32(0.5)           # distance from a texel's plane, in texels, from which a neighbour shows another surface
TURNED = f32(0.9)           # cosine of two normals below which two texels show a crease, where they are
CREASE_PX = f32(0.1)        # so far off one's plane: a bump map turns normals on one plane
BEFORE = f32(0.5)           # of the least depth around: where a part's ray starts
UNLIKE_NORMAL = f32(2)      # a turn of 60 degrees, and
UNLIKE_PLACE = f32(0.1)     # ten texels along a texel's plane, stand beside one off it
NEAR = f32(1e-3)            # of a texel's depth: how far from its place its triangle is looked for


@inline_jit
def _is_uneven(depth, position, normal, size_m, i, j):
    """Does texel (i, j) lie beside one that shows another surface, or nothing?"""
    height, width = depth.shape
    p, n, size = load_pixel(position, i, j), load_pixel(normal, i, j), size_m[i, j]
    for k in range(4):
        u, v = i + (k - 1 if k % 2 == 0 else 0), j + (k - 2 if k % 2 == 1 else 0)
        u, v = min(max(u, 0), height - 1), min(max(v, 0), width - 1)
        if not depth[u, v] < f32(math.inf):
            return True
        d, m = sub(load_pixel(position, u, v), p), load_pixel(normal, u, v)
        off, off_there = abs(dot(d, n)), abs(dot(d, m))
        if min(off, off_there) > OFF_PX * size or (dot(n, m) < TURNED and max(off, off_there) > CREASE_PX * size):
            return True
    return False


@device_jit
def _texel_like(depth, position, normal, size_m, i, j, place, face):
    """Flat index of the texel, of the nine around (i, j), that shows most likely the surface of normal `face` at a place."""
    height, width = depth.shape
    least, like = f32(math.inf), i * width + j
    for u in range(max(i - 1, 0), min(i + 2, height)):
        for v in range(max(j - 1, 0), min(j + 2, width)):
            if not depth[u, v] < f32(math.inf):
                continue
            d, m = sub(place, load_pixel(position, u, v)), load_pixel(normal, u, v)
            unlike = (abs(dot(d, m)) + UNLIKE_PLACE * math.sqrt(dot(d, d))) / max(size_m[u, v], f32(1e-30))
            unlike += UNLIKE_NORMAL * (ONE - dot(face, m))
            if unlike < least:
                least, like = unlike, u * width + v
    return like


@inline_jit
def _ray(projection, x, y):
    """(origin, direction) in view space of the ray through a place of the image plane, as `Camera.rays_vs` has them."""
    if projection == PERSPECTIVE:
        return Vec3(ZERO, ZERO, ZERO), Vec3(x, y, -ONE)
    if projection == ORTHOGRAPHIC:
        return Vec3(x, y, ZERO), Vec3(ZERO, ZERO, -ONE)
    c = math.cos(y)
    return Vec3(ZERO, ZERO, ZERO), Vec3(c * math.sin(x), math.sin(y), -c * math.cos(x))


@inline_jit
def _towards(bvh, slot, d):
    """Normal of a triangle on the side that a ray along d meets."""
    face = triangle_normal(bvh, slot)
    return scaled(face, -ONE) if dot(face, d) > ZERO else face


@pixel_jit
def _find_faces(begin, end, depth, position, is_lit, projection, world_from_view, bvh, faces):
    """Write into `faces` the normals of the triangles at the texels that `is_lit`, where one is found."""
    bvh, world_from_view = borrowed((bvh, world_from_view))
    stack = scratch(STACK, np.int32)
    eye = Vec3(world_from_view[0, 3], world_from_view[1, 3], world_from_view[2, 3])
    axis = turned_by(world_from_view, Vec3(ZERO, ZERO, -ONE))
    for i in range(begin, end):
        for j in range(depth.shape[1]):
            if not is_lit[i, j]:
                continue
            p, reach = load_pixel(position, i, j), NEAR * depth[i, j]
            d = axis if projection == ORTHOGRAPHIC else normalized_or(sub(p, eye), axis)
            _, slot, _, _ = closest_triangle(bvh, stack, along(p, d, -reach), scaled(d, reach), f32(2))
            if slot >= 0:
                face = _towards(bvh, slot, d)
                faces[i, j, 0], faces[i, j, 1], faces[i, j, 2] = face.x, face.y, face.z


@inline_jit
def _shading_normal(normal, faces, i, j, face):
    """That of a part on a triangle of normal `face`: tilted as that of texel (i, j), of the same surface, off its own."""
    shown = load_pixel(normal, i, j)
    if dot(shown, face) > SAME_NORMAL:           # to the last digit what the view tells of a plane
        return shown
    return normalized_or(add(face, sub(shown, load_pixel(faces, i, j))), face)


@pixel_jit
def _look_through_parts(begin, end, depth, position, normal, faces, is_lit, size_m, projection, world_from_view, left, top,
                        step_x, step_y, bvh, reach_m, is_split, places, normals, part_faces, depths, like):
    bvh, world_from_view = borrowed((bvh, world_from_view))
    height, width = depth.shape
    stack = scratch(STACK, np.int32)
    eye = Vec3(world_from_view[0, 3], world_from_view[1, 3], world_from_view[2, 3])
    for i in range(begin, end):
        for j in range(width):
            if not is_lit[i, j] or not _is_uneven(depth, position, normal, size_m, i, j):
                continue
            is_split[i, j] = True
            nearest = f32(math.inf)
            for u in range(max(i - 1, 0), min(i + 2, height)):
                for v in range(max(j - 1, 0), min(j + 2, width)):
                    nearest = min(nearest, depth[u, v])
            before = BEFORE * nearest
            for k in range(PARTS):
                across, down = k % 2, k // 2
                x = left + (f32(j) + f32(0.25) + f32(0.5) * f32(across) + ASIDE_X) * step_x
                y = top - (f32(i) + f32(0.25) + f32(0.5) * f32(down) + ASIDE_Y) * step_y
                origin, d = _ray(projection, x, y)
                d = turned_by(world_from_view, d)
                start = along(add(eye, turned_by(world_from_view, origin)), d, before)
                t, slot, _, _ = closest_hit(bvh, stack, start, d, reach_m)
                if slot < 0:
                    continue
                place, face = along(start, d, t), _towards(bvh, slot, d)
                texel = _texel_like(depth, position, normal, size_m, i, j, place, face)
                shown = _shading_normal(normal, faces, texel // width, texel % width, face)
                places[i, j, k, 0], places[i, j, k, 1], places[i, j, k, 2] = place.x, place.y, place.z
                normals[i, j, k, 0], normals[i, j, k, 1], normals[i, j, k, 2] = shown.x, shown.y, shown.z
                part_faces[i, j, k, 0], part_faces[i, j, k, 1], part_faces[i, j, k, 2] = face.x, face.y, face.z
                depths[i, j, k], like[i, j, k] = before + t, texel


class Seen(NamedTuple):
    """What a lamp sees through texels (H, W) and through PARTS of each that is split.

    faces (H, W, 3) float32: unit normals of the triangles, on the lamp's side; is_split (H, W) bool. Of the parts (H, W,
    PARTS): `places` m, shading `normals` and `part_faces` (..., 3), `depths` m, and `like` int64, the flat index of the
    neighbour that shows the same surface, -1 for a part that shows nothing.
    """

    faces: np.ndarray
    is_split: np.ndarray
    places: np.ndarray
    normals: np.ndarray
    part_faces: np.ndarray
    depths: np.ndarray
    like: np.ndarray


def look_through_texels(depth, position, normal, is_lit, size_m, projection, world_from_view, left, top, step_x, step_y, bvh,
                        reach_m) -> Seen:
    """Find the triangles of the texels that `is_lit` (H, W), and split those that lie beside one of another surface.

    depth (H, W) m, +inf for nothing, position, normal (H, W, 3): of the view; size_m (H, W) float32: width of a texel there;
    projection, left, top, step_x, step_y: of its image plane; world_from_view (3, 4) float32; reach_m: out of the scene.
    """
    height, width = depth.shape
    places, normals, part_faces = np.zeros((3, height, width, PARTS, 3), np.float32)
    seen = Seen(normal.copy(), np.zeros((height, width), np.bool_), places, normals, part_faces,
                np.zeros((height, width, PARTS), np.float32), np.full((height, width, PARTS), -1, np.int64))
    _find_faces(height, depth, position, is_lit, projection, world_from_view, bvh, seen.faces)
    _look_through_parts(height, depth, position, normal, seen.faces, is_lit, size_m, projection, world_from_view, left, top,
                        step_x, step_y, bvh, reach_m, *seen[1:])
    return seen
