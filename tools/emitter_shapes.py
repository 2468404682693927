"""Emissive meshes as lamps and as emissive surfaces, beside Cycles: python -m tools.emitter_shapes [--samples N]

The sample scene cornell_box with an emitter of one shape after the other in the place of its lamp. Fills the table of
docs/passes/emission.md between its marks. Needs bpy; takes some minutes.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any

import bpy

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from rtgi_addon.compare import metrics  # noqa: E402
from rtgi_addon.compare import reference as blender  # noqa: E402
from rtgi_addon.compare.measure import errors_of, noise_of  # noqa: E402
from rtgi_addon.compare.progress import say  # noqa: E402
from rtgi_addon.compare.report import percent, text_table  # noqa: E402
from rtgi_addon.core.techniques import default_settings  # noqa: E402
from rtgi_addon.ui import register  # noqa: E402
from sample_scenes.build import build_scene  # noqa: E402
from tools.parameter_tables import between_marks  # noqa: E402

PAGE = ROOT / "docs" / "passes" / "emission.md"
SIZE = (480, 270)
SHAPES = ("a square near the ceiling", "a box of six faces", "a disk", "a ball", "three tubes of 1.4 m, 2 cm lower",
          "a ceiling that shines")
PEERS = (1, 4)


def add_emitter(shape: str) -> None:
    """Replace the scene's lamp by an emissive mesh of about its power."""
    lamp = next(o for o in bpy.data.objects if o.type == "LIGHT")
    (x, y, z), size, power = lamp.location, lamp.data.size, lamp.data.energy
    bpy.data.objects.remove(lamp)
    area, objects, mesh = size * size, [], bpy.ops.mesh

    def add(scale: tuple[float, float, float] = (1, 1, 1)) -> None:
        bpy.context.object.scale = scale
        objects.append(bpy.context.object)

    if shape == SHAPES[0]:
        mesh.primitive_plane_add(size=size, location=(x, y, z))
        add()
    elif shape == SHAPES[1]:
        mesh.primitive_cube_add(size=1, location=(x, y, z - 0.3))
        add((size, size, 0.1))
    elif shape == SHAPES[2]:
        mesh.primitive_circle_add(vertices=32, radius=0.6 * size, location=(x, y, z - 0.2), fill_type="NGON")
        add()
    elif shape == SHAPES[3]:
        mesh.primitive_uv_sphere_add(radius=0.3 * size, location=(x, y, z - 0.5))
        add()
    elif shape == SHAPES[4]:
        area = 0.3
        for offset in (-0.6, 0.0, 0.6):
            mesh.primitive_plane_add(size=1, location=(x + offset, y, z - 0.02))
            add((0.05, 1.4, 1))
    else:
        area = 1.9**2
        mesh.primitive_plane_add(size=1, location=(x, y, z))
        add((1.9, 1.9, 1))
    material = bpy.data.materials.new("Shines")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeEmission")
    shader.inputs["Color"].default_value = (1, 0.9, 0.7, 1)
    shader.inputs["Strength"].default_value = power / (math.pi * area)
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    for thing in objects:
        thing.data.materials.append(material)
    bpy.context.view_layer.update()


def row_of(shape: str, samples: int) -> list[str]:
    """Cells of a shape's row."""
    scene: Any = build_scene("cornell_box")
    add_emitter(shape)
    truth = blender.render_reference(scene, samples, SIZE)
    cells = [shape]
    for as_lamps in (False, True):
        result, _ = blender.render_rtgi(scene, default_settings().with_params("emission", as_lamps=as_lamps), SIZE)
        errors = errors_of(result, truth)
        cells.append(f"{percent(errors['picture']['block'])} ({errors['bounce']['energy']:.2f})")
    cells.append(percent(noise_of(truth)["picture"]))
    for count in PEERS:
        picture = blender.render_peer(scene, count, size=SIZE).combined[..., :3]
        cells.append(percent(metrics.block_relative_l1(picture, truth.mean("picture"), truth.mask)))
    say(" | ".join(cells))
    return cells


def main() -> None:
    """Measure all shapes and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=32, help="samples a pixel of each half of the reference; 32")
    arguments = parser.parse_args()
    register()
    head = ["emitter", "`as_lamps` off", "`as_lamps` on", "noise", *(f"Cycles {count}" for count in PEERS)]
    table = text_table(head, [row_of(shape, arguments.samples) for shape in SHAPES], markdown=True)
    words = ("By `python -m tools.emitter_shapes`: the Cornell box of the samples with an emitter in the place of its lamp, "
             f"{SIZE[0]}x{SIZE[1]}, Balanced.\nError of the picture against Cycles of 2 x {arguments.samples} samples, in "
             "brackets the bounce's light over that of Cycles.\n\n")
    PAGE.write_text(between_marks(PAGE.read_text(encoding="utf-8"), "shapes", words + table + "\n"), encoding="utf-8")


if __name__ == "__main__":
    main()
