"""A colonnade in low sun: pools of light on a warm floor, and all else lit from them.

The sun reaches a small part of the floor and of the back wall, so the view from the sun must be fitted to what matters.
Every bay is one collection, placed again and again: instances must be captured, not only objects. The camera's lens is
shifted, as architects do to keep columns upright.
"""

from __future__ import annotations

import bpy

from . import kit, patterns

BAY_M, AISLE_M, HEIGHT_M, BAYS = 3.0, 4.2, 4.9, 9
COLUMN = [(0.0, 0.0), (0.4, 0.0), (0.4, 0.14), (0.33, 0.18), (0.34, 0.26), (0.27, 0.34), (0.27, 0.5), (0.24, 2.2)]
COLUMN += [(0.22, 2.6), (0.27, 2.66), (0.24, 2.72), (0.36, 2.9), (0.36, 3.0)]


def build(scene: bpy.types.Scene) -> None:
    """Nine bays in a row, a lawn outside, the sun and a little blue sky."""
    bay = _bay()
    for i in range(BAYS):
        kit.instance(bay, (0, i * BAY_M, 0))
    end = (BAYS - 0.5) * BAY_M
    kit.box("end wall", (AISLE_M + 0.5, 0.2, HEIGHT_M), (0, end, 0), kit.material("end plaster", (0.72, 0.42, 0.25), 0.8))
    kit.text("inscription", "MERIDIES", 0.5, (0, end - 0.14, 3.0), kit.material("bronze", (0.75, 0.5, 0.25), 0.35, 1.0))
    urn = [
        (0.0, 0.0),
        (0.3, 0.0),
        (0.3, 0.06),
        (0.12, 0.14),
        (0.14, 0.22),
        (0.42, 0.6),
        (0.46, 0.9),
        (0.38, 1.0),
        (0.45, 1.08),
    ]
    kit.lathe("urn", urn, kit.material("terracotta", (0.7, 0.25, 0.12), roughness=0.6), location=(-1.35, 4.5, 0))
    kit.plane("lawn", (30, 60), (17.4, 15, -0.3), kit.material("lawn", (0.12, 0.28, 0.05), roughness=0.95))

    kit.lamp("sun", "SUN", 11.0, (12, -2, 8), (0, 2.6, 0), (1.0, 0.8, 0.55), angle=0.012)
    kit.world((0.35, 0.55, 1.0), 0.12)
    kit.camera((0.9, -2.9, 1.6), (-0.75, 10, 1.6), lens_mm=24, shift_y=0.09)


def _bay() -> bpy.types.Collection:
    """One bay, `BAY_M` long in y: floor, column and arch on the open side, closed wall with a pilaster, beamed ceiling."""
    limestone = kit.material("limestone", (0.76, 0.68, 0.55), roughness=0.7)
    blocks = kit.texture("blocks", patterns.stone((0.85, 0.76, 0.62), (0.62, 0.54, 0.44)))
    slabs = kit.texture("slabs", patterns.stone((0.82, 0.66, 0.5), (0.5, 0.4, 0.32), rows=2, columns=2, seed=3))
    bay, half = kit.group("bay"), AISLE_M / 2
    inside = {"collection": bay}
    kit.plane(
        "floor", (AISLE_M + 0.6, BAY_M), (0, 0, 0), kit.material("slabs", roughness=0.3, texture=slabs), tile_m=3.0, **inside
    )
    wall = kit.material("blocks", roughness=0.8, texture=blocks)
    kit.box("back wall", (0.2, BAY_M, HEIGHT_M), (-half - 0.1, 0, 0), wall, tile_m=3.0, **inside)
    kit.box("pilaster", (0.18, 0.5, 3.0), (-half + 0.09, BAY_M / 2, 0), limestone, bevel_m=0.03, **inside)
    kit.box("step", (0.5, BAY_M, 0.3), (half + 0.5, 0, -0.3), limestone, bevel_m=0.03, **inside)
    kit.lathe("column", COLUMN, limestone, location=(half, BAY_M / 2, 0), **inside)
    opening = {"location": (half, 0, 3.0), "rotation_deg": (0, 0, 90)}
    kit.arch("arch", (BAY_M, 0.44, HEIGHT_M - 3.0), (BAY_M - 0.6, 0.0), limestone, **opening, **inside)
    beam = kit.material("beam", (0.42, 0.25, 0.13), roughness=0.6)
    kit.box(
        "ceiling", (AISLE_M + 0.6, BAY_M, 0.1), (0, 0, HEIGHT_M), kit.material("boards", (0.6, 0.4, 0.24), 0.7), **inside
    )
    kit.row(
        kit.box("beams", (AISLE_M, 0.16, 0.22), (0, -1.0, HEIGHT_M - 0.22), beam, bevel_m=0.015, **inside), 3, (0, 1.0, 0)
    )
    return bay
