"""The frame: everything that the passes know of a scene, as plain arrays.

A frame needs no Blender: `frameio` saves it as .npz and loads it again. All positions are relative to `Frame.origin_ws`,
so that scenes far from the world's origin keep their digits in float32. Colours are linear Rec.709, scene-referred.
Images are (H, W, ...) with row 0 at the top.
"""

from __future__ import annotations

import enum
import functools
from dataclasses import dataclass, field

import numpy as np

from .transforms import Camera

NORMAL_STEPS = 32767        # of a corner normal's coordinate from 0 to 1


class LightKind(enum.Enum):
    """The shapes of lamps that the passes know."""

    POINT = "POINT"
    SPOT = "SPOT"
    SUN = "SUN"
    RECTANGLE = "RECTANGLE"
    DISK = "DISK"

    @property
    def is_area(self) -> bool:
        return self in (LightKind.RECTANGLE, LightKind.DISK)


@dataclass(frozen=True)
class Light:
    """One lamp in SI units; `radiometry` derives each factor.

    Attributes
    ----------
    name : str
        Name of the Blender object (and instance), for messages.
    kind : LightKind
    world_from_light : (4, 4) float64
        Rigid; the lamp shines along its -Z; translation relative to the frame's origin.
    power : (3,) float64
        Strength by colour in the unit of the kind: radiant intensity W/sr on the axis of a POINT or SPOT, irradiance
        W/m2 on a plane facing a SUN, radiance W/(m2 sr) of a RECTANGLE or DISK.
    radius_m : float
        Radius of the sphere of a POINT or SPOT; 0 is a mathematical point.
    angle_rad : float
        Angular diameter of a SUN.
    spot_size_rad, spot_blend : float
        Full cone angle of a SPOT and the share of the cone that its soft edge takes.
    size_x_m, size_y_m : float
        Full edges of a RECTANGLE, full axes of a DISK (an ellipse).
    spread_rad : float
        Full angle that an area light spreads over; pi is Lambertian.
    casts_shadow : bool
    diffuse_factor, glossy_factor : float
        Shares of this lamp's light that the two lobes take (the lamp's own "influence" settings).
    is_sphere : bool
        A POINT or SPOT with a radius is a sphere; otherwise a disk that turns towards each receiver (Blender's default,
        "soft falloff").
    is_surface : bool
        It stands for an emissive surface of the scene, whose triangles no longer shine; the picture shows it still.
    """

    name: str
    kind: LightKind
    world_from_light: np.ndarray
    power: np.ndarray
    radius_m: float = 0.0
    angle_rad: float = 0.0
    spot_size_rad: float = np.pi
    spot_blend: float = 0.0
    size_x_m: float = 0.0
    size_y_m: float = 0.0
    spread_rad: float = np.pi
    casts_shadow: bool = True
    diffuse_factor: float = 1.0
    glossy_factor: float = 1.0
    is_sphere: bool = False
    is_surface: bool = False

    @property
    def position_ws(self) -> np.ndarray:
        return self.world_from_light[:3, 3]

    @property
    def direction_ws(self) -> np.ndarray:
        """(3,) unit vector along which the lamp shines."""
        return -self.world_from_light[:3, 2]


@dataclass(frozen=True)
class GBuffer:
    """What one view sees, at pixel centres.

    Attributes
    ----------
    depth : (H, W) float32 m
        Planar, or ray length in an equirectangular view; +inf where nothing is seen.
    position_ws : (H, W, 3) float32 m, relative to the frame's origin; 0 where nothing is seen.
    normal_ws : (H, W, 3) float32
        Unit shading normals, on the viewer's side; (0, 0, 1) where nothing is seen.
    albedo : (H, W, 3) float32
        Diffuse reflectance in [0, 1], as seen (a coat or specular layer above has taken its share).
    specular : (H, W, 3) float32
        Directional reflectance of the glossy lobe towards the viewer.
    roughness : (H, W) float32
        Perceptual: GGX alpha is its square.
    emission : (H, W, 3) float32 W/(m2 sr)
        Radiance of emissive surfaces, and of the visible world where nothing is seen.
    f0 : (H, W) float32
        Reflectance of the glossy lobe at normal incidence where the material tells it, 0 where only `specular` can.
        None stands for 0 everywhere.
    """

    depth: np.ndarray
    position_ws: np.ndarray
    normal_ws: np.ndarray
    albedo: np.ndarray
    specular: np.ndarray
    roughness: np.ndarray
    emission: np.ndarray
    f0: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.f0 is None:
            object.__setattr__(self, "f0", np.zeros(np.shape(self.depth), np.float32))

    @property
    def mask(self) -> np.ndarray:
        """(H, W) bool, True on surfaces."""
        return np.isfinite(self.depth)

    @property
    def shape(self) -> tuple[int, int]:
        return self.depth.shape


@dataclass(frozen=True)
class LightView:
    """The scene as one light sees it: shadow map and reflective shadow map.

    `incident_flux` is (H, W, 3) float32 W: what the light sends into each texel, before any reflection; 0 outside a
    spot's cone. `gbuffer` holds what it falls on.
    """

    light_index: int
    camera: Camera
    gbuffer: GBuffer
    incident_flux: np.ndarray


@dataclass(frozen=True)
class Cutouts:
    """How much of a triangle's surface is there: leaves, chains, fences, panes. Light passes straight through the rest.

    The share that is there (the opacity) is looked up in small maps. The row 0 of a map is the bottom of its picture, and a
    point (x, y) in lengths of its edges lies in the middle of a texel at +0.5; maps repeat, and between texels they are
    bilinear. An even opacity is a map of one texel.

    Attributes
    ----------
    row : (T,) int32, place of each of the geometry's triangles in the lists below; -1 for an opaque one.
    uv : (A, 3, 2) float32, where the triangle's corners lie in its map.
    coverage : (A,) float32, mean opacity of the triangle, about; what its albedo holds already.
    is_veil : (A,) bool, whether views tell nothing of what light does here: most of what is there of the map lets part of
        it through, or views are told something else than shadow rays are.
    place : (A, 3) int32, first texel, height and width of its map.
    texels : (P,) uint8, opacity in 255ths, rows of all maps one after the other.
    most_layers : int
        Behind more of these triangles than this it is dark, whatever they leave: Cycles' limit of transparent bounces.
    """

    row: np.ndarray
    uv: np.ndarray
    coverage: np.ndarray
    is_veil: np.ndarray
    place: np.ndarray
    texels: np.ndarray
    most_layers: int = 8


@dataclass(frozen=True)
class Geometry:
    """World triangles of the evaluated scene, two-sided.

    Attributes
    ----------
    corners_ws : (T, 3, 3) float32 m, triangle, corner, xyz; relative to the frame's origin.
    albedo : (T, 3, 3) float32, diffuse reflectance at the corners.
    emission : (T, 3) float32 W/(m2 sr), mean radiance of the triangle.
    material : (T,) int32, index into `Frame.materials`.
    cutouts : Cutouts or None
        None where every triangle is opaque, which is most scenes: they pay nothing.
    normals_ws : (T, 3, 3) int16 or None
        Shading normals at the corners, unit vectors in NORMAL_STEPS (0.001 degrees off), on the side from which the corners
        go round counter-clockwise; zeros for a flat-shaded triangle. None where all are flat.
    """

    corners_ws: np.ndarray
    albedo: np.ndarray
    emission: np.ndarray
    material: np.ndarray
    cutouts: Cutouts | None = None
    normals_ws: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.corners_ws)

    def coverage(self, triangle: np.ndarray) -> np.ndarray:
        """(n,) float32 mean opacity of the triangles (n,), 1 of opaque ones and at least 1/255."""
        out = np.ones(len(triangle), np.float32)
        if self.cutouts is not None:
            row = self.cutouts.row[triangle]
            out[row >= 0] = np.maximum(self.cutouts.coverage[row[row >= 0]], 1 / 255)
        return out

    @functools.cached_property
    def bounds_ws(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner of the box around all triangles, (3,) each; zeros for no triangles."""
        if not len(self):
            return np.zeros(3, np.float32), np.zeros(3, np.float32)
        flat = self.corners_ws.reshape(-1, 9)    # three times as fast as by rows of three
        return flat.min(0).reshape(3, 3).min(0), flat.max(0).reshape(3, 3).max(0)

    @property
    def scale_m(self) -> float:
        """Longest edge of the bounds: what ray offsets and tolerances are relative to."""
        low, high = self.bounds_ws
        return float(np.max(high - low, initial=0.0))

    @staticmethod
    def empty() -> Geometry:
        return Geometry(np.zeros((0, 3, 3), np.float32), np.zeros((0, 3, 3), np.float32),
                        np.zeros((0, 3), np.float32), np.zeros(0, np.int32))


@dataclass(frozen=True)
class Material:
    """What a surface is made of where no pass tells it per pixel (constants, or means of textures).

    `keeps_energy` is False for a lobe of single scattering, which loses what the microfacets hide from each other. `f0` is
    the glossy lobe's reflectance at normal incidence, 0 where its colour has to tell it (metals, mixtures with them).
    """

    name: str
    albedo: tuple[float, float, float] = (0.8, 0.8, 0.8)
    specular: tuple[float, float, float] = (0.04, 0.04, 0.04)
    roughness: float = 0.5
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    alpha: float = 1.0
    keeps_energy: bool = True
    f0: float = 0.0


@dataclass(frozen=True)
class World:
    """Light from infinity: radiance (H, W, 3) float32 W/(m2 sr) over the sphere.

    Equirectangular in world axes: row 0 is straight up (+Z), column 0 is longitude -pi; longitude 0 is +Y and grows
    towards +X. A constant world is 1x1. `is_black` worlds cost nothing.
    """

    radiance: np.ndarray = field(default_factory=lambda: np.zeros((1, 1, 3), np.float32))

    @property
    def is_black(self) -> bool:
        return not self.radiance.any()

    @property
    def is_constant(self) -> bool:
        return self.radiance.shape[:2] == (1, 1)


@dataclass(frozen=True)
class Frame:
    """One frame of one view layer, ready for the passes.

    `origin_ws` (3,) float64 m is what was taken off every position; `warnings` are lines for the user, one for each
    thing of the scene that RTGI does not model, naming its datablock. `views` come in the order of capture and name
    their light by index. `geometry` is None when no planned pass meets the scene with rays or voxels.
    """

    camera: Camera
    gbuffer: GBuffer
    lights: tuple[Light, ...] = ()
    views: tuple[LightView, ...] = ()
    geometry: Geometry | None = None
    materials: tuple[Material, ...] = ()
    world: World = field(default_factory=World)
    origin_ws: np.ndarray = field(default_factory=lambda: np.zeros(3))
    warnings: tuple[str, ...] = ()

    @property
    def ray_offset_m(self) -> float:
        """What both ends of a ray are lifted off their surfaces by: a fifty-thousandth of the scene's size."""
        return 2e-5 * self.scale_m

    @functools.cached_property
    def scale_m(self) -> float:
        """Size of what matters: twice what the camera sees, at most all geometry.

        Ray offsets and tolerances are relative to it.
        A ground plane of 10 km under a chair must not set the offsets of the chair's rays.
        """
        every = 4 if self.gbuffer.depth.size > 4096 else 1
        seen = self.gbuffer.position_ws[::every, ::every][self.gbuffer.mask[::every, ::every]]
        whole = self.geometry.scale_m if self.geometry is not None else 0.0
        if len(seen) <= 16:                      # too few to tell
            return whole if whole > 0 else 1.0
        extent = float(np.ptp(np.quantile(seen, [0.02, 0.98], axis=0), axis=0).max())
        if not whole > 0:
            return extent if extent > 0 else 1.0
        return min(whole, 2 * extent) if extent > 1e-3 * whole else max(whole * 1e-3, 1e-9)
