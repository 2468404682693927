"""A model town at night under thirty coloured lamps of every shape.

Points with a radius, spots with soft edges, rectangles and discs light a few houses each, so most lamps do not reach most
places: a method that shares its samples evenly among the lamps wastes nearly all of them. A sun is there too, but it is
switched off in renders.
"""

from __future__ import annotations

import bpy
import numpy as np

from . import kit, patterns

COLUMNS, ROWS, STREET_M, BLOCK_M = 7, 5, 1.1, 1.6
COLOURS = ((1.0, 0.55, 0.2), (0.15, 0.45, 1.0), (1.0, 0.12, 0.3), (0.1, 0.9, 0.55), (0.75, 0.25, 1.0), (1.0, 0.85, 0.55))


def build(scene: bpy.types.Scene) -> None:
    """Houses on a grid, street lamps, spots on the towers, shining signs, and a sun that is off."""
    random = np.random.default_rng(11)
    step = BLOCK_M + STREET_M
    centres = [((i - (COLUMNS - 1) / 2) * step, (j - 1) * step) for j in range(ROWS) for i in range(COLUMNS)]
    asphalt = kit.texture("asphalt", patterns.stone((0.5, 0.5, 0.52), (0.42, 0.42, 0.44), rows=4, columns=4, seed=1))
    kit.plane("ground", (40, 40), (0, 4, 0), kit.material("wet asphalt", roughness=0.22, texture=asphalt), tile_m=4.0)
    _houses(centres, random)
    _street_lamps(step)
    _spots(step)
    _signs(step)
    sun = kit.lamp("sun", "SUN", 3.0, (5, -5, 10), (0, 0, 0))
    sun.hide_render = True
    kit.world((0.02, 0.03, 0.08), 0.3)
    scene.view_settings.exposure = 0.7
    kit.camera((-1.3, -9.2, 4.6), (-0.1, -0.6, 0.45), lens_mm=32)


def _houses(centres: list[tuple[float, float]], random: np.random.Generator) -> None:
    walls = [kit.material(f"wall {i}", (v, v * 0.97, v * 0.93), 0.75) for i, v in enumerate((0.78, 0.65, 0.72))]
    dark = kit.material("window", (0.08, 0.09, 0.1), roughness=0.1)
    for i, (x, y) in enumerate(centres):
        floors = 1 + i // COLUMNS + int(random.integers(0, 2))
        size = BLOCK_M * random.uniform(0.8, 1.0)
        height = 0.5 * floors + 0.15
        kit.box(f"house {i}", (size, size, height), (x, y, 0), walls[i % 3], bevel_m=0.03)
        kit.box(f"roof {i}", (size + 0.08, size + 0.08, 0.06), (x, y, height), walls[(i + 1) % 3], bevel_m=0.02)
        pane = kit.box(f"windows {i}", (0.2, size + 0.02, 0.26), (x - 0.36 * size, y, 0.2), dark, bevel_m=0.006)
        kit.row(kit.row(pane, 3, (0.36 * size, 0, 0)), floors, (0, 0, 0.5))


def _street_lamps(step: float) -> None:
    """Twelve points with a radius, on posts."""
    steel = kit.material("post", (0.5, 0.5, 0.52), roughness=0.35, metallic=1.0)
    post = [(0.0, 0.0), (0.06, 0.0), (0.05, 0.06), (0.015, 0.1), (0.012, 0.78), (0.07, 0.8), (0.0, 0.84)]
    for j in range(3):
        for i in range(4):
            x, y = (i - 1.5) * step, (j - 1.5) * step
            kit.lathe(f"post {i} {j}", post, steel, steps=16, location=(x, y, 0))
            colour = COLOURS[(i + 2 * j) % len(COLOURS)]
            kit.lamp(f"street lamp {i} {j}", "POINT", 22, (x, y, 0.9), None, colour, shadow_soft_size=0.03 + 0.02 * (i % 2))


def _spots(step: float) -> None:
    """Eight spots that climb the walls, sharp and soft."""
    for i in range(8):
        x, y = (i % 4 - 1.5) * step, (i // 4 + 0.5) * step - 1.3
        target = (x + (0.9 if i % 2 else -0.9), y + 1.6, 2.0)
        cone = {"spot_size": 0.9 + 0.1 * (i % 3), "spot_blend": (0.05, 0.4, 1.0)[i % 3], "shadow_soft_size": 0.02}
        kit.lamp(f"spot {i}", "SPOT", 110, (x, y, 0.15), target, COLOURS[(3 * i + 1) % len(COLOURS)], **cone)


def _signs(step: float) -> None:
    """Six rectangles and four discs: shining signs that hang over streets and roofs, and letters lit by one of them."""
    paint = kit.material("letters", (0.8, 0.8, 0.8), roughness=0.4)
    kit.text("letters", "RTGI", 0.9, (0, -4.1, 0.01), paint)
    kit.lamp("sign letters", "AREA", 30, (0, -5.2, 1.3), (0, -4.1, 0.3), COLOURS[5], shape="RECTANGLE", size=2.0, size_y=0.2)
    for i in range(9):
        colour = COLOURS[(2 * i + 3) % len(COLOURS)]
        if i % 2:
            x, y = (i // 2 - 1.5) * 2 * step, (i % 4) * step / 2
            kit.lamp(f"disc {i}", "AREA", 40, (x, y - 0.7, 3.6), (x, y, 0), colour, shape="DISK", size=0.5)
        else:
            x, y = (i // 2 - 2) * step, -step / 2
            kit.lamp(
                f"sign {i}", "AREA", 22, (x, y, 1.1), (x, y - 1.0, 0.2), colour, shape="RECTANGLE", size=0.9, size_y=0.3
            )
