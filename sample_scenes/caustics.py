"""Polished metal under a lamp: caustics, the light that mirrors throw.

A ring draws the nephroid of the coffee cup, a tilted bowl throws a crescent, a small mirror lays a faint band over the
table, and a ball of brushed metal spreads what a mirror would keep sharp. All of it is light after one bounce. A path tracer
finds it by chance only, when a ray from the table happens to meet the lamp in the metal.
"""

from __future__ import annotations

import bpy

from . import kit, patterns

RING = [(0.30, 0.0), (0.30, 0.15), (0.315, 0.15), (0.315, 0.0)]
BOWL = [(0.0, 0.02), (0.1, 0.03), (0.19, 0.08), (0.24, 0.17), (0.25, 0.17), (0.2, 0.07), (0.1, 0.0), (0.0, 0.0)]


def build(scene: bpy.types.Scene) -> None:
    """A table in a corner, four pieces of metal, one lamp."""
    oak = kit.material("oak", roughness=0.6, texture=kit.texture("oak", patterns.planks((0.72, 0.56, 0.4), rows=5, seed=3)))
    wall = kit.material("wall paint", (0.72, 0.7, 0.66), roughness=0.9)
    kit.plane("table", (4, 3), (0, 0, 0), oak, tile_m=1.0)
    kit.plane("back wall", (4, 2), (0, 1.2, 1.0), wall, rotation_deg=(90, 0, 0))
    blue = kit.material("blue paint", (0.16, 0.3, 0.5), 0.9)
    kit.plane("left wall", (2, 3), (-1.5, 0, 1.0), blue, rotation_deg=(0, 90, 0))

    brass = kit.material("brass", (0.95, 0.72, 0.36), roughness=0.06, metallic=1.0)
    silver = kit.material("silver", (0.93, 0.92, 0.9), roughness=0.03, metallic=1.0)
    brushed = kit.material("brushed steel", (0.7, 0.7, 0.72), roughness=0.28, metallic=1.0)
    kit.lathe("ring", RING, brass, steps=96, location=(-0.3, -0.25, 0))
    kit.lathe("bowl", BOWL, silver, steps=96, location=(0.55, -0.2, 0), rotation_deg=(0, -14, 0))
    kit.sphere("ball", 0.16, (0.2, 0.55, 0), brushed)
    kit.box("mirror", (0.34, 0.02, 0.26), (-0.85, 0.45, 0.02), silver, rotation_deg=(-14, 0, -4), bevel_m=0.004)

    kit.lamp("lamp", "SPOT", 260, (2.2, -1.5, 1.45), (-0.1, 0.0, 0.1), (1.0, 0.95, 0.86), spot_size=0.95, spot_blend=0.3,
             shadow_soft_size=0.02)
    kit.world((0.03, 0.035, 0.045))
    kit.camera((0.15, -1.75, 1.15), (-0.1, 0.15, 0.12), lens_mm=32)
