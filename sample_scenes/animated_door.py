"""A door that swings open between a lit and a dark room, in 20 frames.

A wedge of light sweeps over the floor and the walls, and the bounce follows it: what a technique keeps from frame
to frame must not lag, and noise must not flicker. Almost closed, the light comes through a slit of a few centimetres.
"""

from __future__ import annotations

import math

import bpy

from . import kit, patterns

FRAMES = 20
AJAR_DEG, OPEN_DEG = 6.0, 105.0
WIDTH_M, HEIGHT_M = 1.0, 2.1
HIDDEN_M = 0.02             # of the wall's edges behind the door frame, whose faces must not lie in theirs


def build(scene: bpy.types.Scene) -> None:
    """Two rooms, the door between them, a lamp in the far one and a weak blue lamp in the near one."""
    _rooms()
    _swing(_door())
    _furniture()
    kit.lamp("hall lamp", "POINT", 330, (0.35, 2.1, 2.0), None, (1.0, 0.76, 0.5), shadow_soft_size=0.08)
    kit.lamp(
        "night lamp",
        "AREA",
        3.0,
        (2.3, -2.6, 2.3),
        (-0.8, 0, 0.8),
        (0.45, 0.6, 1.0),
        shape="RECTANGLE",
        size=0.6,
        size_y=0.9,
    )
    scene.frame_start, scene.frame_end = 1, FRAMES
    scene.frame_set(FRAMES * 3 // 4)
    scene.view_settings.exposure = 1.8
    kit.camera((2.0, -3.3, 1.6), (-0.35, -0.4, 1.0), lens_mm=24)


def angle_rad(frame: int) -> float:
    """How far the door stands open: slow, fast, slow."""
    share = (frame - 1) / (FRAMES - 1)
    smooth = share * share * (3 - 2 * share)
    return math.radians(AJAR_DEG + (OPEN_DEG - AJAR_DEG) * smooth)


def _swing(door: bpy.types.Object) -> None:
    """One key a frame: what happens between keys, a setting of the user, does not matter."""
    for frame in range(1, FRAMES + 1):
        door.rotation_euler.z = -angle_rad(frame)
        door.keyframe_insert("rotation_euler", index=2, frame=frame)


def _rooms() -> None:
    boards = kit.texture("boards", patterns.planks((0.66, 0.47, 0.3), seed=7))
    white = kit.material("white paint", (0.74, 0.73, 0.7), roughness=0.8)
    blue = kit.material("blue paint", (0.3, 0.45, 0.6), roughness=0.8)
    yellow = kit.material("yellow paint", (0.8, 0.55, 0.15), roughness=0.8)
    kit.plane(
        "floor",
        (8, 6),
        (0, 0, 0),
        kit.material("boards", roughness=0.3, texture=boards),
        tile_m=1.2,
        rotation_deg=(0, 0, 90),
    )
    kit.plane("ceiling", (8, 8), (0, 0, 2.6), white, rotation_deg=(180, 0, 0))
    sides = [((0.1, 4, 2.6), (-3, -2, 0)), ((0.1, 4, 2.6), (3, -2, 0)), ((6.1, 0.1, 2.6), (0, -4, 0))]
    kit.boxes("dark room", sides, blue)
    sides = [((0.1, 4, 2.6), (-3, 2, 0)), ((0.1, 4, 2.6), (3, 2, 0)), ((6.1, 0.1, 2.6), (0, 4, 0))]
    kit.boxes("lit room", sides, yellow)
    gap = WIDTH_M + 2 * HIDDEN_M
    side, top = (6 - gap) / 2, HEIGHT_M + HIDDEN_M
    parts = [((side, 0.1, 2.6), (-(gap + side) / 2, 0, 0)), ((side, 0.1, 2.6), ((gap + side) / 2, 0, 0))]
    kit.boxes("partition", [*parts, ((gap, 0.1, 2.6 - top), (0, 0, top))], white)
    frame = [((0.08, 0.16, HEIGHT_M), (-WIDTH_M / 2 - 0.04, 0, 0)), ((0.08, 0.16, HEIGHT_M), (WIDTH_M / 2 + 0.04, 0, 0))]
    frame.append(((WIDTH_M + 0.16, 0.16, 0.08), (0, 0, HEIGHT_M)))
    kit.boxes("door frame", frame, kit.material("frame paint", (0.8, 0.78, 0.75), roughness=0.35), bevel_m=0.01)


def _door() -> bpy.types.Object:
    """The hinge, an empty at the door's edge that carries leaf, panels and knobs; it opens into the dark room."""
    paint = kit.material("door paint", (0.6, 0.12, 0.07), roughness=0.35)
    brass = kit.material("brass", (0.9, 0.65, 0.25), roughness=0.2, metallic=1.0)
    hinge = kit.add("door", None, (-WIDTH_M / 2, -0.03, 0))
    kit.box(
        "door leaf", (WIDTH_M - 0.01, 0.045, HEIGHT_M - 0.02), (WIDTH_M / 2, 0, 0.01), paint, bevel_m=0.004
    ).parent = hinge
    panel = kit.box("door panels", (0.32, 0.07, 0.8), (0.29, 0, 0.16), paint, bevel_m=0.012)
    kit.row(kit.row(panel, 2, (0.42, 0, 0)), 2, (0, 0, 0.95))
    panel.parent = hinge
    knob = kit.sphere("knob", 0.035, (WIDTH_M - 0.09, -0.06, 1.0), brass)
    knob.parent = hinge
    kit.modifier(knob, "MIRROR", use_axis=(False, True, False), mirror_object=hinge)
    return hinge


def _furniture() -> None:
    white = kit.material("porcelain", (0.8, 0.8, 0.78), roughness=0.15)
    oak = kit.material("oak", (0.45, 0.28, 0.14), roughness=0.4)
    kit.box("stand", (0.45, 0.45, 0.75), (-2.1, -1.7, 0), oak, bevel_m=0.02)
    vase = [(0.0, 0.0), (0.09, 0.0), (0.16, 0.16), (0.14, 0.3), (0.06, 0.44), (0.08, 0.5)]
    kit.lathe("vase", vase, white, location=(-2.1, -1.7, 0.75))
    frame = kit.material("gilt frame", (0.85, 0.6, 0.25), roughness=0.3, metallic=1.0)
    kit.box("frame", (0.9, 0.04, 0.7), (1.55, -0.07, 1.2), frame, bevel_m=0.015)
    canvas = kit.material("canvas", roughness=0.7, texture=kit.texture("painting", patterns.painting(seed=9)))
    kit.box("canvas", (0.78, 0.04, 0.58), (1.55, -0.085, 1.26), canvas, tile_m=0.78)
    kit.box("hall bench", (1.2, 0.4, 0.45), (-0.6, 3.4, 0), oak, bevel_m=0.03)
