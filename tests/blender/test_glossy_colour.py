"""Cycles' Glossy Color turned into what surfaces reflect: balls against Cycles, from the middle to the grazing rim."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytestmark = pytest.mark.blender

PX = 96


def balls(bpy, scene, roughness, metallic, light):
    """A ball of lobes that keep their energy and one of lobes that don't, seen from above; both in sight of all light."""
    for number, distribution in enumerate(("GGX", "MULTI_GGX")):
        bpy.ops.mesh.primitive_uv_sphere_add(segments=128, ring_count=64, location=(2.5 * number, 0, 0))
        ball = bpy.context.object
        ball.data.polygons.foreach_set("use_smooth", np.ones(len(ball.data.polygons), np.bool_))
        material = bpy.data.materials.new(distribution)
        material.use_nodes = True
        shader = material.node_tree.nodes["Principled BSDF"]
        shader.distribution = distribution
        shader.inputs["Base Color"].default_value = (0.7, 0.5, 0.3, 1) if metallic else (0, 0, 0, 1)
        shader.inputs["Metallic"].default_value, shader.inputs["Roughness"].default_value = metallic, roughness
        ball.data.materials.append(material)
    camera = bpy.data.cameras.new("Camera")
    camera.type, camera.ortho_scale = "ORTHO", 4.5
    scene.camera = bpy.data.objects.new("Camera", camera)
    scene.camera.location = (1.25, 0, 10)
    scene.collection.objects.link(scene.camera)
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = float(light == "sky")
    if light != "sky":
        sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
        sun.data.energy, sun.data.angle = 3.0, 0.0
        # it stands to the side of the row, so that neither ball shades the other
        sun.rotation_euler = (math.radians({"sun beside the camera": 20, "low sun": 75}[light]), 0, 0)
        scene.collection.objects.link(sun)
    scene.render.engine = "RTGI"
    scene.render.resolution_x, scene.render.resolution_y = 2 * PX, PX
    scene.rtgi.ssr.samples = 64


@pytest.mark.parametrize("light", ["sun beside the camera", "low sun", "sky"])
@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("roughness", [0.5, 0.8])
def test_both_kinds_of_lobes_reflect_in_one_frame_what_cycles_says(bpy_session, empty_scene, roughness, metallic, light):
    import bpy

    from rtgi_addon import engine
    from rtgi_addon.compare.reference import render_reference
    from rtgi_addon.passes.base import Transport

    balls(bpy, empty_scene, roughness, metallic, light)
    reference = render_reference(empty_scene, 64 if light == "sky" else 16)
    bpy.ops.render.render()
    transports = engine.last_result().transports
    got = transports[Transport.WORLD_GLOSSY if light == "sky" else Transport.DIRECT_GLOSSY]
    expected = reference.mean("direct glossy")
    # cosine of view and normal at each pixel, of the ball that it shows
    y, x = (np.mgrid[0:PX, 0:2 * PX] + 0.5 - np.array([PX / 2, PX])[:, None, None]) * 4.5 / (2 * PX)
    for number in range(2):
        r2 = (x - 2.5 * number + 1.25) ** 2 + y**2
        for nearest, farthest in ((0.0, 0.5), (0.5, 0.8), (0.8, 0.95)):
            ring = reference.mask & (r2 >= nearest**2) & (r2 < farthest**2)
            if expected[ring].sum() < 0.02 * expected.sum():        # hardly lit
                continue
            # the rise of metals has the shape of a dielectric's, 2 %; the colour of a lobe of single scattering would be
            # 15 to 75 % off, Glossy Color as it comes up to 5
            assert got[ring].sum() == pytest.approx(expected[ring].sum(), rel=0.025 if metallic else 0.015)
