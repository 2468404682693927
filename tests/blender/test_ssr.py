"""Reflections against Cycles' one bounce, and against the view of a mirrored camera that Blender renders."""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = pytest.mark.blender

SIZE = (64, 36)
SAMPLES = 128           # of each half of the reference
# relative L1 of 8x8 blocks: what few rays and filters, and the pictures' pixels, leave, above the reference's own noise
TOLERANCE = {0.0: 0.08, 0.25: 0.1, 0.5: 0.12}


def surface(name, roughness=0.5, metallic=0.0, colour=None, emission=0.0):
    """Set the shader of a material of the small scene."""
    import bpy

    shader = bpy.data.materials[name].node_tree.nodes["Principled BSDF"]
    shader.inputs["Roughness"].default_value, shader.inputs["Metallic"].default_value = roughness, metallic
    if colour is not None:
        shader.inputs["Base Color"].default_value = (*colour, 1.0)
    shader.inputs["Emission Color"].default_value = (1.0, 0.8, 0.6, 1.0)
    shader.inputs["Emission Strength"].default_value = emission
    bpy.context.view_layer.update()


@pytest.fixture
def rendered(monkeypatch):
    """Renders a scene with reflections and direct light alone: (the frame, the result)."""
    from rtgi_addon import pipeline
    from rtgi_addon.compare.reference import render_rtgi
    from rtgi_addon.core.techniques import default_settings

    frames = []

    def keep(frame, *args, **kwargs):
        frames.append(frame)
        return run(frame, *args, **kwargs)

    run = pipeline.run
    monkeypatch.setattr(pipeline, "run", keep)

    def render(scene, size=SIZE, **params):
        settings = default_settings(techniques=["ssr"]).with_params("ssr", **params)
        result, _ = render_rtgi(scene, settings, size)
        return frames[-1], result

    return render


def block_error(result, reference, part):
    """(relative L1 of blocks less the reference's noise, ratio of the sums)."""
    from rtgi_addon.compare import metrics
    from rtgi_addon.compare.measure import part_of

    mine, mean = part_of(result.transports, part, reference.albedo), reference.mean(part)
    noise = metrics.block_noise(*reference.halves(part), reference.mask)
    return (metrics.block_relative_l1(mine, mean, reference.mask) - noise,
            metrics.energy_ratio(mine, mean, reference.mask))


@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("roughness", TOLERANCE)
def test_glossy_bounce_equals_that_of_cycles(small_scene, rendered, roughness, metallic):
    from rtgi_addon.compare.reference import render_reference

    surface("Floor", roughness, metallic, (0.7, 0.5, 0.3))
    surface("Wall", 1.0)
    _, result = rendered(small_scene, samples=256)
    reference = render_reference(small_scene, SAMPLES, SIZE)
    error, energy = block_error(result, reference, "glossy bounce")
    assert error < TOLERANCE[roughness] and abs(energy - 1) < 0.06


def test_emission_and_the_world_in_a_mirror_are_glossy_direct_in_cycles(bpy_session, small_scene, rendered):
    from rtgi_addon.compare.reference import render_reference

    small_scene.objects["Spot"].hide_render = True
    world = bpy_session.data.worlds.new("Sky")
    if bpy_session.app.version < (5, 0, 0):
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.2, 0.4, 0.8, 1.0)
    small_scene.world = world
    surface("Floor", 0.2, 1.0, (0.8, 0.8, 0.8))
    surface("Wall", 1.0, emission=3.0)
    _, result = rendered(small_scene, samples=256)
    reference = render_reference(small_scene, SAMPLES, SIZE)
    error, energy = block_error(result, reference, "direct glossy")
    assert error < 0.06 and abs(energy - 1) < 0.04


def test_mirror_shows_what_a_mirrored_camera_renders(bpy_session, small_scene, rendered):
    # Blender's cameras are right-handed: the mirrored one stands on its head, and its picture is turned over
    from mathutils import Matrix

    surface("Floor", 0.0, 1.0, (1.0, 1.0, 1.0))
    surface("Wall", 1.0)
    surface("Cube", 1.0)
    size = (128, 72)
    frame, result = rendered(small_scene, size, edge_fade=0.0, fallback="WORLD", thickness=0.002)
    g, camera = frame.gbuffer, frame.camera
    floor = g.mask & (np.abs(g.position_ws[..., 2]) < 1e-3) & (g.normal_ws[..., 2] > 0.99)

    place = small_scene.camera
    x, y, z, at = (np.array(place.matrix_world)[:3, k] for k in range(4))
    flip = np.array([1.0, 1.0, -1.0])
    turned = np.eye(4)
    turned[:3] = np.stack([flip * x, -flip * y, flip * z, flip * at], 1)
    place.matrix_world = Matrix(turned)
    small_scene.objects["Floor"].visible_camera = False
    bpy_session.context.view_layer.update()
    mirrored, picture = rendered(small_scene, size, fallback="WORLD")
    seen, position = picture.combined[::-1, :, :3], mirrored.gbuffer.position_ws[::-1]
    # what the mirrored view shows is valid where the camera itself sees the same place
    column, row, depth = camera.project(position.astype(np.float64))
    inside = floor & mirrored.gbuffer.mask[::-1] & (column > 1) & (row > 1) & (column < size[0] - 1) & (row < size[1] - 1)
    there = (np.clip(row, 0, size[1] - 1).astype(int), np.clip(column, 0, size[0] - 1).astype(int))
    off = np.abs(((position - g.position_ws[there]) * g.normal_ws[there]).sum(-1))
    same_side = (mirrored.gbuffer.normal_ws[::-1] * g.normal_ws[there]).sum(-1) > 0.99
    valid = inside & (depth > 0) & (off < 1e-3) & same_side
    valid[:, 0] = valid[:, -1] = valid[0] = valid[-1] = False
    assert valid.sum() > 300

    from rtgi_addon.passes.base import Transport

    mine = result.transports[Transport.BOUNCE_GLOSSY] / np.maximum(g.specular, 1e-6)
    # half a pixel: half-way to what the neighbouring pixels show, and the noise of soft shadows
    shifted = [np.roll(seen, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    low, high = (seen + (f(shifted, 0) - seen) / 2 for f in (np.min, np.max))
    slack = 0.02 * seen[valid].max()
    close = ((mine > low - slack) & (mine < high + slack)).all(-1)
    assert close[valid].mean() >= 0.99


def test_scene_without_gloss_is_planned_without_reflections(small_scene):
    from rtgi_addon.compare.reference import render_rtgi
    from rtgi_addon.core.techniques import default_settings

    for name in ("Floor", "Wall", "Cube"):
        surface(name, 1.0)
        import bpy

        bpy.data.materials[name].node_tree.nodes["Principled BSDF"].inputs["Specular IOR Level"].default_value = 0.0
    result, _ = render_rtgi(small_scene, default_settings(), SIZE)
    assert {"what": "Screen-Space Reflections", "why": "no surface in view is glossy"} in result.report["plan"]["left_out"]
