"""The parameters of every technique and the presets: numpy-free data that panels, command line and passes share.

Each technique has one frozen dataclass; its fields carry range, unit and description, and everything a user sees of them
is made from those. The passes import their dataclass from here, so that panels can be built without loading a kernel.
A new technique adds its dataclass, one line in `TECHNIQUE_PARAMS` and, where its cost has a knob, lines in `PRESET_PARAMS`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from ..errors import InputError
from .params import Params, param
from .settings import PRESETS, Settings


@dataclass(frozen=True)
class DirectParams(Params):
    """Light of lamps that reaches a pixel without a bounce."""

    soft_shadow_rays: int = param(
        16, "Rays towards a lamp that has a size, at each pixel in its half shadow; noise falls with the square root",
        low=1, high=1024, soft_high=256)
    exact_shadows: bool = param(
        False, "Trace a ray at every pixel instead of trusting the shadow map; slower, and the yardstick for the map")


@dataclass(frozen=True)
class WorldParams(Params):
    """Light of the world's background that reaches a pixel without a bounce."""

    rays: int = param(
        16, "Rays into the sky from each gather point; noise falls with the square root", low=1, high=1024, soft_high=256)
    lattice_px: int = param(
        2, "Distance between gather points; pixels between them are interpolated where the surface is smooth",
        low=1, high=16, soft_high=8, unit="px")


@dataclass(frozen=True)
class EmissionParams(Params):
    """Light of emissive surfaces that reaches a pixel without a bounce."""

    rays: int = param(
        8, "Rays to emissive surfaces from each gather point; noise falls with the square root", low=1, high=1024,
        soft_high=256)
    clusters: int = param(
        512, "Groups that points on emissive surfaces are put into; more follow many small ones better",
        low=16, high=16384, soft_high=4096)
    lattice_px: int = param(
        2, "Distance between gather points; pixels between them are interpolated where the surface is smooth",
        low=1, high=16, soft_high=8, unit="px")
    as_lamps: bool = param(
        True, "Rectangles, disks and balls that give much of the light are lit with as lamps, with their shadows and bounce")


@dataclass(frozen=True)
class RsmParams(Params):
    """Reflective shadow maps: the surfaces that a lamp lights, seen from the lamp, give the bounce."""

    method: str = param(
        "VISIBLE", "How the lit texels are gathered",
        choices=(("VISIBLE", "Visibility Rays",
                  "Lit texels in clusters, rays through the scene's triangles decide what is seen: no light through walls"),
                 ("ALL", "All Texels", "Every lit texel, or an even share of them; what stands between is not noticed"),
                 ("PAPER", "As Published",
                  "Samples on a disk around the pixel's place in the map (Dachsbacher and Stamminger 2005), no visibility")))
    samples: int = param(
        400, "Texels summed at each pixel by the methods without visibility", low=1, high=16384, soft_high=4096,
        only={"method": ("ALL", "PAPER")})
    radius: float = param(
        0.3, "Radius of the disk of samples as a share of the map's width; light from outside it is missing",
        low=0.001, high=1.0, only={"method": "PAPER"})
    weighting: str = param(
        "UNBIASED", "Weight of a sample at distance r from the centre of the disk",
        choices=(("UNBIASED", "Unbiased", "Weight by the density of the samples, which is proportional to r"),
                 ("PUBLISHED", "As Published", "Weight r squared, as printed in the paper: energy is not kept")),
        only={"method": "PAPER"})
    lattice_px: int = param(
        4, "Distance between gather points; pixels between them are interpolated where the surface is smooth",
        low=1, high=16, soft_high=8, unit="px", only={"method": "VISIBLE"})
    rays: int = param(
        16, "Visibility rays from each gather point; noise falls with the square root", low=1, high=1024, soft_high=256,
        only={"method": "VISIBLE"})
    clusters: int = param(
        512, "Groups that the lit texels of all lamps are put into; more follow small bright places better",
        low=16, high=16384, soft_high=4096, only={"method": "VISIBLE"})
    glossy_texels: bool = param(
        True, "Lit surfaces send out their glossy lobe too; without it part of the bounce is missing",
        only={"method": ("VISIBLE", "ALL")})
    photons: int = param(
        65536, "Photons that follow lamps' light off mirror-like surfaces, for the caustics that these throw; "
        "more make them sharper, 0 blurs them", low=0, high=1 << 24, soft_high=1 << 20, only={"method": "VISIBLE"})
    map_texels: int = param(
        32768, "Texels of each lamp's view; light of near ones is looked up in the triangles, so that few will do, but "
        "for the methods without visibility", low=256, high=1 << 24, soft_high=1 << 20, is_for_capture=True)


@dataclass(frozen=True)
class VxgiParams(Params):
    """Voxel global illumination: lit voxels of the scene, and cones through them."""

    resolution: int = param(
        128, "Voxels along the longest edge of the part of the scene that the picture's light reaches; finer ones take "
             "memory with the square and follow thin things", low=8, high=512, soft_high=256)
    lattice_px: int = param(
        4, "Distance between gather points; pixels between them are interpolated where the surface is smooth",
        low=1, high=16, soft_high=8, unit="px")
    cones: int = param(
        32, "Cones from each gather point; noise falls, and time rises, with their number", low=1, high=1024, soft_high=256)
    exact_voxels: int = param(
        1024, "Voxels that a cone is followed as an exact ray before it widens; 0 is the method as published, which blurs "
              "light through walls", low=0, high=1024)
    glossy_voxels: bool = param(
        True, "Lit voxels send out their glossy lobe too; without it part of the bounce is missing")
    solid: bool = param(
        False, "Fill closed bodies, so that widened cones do not see light through them; dims faces beside them, and exact "
               "rays need it not")
    world_light: bool = param(
        False, "Cones that leave the voxels bring the world's light, in place of the rays of World Light")
    glossy: bool = param(
        False, "Glossy pixels take a cone around their mirror direction; reflections are as coarse as the voxels")
    map_texels: int = param(
        131072, "Texels of each lamp's view; with fewer, voxels that a lamp lights get none", low=256, high=1 << 24,
        soft_high=1 << 20, is_for_capture=True)
    pictures: bool = param(
        False, "Also draw the voxels as the camera sees them, for a look at what the technique sees: views of Last Render, "
               "and layers of --passes")


@dataclass(frozen=True)
class LpvParams(Params):
    """Light propagation volumes: light of lit surfaces travels through a grid of cells."""

    mode: str = param(
        "ORDINATES", "What a cell keeps of its light, and how that moves on",
        choices=(("ORDINATES", "Directions",
                  "Flux by patches of directions, carried through the grid in one sweep: light keeps its way and falls off "
                  "as it should"),
                 ("HARMONICS", "Harmonics",
                  "Intensity in spherical harmonics, stepped from neighbour to neighbour until little is left in motion: "
                  "light spreads like heat"),
                 ("PAPER", "As Published",
                  "Clamped steps, fuzzy blockers and damping (Kaplanyan and Dachsbacher 2010): too bright near, too dark "
                  "far, through thin walls")))
    resolution: int = param(
        32, "The grid has the cube of this number of cells, whatever its shape; light leaks and blurs over a cell, time and "
        "memory grow with their number", low=8, high=96, soft_high=64)
    directions: int = param(
        4, "Patches of directions along an edge of each of a cube's six faces: 4 makes 96, odd numbers count as the next "
        "even one; fewer show the light of small places as rays. Directions only", low=2, high=8, soft_high=6,
        only={"mode": "ORDINATES"})
    cascades: int = param(
        2, "Grids inside of each other, the inner ones around what is near to the camera, if that is much smaller than the "
        "scene; each costs as much as the first. Directions only", low=1, high=4, only={"mode": "ORDINATES"})
    blockers: bool = param(
        True, "Surfaces stop light between cells; without it the grid is empty space")
    glossy_texels: bool = param(
        True, "Lit surfaces send out their glossy lobe too; without it part of the bounce is missing. Directions only",
        only={"mode": "ORDINATES"})
    lattice_px: int = param(
        6, "Distance between pixels that look into the grid; those between are interpolated where the surface is smooth",
        low=1, high=16, soft_high=8, unit="px")
    residual: float = param(
        0.01, "Share of the flux in motion at which steps end. Harmonics only", low=0.0, high=1.0,
        only={"mode": "HARMONICS"})
    max_iterations: int = param(
        64, "Steps that are taken at most; in open space light hardly ever leaves. Harmonics only",
        low=1, high=1024, soft_high=256, only={"mode": "HARMONICS"})
    iterations: int = param(
        8, "Steps, each to the next cell; more of them brighten what is far. As published only",
        low=1, high=256, soft_high=64, only={"mode": "PAPER"})
    damping: bool = param(
        True, "Darken light that changes against its direction across a surface: it came through. As published only",
        only={"mode": "PAPER"})
    map_texels: int = param(
        65536, "Texels of each lamp's view; far more than cells that a lamp lights add nothing", low=256, high=1 << 24,
        soft_high=1 << 20, is_for_capture=True)


@dataclass(frozen=True)
class FinalGatherParams(Params):
    """The bounce of the world's light and of emissive surfaces: rays that ask their hits."""

    rays: int = param(
        16, "Rays from each gather point; noise falls with the square root", low=1, high=1024, soft_high=256)
    lattice_px: int = param(
        8, "Distance between gather points; pixels between them are interpolated where the surface is smooth",
        low=1, high=16, soft_high=8, unit="px")


@dataclass(frozen=True)
class SsrParams(Params):
    """Screen-space reflections: glossy surfaces show what the picture, and beyond it the scene, holds."""

    method: str = param(
        "TRIANGLES", "How a ray finds what it meets",
        choices=(("TRIANGLES", "Triangles",
                  "Rays through the scene's triangles; the picture tells the light of hits that it shows. Exact, and with "
                  "Blender's ray tracer the fastest"),
                 ("HIERARCHY", "Hierarchy", "Every pixel that the ray crosses, skipping empty parts by a pyramid of depths"),
                 ("DDA", "Every Pixel", "Every pixel that the ray crosses; the same hits as the hierarchy, in more steps"),
                 ("LINEAR", "Even Steps", "Steps of a fixed length, as first published: thin things fall between two")))
    fallback: str = param(
        "RAYS", "What answers where the picture cannot: off the frame, and behind what the camera sees",
        choices=(("RAYS", "Rays", "Rays through the scene's triangles, their hits lit by the lamps"),
                 ("WORLD", "World", "The world alone; black where it is black"),
                 ("CONES", "Voxel Cones", "The glossy light of the voxel cones, where that technique runs; else rays")))
    samples: int = param(
        8, "Rays for each block of 4x4 pixels, at least one for each smooth pixel; noise falls with the square root",
        low=1, high=4096, soft_high=256)
    lattice_px: int = param(
        4, "Largest distance between traced pixels on rough surfaces; pixels between them are interpolated",
        low=1, high=4, unit="px")
    step_px: int = param(
        4, "Length of a step where rays take even steps", low=1, high=64, unit="px", only={"method": "LINEAR"})
    thickness: float = param(
        0.02, "Thickness of what the camera sees where no triangles are asked, as a share of the scene's size: too thin "
        "leaves holes, too thick smears", low=0.0, high=1.0, only={"fallback": ("WORLD", "CONES")})
    edge_fade: float = param(
        0.05, "Width of the frame's edge over which hits in the picture fade into what answers beyond it, as a share of its "
        "shorter side", low=0.0, high=0.5)


@dataclass(frozen=True)
class HbaoParams(Params):
    """Horizon-based ambient occlusion: world light, shadowed by what the screen shows around a pixel."""

    method: str = param(
        "COSINE", "What is measured",
        choices=(("COSINE", "Cosine-Correct",
                  "Sectors around the viewer's direction, with thickness: ray-traced visibility where the screen shows all"),
                 ("PUBLISHED", "As Published",
                  "Horizons with tangent bias and falloff (Bavoil et al. 2008): even in angle, nothing passes behind")))
    radius_m: float = param(
        0.0, "Distance up to which things hide the sky; 0 takes 20 % of the scene's size",
        low=0.0, high=1e6, soft_high=100.0, unit="m")
    slices: int = param(
        2, "Planes through the viewer's direction that are marched to both sides; the blur evens out few of them", low=1,
        high=64, soft_high=16)
    steps: int = param(
        12, "Samples to each side of a slice; too few miss what is small and leave corners too bright", low=1, high=256,
        soft_high=64)
    thickness: float = param(
        0.7, "Depth of what stands behind each visible point, as a share of the radius; light passes behind thinner things",
        low=0.0, high=10.0, soft_high=2.0, only={"method": "COSINE"})
    bias_rad: float = param(
        0.1, "Elevation over the tangent plane below which the published form sees no occluder; hides coarse meshes' edges",
        low=0.0, high=1.5, unit="rad", only={"method": "PUBLISHED"})
    falloff: bool = param(
        True, "The published form lets occluders fade towards the radius; off, they count in full",
        only={"method": "PUBLISHED"})
    bent_normals: bool = param(
        True, "Light of a map is looked up along the mean open direction instead of the normal; takes a tenth longer",
        only={"method": "COSINE"})
    multi_bounce: bool = param(
        False, "Adds the light that surfaces alike send to each other, as an exact series; off, no bounce is added")
    blur: int = param(
        2, "Radius of the edge-preserving blur in gathered points; 0 leaves the noise", low=0, high=8, unit="px")
    lattice_px: int = param(
        1, "Distance between gathered points; pixels between them are interpolated along their surface", low=1, high=8,
        unit="px")
    overscan: float = param(
        0.0, "Rim beyond the picture's edges, as a share of its shorter side, that is ray-cast for occluders off screen",
        low=0.0, high=1.0, soft_high=0.5)


@dataclass(frozen=True)
class SsaoParams(Params):
    """Screen-space ambient occlusion: world light, shadowed by random points around a pixel that the screen hides."""

    method: str = param(
        "HEMISPHERE", "Where the points lie",
        choices=(("HEMISPHERE", "Hemisphere", "On the normal's side; what lies far before a point does not hide it"),
                 ("SPHERE", "As Published",
                  "All around, without normals (Mittring 2007): no occlusion if more than half is seen; false shadows")))
    radius_m: float = param(
        0.0, "Radius of the ball of points; 0 takes 20 % of the scene's size", low=0.0, high=1e6, soft_high=100.0, unit="m")
    samples: int = param(
        16, "Points around each pixel; noise falls with the square root, and the blur evens it out", low=1, high=1024,
        soft_high=128)
    blur: int = param(
        2, "Radius of the edge-preserving blur in gathered points; 0 leaves the noise", low=0, high=8, unit="px")
    lattice_px: int = param(
        1, "Distance between gathered points; pixels between them are interpolated along their surface", low=1, high=8,
        unit="px")
    overscan: float = param(
        0.0, "Rim beyond the picture's edges, as a share of its shorter side, that is ray-cast for occluders off screen",
        low=0.0, high=1.0, soft_high=0.5)


@dataclass(frozen=True)
class SsdoParams(Params):
    """Screen-space directional occlusion: world light by direction, and the bounce from near surfaces in view."""

    form: str = param(
        "SECTORS", "How the surroundings of a pixel are looked at",
        choices=(("SECTORS", "Sectors",
                  "Slices around the viewer's direction, 64 sectors each: cosine and solid angle exact"),
                 ("SAMPLES", "As Published",
                  "Random points in the hemisphere (Ritschel, Grosch and Seidel 2009): rough, and wrong close to a corner")))
    radius_m: float = param(
        0.0, "How far surfaces shadow and light each other; 0 takes 20 % of the scene's size", low=0.0, high=1e6,
        soft_high=100.0, unit="m")
    thickness: float = param(
        0.05, "Depth of what only shows its front, as a share of the radius; thick hides light behind thin things",
        low=0.0, high=1.0, only={"form": "SECTORS"})
    slices: int = param(
        1, "Slices at each gathered point; noise falls faster than with the square root", low=1, high=64, soft_high=8,
        only={"form": "SECTORS"})
    steps: int = param(
        8, "Steps along each side of a slice, before edges are sought between them; few miss small things", low=1, high=64,
        soft_high=32, only={"form": "SECTORS"})
    samples: int = param(
        32, "Points around each pixel in the published form; noise falls with the square root", low=1, high=1024,
        soft_high=128, only={"form": "SAMPLES"})
    lattice_px: int = param(
        2, "Distance between gathered points; pixels between them are interpolated along their surface", low=1, high=8,
        unit="px")
    blur: int = param(
        2, "Radius of the edge-preserving blur in gathered points; 0 leaves the noise", low=0, high=8, unit="px")
    hand_over: bool = param(
        False, "Bring the bounce of near surfaces in view also beside reflective shadow maps, which then leave it out")


TECHNIQUE_PARAMS: dict[str, type[Params]] = {
    "direct": DirectParams, "world": WorldParams, "emission": EmissionParams, "rsm": RsmParams, "vxgi": VxgiParams,
    "lpv": LpvParams, "hbao": HbaoParams, "ssao": SsaoParams, "ssdo": SsdoParams, "final_gather": FinalGatherParams,
    "ssr": SsrParams}

# these run in every render and have no toggle
ALWAYS_ON = ("direct", "world", "emission")

LABELS: dict[str, str] = {
    "direct": "Direct Light",
    "world": "World Light",
    "emission": "Emissive Surfaces",
    "rsm": "Reflective Shadow Maps",
    "vxgi": "Voxel Global Illumination",
    "lpv": "Light Propagation Volumes",
    "hbao": "Ambient Occlusion (HBAO)",
    "ssao": "Ambient Occlusion (SSAO)",
    "ssdo": "Directional Occlusion (SSDO)",
    "final_gather": "Final Gathering",
    "ssr": "Screen-Space Reflections",
}

# A preset decides exactly these; every other parameter is the user's own. What Auto runs has points of the measured front
# (docs/calibration.md).
PRESET_PARAMS: dict[str, dict[str, dict[str, Any]]] = {
    "DRAFT": {
        "direct": {"soft_shadow_rays": 8},
        "world": {"lattice_px": 4, "rays": 16},
        "emission": {"lattice_px": 8, "rays": 8, "clusters": 512},
        "rsm": {"lattice_px": 8, "rays": 16, "clusters": 512, "map_texels": 16384},
        "vxgi": {"resolution": 96, "lattice_px": 8, "cones": 32},
        "lpv": {"resolution": 24, "directions": 4, "lattice_px": 8},
        "hbao": {"slices": 2, "steps": 8, "lattice_px": 2, "overscan": 0.0},
        "ssao": {"samples": 8, "lattice_px": 2, "overscan": 0.0},
        "ssdo": {"slices": 1, "steps": 6, "lattice_px": 2, "samples": 16},
        "final_gather": {"lattice_px": 8, "rays": 8},
        "ssr": {"samples": 4},
    },
    "BALANCED": {
        "direct": {"soft_shadow_rays": 16},
        "world": {"lattice_px": 2, "rays": 16},
        "emission": {"lattice_px": 2, "rays": 8, "clusters": 512},
        "rsm": {"lattice_px": 4, "rays": 16, "clusters": 512, "map_texels": 32768},
        "vxgi": {"resolution": 128, "lattice_px": 4, "cones": 32},
        "lpv": {"resolution": 32, "directions": 4, "lattice_px": 6},
        "hbao": {"slices": 2, "steps": 12, "lattice_px": 1, "overscan": 0.0},
        "ssao": {"samples": 16, "lattice_px": 1, "overscan": 0.0},
        "ssdo": {"slices": 1, "steps": 8, "lattice_px": 2, "samples": 32},
        "final_gather": {"lattice_px": 8, "rays": 16},
        "ssr": {"samples": 8},
    },
    "QUALITY": {
        "direct": {"soft_shadow_rays": 64},
        "world": {"lattice_px": 2, "rays": 32},
        "emission": {"lattice_px": 2, "rays": 32, "clusters": 512},
        "rsm": {"lattice_px": 2, "rays": 32, "clusters": 512, "map_texels": 65536},
        "vxgi": {"resolution": 256, "lattice_px": 2, "cones": 64},
        "lpv": {"resolution": 48, "directions": 6, "lattice_px": 3},
        "hbao": {"slices": 4, "steps": 32, "lattice_px": 1, "overscan": 0.15},
        "ssao": {"samples": 64, "lattice_px": 1, "overscan": 0.15},
        "ssdo": {"slices": 2, "steps": 16, "lattice_px": 1, "samples": 64},
        "final_gather": {"lattice_px": 4, "rays": 48},
        "ssr": {"samples": 32},
    },
}


def optional_techniques() -> tuple[str, ...]:
    """The techniques that a user can switch on and off, in the order of the panel."""
    return tuple(name for name in TECHNIQUE_PARAMS if name not in ALWAYS_ON)


def preset_params(preset: str) -> dict[str, Params]:
    """Parameters of every technique under a preset; InputError for an unknown one."""
    if preset not in PRESET_PARAMS:
        raise InputError(f"preset must be one of {', '.join(p[0].lower() for p in PRESETS)}, got {preset.lower()!r}")
    changes = PRESET_PARAMS[preset]
    return {name: dataclasses.replace(kind(), **changes.get(name, {})) for name, kind in TECHNIQUE_PARAMS.items()}


def default_settings(preset: str = "BALANCED", techniques: tuple[str, ...] | list[str] | None = None) -> Settings:
    """Settings of a preset.

    `techniques` None lets the planner choose among all of them; a list runs exactly these (and what always runs).
    InputError for an unknown name.
    """
    for name in techniques or ():
        if name not in TECHNIQUE_PARAMS:
            raise InputError(f"no technique is called {name!r}; known are {', '.join(TECHNIQUE_PARAMS)}")
    wanted = TECHNIQUE_PARAMS if techniques is None else (*ALWAYS_ON, *techniques)
    return Settings(preset=preset, use_auto=techniques is None,
                    enabled={name: name in wanted for name in TECHNIQUE_PARAMS}, params=preset_params(preset))
