"""Emissive meshes that are lamps, against Cycles: direct light and bounce, and what is left of them elsewhere."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytestmark = pytest.mark.blender

SIZE = (64, 40)
SAMPLES = 128           # of each half; the noise that leaves is measured from the halves and allowed for


def add_emitter(bpy, scene, shape):
    """An emissive mesh in place of the scene's lamp."""
    bpy.data.objects.remove(scene.objects["Spot"])
    place = (0.3, -0.6, 1.9)
    if shape == "rectangle":
        bpy.ops.mesh.primitive_plane_add(size=1.0, location=place, rotation=(0.3, 0.2, 0.5))
        bpy.context.object.scale = (1.2, 0.3, 1.0)
    elif shape == "disk":
        bpy.ops.mesh.primitive_circle_add(radius=0.5, vertices=32, fill_type="NGON", location=place,
                                          rotation=(0.2, -0.3, 0.0))
    elif shape == "ball":
        bpy.ops.mesh.primitive_uv_sphere_add(radius=0.25, location=place)
    else:
        bpy.ops.mesh.primitive_cube_add(size=0.4, location=place, rotation=(0.3, 0.2, 0.5))
    material = bpy.data.materials.new("Shines")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    material.node_tree.nodes.clear()
    shader = material.node_tree.nodes.new("ShaderNodeEmission")
    shader.inputs["Color"].default_value, shader.inputs["Strength"].default_value = (1.0, 0.6, 0.3, 1.0), 8.0
    output = material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
    bpy.context.object.data.materials.append(material)
    bpy.context.view_layer.update()
    return bpy.context.object


def rtgi_and_cycles(scene, **params):
    """(our last result, Cycles' reference)."""
    import bpy

    from rtgi_addon import engine
    from rtgi_addon.compare.reference import render_reference

    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.rtgi.direct.soft_shadow_rays = 256
    for name, value in params.items():
        setattr(scene.rtgi.emission, name, value)
    reference = render_reference(scene, SAMPLES)
    bpy.ops.render.render()
    return engine.last_result(), reference


def errors(result, reference, part):
    """(sum of the errors of 8x8 blocks over the light, the same of the reference's own noise, energy) of a part."""
    from rtgi_addon.compare import metrics
    from rtgi_addon.compare.measure import part_of

    got, mask = part_of(result.transports, part, reference.albedo), reference.mask
    wanted, halves = reference.mean(part), reference.halves(part)
    return (metrics.block_relative_l1(got, wanted, mask), metrics.block_noise(*halves, mask),
            metrics.energy_ratio(got, wanted, mask))


@pytest.mark.parametrize("shape", ["rectangle", "disk", "ball", "box"])
def test_direct_light_and_bounce_are_those_of_cycles(bpy_session, small_scene, shape):
    from rtgi_addon.passes.base import Transport

    add_emitter(bpy_session, small_scene, shape)
    result, reference = rtgi_and_cycles(small_scene)
    assert Transport.DIRECT_DIFFUSE in result.transports
    assert not np.any(result.transports.get(Transport.EMISSION_DIFFUSE, 0))
    error, noise, energy = errors(result, reference, "direct diffuse")
    # shadows of 256 rays; a ball of 32 parts stands for the sphere around it
    assert error < 0.01 + noise and energy == pytest.approx(1, abs=0.01)
    error, noise, energy = errors(result, reference, "bounce")
    # an area lamp of Blender's in the rectangle's place has 11 % and .96: few pixels, many of them at edges
    assert error < 0.12 + noise and energy == pytest.approx(1, abs=0.06)


def test_switched_off_they_are_emissive_surfaces(bpy_session, small_scene):
    from rtgi_addon.passes.base import Transport

    add_emitter(bpy_session, small_scene, "rectangle")
    result, reference = rtgi_and_cycles(small_scene, as_lamps=False)
    assert result.transports[Transport.EMISSION_DIFFUSE].any() and Transport.DIRECT_DIFFUSE not in result.transports
    assert errors(result, reference, "direct diffuse")[2] == pytest.approx(1, abs=0.05)


def test_the_picture_shows_them_and_mirrors_do(bpy_session, small_scene):
    """A mirror for a floor: the panel is in the picture by its emission and in the mirror as a lamp's reflection, once."""
    bpy = bpy_session
    add_emitter(bpy, small_scene, "rectangle")
    shader = bpy.data.materials["Floor"].node_tree.nodes["Principled BSDF"]
    shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = 1.0, 0.05
    small_scene.camera.location, small_scene.camera.rotation_euler = (0.0, -5.0, 2.6), (1.2, 0.0, 0.0)
    result, reference = rtgi_and_cycles(small_scene)
    error, noise, energy = errors(result, reference, "direct glossy")
    assert error < 0.1 + noise and energy == pytest.approx(1, abs=0.05)
    wanted = reference.mean("picture")
    assert result.combined[..., :3].max() == pytest.approx(wanted.max(), rel=0.02)     # the panel itself, 8 W/(m2 sr)


def test_animation_follows_a_moving_panel(bpy_session, small_scene):
    from rtgi_addon import engine
    from rtgi_addon.passes.base import Transport

    bpy, panel = bpy_session, add_emitter(bpy_session, small_scene, "rectangle")
    small_scene.render.resolution_x, small_scene.render.resolution_y = SIZE
    bpy.ops.render.render()
    before = engine.last_result().transports[Transport.DIRECT_DIFFUSE].copy()
    panel.location.z -= 0.4
    bpy.context.view_layer.update()
    bpy.ops.render.render()
    after = engine.last_result().transports[Transport.DIRECT_DIFFUSE]
    assert after.mean() > 1.1 * before.mean()
    assert math.isfinite(float(after.sum()))
