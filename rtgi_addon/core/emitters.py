"""Emissive meshes of the shapes that lamps have, found among a scene's triangles: rectangles, disks and balls.

As lamps they have an irradiance in closed form, the shadows of lamps, and views that carry their bounce; what thousands of
points on them give is noise and a blur of the same.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .frame import Geometry, Light, LightKind
from .radiometry import find_emitters

MOST_TRIANGLES = 8192       # that are looked at, the strongest: this is done for every frame
LEAST_SHARE = 0.1           # of the light of all that shines, that a shape gives at least: of many small ones none is a lamp
FLAT = 1e-3                 # sine between the normals of triangles of one plane
ALIKE = 1e-3                # relative difference of the radiance of triangles of one shape
FILLS = 0.995               # area over that of the rectangle around it
ROUND = 0.02                # relative: of the radius, squared, that corners are off a disk's ellipse, or of it off a ball
LEAST_CORNERS = 12          # of a disk
MOST_SIDES = 16             # of an outline that are tried as those of a rectangle
LEAST_BALL = 0.85           # area of a ball's triangles over the sphere's: 20 of them have .76, 80 have .93
WIDEST_BALL = 0.5           # diameter over the longest edge of the scene's bounds: a wider one is a dome around the scene
LIFT = 1e-4                 # of its longest edge that a lamp stands before its surface


class Shape(NamedTuple):
    """A mesh, or a part of one, that shines as a lamp does.

    triangles (n,) int64; kind RECTANGLE, DISK, or POINT for a ball; centre (3,) m; unit axes (3, 3), the last of which is
    the normal; full sizes in m along the first two; radiance (3,) W/(m2 sr).
    """

    triangles: np.ndarray
    kind: LightKind
    centre_ws: np.ndarray
    axes: np.ndarray
    size_x_m: float
    size_y_m: float
    radiance: np.ndarray

    @property
    def span_m(self) -> float:
        """Its longer edge."""
        return max(self.size_x_m, self.size_y_m)

    def lamp(self, is_front: bool, name: str) -> Light:
        """The side that the normal is on, or the other one, as a lamp; of a ball all of it, and it has one side."""
        sign, world_from_light = 1 if is_front else -1, np.eye(4)
        # a few units in the last place of its coordinates at least: neither rays nor the view must meet the shape itself
        lift_m = LIFT * self.span_m + 4e-7 * float(np.abs(self.centre_ws).max())
        world_from_light[:3, :3] = np.stack([self.axes[0], -sign * self.axes[1], -sign * self.axes[2]], 1)
        world_from_light[:3, 3] = self.centre_ws
        if self.kind is LightKind.POINT:
            radius_m = self.size_x_m / 2 + lift_m
            return Light(name, self.kind, world_from_light, self.radiance * math.pi * (self.size_x_m / 2) ** 2, radius_m,
                         is_sphere=True, is_surface=True)
        world_from_light[:3, 3] += sign * lift_m * self.axes[2]
        return Light(name, self.kind, world_from_light, self.radiance, size_x_m=self.size_x_m, size_y_m=self.size_y_m,
                     is_surface=True)


def find_shapes(geometry: Geometry) -> list[Shape]:
    """The shapes of a scene that shine, balls first.

    Triangles that share edges and shine alike are a shape if together they are a ball, or lie in one plane and fill a
    rectangle or a disk (an ellipse). Triangles of a textured emission mostly differ, and those with cutouts are none.
    """
    emitters = find_emitters(geometry)
    index = np.flatnonzero(geometry.emission.any(1))
    total = float(emitters.power.sum())
    usable = np.isfinite(emitters.corners).all((1, 2)) & (emitters.power > 0)
    if geometry.cutouts is not None:
        usable &= geometry.cutouts.row[index] < 0
    chosen = np.flatnonzero(usable)
    if len(chosen) > MOST_TRIANGLES:
        chosen = np.sort(chosen[np.argsort(-emitters.power[chosen], kind="stable")[:MOST_TRIANGLES]])
    if not len(chosen):
        return []
    corners, across, radiance, power = (values[chosen] for values in emitters)
    body, plane = _connected(corners, across, radiance)
    shapes, is_left = [], np.ones(len(chosen), bool)
    for part, shape_of in ((body, _ball_of), (plane, _panel_of)):
        share = np.bincount(part, power * is_left) / total
        for number in np.flatnonzero(share >= LEAST_SHARE):
            mine = np.flatnonzero(part == number)
            shape = shape_of(index[chosen[mine]], corners[mine], across[mine], radiance[mine[0]])
            if shape is not None and (shape.kind is not LightKind.POINT or shape.span_m < WIDEST_BALL * geometry.scale_m):
                is_left[mine] = False
                shapes.append(shape)
    return shapes


def _connected(corners: np.ndarray, across: np.ndarray, radiance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) int64 numbers of the parts that share edges and their radiance, and of those that lie in one plane too."""
    # what meshes weld is the same to the last bit, also after it was placed in the world
    places = corners.reshape(-1, 3)
    order = np.lexsort(places.T)                 # numpy's unique rows take five times as long
    is_new = (places[order[1:]] != places[order[:-1]]).any(1)
    vertex = np.empty(len(places), np.int64)
    vertex[order] = np.concatenate([[0], np.cumsum(is_new)])
    vertex = vertex.reshape(-1, 3)
    edges = np.sort(np.stack([vertex, np.roll(vertex, -1, 1)], -1).reshape(-1, 2), 1)
    of = np.repeat(np.arange(len(corners)), 3)
    order = np.lexsort((of, edges[:, 1], edges[:, 0]))
    same = (edges[order[1:]] == edges[order[:-1]]).all(1)
    a, b = of[order[:-1]][same], of[order[1:]][same]
    alike = np.abs(radiance[a] - radiance[b]).max(1) <= ALIKE * radiance[a].max(1)
    a, b = a[alike], b[alike]
    normal = across / np.linalg.norm(across, axis=1, keepdims=True)
    is_flat = np.linalg.norm(np.cross(normal[a], normal[b]), axis=1) < FLAT
    return _joined(len(corners), a, b), _joined(len(corners), a[is_flat], b[is_flat])


def _joined(count: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(count,) int64 numbers, from 0, of the parts that links between a (m,) and b (m,) leave."""
    label = np.arange(count)
    while True:
        least, before = np.minimum(label[a], label[b]), label.copy()
        np.minimum.at(label, label[a], least)
        np.minimum.at(label, label[b], least)
        label = label[label]
        if np.array_equal(label, before):
            return np.unique(label, return_inverse=True)[1]


def _ball_of(triangles: np.ndarray, corners: np.ndarray, across: np.ndarray, radiance: np.ndarray) -> Shape | None:
    """The ball that triangles make, or None."""
    places = np.unique(corners.reshape(-1, 3), axis=0)
    centre = (places.min(0) + places.max(0)) / 2
    off = np.linalg.norm(places - centre, axis=1)
    radius_m, area_m2 = float(off.max()), 0.5 * float(np.linalg.norm(across, axis=1).sum())
    share = area_m2 / max(4 * math.pi * radius_m**2, 1e-300)
    if off.min() < (1 - ROUND) * radius_m or not LEAST_BALL <= share <= 1 + ROUND:
        return None
    # the sphere through the corners, which holds the mesh, of the mesh's flux
    return Shape(triangles, LightKind.POINT, centre, np.eye(3), 2 * radius_m, 2 * radius_m, radiance * share)


def _panel_of(triangles: np.ndarray, corners: np.ndarray, across: np.ndarray, radiance: np.ndarray) -> Shape | None:
    """The rectangle or disk that triangles of one plane make, or None."""
    area_m2 = 0.5 * float(np.linalg.norm(across, axis=1).sum())
    normal = (across * np.sign(across @ across[0])[:, None]).sum(0)
    normal /= np.linalg.norm(normal)
    places, of = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    origin = places.mean(0)
    places = places - origin
    best, box = None, math.inf
    for x_axis in _sides_of(places, of.reshape(-1, 3)):
        y_axis = np.cross(normal, x_axis)
        flat = places @ np.stack([x_axis, y_axis], 1)
        size = np.ptp(flat, axis=0)
        if float(size.prod()) < box:
            best, box = (x_axis, y_axis, (flat.min(0) + flat.max(0)) / 2, size), float(size.prod())
    kind = LightKind.RECTANGLE
    if not FILLS <= area_m2 / max(box, 1e-300) <= 1 / FILLS:
        best, kind = _ellipse_through(places, normal, area_m2), LightKind.DISK
    if best is None:
        return None
    x_axis, y_axis, middle, size = best
    centre = origin + x_axis * middle[0] + y_axis * middle[1]
    return Shape(triangles, kind, centre, np.stack([x_axis, y_axis, normal]), float(size[0]), float(size[1]), radiance)


def _sides_of(places: np.ndarray, vertex: np.ndarray) -> np.ndarray:
    """(n, 3) unit vectors along the longest edges of the outline of triangles (m, 3) between places (k, 3), few of them."""
    edges, count = np.unique(np.sort(np.stack([vertex, np.roll(vertex, -1, 1)], -1).reshape(-1, 2), 1), axis=0,
                             return_counts=True)
    along = np.subtract(*places[edges[count == 1]].swapaxes(0, 1))
    length = np.linalg.norm(along, axis=1)
    longest = np.argsort(-length, kind="stable")[:MOST_SIDES]
    return along[longest] / length[longest, None]


def _ellipse_through(places: np.ndarray, normal: np.ndarray,
                     area_m2: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """(unit axes, centre along them, full sizes) of the ellipse that an even polygon's corners lie on, of the same area.

    `places` (n, 3) are relative to their mean.
    """
    off = np.linalg.norm(places, axis=1)
    rim = places[off > 1e-3 * off.max()]         # a fan has a corner in its middle
    if len(rim) < LEAST_CORNERS:
        return None
    x_axis = np.linalg.svd(rim, full_matrices=False)[2][0]
    y_axis = np.cross(normal, x_axis)
    flat = rim @ np.stack([x_axis, y_axis], 1)
    # corners evenly around an ellipse: their mean square is half that of the half axis
    half = np.sqrt(2 * (flat**2).mean(0))
    if not (half > 0).all() or np.abs(((flat / half) ** 2).sum(1) - 1).max() > ROUND:
        return None
    half *= math.sqrt(area_m2 / (math.pi * float(half.prod())))
    return x_axis, y_axis, np.zeros(2), 2 * half
