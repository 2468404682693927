"""The world's light as its nodes tell it, pictures of all directions in world axes, and what is not modelled."""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = pytest.mark.blender


@pytest.fixture
def bpy(bpy_session, empty_scene):
    return bpy_session


@pytest.fixture
def world(bpy):
    """A world of strength 1, its tree and its Background node."""
    world = bpy.data.worlds.new("Sky")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    bpy.context.scene.world = world
    return world


def read(bpy):
    from rtgi_addon.capture.world import read_world_constant
    return read_world_constant(bpy.context.evaluated_depsgraph_get())


def test_no_world_is_black(bpy):
    bpy.context.scene.world = None
    assert read(bpy).kind == "black"


def test_a_plain_background_is_constant(bpy, world):
    node = world.node_tree.nodes["Background"]
    node.inputs["Color"].default_value, node.inputs["Strength"].default_value = (0.1, 0.2, 0.3, 1), 2.0
    reading = read(bpy)
    assert reading.kind == "constant"
    np.testing.assert_allclose(reading.radiance, (0.2, 0.4, 0.6), rtol=1e-6)


def test_a_background_without_strength_is_black(bpy, world):
    node = world.node_tree.nodes["Background"]
    node.inputs["Strength"].default_value = 0.0
    reading = read(bpy)
    assert reading.kind == "black" and not reading.radiance.any()


def test_an_unconnected_world_is_black(bpy, world):
    world.node_tree.links.clear()
    assert read(bpy).kind == "black"


def test_two_added_backgrounds_add_up(bpy, world):
    tree, node = world.node_tree, world.node_tree.nodes["Background"]
    node.inputs["Color"].default_value = (1, 0, 0, 1)
    second, add = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeAddShader")
    second.inputs["Color"].default_value = (0, 0.5, 0, 1)
    tree.links.new(node.outputs[0], add.inputs[0])
    tree.links.new(second.outputs[0], add.inputs[1])
    tree.links.new(add.outputs[0], tree.nodes["World Output"].inputs["Surface"])
    np.testing.assert_allclose(read(bpy).radiance, (1, 0.5, 0), rtol=1e-6)


@pytest.mark.parametrize("kind", ["ShaderNodeTexSky", "ShaderNodeTexEnvironment", "ShaderNodeTexGradient"])
def test_a_textured_world_has_to_be_captured(bpy, world, kind):
    tree = world.node_tree
    tree.links.new(tree.nodes.new(kind).outputs["Color"], tree.nodes["Background"].inputs["Color"])
    assert read(bpy).kind == "map"


def test_a_world_that_asks_for_the_kind_of_ray_is_warned_of(bpy, world):
    tree = world.node_tree
    tree.links.new(tree.nodes.new("ShaderNodeLightPath").outputs[0], tree.nodes["Background"].inputs["Strength"])
    reading = read(bpy)
    assert reading.kind == "map"
    assert len(reading.warnings) == 1 and reading.warnings[0].startswith("world 'Sky': it differs by the kind of ray")


def test_a_volume_in_the_world_is_warned_of(bpy, world):
    tree = world.node_tree
    tree.links.new(tree.nodes.new("ShaderNodeVolumeScatter").outputs[0], tree.nodes["World Output"].inputs["Volume"])
    assert read(bpy).warnings == ("world 'Sky': its volume is left out",)


def directions(height, width):
    """(H, W, 3) world directions of the pixels of `core.frame.World`, from its own description."""
    latitude = np.pi / 2 - (np.arange(height) + 0.5) / height * np.pi
    longitude = (np.arange(width) + 0.5) / width * 2 * np.pi - np.pi
    latitude, longitude = np.meshgrid(latitude, longitude, indexing="ij")
    return np.stack([np.cos(latitude) * np.sin(longitude), np.cos(latitude) * np.cos(longitude), np.sin(latitude)], -1)


def test_a_view_along_plus_y_is_in_world_axes_already(bpy_session):
    from rtgi_addon.capture.views import full_sphere, world_axes
    from rtgi_addon.capture.world import in_world_axes
    picture = np.zeros((8, 16, 3), np.float32)
    assert in_world_axes(picture, full_sphere(16, 8, world_axes())) is picture


def test_a_turned_view_is_turned_back(bpy_session, rng):
    from rtgi_addon.capture.views import full_sphere
    from rtgi_addon.capture.world import in_world_axes
    turn = np.eye(4)
    turn[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn[:3, :3] *= np.sign(np.linalg.det(turn[:3, :3]))
    view = full_sphere(128, 64, turn)
    seen_ws = view.rays_vs()[1] @ turn[:3, :3].T
    # the picture shows each direction as its colour; looked up between pixels of 2.8 degrees it is off by their sagitta,
    # and by up to half a pixel at the poles, where there is no pixel beyond the last
    np.testing.assert_allclose(in_world_axes(seen_ws.astype(np.float32), view), directions(64, 128), atol=0.03)


def test_cycles_lays_out_all_directions_as_the_world_does(bpy, world, tmp_path):
    from mathutils import Matrix

    from rtgi_addon.capture.views import world_axes
    tree = world.node_tree
    # radiance is the direction, moved into the positive: 0.5 + 0.5 d
    half = tree.nodes.new("ShaderNodeVectorMath")
    half.operation = "MULTIPLY_ADD"
    half.inputs[1].default_value = half.inputs[2].default_value = (0.5, 0.5, 0.5)
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], half.inputs[0])
    tree.links.new(half.outputs[0], tree.nodes["Background"].inputs["Color"])
    scene, data = bpy.context.scene, bpy.data.cameras.new("Eye")
    scene.camera = bpy.data.objects.new("Eye", data)
    scene.collection.objects.link(scene.camera)
    scene.camera.matrix_world = Matrix(world_axes())
    data.type, data.panorama_type = "PANO", "EQUIRECTANGULAR"
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
    scene.cycles.pixel_filter_type = "BOX"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 32, 16, 100
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = str(tmp_path / "sphere.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    flat = np.empty(32 * 16 * 4, np.float32)
    image.pixels.foreach_get(flat)
    picture = flat.reshape(16, 32, 4)[::-1, :, :3]
    # one ray somewhere in each pixel of 11 degrees
    np.testing.assert_allclose(2 * picture - 1, directions(16, 32), atol=0.2)


def warnings(bpy):
    from rtgi_addon.capture.materials import read_materials
    from rtgi_addon.capture.unsupported import unsupported_warnings
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return unsupported_warnings(depsgraph, read_materials(depsgraph))


def add_lamp(bpy, kind="SPOT"):
    lamp = bpy.data.lights.new("Torch", kind)
    thing = bpy.data.objects.new("Torch Object", lamp)
    bpy.context.scene.collection.objects.link(thing)
    return thing, lamp


def test_a_plain_scene_has_no_warnings(bpy, world):
    add_lamp(bpy)
    bpy.ops.mesh.primitive_cube_add()
    assert warnings(bpy) == ()


def test_light_linking_is_warned_of_with_the_objects_name(bpy):
    thing, _ = add_lamp(bpy)
    thing.light_linking.receiver_collection = bpy.data.collections.new("Only these")
    assert warnings(bpy) == ("object 'Torch Object': light linking is ignored; it acts on everything",)


def test_a_shadow_catcher_is_warned_of(bpy):
    bpy.ops.mesh.primitive_plane_add()
    bpy.context.object.is_shadow_catcher = True
    assert warnings(bpy) == ("object 'Plane': it catches no shadows; it is drawn as any other surface",)


def test_a_world_that_some_rays_do_not_see_is_warned_of(bpy, world):
    from rtgi_addon.capture.world import read_world_constant

    bpy.context.scene.world.cycles_visibility.glossy = False
    reading = read_world_constant(bpy.context.evaluated_depsgraph_get())
    assert reading.warnings == ("world 'Sky': its ray visibility is ignored; glossy rays see it",)


def test_an_ies_lamp_is_warned_of(bpy):
    _, lamp = add_lamp(bpy)
    if bpy.app.version < (5, 0, 0):
        lamp.use_nodes = True
    tree = lamp.node_tree
    tree.links.new(tree.nodes.new("ShaderNodeTexIES").outputs[0], tree.nodes["Emission"].inputs["Strength"])
    assert warnings(bpy) == ("light 'Torch': its IES profile is ignored; it shines evenly",)


def test_hair_is_warned_of(bpy):
    bpy.ops.mesh.primitive_plane_add()
    plane = bpy.context.object
    plane.modifiers.new("Fur", "PARTICLE_SYSTEM")
    plane.particle_systems[0].settings.type = "HAIR"
    found = warnings(bpy)
    assert len(found) == 1 and found[0].startswith("object 'Plane': the hair of particle system")


def test_motion_blur_and_depth_of_field_are_warned_of(bpy):
    scene, data = bpy.context.scene, bpy.data.cameras.new("Eye")
    scene.camera = bpy.data.objects.new("Eye Object", data)
    scene.collection.objects.link(scene.camera)
    scene.render.use_motion_blur = data.dof.use_dof = True
    lines = warnings(bpy)
    assert [line.split(":")[0] for line in lines] == ["camera 'Eye Object'", "scene 'Scene'"]


def test_one_material_on_many_objects_warns_once(bpy):
    material = bpy.data.materials.new("Window")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Transmission Weight"].default_value = 1.0
    for k in range(3):
        bpy.ops.mesh.primitive_plane_add(location=(k, 0, 0))
        bpy.context.object.data.materials.append(material)
    assert len(warnings(bpy)) == 1


def test_the_world_shows_through_a_veil_by_what_it_lets_through(bpy_session, small_scene):
    """A pane of alpha 0.3 before an even sky: 0.7 of the sky, in the mean and without the grain of Cycles' one sample."""
    from rtgi_addon import engine

    bpy = bpy_session
    for name in ("Wall", "Cube", "Floor", "Spot"):
        bpy.data.objects.remove(small_scene.objects[name])
    world = bpy.data.worlds.new("Sky")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (0.5, 1.0, 2.0, 1.0)
    small_scene.world = world
    bpy.ops.mesh.primitive_plane_add(size=3.0, location=(0.0, 0.0, 2.0), rotation=(np.pi / 2, 0.0, 0.0))
    material = bpy.data.materials.new("Pane")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Alpha"].default_value, shader.inputs["Base Color"].default_value = 0.3, (0.0, 0.0, 0.0, 1.0)
    shader.inputs["Specular IOR Level"].default_value = 0.0
    bpy.context.object.data.materials.append(material)
    bpy.context.view_layer.update()
    bpy.ops.render.render()
    result = engine.last_result()
    sky = np.array([0.5, 1.0, 2.0])
    share = result.combined[..., :3] / sky
    pane = share[..., 0] < 0.95
    assert 0.1 < pane.mean() < 0.6
    inner = pane.copy()
    for axis in (0, 1):
        for step in (-2, -1, 1, 2):
            inner &= np.roll(pane, step, axis)
    # 25 samples of which 7 in 10 get through are off by 0.09, all together by less than 0.02
    assert abs(share[inner].mean() - 0.7) < 0.02 and share[inner].std() < 0.12
    assert np.allclose(share[~pane & (share[..., 0] > 0.99)], 1, atol=1e-3)
