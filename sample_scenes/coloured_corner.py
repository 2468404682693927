"""A corner of two saturated walls: colour bleeding on white things.

Two spots shine past the head on the walls only, and a weak lamp from the front gives the white things their shape.
Their shadowed sides take their colours from the walls: what is lost without a bounce is colour as much as brightness, so an
occlusion method alone gets the hue wrong.
"""

from __future__ import annotations

import bpy

from . import kit


def build(scene: bpy.types.Scene) -> None:
    """Floor, an orange and a blue wall, a head on a drum and solid letters, two spots and a weak soft lamp."""
    white = kit.material("white", (0.8, 0.8, 0.8), roughness=0.5)
    chalk = kit.material("chalk", (0.75, 0.73, 0.7), roughness=0.85)
    orange = kit.material("orange wall", (0.85, 0.2, 0.03), roughness=0.8)
    blue = kit.material("blue wall", (0.03, 0.16, 0.7), roughness=0.8)

    kit.plane("floor", (9, 9), (0, 0, 0), chalk)
    kit.box("orange wall", (6.6, 0.1, 4), (-1.6, 1.8, 0), orange, rotation_deg=(0, 0, 60))
    kit.box("blue wall", (6.6, 0.1, 4), (1.6, 1.8, 0), blue, rotation_deg=(0, 0, -60))

    drum = [(0.0, 0.0), (0.62, 0.0), (0.62, 0.06), (0.55, 0.1), (0.55, 0.62), (0.62, 0.66), (0.62, 0.72), (0.0, 0.72)]
    kit.lathe("drum", drum, white, location=(0, 1.6, 0))
    kit.monkey("head", (0, 1.55, 1.3), white, rotation_deg=(-8, 0, 0)).scale = (0.75, 0.75, 0.75)
    kit.text("letters", "BOUNCE", 0.62, (0, 0.3, 0.01), white)
    kit.sphere("left ball", 0.26, (-1.25, 0.95, 0), white)
    kit.sphere("right ball", 0.26, (1.25, 0.95, 0), white)

    soft = {"spot_size": 0.85, "spot_blend": 0.6, "shadow_soft_size": 0.08}
    kit.lamp("lamp on orange", "SPOT", 800, (-0.6, -0.2, 3.9), (-1.75, 1.4, 1.2), (1.0, 0.93, 0.82), **soft)
    kit.lamp("lamp on blue", "SPOT", 1000, (0.6, -0.2, 3.9), (1.75, 1.4, 1.2), (0.9, 0.95, 1.0), **soft)
    kit.lamp("soft lamp", "AREA", 8, (-0.6, -3.4, 3.2), (0, 1.4, 1.0), (1.0, 0.95, 0.9), shape="DISK", size=0.8)
    scene.view_settings.exposure = 0.3
    kit.camera((0, -3.9, 1.75), (0, 1.2, 1.05), lens_mm=35)
