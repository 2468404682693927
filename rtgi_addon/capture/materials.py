"""Materials of the evaluated scene to `core.frame.Material`, and their surface closures at any surface point.

Only evaluated copies are read, and one field of them is written: `number_materials` sets their pass index, by which the
"Material Index" pass tells the material of each pixel. The user's own materials are never touched.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import bpy
import numpy as np

from ..core.frame import Material
from .images import ImageCache
from .needs import SCATTERING_NODES
from .nodes import BOUNCED_PATH, NodeReader, Points, node_tree, normal_reflectance, spread_evenly

SURFACE_TYPES = ("MESH", "CURVE", "SURFACE", "META", "FONT")

# how each thing that is not modelled shows up; the datablock's name goes in front
_NOT_MODELLED = {
    "volume": "its volume is left out",
    "subsurface": "subsurface scattering is rendered as plain diffuse reflection",
    "sheen": "its sheen is rendered as plain diffuse reflection, too bright where lamps stand high over it",
    "refraction": "light is not refracted or let through; the surface is opaque to light that bounces",
    "translucency": "light from behind is not let through; the surface reflects it as if lit from the front",
    "displacement": "displacement shows in the picture, but shadows and bounces meet the undisplaced surface",
    "portal": "ray portals are left out",
}


@dataclass
class Surface:
    """The closures of a surface, each array float32 (n, 3) or (n, 1) with n = 1 or the number of points.

    `transparent` is what passes straight through; `rough_specular` is the roughness weighted by the specular mean, and
    `f0_specular` the reflectance at normal incidence, so that all fields mix linearly. `known_specular` is the part of that
    mean whose reflectance at normal incidence the nodes tell, which a metal's colour does not.
    """

    diffuse: np.ndarray
    specular: np.ndarray
    rough_specular: np.ndarray
    emission: np.ndarray
    transparent: np.ndarray
    f0_specular: np.ndarray
    known_specular: np.ndarray

    @staticmethod
    def of(diffuse=0.0, specular=0.0, roughness=1.0, emission=0.0, transparent=0.0, f0=0.0) -> Surface:
        """From scalars or arrays that broadcast to (n, 3); `roughness` and `f0` to (n, 1), an `f0` of 0 being unknown."""
        wide = [np.broadcast_to(np.asarray(a, np.float32), (np.shape(a)[0] if np.ndim(a) else 1, 3))
                for a in (diffuse, specular, emission, transparent)]
        mean, f0 = wide[1].mean(1, keepdims=True), np.asarray(f0, np.float32)
        return Surface(wide[0], wide[1], np.asarray(roughness, np.float32) * mean, wide[2], wide[3], f0 * mean,
                       (f0 > 0) * mean)

    def __mul__(self, weight: np.ndarray) -> Surface:
        return Surface(*(getattr(self, field.name) * weight for field in dataclasses.fields(self)))

    def __add__(self, other: Surface) -> Surface:
        return Surface(*(getattr(self, field.name) + getattr(other, field.name) for field in dataclasses.fields(self)))

    @property
    def roughness(self) -> np.ndarray:
        """(n, 1) mean over the lobes; 1 without any."""
        weight = self.specular.mean(1, keepdims=True)
        return np.where(weight > 1e-6, self.rough_specular / np.maximum(weight, 1e-6), 1.0)

    @property
    def f0(self) -> float:
        """Mean reflectance at normal incidence of the glossy lobes; 0 unless it is known of all of them."""
        weight = float(self.specular.mean())
        is_known = weight > 1e-6 and float(self.known_specular.mean()) > 0.999 * weight
        return float(self.f0_specular.mean()) / weight if is_known else 0.0


class SurfaceReader:
    """Reads the closures of one material, with `values` for what feeds them; `found` names what is not modelled."""

    def __init__(self, images: ImageCache, points: Points | None = None, light_path: dict[str, float] = BOUNCED_PATH):
        self.values = NodeReader(images, points, light_path)
        self.found: set[str] = set()

    def material(self, material: bpy.types.Material | None) -> Surface:
        """The surface of an evaluated material; None gives what Cycles puts on an empty slot."""
        if material is None:
            return Surface.of(diffuse=0.8)
        tree = node_tree(material)
        if tree is None:
            self.values.trace.append(tuple(material.diffuse_color[:3]))
            return Surface.of(diffuse=np.array([material.diffuse_color[:3]]))
        output = tree.get_output_node("CYCLES")
        if output is None:
            return Surface.of()
        inputs = {socket.identifier: socket for socket in output.inputs}
        if inputs["Volume"].is_linked:
            self.found.add("volume")
        if inputs["Displacement"].is_linked and material.displacement_method != "BUMP":
            self.found.add("displacement")
        return self._closure(inputs["Surface"])

    def _closure(self, socket: bpy.types.NodeSocket) -> Surface:
        surface = self.values.follow(socket, self._output)
        return Surface.of() if surface is None else surface

    def _output(self, output: bpy.types.NodeSocket) -> Surface:
        node = output.node
        self.values.trace.append((node.type, output.identifier))
        read = getattr(self, "node_" + node.type.lower(), None)
        if read is None:
            # an unknown closure reflects what its colour says
            names = [name for name in ("Color", "Base Color") if self.values.socket(node, name) is not None]
            return Surface.of(diffuse=self._albedo(node, names[0])) if names else Surface.of()
        return read(node)

    def _albedo(self, node: bpy.types.Node, name: str = "Color") -> np.ndarray:
        return np.clip(self.values.colour(node, name), 0, 1)

    # one method for each node type

    def node_mix_shader(self, node):
        share = np.clip(self.values.scalar(node, "Fac"), 0, 1)
        first, second = (self.values.socket(node, name) for name in ("Shader", "Shader_001"))
        if share.max() <= 0:
            return self._closure(first)
        if share.min() >= 1:
            return self._closure(second)
        return self._closure(first) * (1 - share) + self._closure(second) * share

    def node_add_shader(self, node):
        return self._closure(self.values.socket(node, "Shader")) + self._closure(self.values.socket(node, "Shader_001"))

    def node_emission(self, node):
        return Surface.of(emission=self.values.colour(node, "Color") * self.values.scalar(node, "Strength"))

    node_background = node_emission

    def node_bsdf_diffuse(self, node):
        return Surface.of(diffuse=self._albedo(node))

    node_bsdf_toon = node_bsdf_diffuse

    def node_bsdf_sheen(self, node):
        self.found.add("sheen")
        return self.node_bsdf_diffuse(node)

    def node_bsdf_glossy(self, node):
        # it has no Fresnel term: as much at normal incidence as at grazing
        return Surface.of(specular=self._albedo(node), roughness=self.values.scalar(node, "Roughness"), f0=1.0)

    def node_bsdf_metallic(self, node):
        return Surface.of(specular=self._albedo(node, "Base Color"), roughness=self.values.scalar(node, "Roughness"))

    def node_bsdf_glass(self, node):
        self.found.add("refraction")
        roughness = np.clip(self.values.scalar(node, "Roughness"), 0, 1)
        f0 = normal_reflectance(self.values.scalar(node, "IOR"))
        return Surface.of(specular=self._albedo(node) * mean_reflectance(f0, roughness), roughness=roughness, f0=f0)

    def node_bsdf_refraction(self, node):
        self.found.add("refraction")
        return Surface.of()

    def node_bsdf_translucent(self, node):
        self.found.add("translucency")
        return Surface.of(diffuse=self._albedo(node))

    def node_subsurface_scattering(self, node):
        self.found.add("subsurface")
        return Surface.of(diffuse=self._albedo(node))

    def node_bsdf_transparent(self, node):
        return Surface.of(transparent=self._albedo(node))

    def node_bsdf_ray_portal(self, node):
        self.found.add("portal")
        return Surface.of(transparent=self._albedo(node))

    def node_holdout(self, node):
        return Surface.of()

    def node_bsdf_principled(self, node):
        values = self.values
        base, tint = self._albedo(node, "Base Color"), self._albedo(node, "Specular Tint")
        metallic, transmission, alpha, subsurface, coat, sheen = (
            np.clip(values.scalar(node, name), 0, 1)
            for name in ("Metallic", "Transmission Weight", "Alpha", "Subsurface Weight", "Coat Weight", "Sheen Weight"))
        roughness = np.clip(values.scalar(node, "Roughness"), 0, 1)
        if (transmission * (1 - metallic)).max() > 0:
            self.found.add("refraction")
        if (subsurface * (1 - metallic) * (1 - transmission)).max() > 0:
            self.found.add("subsurface")
        if sheen.max() > 0:
            self.found.add("sheen")
        # the specular level scales the reflectance at normal incidence, with 0.5 as the neutral value
        f0 = np.clip(normal_reflectance(values.scalar(node, "IOR")) * 2 * values.scalar(node, "Specular IOR Level"), 0, 1)
        taken = mean_reflectance(f0, roughness)
        diffuse = base * (1 - metallic) * (1 - transmission) * (1 - taken)
        specular = base * metallic + (1 - metallic) * taken * tint
        emission = values.colour(node, "Emission Color") * values.scalar(node, "Emission Strength")
        known = np.where(metallic > 0, 0, np.maximum(f0 * tint.mean(1, keepdims=True), 1e-4))
        surface = Surface.of(diffuse, specular, roughness, emission, f0=known)
        if coat.max() > 0:
            coat_roughness = np.clip(values.scalar(node, "Coat Roughness"), 0, 1)
            coat_f0 = normal_reflectance(values.scalar(node, "Coat IOR"))
            coat_specular = coat * mean_reflectance(coat_f0, coat_roughness)
            below = 1 - coat_specular
            # light crosses the tinted coat on its way in and out; at normal incidence that is the tint itself
            below = below * (1 + coat * (self._albedo(node, "Coat Tint") - 1))
            grey = below.mean(1, keepdims=True)
            under = Surface(surface.diffuse * below, surface.specular * below, surface.rough_specular * grey,
                            surface.emission * below, surface.transparent, surface.f0_specular * grey,
                            surface.known_specular * grey)
            surface = under + Surface.of(specular=coat_specular, roughness=coat_roughness, f0=coat_f0)
        return surface * alpha + Surface.of(transparent=1 - alpha)


# fitted to Cycles' Diffuse Color of a white Principled sphere at IOR 1.2, 1.5 and 2, with an error below 0.0005
_ROUGHNESS_KNOTS = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0)
_SCALE_KNOTS = (0.904, 0.904, 0.910, 0.870, 0.693, 0.455)
_GRAZING_KNOTS = (0.0546, 0.0543, 0.0491, 0.0282, 0.0114, 0.0034)
_GRAZING_F0 = 0.008


def mean_reflectance(f0: np.ndarray, roughness: np.ndarray) -> np.ndarray:
    """Share of uniform light that a dielectric layer reflects, and so takes from the diffuse layer under it.

    `f0` is its reflectance at normal incidence. A scale of it and a share for grazing light, both by roughness, as in the
    split sums of real-time rendering; the grazing share fades with f0.
    """
    scale, grazing = (np.interp(roughness, _ROUGHNESS_KNOTS, knots) for knots in (_SCALE_KNOTS, _GRAZING_KNOTS))
    return f0 * scale + grazing * f0 / (f0 + _GRAZING_F0)


@dataclass(frozen=True)
class MaterialTable:
    """Materials of a frame.

    Attributes
    ----------
    materials : tuple of Material
        The first is what an empty slot shows; `Frame.materials` and `Geometry.material` use this order.
    index : dict
        Address of each evaluated material to its place in `materials`.
    traces : tuple
        What each material's surface depends on besides points: equal traces shade equally.
    needs : tuple of frozenset
        Point data that each material's surface varies with: empty for an even one.
    is_stepped : tuple of bool
        Whether a threshold or ramp shades the material, so that means over texels have to come after it.
    may_let_through : tuple of bool
        Whether light may pass straight through some of the material; False for sure where not.
    warnings : tuple of str
        One line for each thing that is not modelled, naming the material.
    evaluated : tuple
        The evaluated datablocks, None for the first; valid as long as the depsgraph is.
    """

    materials: tuple[Material, ...]
    index: dict[int, int]
    traces: tuple[tuple, ...]
    needs: tuple[frozenset, ...]
    is_stepped: tuple[bool, ...]
    may_let_through: tuple[bool, ...]
    warnings: tuple[str, ...]
    evaluated: tuple[bpy.types.Material | None, ...] = field(repr=False)

    @property
    def roughness(self) -> np.ndarray:
        """(M,) float32 perceptual roughness, for a Blender without a roughness pass."""
        return np.array([material.roughness for material in self.materials], np.float32)

    @property
    def f0(self) -> np.ndarray:
        """(M,) float32 reflectance at normal incidence as `core.frame.Material` has it, 0 where unknown."""
        return np.array([material.f0 for material in self.materials], np.float32)

    @property
    def keeps_energy(self) -> np.ndarray:
        """(M,) float32, 0 for materials whose lobes scatter once and lose what the microfacets hide from each other."""
        return np.array([material.keeps_energy for material in self.materials], np.float32)

    @property
    def pass_index(self) -> np.ndarray:
        """(M,) float32 pass index that the user gave each material, which `number_materials` hides from Cycles."""
        return np.array([0 if m is None else m.original.pass_index for m in self.evaluated], np.float32)

    @property
    def has_glossy(self) -> bool:
        return any(max(material.specular) > 1e-4 for material in self.materials)

    @property
    def has_emission(self) -> bool:
        return any(max(material.emission) > 0 for material in self.materials)

    @property
    def has_transparency(self) -> bool:
        return any(material.alpha < 1 - 1e-4 for material in self.materials)

    def of(self, material: bpy.types.Material | None) -> int:
        """Place of an evaluated material; 0 for None and for one that the table does not know."""
        return 0 if material is None else self.index.get(material.as_pointer(), 0)


def used_materials(depsgraph: bpy.types.Depsgraph) -> list[bpy.types.Material]:
    """Evaluated materials in the slots of the surfaces that render, sorted by name."""
    found: dict[int, bpy.types.Material] = {}
    seen: set[tuple] = set()
    for instance in depsgraph.object_instances:
        source = instance.object
        if source.type not in SURFACE_TYPES or not instance.show_self:
            continue
        key = (source.original.as_pointer(), source.data.as_pointer() if source.data else 0)
        if key in seen:
            continue
        seen.add(key)
        for slot in source.material_slots:
            if slot.material is not None:
                found.setdefault(slot.material.as_pointer(), slot.material)
    return sorted(found.values(), key=lambda material: material.name_full)


def _keeps_energy(material: bpy.types.Material | None) -> bool:
    """False if every glossy node of the material is set to single scattering; node groups are not looked into.

    Cycles' Glossy Color leaves that loss out, so it has to be known.
    """
    tree = node_tree(material) if material else None
    kinds = {node.distribution for node in tree.nodes if node.type in SCATTERING_NODES} if tree else set()
    return not kinds or "MULTI_GGX" in kinds


def _to_material(name: str, surface: Surface) -> Material:
    def colour(values: np.ndarray) -> tuple[float, float, float]:
        return tuple(float(v) for v in values.mean(0))

    # the roughness is that of the specular light, as in the surface itself
    weight = surface.specular.mean()
    roughness = float(surface.rough_specular.mean() / weight) if weight > 1e-6 else 1.0
    return Material(name, colour(surface.diffuse), colour(surface.specular), roughness,
                    colour(np.maximum(surface.emission, 0)), float(np.clip(1 - surface.transparent.mean(), 0, 1)),
                    f0=surface.f0)


class _UnitSquare:
    """Points spread evenly over the unit square of every texture layer: what a mean over textures is taken of."""

    _CELLS = 24

    def __init__(self) -> None:
        # one small triangle somewhere in each cell; fixed numbers, so that a scene reads the same each time
        random = np.random.default_rng(0)
        corner = np.stack(np.meshgrid(np.arange(self._CELLS), np.arange(self._CELLS)), -1).reshape(-1, 1, 2)
        inside = random.uniform(0, 1, (len(corner), 1, 2)) / 2 + np.array([[0, 0], [0.5, 0], [0, 0.5]])
        flat = ((corner + inside) / self._CELLS).reshape(-1, 2)
        self._uv = np.concatenate([flat, np.zeros((len(flat), 1))], 1).astype(np.float32)

    def uv(self, name: str) -> np.ndarray | None:
        return self._uv

    def attribute(self, name: str) -> np.ndarray | None:
        return None

    def spread(self, number: int) -> np.ndarray | None:
        return spread_evenly(len(self._uv), number)


class MaterialCache:
    """What stays between frames: the images' pyramids and, for each trace, the material that it gave."""

    def __init__(self) -> None:
        self.images = ImageCache()
        self.materials: dict[tuple, Material] = {}


def read_materials(depsgraph: bpy.types.Depsgraph, cache: MaterialCache | None = None) -> MaterialTable:
    """Constants, or means of textures, of every material that the evaluated scene shows.

    `cache` keeps what was read of textures for the next frame. The order is the same for equal scenes: by name.
    """
    cache = cache or MaterialCache()
    cache.images.begin(depsgraph.scene.frame_current)
    kept: dict[tuple, Material] = {}
    materials, traces, needs, stepped, through, warnings = [], [], [], [], [], []
    used = used_materials(depsgraph)
    for material in (None, *used):
        reader = SurfaceReader(cache.images)
        name = material.name_full if material else "(no material)"
        surface = reader.material(material)
        trace = tuple(reader.values.trace)
        found = cache.materials.get((name, trace))
        if found is None:
            if reader.values.has_patterns or any(kind == "uv" for kind, _ in reader.values.needs):
                surface = SurfaceReader(cache.images, _UnitSquare()).material(material)
            found = _to_material(name, surface)
        found = dataclasses.replace(found, keeps_energy=_keeps_energy(material))
        kept[name, trace] = found
        materials.append(found)
        traces.append(trace)
        needs.append(frozenset(reader.values.needs))
        stepped.append(reader.values.is_stepped)
        # a Light Path node may tell shadow rays something else, and a mean of an attribute is not known
        through.append(found.alpha < 1 - 1e-3 or "LIGHT_PATH" in reader.values.found
                       or any(kind == "attribute" for kind, _ in reader.values.needs))
        warnings += [f"material {name!r}: {_NOT_MODELLED[what]}" for what in sorted(reader.found)]
    cache.materials = kept
    return MaterialTable(tuple(materials), {m.as_pointer(): k for k, m in enumerate(used, 1)}, tuple(traces), tuple(needs),
                         tuple(stepped), tuple(through), tuple(warnings), (None, *used))


def number_materials(depsgraph: bpy.types.Depsgraph, table: MaterialTable) -> None:
    """Set the pass index of the evaluated materials to their place in the table; pixels without a material keep 0.

    Call it after the depsgraph was evaluated and before Cycles reads it. The originals keep theirs.
    """
    for datablock in depsgraph.ids:
        if isinstance(datablock, bpy.types.Material) and datablock.is_evaluated:
            datablock.pass_index = table.of(datablock)
