"""World triangles of the evaluated scene, with albedo and normals at the corners, emission, and opacity where it is not 1.

Positions and normals are read anew each frame. Colours depend on texture coordinates and materials and not on positions, so
`GeometryCache` keeps them between frames under a checksum of exactly these; and normals in the world while neither they nor
their object turn.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field, replace

import bpy
import numpy as np

from ..core.frame import NORMAL_STEPS, Geometry
from .cutouts import EVEN, CutoutBuilder, MeshCutouts, Opacity, join_cutouts, read_opacity, shadow_trace
from .images import ImageCache
from .materials import SURFACE_TYPES, MaterialCache, MaterialTable, SurfaceReader
from .nodes import spread_evenly

_KINDS = {"FLOAT": ("value", 1), "INT": ("value", 1), "BOOLEAN": ("value", 1), "FLOAT_VECTOR": ("vector", 3),
          "FLOAT2": ("vector", 2), "FLOAT_COLOR": ("color", 4), "BYTE_COLOR": ("color", 4)}
_INVISIBLE_ALPHA = 1 / 512    # a surface that lets more than this much less through is not worth a triangle


@dataclass
class _Topology:
    """Triangles of a mesh: `loops` (T, 3) and `faces` (T,), None where both count up (all faces are triangles)."""

    loops: np.ndarray | None
    faces: np.ndarray | None


@dataclass
class _Colours:
    """What a mesh's triangles look like, as in Geometry; `keep` (T,) bool tells which of them are left, None for all."""

    albedo: np.ndarray
    emission: np.ndarray
    material: np.ndarray
    keep: np.ndarray | None
    cutouts: MeshCutouts | None = None


@dataclass(frozen=True)
class _Normals:
    """Shading normals of a mesh in object space: `values` (n, 3) float32, 0 for flat faces, and which of them lies at each
    corner of the triangles, `index` (T, 3) int32."""

    values: np.ndarray
    index: np.ndarray


@dataclass(frozen=True)
class _Opacities:
    """Of each material of a table: its Opacity, None for an opaque one, and what it depends on."""

    found: tuple[Opacity | None, ...]
    traces: tuple[tuple, ...]


@dataclass(frozen=True)
class Range:
    """Triangles start to stop of a Geometry that come with one object; `owners` are addresses of originals.

    Those of the object, of its data, and of what makes an instance of it.
    """

    owners: frozenset[int]
    start: int
    stop: int


Ranges = tuple[Range, ...]


@dataclass
class GeometryCache:
    """What stays between frames. One engine keeps one; everything not used in a frame is dropped at its end.

    `materials` is for `read_materials`, whose textures both share; `ranges` tell whose triangles the last frame's are, and
    `has_shadowless` whether there was an object that casts no shadow.
    """

    materials: MaterialCache = field(default_factory=MaterialCache)
    topologies: dict[tuple, _Topology] = field(default_factory=dict)
    colours: dict[tuple, _Colours] = field(default_factory=dict)
    opacities: dict[tuple, Opacity | None] = field(default_factory=dict)
    normals: dict[tuple, np.ndarray] = field(default_factory=dict)
    joined: tuple[list[_Colours], int, tuple] = ([], 0, ())
    ranges: Ranges = ()
    has_shadowless: bool = False


def _lattice(splits: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points (P, 3) evenly inside a triangle, three for each of 4^splits parts, and the (3, P) linear fit.

    The points of a part lie halfway between its corners and its middle. The fit gives the values at the corners of the
    linear function nearest to values at the points; its mean is the points' mean.
    """
    parts = np.eye(3)[None]
    for _ in range(splits):
        middle = (parts + np.roll(parts, -1, axis=1)) / 2
        parts = np.concatenate([np.stack([parts[:, k], middle[:, k], middle[:, k - 1]], 1) for k in range(3)] + [middle])
    points = ((parts + parts.mean(1, keepdims=True)) / 2).reshape(-1, 3)
    return points.astype(np.float32), np.linalg.pinv(points).astype(np.float32)


_PLAIN, _STEPPED = _lattice(0), _lattice(1)


def _values(mesh: bpy.types.Mesh, name: str, prop: str, width: int, dtype: type) -> np.ndarray | None:
    """(n, width) of an attribute, straight from its memory; None where the mesh has none."""
    attribute = mesh.attributes.get(name)
    if attribute is None:
        return None
    out = np.empty(len(attribute.data) * width, dtype)
    attribute.data.foreach_get(prop, out)
    return out.reshape(-1, width)


def _vectors(normals: bpy.types.bpy_prop_collection) -> np.ndarray:
    """(n, 3) float32 of a mesh's normals."""
    out = np.empty(3 * len(normals), np.float32)
    normals.foreach_get("vector", out)
    return out.reshape(-1, 3)


class _Mesh:
    """One evaluated mesh: its arrays as they are asked for, and points inside each triangle for shading.

    `chosen` are the triangles that are shaded, None for all, at the barycentric `points` (P, 3) of each.
    """

    def __init__(self, mesh: bpy.types.Mesh, cache: dict[tuple, _Topology], kept: dict[tuple, _Topology]):
        self.mesh = mesh
        self.positions = _values(mesh, "position", "vector", 3, np.float32)
        corners = _values(mesh, ".corner_vert", "value", 1, np.int32)
        self.corners = np.zeros(0, np.int32) if corners is None else corners[:, 0]
        self.topology = self._topology(cache, kept)
        self.chosen: np.ndarray | None = None
        self.points = _PLAIN[0]
        self._layers: dict[tuple[str, str], np.ndarray | None] = {}

    def _topology(self, cache: dict[tuple, _Topology], kept: dict[tuple, _Topology]) -> _Topology:
        faces, loops = len(self.mesh.polygons), len(self.corners)
        if loops == 3 * faces:
            return _Topology(None, None)
        # which diagonal cuts a quad depends on the positions
        key = (faces, loops, zlib.crc32(self.positions), zlib.crc32(self.corners))
        found = kept.get(key) or cache.get(key)
        if found is None:
            triangles = self.mesh.loop_triangles
            found = _Topology(np.empty(3 * len(triangles), np.int32), np.empty(len(triangles), np.int32))
            triangles.foreach_get("loops", found.loops)
            triangles.foreach_get("polygon_index", found.faces)
        kept[key] = found
        return found

    def __len__(self) -> int:
        return len(self.corners) // 3 if self.topology.loops is None else len(self.topology.faces)

    @property
    def vertices(self) -> np.ndarray:
        """(T, 3) int32 vertex of each corner."""
        loops = self.topology.loops
        return (self.corners if loops is None else self.corners[loops]).reshape(-1, 3)

    def normals(self) -> _Normals | None:
        """Shading normals; None where all faces are flat."""
        domain = self.mesh.normals_domain
        if domain == "FACE":
            return None
        if domain == "POINT":                    # fewer than corners, and they index as positions do
            return _Normals(_vectors(self.mesh.vertex_normals), self.vertices)
        values, loops = _vectors(self.mesh.corner_normals), self.topology.loops
        loops = (np.arange(len(values), dtype=np.int32) if loops is None else loops).reshape(-1, 3)
        # custom normals are free to bend flat faces too
        flat = None if self.mesh.has_custom_normals else _values(self.mesh, "sharp_face", "value", 1, bool)
        if flat is not None:
            faces = self.topology.faces
            values[loops[flat[:, 0] if faces is None else flat[faces, 0]]] = 0
        return _Normals(values, loops)

    def slots(self) -> np.ndarray | None:
        """(T,) int32 slot of each triangle; None where all faces are in the first."""
        index = _values(self.mesh, "material_index", "value", 1, np.int32)
        if index is None or not index.any():
            return None
        return index[:, 0] if self.topology.faces is None else index[self.topology.faces, 0]

    def layer_name(self, kind: str, name: str) -> str | None:
        """The attribute that a node's layer name means, "" being the one that renders."""
        if name:
            return name
        layers = self.mesh.uv_layers if kind == "uv" else self.mesh.color_attributes
        if kind == "uv":
            return next((layer.name for layer in layers if layer.active_render), None)
        k = layers.render_color_index
        return layers[k].name if 0 <= k < len(layers) else None

    def layer(self, kind: str, name: str) -> np.ndarray | None:
        """(3 T, 4) float32 of a layer at the corners, missing channels 0 and alpha 1; None where there is none."""
        key = (kind, name)
        if key not in self._layers:
            self._layers[key] = self._read_layer(kind, name)
        return self._layers[key]

    def _read_layer(self, kind: str, name: str) -> np.ndarray | None:
        raw = self.raw_layer(kind, name)
        if raw is None:
            return None
        values, domain = raw
        if domain == "POINT":
            values = values[self.vertices.ravel()]
        elif domain == "FACE":
            faces = self.topology.faces
            values = np.repeat(values if faces is None else values[faces], 3, axis=0)
        elif self.topology.loops is not None:
            values = values[self.topology.loops]
        out = np.zeros((len(values), 4), np.float32)
        out[:, 3] = 1
        if values.shape[1] == 1:
            out[:, :3] = values
        else:
            out[:, :values.shape[1]] = values
        return out

    def raw_layer(self, kind: str, name: str) -> tuple[np.ndarray, str] | None:
        """Values of a layer as stored, and their domain; None where the mesh has none that fits."""
        name = self.layer_name(kind, name)
        attribute = self.mesh.attributes.get(name) if name else None
        if attribute is None or attribute.data_type not in _KINDS or attribute.domain not in {"POINT", "CORNER", "FACE"}:
            return None
        prop, width = _KINDS[attribute.data_type]
        dtype = {"INT": np.int32, "BOOLEAN": bool}.get(attribute.data_type, np.float32)
        return _values(self.mesh, name, prop, width, dtype), attribute.domain

    def checksum(self, needs: frozenset) -> tuple:
        """Changes with the point data in `needs` and the triangles they lie on."""
        if not needs:
            return ()
        topology = self.topology.loops
        sums: list = [len(self), 0 if topology is None else zlib.crc32(topology)]
        for kind, name in sorted(needs):
            raw = self.raw_layer(kind, name)
            sums.append((kind, name) if raw is None else (kind, name, raw[1], raw[0].dtype.str, zlib.crc32(raw[0])))
            if raw is not None and raw[1] == "POINT":
                sums.append(zlib.crc32(self.corners))
        return tuple(sums)

    # nodes.Points, on the chosen triangles

    def _inside(self, kind: str, name: str) -> np.ndarray | None:
        values = self.layer(kind, name)
        if values is None:
            return None
        values = values.reshape(-1, 3, 4)
        values = values if self.chosen is None else values[self.chosen]
        return np.einsum("pc,tcv->tpv", self.points, values).reshape(-1, 4)

    def uv(self, name: str) -> np.ndarray | None:
        values = self._inside("uv", name)
        return None if values is None else values[:, :3]

    def attribute(self, name: str) -> np.ndarray | None:
        return self._inside("attribute", name)

    def spread(self, number: int) -> np.ndarray | None:
        # where thresholds do not tell them apart means give the mean, without noise
        if self.points is _PLAIN[0]:
            return None
        return spread_evenly((len(self) if self.chosen is None else len(self.chosen)) * len(self.points), number)


def _by_triangle(values: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """(T, P, 3) of values (1 or T P, 3) at P points of T triangles."""
    return np.broadcast_to(values, (shape[0] * shape[1], 3)).reshape(shape)


def _read_opacities(table: MaterialTable, cache: GeometryCache) -> _Opacities:
    """Opacities of the materials; the maps of the last frame where nothing changed."""
    found: list[Opacity | None] = [None] * len(table.materials)
    traces: list[tuple] = [()] * len(table.materials)
    kept = {}
    for k in np.flatnonzero(table.may_let_through):
        material, images = table.evaluated[k], cache.materials.images
        traces[k] = shadow_trace(material, images)
        key = (table.materials[k].name, traces[k])
        found[k] = kept[key] = cache.opacities[key] if key in cache.opacities else read_opacity(material, images)
    cache.opacities = kept
    return _Opacities(tuple(found), tuple(traces))


def _shade(mesh: _Mesh, slot_materials: tuple[int, ...], table: MaterialTable, opacities: _Opacities,
           images: ImageCache) -> _Colours:
    """Colours of a mesh whose slots hold the table's materials `slot_materials`."""
    slots, count = mesh.slots(), len(mesh)
    order = np.array(slot_materials, np.int32)
    # a face beyond the slots shows the last of them, as in Blender
    material = (np.full(count, order[0], np.int32) if slots is None else order[np.clip(slots, 0, len(order) - 1)])
    albedo, emission = np.empty((count, 3, 3), np.float32), np.empty((count, 3), np.float32)
    keep, cutouts = np.ones(count, bool), CutoutBuilder(count, images)
    for k in np.unique(material):
        constants = table.materials[k]
        chosen = np.nonzero(material == k)[0]
        whole = len(chosen) == count
        where = slice(None) if whole else chosen
        if constants.alpha < _INVISIBLE_ALPHA and not max(constants.emission) > 0:
            keep[where] = False
        if not table.needs[k]:
            albedo[where], emission[where] = constants.albedo, constants.emission
            if opacities.found[k] is not None:
                cutouts.add(chosen, table.evaluated[k], opacities.found[k], constants.alpha, mesh.layer)
            continue
        mesh.chosen = None if whole else chosen
        mesh.points, fit = _STEPPED if table.is_stepped[k] else _PLAIN
        surface = SurfaceReader(images, mesh).material(table.evaluated[k])
        shape = (len(chosen), len(mesh.points), 3)
        albedo[where] = np.clip(np.einsum("cp,tpv->tcv", fit, _by_triangle(surface.diffuse, shape)), 0, 1)
        emission[where] = np.maximum(_by_triangle(surface.emission, shape).mean(1), 0)
        coverage = 1 - _by_triangle(surface.transparent, shape).mean((1, 2))
        there = coverage > _INVISIBLE_ALPHA
        if opacities.found[k] is not None:
            # three points of a triangle may miss a leaf that its map shows
            there |= cutouts.add(chosen, table.evaluated[k], opacities.found[k], coverage, mesh.layer)
        keep[where] &= there | emission[where].any(1)
    if keep.all():
        return _Colours(albedo, emission, material, None, cutouts.build(keep))
    return _Colours(albedo[keep], emission[keep], material[keep], keep, cutouts.build(keep))


def _shadowless(colours: _Colours) -> _Colours:
    """What is left of a mesh that casts no shadow: triangles that shine, and no ray meets them.

    Rays for light and rays for what reflects light are the same here, and shadows where there are none are worse than
    something missing in a mirror. Lamps' views are cast through the same triangles then, so that these are no veils.
    """
    shines = colours.emission.any(1)
    keep = shines.copy() if colours.keep is None else colours.keep.copy()
    if colours.keep is not None:
        keep[colours.keep] = shines
    count = int(shines.sum())
    nothing = MeshCutouts(np.arange(count, dtype=np.int32), np.zeros((count, 3, 2), np.float32), np.ones(count, np.float32),
                          np.zeros(count, np.int32), [EVEN[0]], [False])
    return _Colours(colours.albedo[shines], colours.emission[shines], colours.material[shines], keep,
                    nothing if count else None)


@dataclass
class _Part:
    """One mesh with the materials of one object: vertices in object space, triangles, colours, normals if it has any."""

    positions: np.ndarray
    vertices: np.ndarray
    colours: _Colours
    normals: _Normals | None


def _is_met_by_rays(source: bpy.types.Object) -> bool:
    return source.visible_diffuse or source.visible_shadow or source.visible_glossy


def _read_part(source: bpy.types.Object, table: MaterialTable, opacities: _Opacities, cache: GeometryCache,
               kept: GeometryCache) -> _Part | None:
    """The triangles of an evaluated object; None where it has none."""
    is_mesh = source.type == "MESH"
    data = source.data if is_mesh else source.to_mesh()
    try:
        if data is None or not len(data.polygons):
            return None
        mesh = _Mesh(data, cache.topologies, kept.topologies)
        slots = tuple(table.of(slot.material) for slot in source.material_slots) or (0,)
        needs = frozenset().union(*(table.needs[k] for k in slots))
        index = mesh.slots()
        key = (len(mesh), slots, tuple(table.traces[k] for k in slots), tuple(opacities.traces[k] for k in slots),
               tuple(table.materials[k].name for k in slots),
               0 if index is None else zlib.crc32(np.ascontiguousarray(index)), mesh.checksum(needs), source.visible_shadow)
        colours = kept.colours.get(key) or cache.colours.get(key)
        if colours is None:
            colours = _shade(mesh, slots, table, opacities, cache.materials.images)
            if not source.visible_shadow:
                colours = _shadowless(colours)
        kept.colours[key] = colours
        if source.is_holdout:
            colours = replace(colours, albedo=np.zeros_like(colours.albedo), emission=np.zeros_like(colours.emission))
        vertices, normals = mesh.vertices, mesh.normals()
        if colours.keep is not None:
            vertices = vertices[colours.keep]
            normals = normals and replace(normals, index=normals.index[colours.keep])
        return _Part(mesh.positions, vertices, colours, normals)
    finally:
        if not is_mesh:
            source.to_mesh_clear()


def _place(positions: np.ndarray, matrix: np.ndarray, origin_ws: np.ndarray) -> np.ndarray:
    """(V, 3) float32: `matrix` (4, 4) applied to object space positions, less the origin, computed in float64.

    Written out, because a matrix product of this shape waits for the linear algebra library's threads.
    """
    x, y, z = (positions[:, k].astype(np.float64) for k in range(3))
    placed = np.empty_like(positions)
    for k in range(3):
        a, b, c, d = matrix[k]
        placed[:, k] = a * x + b * y + c * z + (d - origin_ws[k])
    return placed


def _turn(normals: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(n, 3) int16 in NORMAL_STEPS: object space normals as `matrix` (4, 4) turns them; 0 for those that have no direction.

    By the cofactors, which are the inverse transpose times the determinant: a mirroring matrix, under which the corners of a
    triangle go round the other way, puts its normals on the other side as well, and one that flattens has cofactors too.
    """
    (a, b, c), (d, e, f), (g, h, i) = matrix[:3, :3].tolist()
    cofactors = np.array([(e * i - f * h, f * g - d * i, d * h - e * g), (c * h - b * i, a * i - c * g, b * g - a * h),
                          (b * f - c * e, c * d - a * f, a * e - b * d)])
    cofactors *= NORMAL_STEPS / max(np.abs(cofactors).max(), 1e-300)
    # not a matrix product, see `_place`; by coordinates, twice as fast as by normals
    turned = np.einsum("kj,jn->kn", cofactors.astype(np.float32), np.ascontiguousarray(normals.T))
    size = np.sqrt(turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2])
    is_lost = ~(size > 0)
    if is_lost.any():
        turned[:, is_lost], size[is_lost] = 0, 1
    turned *= NORMAL_STEPS / size
    return np.rint(turned, out=turned).T.astype(np.int16, order="C")


def _turn_again(normals: _Normals, matrix: np.ndarray, cache: GeometryCache, kept: GeometryCache) -> np.ndarray:
    """`_turn` of a mesh's normals, or what it gave in the last frame."""
    key = (normals.values.shape, zlib.crc32(normals.values), matrix[:3, :3].tobytes())
    found = kept.normals.get(key, cache.normals.get(key))
    kept.normals[key] = found = _turn(normals.values, matrix) if found is None else found
    return found


def _owners(instance: bpy.types.DepsgraphObjectInstance) -> frozenset[int]:
    source, parent = instance.object, instance.parent if instance.is_instance else None
    found = (source.original, source.data.original if source.data else None, parent.original if parent else None)
    return frozenset(owner.as_pointer() for owner in found if owner is not None)


def _join_normals(normals: list[tuple[np.ndarray, np.ndarray] | None], stops: list[int]) -> np.ndarray | None:
    """`Geometry.normals_ws` of parts that end at the triangles `stops`: of each its normals and which lie at its corners."""
    if not any(normals):
        return None
    out = np.zeros((stops[-1], 3, 3), np.int16)
    for part, start, stop in zip(normals, [0, *stops], stops, strict=False):
        if part is not None:
            np.take(*part, axis=0, out=out[start:stop], mode="clip")
    return out


def read_geometry(depsgraph: bpy.types.Depsgraph, table: MaterialTable, origin_ws: np.ndarray,
                  cache: GeometryCache | None = None) -> Geometry:
    """Triangles of everything in the evaluated scene that rays can meet, instances included.

    Parameters
    ----------
    table : MaterialTable
        Of the same depsgraph.
    origin_ws : (3,) float64 m
        Taken off every position in float64, before rounding to float32.
    cache : GeometryCache or None
        Pass the same one in each frame; textures are then sampled only where something changed.

    Left out are objects that no diffuse, glossy or shadow ray can meet, what does not shine of those that cast no shadow,
    and triangles that are fully transparent. The share of a surface that is transparent counts as black in its albedo;
    `cutouts` say where it is. NaN coordinates are handed on. The colours of two frames are the same arrays where nothing
    changed: do not write to them.
    """
    cache = GeometryCache() if cache is None else cache
    kept = GeometryCache()
    opacities = _read_opacities(table, cache)
    origin_ws = np.asarray(origin_ws, np.float64)
    parts: dict[tuple, _Part | None] = {}
    cache.has_shadowless = False
    placed, vertices, colours, normals, owners = [], [], [], [], []
    for instance in depsgraph.object_instances:
        source = instance.object
        if source.type not in SURFACE_TYPES or not instance.show_self or not _is_met_by_rays(source):
            continue
        cache.has_shadowless |= source.visible_camera and not source.visible_shadow
        matrix = np.array(instance.matrix_world, np.float64)
        # the data alone does not tell which modifiers and slots an object adds to it; an instance's object is a passing copy
        key = (source.original.as_pointer(), source.data.as_pointer())
        if key not in parts:
            parts[key] = _read_part(source, table, opacities, cache, kept)
        part = parts[key]
        if part is None or not len(part.vertices):
            continue
        placed.append(_place(part.positions, matrix, origin_ws))
        vertices.append(part.vertices)
        colours.append(part.colours)
        normals.append(part.normals and (_turn_again(part.normals, matrix, cache, kept), part.normals.index))
        owners.append(_owners(instance))
    stops = np.cumsum([len(v) for v in vertices], dtype=np.int64).tolist()
    cache.ranges = tuple(Range(*r) for r in zip(owners, [0, *stops], stops, strict=False))
    cache.topologies, cache.colours, cache.normals = kept.topologies, kept.colours, kept.normals
    if not placed:
        return Geometry.empty()
    corners = np.empty((sum(map(len, vertices)), 3, 3), np.float32)
    start = 0
    for points, triangles in zip(placed, vertices, strict=True):
        # indices come from Blender and are in range; "clip" only spares the check
        np.take(points, triangles, axis=0, out=corners[start:start + len(triangles)], mode="clip")
        start += len(triangles)
    most_layers = depsgraph.scene.cycles.transparent_max_bounces
    last, last_layers, joined = cache.joined
    if len(last) != len(colours) or last_layers != most_layers or any(
            a is not b for a, b in zip(last, colours, strict=True)):
        joined = (*(np.concatenate([getattr(c, name) for c in colours]) for name in ("albedo", "emission", "material")),
                  join_cutouts([len(c.material) for c in colours], [c.cutouts for c in colours], most_layers))
        cache.joined = (colours, most_layers, joined)
    return Geometry(corners, *joined, _join_normals(normals, stops))
