"""What the tools that measure techniques share: captured frames, scenes under other light, references of them, JPEG files.

Needs Blender or the bpy module, and `rtgi_addon.register()` before.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from rtgi_addon import pipeline
from rtgi_addon.compare import reference as blender
from rtgi_addon.compare.halves import Reference, load_reference
from rtgi_addon.compare.progress import say
from rtgi_addon.compare.references import keep, name_of
from rtgi_addon.core.frame import Frame
from rtgi_addon.core.settings import Settings
from rtgi_addon.core.techniques import default_settings

JPEG_QUALITY = 88


def captured(scene: Any, size: tuple[int, int], settings: Settings | None = None) -> tuple[Frame, pipeline.Result]:
    """(frame, result) of one F12 by RTGI; without settings the frame has what every technique would ask for."""
    kept = []

    def run_and_keep(frame, *args, **kwargs):
        kept.append(frame)
        return run(frame, *args, **kwargs)

    run, pipeline.run = pipeline.run, run_and_keep
    try:
        result, _ = blender.render_rtgi(scene, settings or _asking_for_all(), size)
    finally:
        pipeline.run = run
    return kept[-1], result


def _asking_for_all() -> Settings:
    """The default settings, with views of lamps that serve every technique, and emissive surfaces left to theirs."""
    settings = default_settings()
    most = max(getattr(params, "map_texels", 0) for params in settings.params.values())
    return settings.with_params("rsm", map_texels=most).with_params("emission", as_lamps=False)


@contextlib.contextmanager
def _without_lamps(scene: Any) -> Iterator[None]:
    with blender.changed([(o, "hide_render", True) for o in scene.objects if o.type == "LIGHT"]):
        yield


@contextlib.contextmanager
def under_even_sky(scene: Any) -> Iterator[None]:
    """The scene without its lamps under a sky of radiance 1 from all sides, for the time of the context."""
    sky = bpy.data.worlds.new("even sky")
    sky.use_nodes = True
    background = next(node for node in sky.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value, background.inputs["Strength"].default_value = (1, 1, 1, 1), 1.0
    before = scene.world
    try:
        scene.world = sky
        with _without_lamps(scene):
            yield
    finally:
        scene.world = before
        bpy.data.worlds.remove(sky)


def panel_lamps(scene: Any) -> list[Any]:
    """The lamps that `with_panels` can replace: square and rectangular ones."""
    return [o for o in scene.objects
            if o.type == "LIGHT" and o.data.type == "AREA" and o.data.shape in ("SQUARE", "RECTANGLE")]


@contextlib.contextmanager
def with_panels(scene: Any) -> Iterator[None]:
    """Emissive panels in place of `panel_lamps`, and no other lamps, for the time of the context.

    A panel has the lamp's radiance, and has it on both of its sides.
    """
    made: list[Any] = []
    for lamp in panel_lamps(scene):
        x, y = lamp.data.size, lamp.data.size_y if lamp.data.shape == "RECTANGLE" else lamp.data.size
        corners = [(sx * x / 2, sy * y / 2, 0.0) for sx, sy in ((-1, -1), (-1, 1), (1, 1), (1, -1))]
        scale = lamp.matrix_world.to_scale()
        mesh = bpy.data.meshes.new("panel")
        mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
        material = bpy.data.materials.new("panel")
        material.use_nodes = True
        tree = material.node_tree
        tree.nodes.clear()
        shader = tree.nodes.new("ShaderNodeEmission")
        shader.inputs["Color"].default_value = (*lamp.data.color, 1)
        shader.inputs["Strength"].default_value = lamp.data.energy / (math.pi * x * y * scale.x * scale.y)
        tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
        mesh.materials.append(material)
        panel = bpy.data.objects.new("panel", mesh)
        panel.matrix_world = lamp.matrix_world
        scene.collection.objects.link(panel)
        made.append(panel)
    try:
        with _without_lamps(scene):
            bpy.context.view_layer.update()
            yield
    finally:
        for panel in made:
            mesh, material = panel.data, panel.data.materials[0]
            bpy.data.objects.remove(panel)
            bpy.data.meshes.remove(mesh)
            bpy.data.materials.remove(material)


def lit_by(scene: Any, light: str) -> contextlib.AbstractContextManager[None]:
    """For the time of the context under "even_sky" or "own_sky" without lamps, with "shining_panels", or "" as it is."""
    return {"": lambda _: contextlib.nullcontext(), "own_sky": _without_lamps, "even_sky": under_even_sky,
            "shining_panels": with_panels}[light](scene)


def reference_under(scene: Any, path: Path, light: str, size: tuple[int, int], samples: int, cache: Path) -> Reference:
    """A reference of the scene as it is now lit; `light` names how and is part of the name in `cache`, as are the bytes."""
    kept = cache / name_of(f"{path.stem}_{light}", size, path.read_bytes(), light, size, samples, blender.SEEDS,
                           blender.blender_version())
    if kept.is_file():
        return dataclasses.replace(load_reference(kept, size), source=str(kept))
    say(f"{path.stem}, {light}: reference by Cycles, one bounce, 2 x {samples} samples, {size[0]}x{size[1]}")
    found = blender.render_reference(scene, samples, size)
    keep(found, kept)
    return found


def write_jpeg(path: Path, pixels: np.ndarray, quality: int = JPEG_QUALITY) -> None:
    """Write (H, W, 3) uint8, row 0 at the top, as JPEG."""
    image = bpy.data.images.new("figure", pixels.shape[1], pixels.shape[0])
    try:
        rgba = np.ones((*pixels.shape[:2], 4), np.float32)
        rgba[..., :3] = pixels[::-1] / np.float32(255)
        image.pixels.foreach_set(rgba.ravel())
        image.filepath_raw, image.file_format = str(path.resolve()), "JPEG"
        path.parent.mkdir(parents=True, exist_ok=True)
        image.save(quality=quality)
    finally:
        bpy.data.images.remove(image)


def size_of(words: str) -> tuple[int, int]:
    """(width, height) of words such as "640x360"."""
    width, _, height = words.partition("x")
    return int(width), int(height)
