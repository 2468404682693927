"""A flashlight in a dark furnished room: one cone of light, everything else is bounce.

The scene that reflective shadow maps were made for: a single spot, a few square metres in the light, and a room that only
its reflection shows. Methods that look at the screen alone work well as long as the lit place is in the picture.
"""

from __future__ import annotations

import bpy

from . import kit, patterns


def build(scene: bpy.types.Scene) -> None:
    """A living room and a spot that shines on its red armchair."""
    _room()
    _armchair((-0.35, 1.15))
    _table((1.15, 0.55))
    _bookshelf((2.42, 1.3))
    _floor_lamp((-1.75, 1.75))
    kit.lamp(
        "flashlight",
        "SPOT",
        260,
        (1.15, -2.3, 1.35),
        (-0.15, 1.5, 0.72),
        (1.0, 0.9, 0.72),
        spot_size=0.78,
        spot_blend=0.35,
        shadow_soft_size=0.03,
    )
    scene.view_settings.exposure = 3.2
    kit.camera((0.7, -3.2, 1.5), (0.0, 1.2, 0.95), lens_mm=26)


def _room() -> None:
    boards = kit.texture("boards", patterns.planks((0.62, 0.44, 0.28)))
    weave = kit.texture(
        "weave", patterns.stripes(((0.72, 0.66, 0.55), (0.2, 0.32, 0.38), (0.72, 0.66, 0.55), (0.6, 0.25, 0.15)) * 2)
    )
    wall = kit.material("wall paint", (0.78, 0.74, 0.67), roughness=0.8)
    kit.plane("floor", (6, 7), (0, 0, 0), kit.material("boards", roughness=0.35, texture=boards), tile_m=1.2)
    kit.plane("ceiling", (6, 7), (0, 0, 2.7), kit.material("ceiling paint", (0.8, 0.8, 0.78), 0.9), rotation_deg=(180, 0, 0))
    kit.plane("back wall", (6, 2.7), (0, 2.6, 1.35), wall, rotation_deg=(90, 0, 0))
    kit.plane(
        "left wall", (2.7, 7), (-2.6, 0, 1.35), kit.material("teal paint", (0.12, 0.4, 0.4), 0.8), rotation_deg=(0, 90, 0)
    )
    kit.plane("right wall", (2.7, 7), (2.6, 0, 1.35), wall, rotation_deg=(0, -90, 0))
    kit.plane("near wall", (6, 2.7), (0, -3.45, 1.35), wall, rotation_deg=(-90, 0, 0))
    skirting = kit.material("skirting", (0.8, 0.78, 0.74), roughness=0.4)
    kit.box("skirting", (5.2, 0.02, 0.12), (0, 2.59, 0), skirting, bevel_m=0.006)
    kit.box("rug", (2.6, 1.9, 0.012), (0.1, 0.6, 0), kit.material("rug", roughness=0.95, texture=weave), tile_m=1.3)
    frame = kit.material("gilt frame", (0.85, 0.6, 0.25), roughness=0.3, metallic=1.0)
    kit.box("frame", (1.0, 0.04, 0.8), (-0.55, 2.57, 1.35), frame, bevel_m=0.015)
    canvas = kit.material("canvas", roughness=0.7, texture=kit.texture("painting", patterns.painting(seed=4)))
    kit.box("canvas", (0.86, 0.04, 0.66), (-0.55, 2.555, 1.42), canvas, tile_m=0.86)


def _armchair(place: tuple[float, float]) -> None:
    red = kit.material("red cloth", (0.6, 0.07, 0.05), roughness=0.85)
    parts = {
        "seat": ((0.78, 0.75, 0.3), (0.0, 0.0, 0.12)),
        "back": ((1.1, 0.24, 0.85), (0.0, 0.42, 0.12)),
        "cushion": ((0.74, 0.66, 0.16), (0.0, -0.06, 0.42)),
        "left arm": ((0.2, 0.85, 0.52), (-0.46, 0.02, 0.12)),
        "right arm": ((0.2, 0.85, 0.52), (0.46, 0.02, 0.12)),
    }
    chair = kit.add("armchair", None, (*place, 0), (0, 0, 12))
    for name, (size, location) in parts.items():
        part = kit.box(f"armchair {name}", size, location, red, bevel_m=0.05)
        part.parent = chair
        kit.modifier(part, "SUBSURF", levels=1, render_levels=1)
    legs = kit.boxes(
        "armchair legs", [((0.06, 0.06, 0.12), (0.4, 0.3, 0))], kit.material("dark wood", (0.1, 0.05, 0.03), 0.4)
    )
    legs.parent = chair
    kit.modifier(legs, "MIRROR", use_axis=(True, True, False))


def _table(place: tuple[float, float]) -> None:
    oak = kit.material("oak", roughness=0.4, texture=kit.texture("oak", patterns.planks((0.72, 0.52, 0.32), rows=4, seed=2)))
    table = kit.add("table", None, (*place, 0), (0, 0, -8))
    kit.box("table top", (0.9, 0.6, 0.04), (0, 0, 0.42), oak, bevel_m=0.01).parent = table
    legs = kit.boxes("table legs", [((0.05, 0.05, 0.42), (0.38, 0.24, 0))], oak)
    legs.parent = table
    kit.modifier(legs, "MIRROR", use_axis=(True, True, False))
    vase = [(0.0, 0.0), (0.07, 0.0), (0.11, 0.1), (0.1, 0.18), (0.045, 0.27), (0.055, 0.31)]
    glaze = kit.material("glaze", (0.05, 0.2, 0.55), roughness=0.12)
    kit.lathe("vase", vase, glaze, location=(0.2, 0.08, 0.46)).parent = table
    bowl = [(0.0, 0.0), (0.06, 0.0), (0.13, 0.06), (0.15, 0.1), (0.14, 0.1), (0.0, 0.03)]
    brass = kit.material("brass", (0.9, 0.65, 0.25), roughness=0.25, metallic=1.0)
    kit.lathe("bowl", bowl, brass, location=(-0.22, -0.05, 0.46)).parent = table


def _bookshelf(place: tuple[float, float]) -> None:
    wood = kit.material("shelf wood", (0.4, 0.24, 0.13), roughness=0.5)
    shelf = kit.add("bookshelf", None, (*place, 0), (0, 0, -90))
    boards = kit.box("shelf boards", (0.9, 0.3, 0.03), (0, 0, 0.05), wood, bevel_m=0.004)
    sides = kit.box("shelf sides", (0.03, 0.3, 2.2), (-0.45, 0, 0), wood, bevel_m=0.004)
    kit.row(boards, 6, (0, 0, 0.42)).parent = shelf
    kit.row(sides, 2, (0.9, 0, 0)).parent = shelf
    covers = ((0.6, 0.1, 0.08), (0.1, 0.25, 0.5), (0.75, 0.6, 0.3), (0.1, 0.35, 0.2), (0.35, 0.15, 0.35))
    for level in range(5):
        for i, cover in enumerate(covers):
            colour = kit.material(f"cover {level} {i}", cover[level % 3 :] + cover[: level % 3], roughness=0.6)
            height = 0.24 + 0.025 * ((3 * level + 2 * i) % 5)
            where = (-0.4 + 0.17 * i, -0.04, 0.08 + 0.42 * level)
            book = kit.box(f"books {level} {i}", (0.036, 0.2, height), where, colour, bevel_m=0.004)
            kit.row(book, 4, (0.0385, 0, 0)).parent = shelf


def _floor_lamp(place: tuple[float, float]) -> None:
    steel = kit.material("steel", (0.6, 0.6, 0.62), roughness=0.3, metallic=1.0)
    stand = [(0.0, 0.0), (0.17, 0.0), (0.17, 0.02), (0.02, 0.035), (0.014, 0.05), (0.014, 1.55), (0.0, 1.55)]
    kit.lathe("lamp stand", stand, steel, steps=20, location=(*place, 0))
    linen = kit.material("linen", (0.8, 0.74, 0.62), roughness=0.9)
    kit.lathe("lamp shade", [(0.26, 1.35), (0.16, 1.72)], linen, location=(*place, 0))
