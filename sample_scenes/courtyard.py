"""A courtyard under an evening sky: an image lights it from all sides, a low sun from one.

Light from the world needs visibility in every direction: the arcades are dark inside, the open middle is bright. The sun
reaches two wings, whose warm light is the bounce. The sky is an equirectangular float image, made by `patterns.sky`.
"""

from __future__ import annotations

import math

import bpy

from . import kit, patterns

HALF_M, ARCHES, ARCH_M, GALLERY_M = 7.5, 5, 3.0, 2.4
SUN_AZIMUTH_DEG, SUN_ELEVATION_DEG = 308.0, 36.0


def build(scene: bpy.types.Scene) -> None:
    """Four equal wings round a paved court with a fountain, trees in tubs, the sun and the sky."""
    wing = _wing()
    for turn_deg in (0, 90, 180, 270):
        kit.instance(wing, (0, 0, 0), turn_deg)
    paving = kit.texture("paving", patterns.stone((0.76, 0.7, 0.62), (0.42, 0.38, 0.33), rows=3, columns=3, seed=8))
    kit.plane("court", (24, 24), (0, 0, 0), kit.material("paving", roughness=0.55, texture=paving), tile_m=3.0)
    _fountain()
    tree = _tree()
    for i, (x, y) in enumerate(((-4.6, -1.5), (-4.6, 4.6), (4.6, 4.6), (4.6, -1.5))):
        kit.instance(tree, (x, y, 0), turn_deg=70 * i, scale=1.0 + 0.08 * i)

    azimuth, elevation = math.radians(SUN_AZIMUTH_DEG), math.radians(SUN_ELEVATION_DEG)
    direction = [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    kit.lamp("sun", "SUN", 6.5, [30 * d for d in direction], (0, 0, 0), (1.0, 0.68, 0.4), angle=0.02)
    sky = kit.texture("sky", patterns.sky(SUN_AZIMUTH_DEG, SUN_ELEVATION_DEG), is_float=True)
    kit.world((0.3, 0.4, 0.6), 0.7, environment=sky)
    kit.camera((2.2, -6.6, 1.7), (-1.0, 3.0, 1.9), lens_mm=23, shift_y=0.05)


def _wing() -> bpy.types.Collection:
    """The wing at +y: an arcade in front of a gallery with a roof, and an upper wall with windows."""
    plaster = kit.material("plaster", (0.8, 0.66, 0.5), roughness=0.85)
    trim = kit.material("trim", (0.78, 0.74, 0.68), roughness=0.6)
    rust = kit.material("gallery plaster", (0.72, 0.3, 0.16), roughness=0.85)
    shutter = kit.material("shutter", (0.12, 0.32, 0.3), roughness=0.5)
    tiles = kit.material("roof tiles", (0.55, 0.22, 0.12), roughness=0.8)
    wing = kit.group("wing")
    inside = {"collection": wing}
    first = -(ARCHES - 1) / 2 * ARCH_M
    arch = kit.arch("arcade", (ARCH_M, 0.4, 3.3), (2.3, 1.7), plaster, location=(first, HALF_M, 0), **inside)
    kit.row(arch, ARCHES, (ARCH_M, 0, 0))
    pier = kit.box("imposts", (0.8, 0.5, 0.12), (first - ARCH_M / 2, HALF_M, 1.62), trim, bevel_m=0.02, **inside)
    kit.row(pier, ARCHES + 1, (ARCH_M, 0, 0))
    length = 2 * (HALF_M + GALLERY_M)
    kit.box("gallery wall", (length, 0.2, 3.3), (0, HALF_M + GALLERY_M, 0), rust, **inside)
    kit.box("gallery roof", (length, GALLERY_M, 0.15), (0, HALF_M + GALLERY_M / 2, 3.3), plaster, **inside)
    kit.box("cornice", (2 * HALF_M - 0.2, 0.5, 0.16), (0, HALF_M - 0.1, 3.3), trim, bevel_m=0.03, **inside)
    kit.box("upper wall", (2 * HALF_M + 0.3, 0.3, 2.3), (0, HALF_M + 0.2, 3.4), plaster, **inside)
    window = kit.boxes("windows", [((0.5, 0.08, 1.3), (first - 0.27, HALF_M + 0.03, 3.9))], shutter, bevel_m=0.015, **inside)
    kit.row(kit.row(window, 2, (0.54, 0, 0)), ARCHES, (ARCH_M, 0, 0))
    sill = kit.box("sills", (1.3, 0.2, 0.08), (first, HALF_M, 3.8), trim, bevel_m=0.015, **inside)
    kit.row(sill, ARCHES, (ARCH_M, 0, 0))
    kit.box("eaves", (2 * HALF_M + 0.8, 0.9, 0.12), (0, HALF_M + 0.1, 5.7), tiles, rotation_deg=(-14, 0, 0), **inside)
    return wing


def _fountain() -> None:
    stone = kit.material("fountain stone", (0.72, 0.7, 0.66), roughness=0.5)
    basin = [
        (0.0, 0.0),
        (1.7, 0.0),
        (1.7, 0.12),
        (1.5, 0.16),
        (1.5, 0.5),
        (1.6, 0.55),
        (1.6, 0.62),
        (1.38, 0.62),
        (1.38, 0.4),
    ]
    kit.lathe("basin", basin, stone, steps=48)
    bowl = [
        (0.16, 0.38),
        (0.13, 1.1),
        (0.3, 1.2),
        (0.75, 1.42),
        (0.78, 1.5),
        (0.7, 1.5),
        (0.2, 1.32),
        (0.1, 1.36),
        (0.07, 1.75),
    ]
    kit.lathe("bowl", [*bowl, (0.14, 1.85), (0.0, 2.0)], stone, steps=40)
    water = kit.material("water", (0.05, 0.12, 0.13), roughness=0.05)
    kit.lathe("water", [(0.0, 0.48), (1.39, 0.48)], water, steps=48)


def _tree() -> bpy.types.Collection:
    """A clipped tree in a tub; its crown is a sphere that a subdivision rounds and a cloud texture makes uneven."""
    tree = kit.group("tree")
    inside = {"collection": tree}
    clay = kit.material("clay", (0.62, 0.25, 0.13), roughness=0.7)
    kit.lathe(
        "tub",
        [(0.0, 0.0), (0.34, 0.0), (0.46, 0.6), (0.5, 0.62), (0.5, 0.7), (0.42, 0.7), (0.42, 0.62), (0.0, 0.62)],
        clay,
        **inside,
    )
    kit.lathe("trunk", [(0.07, 0.6), (0.05, 1.5)], kit.material("bark", (0.2, 0.12, 0.07), 0.9), steps=12, **inside)
    crown = kit.sphere("crown", 0.75, (0, 0, 1.3), kit.material("leaves", (0.1, 0.26, 0.05), roughness=0.7), **inside)
    lumps = bpy.data.textures.new("lumps", "CLOUDS")
    lumps.noise_scale = 0.22
    kit.modifier(crown, "DISPLACE", texture=lumps, strength=0.35)
    return tree
