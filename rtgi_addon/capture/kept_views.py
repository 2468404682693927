"""Views of lamps between the frames of an animation: only those are redone that something moved in.

Blender tells an engine whose depsgraph it keeps what changed since the last frame. A view stays if its camera is the same
and nothing in it changed: no material, no image, no object whose old or new place lies in it. What stays is what would
come out again, so that a frame does not depend on those before it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass, field

import bpy
import numpy as np

from ..core.frame import GBuffer, Geometry, Light
from ..core.transforms import Camera, Projection
from .geometry import Ranges
from .materials import SURFACE_TYPES
from .nodes import node_tree

# changes of these show in no view of a lamp, or come with changes of objects that do
_WITHOUT_TRACE = (bpy.types.Scene, bpy.types.Action, bpy.types.Camera, bpy.types.Collection, bpy.types.World,
                  bpy.types.Light, bpy.types.Armature, bpy.types.Key, bpy.types.Lattice)
_SHAPES = (bpy.types.Mesh, bpy.types.Curve, bpy.types.MetaBall)
_UNSEEN_OBJECTS = ("LIGHT", "CAMERA", "EMPTY", "ARMATURE", "LATTICE", "SPEAKER", "LIGHT_PROBE")


@dataclass(frozen=True)
class _View:
    camera: Camera
    near_m: float
    gbuffer: GBuffer


@dataclass
class KeptViews:
    """One engine's: it is told of each update, then of the geometry, then asked for views and given those that were made."""

    _views: dict[str, _View] = field(default_factory=dict)
    _depsgraph: int = 0
    _layer: str = ""
    _changed: set[int] = field(default_factory=set)
    _is_unknown: bool = True    # whether anything may have changed
    _corners_ws: np.ndarray | None = None
    _ranges: Ranges = ()
    _origin_ws: np.ndarray | None = None

    def note_updates(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Collect what Blender says has changed; for every `update`, before anything is written to evaluated copies."""
        if (depsgraph.as_pointer(), depsgraph.view_layer.name) != (self._depsgraph, self._layer):
            self._depsgraph, self._layer, self._is_unknown = depsgraph.as_pointer(), depsgraph.view_layer.name, True
        if self._is_unknown:
            return
        trees = {id_.node_tree.original.as_pointer() for id_ in depsgraph.ids
                 if isinstance(id_, (bpy.types.World, bpy.types.Light)) and id_.node_tree is not None}
        for update in depsgraph.updates:
            changed = update.id.original
            if isinstance(changed, bpy.types.Object):
                makes_instances = changed.instance_type != "NONE"
                if makes_instances or changed.type not in _UNSEEN_OBJECTS:
                    self._changed.add(changed.as_pointer())
                    self._is_unknown |= not makes_instances and changed.type not in SURFACE_TYPES
            elif isinstance(changed, _SHAPES):
                self._changed.add(changed.as_pointer())
            elif not isinstance(changed, _WITHOUT_TRACE) and changed.as_pointer() not in trees:
                self._is_unknown = True

    def settle(self, geometry: Geometry, ranges: Ranges, origin_ws: np.ndarray,
               materials: Iterable[bpy.types.Material | None]) -> None:
        """Drop the views in which something has changed.

        `ranges` tell whose triangles are whose in `geometry`; `materials` are the evaluated ones of its surfaces.
        """
        self._is_unknown |= any(_changes_unseen(node_tree(m)) for m in materials if m is not None and node_tree(m))
        moved = None if self._is_unknown else self._hulls_of_changes(geometry.corners_ws, ranges, origin_ws)
        if moved is None:
            self._views.clear()
        elif len(moved):
            self._views = {name: view for name, view in self._views.items() if not _is_met(view.camera, moved)}
        self._corners_ws, self._ranges, self._origin_ws = geometry.corners_ws, ranges, origin_ws
        self._changed, self._is_unknown = set(), False

    def find(self, light: Light, camera: Camera, near_m: float) -> GBuffer | None:
        """What a lamp saw through this camera from `near_m` on, where it would see the same again."""
        view = self._views.get(light.name)
        same = view is not None and view.near_m == near_m and _are_same(view.camera, camera)
        return view.gbuffer if same else None

    def put(self, light: Light, camera: Camera, near_m: float, gbuffer: GBuffer) -> None:
        """Keep what was seen."""
        self._views[light.name] = _View(camera, near_m, gbuffer)

    def _hulls_of_changes(self, corners_ws: np.ndarray, ranges: Ranges, origin_ws: np.ndarray) -> np.ndarray | None:
        """(n, 8, 3) corners of boxes around what changed, before and now; None where all may have."""
        if self._corners_ws is None or not np.array_equal(self._origin_ws, origin_ws):
            return None
        if len(ranges) != len(self._ranges) or any(
                a.owners != b.owners or a.stop != b.stop for a, b in zip(ranges, self._ranges, strict=True)):
            return None
        mine = [r for r in ranges if not r.owners.isdisjoint(self._changed)]
        if not self._changed <= frozenset().union(*(r.owners for r in mine)):
            return None                          # something that views may show, but rays do not meet
        both = self._corners_ws, corners_ws
        boxes = [_box(corners[r.start:r.stop]) for r in mine for corners in both if r.stop > r.start]
        return np.array(boxes, np.float64).reshape(-1, 8, 3)


def _changes_unseen(tree: bpy.types.NodeTree) -> bool:
    """Whether a material may change with the frame or with objects that do not wear it, which updates do not tell."""
    for node in tree.nodes:
        if node.type == "GROUP" and node.node_tree is not None and _changes_unseen(node.node_tree):
            return True
        if node.type == "TEX_COORD" and node.object is not None:
            return True
        image = getattr(node, "image", None)
        if image is not None and image.source in {"SEQUENCE", "MOVIE"}:
            return True
        if node.type in {"SCRIPT", "TEX_POINTDENSITY"} or getattr(node, "attribute_type", "") == "VIEW_LAYER":
            return True
    return False


def _box(corners: np.ndarray) -> list[tuple[float, float, float]]:
    """The eight corners of the box around (T, 3, 3) corners."""
    points = corners.reshape(-1, 3)
    low, high = points.min(0), points.max(0)
    return [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]


def _is_met(camera: Camera, hulls: np.ndarray) -> bool:
    """Whether one of the hulls (n, 8, 3) may show in the view; one with a corner that is no number may be anywhere."""
    if not np.isfinite(hulls).all():
        return True
    boxes, _ = camera.boxes_around(hulls)
    left, right, top, bottom = boxes.T
    turn = 2 * np.pi / camera.pixel_size[0]      # a panorama's box may lie beyond a full turn's edge

    def crosses(shift: float) -> np.ndarray:
        return (left + shift <= camera.width_px + 1) & (right + shift >= -1) & (top <= camera.height_px + 1) & (bottom >= -1)

    found = crosses(0.0)
    if camera.projection is Projection.EQUIRECTANGULAR:
        found |= crosses(turn) | crosses(-turn)
    return bool((found & (left <= right) & (top <= bottom)).any())


def _are_same(a: Camera, b: Camera) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(Camera))
