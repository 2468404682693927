"""Direct light of every lamp against Cycles: the shapes, their units, their shadows and their highlights."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytestmark = pytest.mark.blender

SIZE = (64, 40)
SAMPLES = 64            # of each half; what noise that leaves is measured from the halves and allowed for

LAMPS = {
    "hard point": ("POINT", {"energy": 100.0, "shadow_soft_size": 0.0}),
    "round point": ("POINT", {"energy": 100.0, "shadow_soft_size": 0.3}),
    "sphere": ("POINT", {"energy": 100.0, "shadow_soft_size": 0.5, "use_soft_falloff": False}),
    "hard spot": ("SPOT", {"energy": 300.0, "shadow_soft_size": 0.0, "spot_size": 1.2, "spot_blend": 0.3}),
    "soft spot": ("SPOT", {"energy": 300.0, "shadow_soft_size": 0.2, "spot_size": 1.5, "spot_blend": 1.0}),
    "spherical spot": ("SPOT", {"energy": 300.0, "shadow_soft_size": 0.3, "spot_size": 1.3, "spot_blend": 0.2,
                                "use_soft_falloff": False}),
    "hard sun": ("SUN", {"energy": 3.0, "angle": 0.0}),
    "wide sun": ("SUN", {"energy": 3.0, "angle": math.radians(30)}),
    "bare sun": ("SUN", {"energy": 5.0, "angle": math.radians(60), "normalize": False}),
    "bare point": ("POINT", {"energy": 500.0, "shadow_soft_size": 0.2, "normalize": False}),
    "bare square": ("AREA", {"energy": 100.0, "shape": "SQUARE", "size": 0.6, "normalize": False}),
    "square": ("AREA", {"energy": 100.0, "shape": "SQUARE", "size": 0.8}),
    "rectangle": ("AREA", {"energy": 100.0, "shape": "RECTANGLE", "size": 1.6, "size_y": 0.2}),
    "disk": ("AREA", {"energy": 100.0, "shape": "DISK", "size": 1.0}),
    "ellipse": ("AREA", {"energy": 100.0, "shape": "ELLIPSE", "size": 1.4, "size_y": 0.4}),
    "narrow square": ("AREA", {"energy": 100.0, "shape": "SQUARE", "size": 1.0, "spread": math.radians(60)}),
    "narrow disk": ("AREA", {"energy": 100.0, "shape": "DISK", "size": 1.0, "spread": math.radians(90)}),
}
HARD = ("hard point", "hard spot", "hard sun")


def light_with(bpy, scene, name):
    """Replace the scene's lamp."""
    kind, settings = LAMPS[name]
    old = scene.objects["Spot"]
    lamp = bpy.data.lights.new("Lamp", kind)
    for key, value in settings.items():
        setattr(lamp, key, value)
    new = bpy.data.objects.new("Lamp", lamp)
    new.location, new.rotation_euler = (0.9, -1.2, 2.6), (0.4, 0.25, 0.0)
    scene.collection.objects.link(new)
    bpy.data.objects.remove(old)
    bpy.context.view_layer.update()


def rtgi_and_cycles(scene, roughness=None, index=1.5):
    """(our transports, the two halves of Cycles' reference, mask)."""
    import bpy

    from rtgi_addon import engine
    from rtgi_addon.compare.reference import render_reference

    for material in bpy.data.materials:
        shader = material.node_tree.nodes["Principled BSDF"]
        shader.inputs["Specular IOR Level"].default_value = 0.0 if roughness is None else 0.5
        shader.inputs["Roughness"].default_value, shader.inputs["IOR"].default_value = roughness or 1.0, index
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.rtgi.direct.soft_shadow_rays = 256
    reference = render_reference(scene, SAMPLES)
    bpy.ops.render.render()
    return engine.last_result().transports, reference


@pytest.mark.parametrize("name", LAMPS)
def test_diffuse_direct_light_is_that_of_cycles(bpy_session, small_scene, name):
    from rtgi_addon.passes.base import Transport

    light_with(bpy_session, small_scene, name)
    transports, reference = rtgi_and_cycles(small_scene)
    mask = reference.mask
    got = (transports[Transport.DIRECT_DIFFUSE] / np.pi * reference.albedo)[mask]
    a, b = (half[mask] for half in reference.halves("direct diffuse"))
    mean = (a + b) / 2
    noise = np.abs(a - b).sum() / 2 / mean.sum()
    assert np.abs(got - mean).sum() / mean.sum() <= (0.01 if name in HARD else 0.02) + noise
    # the noise of many pixels cancels in the sum
    assert got.sum() == pytest.approx(mean.sum(), rel=0.005)
    if name in HARD:
        close = np.abs(got - mean).max(-1) <= 0.01 * mean.max(-1) + 1e-3 * mean.mean()
        assert close.mean() >= 0.995


@pytest.mark.parametrize("roughness", [0.3, 0.6])
@pytest.mark.parametrize("name", ["round point", "hard sun", "square"])
def test_highlights_are_those_of_cycles(bpy_session, small_scene, name, roughness):
    from rtgi_addon.passes.base import Transport

    light_with(bpy_session, small_scene, name)
    transports, reference = rtgi_and_cycles(small_scene, roughness)
    a, b = (half[reference.mask] for half in reference.halves("direct glossy"))
    got, mean = transports[Transport.DIRECT_GLOSSY][reference.mask], (a + b) / 2
    noise = np.abs(a - b).sum() / 2 / mean.sum()
    assert np.abs(got - mean).sum() / mean.sum() <= 0.06 + noise
    assert got.sum() == pytest.approx(mean.sum(), rel=0.03)


@pytest.mark.parametrize("index", [1.33, 1.45, 1.7])
def test_highlights_of_other_indices_are_those_of_cycles(bpy_session, small_scene, index):
    from rtgi_addon.passes.base import Transport

    light_with(bpy_session, small_scene, "hard sun")
    transports, reference = rtgi_and_cycles(small_scene, 0.5, index)
    mean, got = reference.mean("direct glossy")[reference.mask], transports[Transport.DIRECT_GLOSSY][reference.mask]
    # Fresnel's rise is a fit to the index's own, 3 % off at 1.33; with that of index 1.5 this was up to 7 % off, with its
    # reflectance at normal incidence too by 8 to 40 %
    assert np.abs(got - mean).sum() / mean.sum() <= 0.04
    assert got.sum() == pytest.approx(mean.sum(), rel=0.04)


@pytest.mark.parametrize("shines", [False, True])
def test_light_passes_through_what_casts_no_shadow(bpy_session, small_scene, shines):
    """A cube around the lamp, as a bulb's glass is; one that shines does so beside the lamp."""
    from rtgi_addon.passes.base import Transport

    bpy = bpy_session
    light_with(bpy, small_scene, "round point")
    bpy.ops.mesh.primitive_cube_add(size=0.8, location=small_scene.objects["Lamp"].location)
    glass = bpy.context.object
    glass.visible_shadow = False
    material = bpy.data.materials["Floor"].copy()
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Emission Color"].default_value = (1.0, 0.5, 0.2, 1.0)
    shader.inputs["Emission Strength"].default_value = 2.0 if shines else 0.0
    glass.data.materials.append(material)
    bpy.context.view_layer.update()
    transports, reference = rtgi_and_cycles(small_scene)
    mask = reference.mask & (np.abs(reference.albedo - 0.8).max(-1) > 1e-3)      # the wall and the small cube
    got = transports[Transport.DIRECT_DIFFUSE] + transports.get(Transport.EMISSION_DIFFUSE, 0)
    got, mean = (got / np.pi * reference.albedo)[mask], reference.mean("direct diffuse")[mask]
    assert got.sum() == pytest.approx(mean.sum(), rel=0.03)
    assert np.abs(got - mean).sum() < 0.06 * mean.sum()


def sky_over(bpy, scene, kind):
    """A world with a sun in it for the scene in place of its lamp."""
    bpy.data.objects.remove(scene.objects["Spot"])
    world = bpy.data.worlds.new("Sky")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    scene.world, tree = world, world.node_tree
    background = tree.nodes["Background"]
    if kind == "sky":
        node = tree.nodes.new("ShaderNodeTexSky")
        kinds = [item.identifier for item in node.bl_rna.properties["sky_type"].enum_items]
        node.sky_type = "NISHITA" if "NISHITA" in kinds else "MULTIPLE_SCATTERING"
        node.sun_elevation, node.sun_rotation = 0.7, 2.6
        background.inputs["Strength"].default_value = 0.2
    else:
        node = tree.nodes.new("ShaderNodeTexEnvironment")
        image = bpy.data.images.new("Field", 256, 128, float_buffer=True)
        row, column = np.mgrid[0:128, 0:256]
        pixels = np.ones((128, 256, 4), np.float32)
        pixels[..., :3] = (0.2, 0.3, 0.5)
        pixels[np.hypot(row - 100.5, column - 40.5) < 2.4, :3] = (900, 800, 600)
        image.pixels.foreach_set(pixels.ravel())
        image.pack()
        node.image = image
    tree.links.new(node.outputs["Color"], background.inputs["Color"])
    bpy.context.view_layer.update()


@pytest.mark.parametrize("kind", ["sky", "environment"])
def test_a_sun_in_the_world_lights_and_shadows_as_in_cycles(bpy_session, small_scene, kind):
    from rtgi_addon import engine
    from rtgi_addon.passes.base import Transport

    sky_over(bpy_session, small_scene, kind)
    small_scene.rtgi.world.rays = 256
    transports, reference = rtgi_and_cycles(small_scene)
    assert list(engine.last_result().report["diagnostics"]["direct"]["asked_pixels"]) == ["sun of Sky"]
    mask = reference.mask
    got = ((transports[Transport.DIRECT_DIFFUSE] + transports[Transport.WORLD_DIFFUSE]) / np.pi * reference.albedo)[mask]
    a, b = (half[mask] for half in reference.halves("direct diffuse"))
    mean = (a + b) / 2
    noise = np.abs(a - b).sum() / 2 / mean.sum()
    # the sky's light is smoothed over its own lattice, and the sun is as the even disk of its light
    assert np.abs(got - mean).sum() / mean.sum() <= 0.03 + noise
    assert got.sum() == pytest.approx(mean.sum(), rel=0.01)
    if kind == "sky":
        sun = transports[Transport.DIRECT_DIFFUSE].mean(-1)
        floor = mask & (transports[Transport.WORLD_DIFFUSE].mean(-1) > 0)
        assert (sun[floor] == 0).any() and (sun[floor] > 0).any()           # shadows have an edge


@pytest.mark.parametrize(("cells", "lean", "is_lit"), [(1, 0.995, True), (32, 0.995, False), (1, 0.5, False)])
def test_sheet_whose_normals_lean_to_a_sun_behind_it_is_lit_as_in_cycles(bpy_session, small_scene, cells, lean, is_lit):
    """Rays lifted off one large triangle pass beside the sheet, off small ones they meet the next, as at less lean."""
    from rtgi_addon.compare.measure import part_of

    bpy = bpy_session
    for thing in [o for o in small_scene.objects if o.type in ("MESH", "LIGHT")]:
        bpy.data.objects.remove(thing)
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=cells, y_subdivisions=cells, size=6, location=(0.0, 0.0, 2.0),
                                    rotation=(math.pi, 0.0, 0.0))
    sheet = bpy.context.object
    bpy.ops.object.shade_smooth()
    sheet.data.materials.append(bpy.data.materials["Floor"])
    normal = (0.0, lean, math.sqrt(1 - lean * lean))         # of the sheet, which is turned over: leans towards -Y
    sheet.data.normals_split_custom_set([normal] * len(sheet.data.loops))
    lamp = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    lamp.data.angle, lamp.data.energy, lamp.rotation_euler = 0.0, 3.0, (0.93, 0.0, 0.0)        # shines down and along +Y
    small_scene.collection.objects.link(lamp)
    small_scene.camera.location, small_scene.camera.rotation_euler = (0.0, 0.0, -4.0), (math.pi, 0.0, 0.0)
    bpy.context.view_layer.update()
    transports, reference = rtgi_and_cycles(small_scene)
    got, wanted = (light[reference.mask] for light in (part_of(transports, "direct diffuse", reference.albedo),
                                                       reference.mean("direct diffuse")))
    assert (wanted.max() > 0) == is_lit
    # no noise: one direction, and the whole sheet alike
    np.testing.assert_allclose(got, wanted, rtol=1e-3, atol=1e-6)
