"""Materials that let light straight through: what is read of them, and their shadows against Cycles."""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = pytest.mark.blender

SIZE = (64, 36)
SAMPLES = 64            # of each half; what noise that leaves is measured from the halves and allowed for


@pytest.fixture
def bpy(bpy_session, empty_scene):
    return bpy_session


@pytest.fixture
def read(bpy):
    """Reads the current scene's triangles; the same cache serves all reads of a test."""
    from rtgi_addon.capture.geometry import GeometryCache, read_geometry
    from rtgi_addon.capture.materials import read_materials
    cache = GeometryCache()

    def read_scene():
        depsgraph = bpy.context.evaluated_depsgraph_get()
        return read_geometry(depsgraph, read_materials(depsgraph, cache.materials), np.zeros(3), cache)

    return read_scene


def checker_image(bpy, cells=4, block_px=16, name="Checker"):
    """White, its alpha a checkerboard whose lower left square is there."""
    odd = np.add.outer(np.arange(cells), np.arange(cells)) % 2
    pixels = np.ones((cells * block_px, cells * block_px, 4), np.float32)
    pixels[..., 3] = np.kron(1 - odd, np.ones((block_px, block_px)))
    image = bpy.data.images.new(name, cells * block_px, cells * block_px, alpha=True)
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    return image


def card(bpy, uv=((0, 0), (1, 0), (1, 1), (0, 1)), size=1.0, height=1.5, name="Card"):
    """A square in the air with texture coordinates; gives the object and its tree."""
    mesh = bpy.data.meshes.new(name)
    h = size / 2
    mesh.from_pydata([(-h, -h, height), (h, -h, height), (h, h, height), (-h, h, height)], [], [(0, 1, 2, 3)])
    layer = mesh.uv_layers.new(name="UVMap")
    for corner, place in zip(layer.data, uv, strict=True):
        corner.uv = place
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    mesh.materials.append(material)
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(thing)
    return thing, material.node_tree


def add_image(bpy, tree, **settings):
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = checker_image(bpy)
    for name, value in settings.items():
        setattr(node, name, value)
    return node


def principled_alpha(bpy, tree):
    tree.links.new(add_image(bpy, tree).outputs["Alpha"], tree.nodes["Principled BSDF"].inputs["Alpha"])


def transparent_mix(bpy, tree):
    """Transparent where the image's alpha is 0."""
    mix, clear = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTransparent")
    tree.links.new(add_image(bpy, tree).outputs["Alpha"], mix.inputs["Fac"])
    tree.links.new(clear.outputs[0], mix.inputs[1])
    tree.links.new(tree.nodes["Principled BSDF"].outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.nodes["Material Output"].inputs["Surface"])


def even_alpha(bpy, tree):
    tree.nodes["Principled BSDF"].inputs["Alpha"].default_value = 0.3


def dark_glass(bpy, tree):
    tree.nodes["Principled BSDF"].inputs["Alpha"].default_value = 0.7


def even_mix(bpy, tree):
    mix, clear = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTransparent")
    mix.inputs["Fac"].default_value = 0.3
    tree.links.new(clear.outputs[0], mix.inputs[1])
    tree.links.new(tree.nodes["Principled BSDF"].outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.nodes["Material Output"].inputs["Surface"])


def clear_for_shadows(bpy, tree):
    """A pane that only shadow rays pass: the usual way to light a room through glass."""
    mix, clear = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTransparent")
    tree.links.new(tree.nodes.new("ShaderNodeLightPath").outputs["Is Shadow Ray"], mix.inputs["Fac"])
    tree.links.new(tree.nodes["Principled BSDF"].outputs[0], mix.inputs[1])
    tree.links.new(clear.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], tree.nodes["Material Output"].inputs["Surface"])


def opacity_at(geometry, x, y):
    """Opacity where a line straight down at (x, y) meets the geometry's cards, by the oracle's lookup."""
    from tests.oracle import cutouts_oracle

    meetings = cutouts_oracle.meetings(np.array([x, y, 10.0]), np.array([0, 0, -20.0]), geometry.corners_ws)
    return [cutouts_oracle.opacity(geometry.cutouts, k, u, v) for _, k, u, v in meetings]


def test_opaque_scenes_have_no_cutouts(bpy, read):
    _, tree = card(bpy)
    node = add_image(bpy, tree)
    tree.links.new(node.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    assert read().cutouts is None


@pytest.mark.parametrize("make", [principled_alpha, transparent_mix])
def test_an_alpha_image_is_looked_up_at_the_texture_coordinates(bpy, read, make):
    _, tree = card(bpy)
    make(bpy, tree)
    geometry = read()
    assert (geometry.cutouts.row >= 0).all()
    # the middles of the 4 x 4 squares of the checker, a little off the diagonal; the card reaches from -0.5 to 0.5
    for i in range(4):
        for j in range(4):
            expected = 1 - (i + j) % 2
            assert opacity_at(geometry, (j + 0.5) / 4 - 0.5, (i + 0.55) / 4 - 0.5) == [pytest.approx(expected, abs=1e-3)]
    tree.nodes["Principled BSDF"].inputs["Specular IOR Level"].default_value = 0.0
    # what is there of the card has the albedo of its material
    geometry = read()
    np.testing.assert_allclose(geometry.albedo.mean((1, 2)) / geometry.cutouts.coverage, 0.8, rtol=1e-3)


@pytest.mark.parametrize("make", [even_alpha, even_mix])
def test_an_even_alpha_is_one_texel(bpy, read, make):
    _, tree = card(bpy)
    make(bpy, tree)
    cutouts = read().cutouts
    assert cutouts.texels / 255 == pytest.approx(0.3, abs=1 / 255) and cutouts.place.tolist() == [[0, 1, 1]] * 2
    np.testing.assert_allclose(cutouts.coverage, 0.3, atol=1e-6)


def test_repeated_maps_are_stored_once_for_all_meshes(bpy, read):
    _, tree = card(bpy, uv=((0, 0), (7, 0), (7, 7), (0, 7)))
    principled_alpha(bpy, tree)
    other, _ = card(bpy, uv=((-3, 2), (1, 2), (1, 5), (-3, 5)), height=2.5, name="Other")
    other.data.materials[0] = bpy.data.materials["Card"]
    geometry = read()
    assert len(geometry.cutouts.texels) == 64 * 64 and len(geometry.cutouts.uv) == 4
    # on the first card one square is 1/28 wide; on the other, 1/16 by 1/12, and its lower left is there too
    assert opacity_at(geometry, 0.5 / 28 - 0.5, 0.6 / 28 - 0.5) == pytest.approx([1, 1], abs=1e-3)
    assert opacity_at(geometry, 1.5 / 28 - 0.5, 0.6 / 28 - 0.5) == pytest.approx([1, 0], abs=1e-3)


def test_a_map_that_does_not_repeat_covers_what_the_mesh_uses(bpy, read):
    _, tree = card(bpy, uv=((-1, -1), (2, -1), (2, 2), (-1, 2)))
    node = add_image(bpy, tree, extension="CLIP")
    tree.links.new(node.outputs["Alpha"], tree.nodes["Principled BSDF"].inputs["Alpha"])
    geometry = read()
    # only the middle third of the card shows the image; nothing is there around it
    assert opacity_at(geometry, -0.3, 0.1) == opacity_at(geometry, 0.4, -0.45) == [pytest.approx(0, abs=1e-6)]
    assert opacity_at(geometry, -1 / 6 + 1 / 24, -1 / 6 + 1.1 / 24) == [pytest.approx(1, abs=1e-3)]
    assert opacity_at(geometry, -1 / 6 + 3 / 24, -1 / 6 + 1 / 24) == [pytest.approx(0, abs=1e-3)]


def test_a_threshold_cuts_the_image(bpy, read):
    _, tree = card(bpy)
    image = bpy.data.images.new("Ramp", 64, 4, alpha=True)
    pixels = np.ones((4, 64, 4), np.float32)
    pixels[..., 3] = (np.arange(64) + 0.5) / 64
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    node, less = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeMath")
    node.image, node.extension, less.operation = image, "EXTEND", "GREATER_THAN"
    less.inputs[1].default_value = 0.25
    tree.links.new(node.outputs["Alpha"], less.inputs[0])
    tree.links.new(less.outputs[0], tree.nodes["Principled BSDF"].inputs["Alpha"])
    geometry = read()
    assert opacity_at(geometry, -0.28, 0.1) == [0] and opacity_at(geometry, -0.22, 0.1) == [1]


def test_an_alpha_from_an_attribute_is_a_mean_for_each_triangle(bpy, read):
    thing, tree = card(bpy)
    colours = thing.data.color_attributes.new("Tint", "FLOAT_COLOR", "POINT")
    for k, alpha in enumerate((0.2, 0.2, 0.8, 0.8)):
        colours.data[k].color = (1, 1, 1, alpha)
    node = tree.nodes.new("ShaderNodeVertexColor")
    node.layer_name = "Tint"
    tree.links.new(node.outputs["Alpha"], tree.nodes["Principled BSDF"].inputs["Alpha"])
    cutouts = read().cutouts
    mean = cutouts.texels[cutouts.place[:, 0]] / 255
    np.testing.assert_allclose(np.sort(mean), [0.4, 0.6], atol=0.01)


def test_a_light_path_node_tells_shadow_rays_the_truth(bpy, read):
    _, tree = card(bpy)
    clear_for_shadows(bpy, tree)
    geometry = read()
    assert len(geometry) == 2 and geometry.cutouts.texels.tolist() == [0]
    # whatever bounces sees the pane whole
    np.testing.assert_allclose(geometry.cutouts.coverage, 1)


def test_a_material_without_transparent_shadows_is_opaque(bpy, read):
    thing, tree = card(bpy)
    even_alpha(bpy, tree)
    thing.data.materials[0].use_transparent_shadow = False
    assert read().cutouts is None


def test_an_unchanged_scene_gives_the_same_cutouts(bpy, read):
    _, tree = card(bpy)
    principled_alpha(bpy, tree)
    first = read()
    assert read().cutouts is first.cutouts


def test_a_changed_alpha_is_noticed(bpy, read):
    _, tree = card(bpy)
    even_alpha(bpy, tree)
    read()
    tree.nodes["Principled BSDF"].inputs["Alpha"].default_value = 0.6
    assert read().cutouts.texels / 255 == pytest.approx(0.6, abs=1 / 255)


def test_only_the_triangles_of_a_see_through_material_have_rows(bpy, read):
    card(bpy, name="Solid")
    _, tree = card(bpy, height=2.0)
    even_alpha(bpy, tree)
    geometry = read()
    there = geometry.cutouts.row >= 0
    np.testing.assert_array_equal(there, np.isclose(geometry.corners_ws[:, 0, 2], 2.0))
    np.testing.assert_allclose(geometry.coverage(np.arange(4)), np.where(there, 0.3, 1), atol=1e-6)


LAMPS = {
    "hard spot": ("SPOT", {"energy": 300.0, "shadow_soft_size": 0.0, "spot_size": 1.2}),
    "soft point": ("POINT", {"energy": 100.0, "shadow_soft_size": 0.15}),
    "hard sun": ("SUN", {"energy": 3.0, "angle": 0.0}),
    "square": ("AREA", {"energy": 100.0, "shape": "SQUARE", "size": 0.5}),
}


def scene_with_card(bpy, scene, make, lamp):
    """The small scene with a card over the floor where `lamp` shines through it."""
    kind, settings = LAMPS[lamp]
    for thing in ("Spot", "Cube"):
        bpy.data.objects.remove(scene.objects[thing])
    data = bpy.data.lights.new("Lamp", kind)
    for key, value in settings.items():
        setattr(data, key, value)
    new = bpy.data.objects.new("Lamp", data)
    new.location = (0.0, -0.3, 4.0)
    scene.collection.objects.link(new)
    _, tree = card(bpy, size=1.4)
    make(bpy, tree)
    for material in bpy.data.materials:
        material.node_tree.nodes["Principled BSDF"].inputs["Specular IOR Level"].default_value = 0.0
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.rtgi.direct.soft_shadow_rays = 256
    bpy.context.view_layer.update()


def floor_light(bpy, scene, part):
    """(ours, the two halves of Cycles) on the pixels of the floor, W/(m2 sr)."""
    from rtgi_addon import engine
    from rtgi_addon.compare.measure import part_of
    from rtgi_addon.compare.reference import render_reference

    reference = render_reference(scene, SAMPLES)
    frames = []
    capture = engine.RTGIEngine._capture
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine.RTGIEngine, "_capture", lambda self, *args: frames.append(capture(self, *args)) or frames[-1])
        bpy.ops.render.render()
    frame = frames[0][0]
    # pixels that the card covers show a mixture, which is another matter
    floor = frame.gbuffer.mask & (np.abs(frame.gbuffer.position_ws[..., 2]) < 1e-3) & (
        np.abs(frame.gbuffer.albedo - 0.8).max(-1) < 1e-3)
    ours = part_of(engine.last_result().transports, part, reference.albedo)
    return ours[floor], *(half[floor] for half in reference.halves(part))


@pytest.mark.parametrize("lamp", LAMPS)
@pytest.mark.parametrize("make", [principled_alpha, transparent_mix, even_alpha, dark_glass, clear_for_shadows])
def test_shadows_of_cards_are_those_of_cycles(bpy_session, small_scene, make, lamp):
    scene_with_card(bpy_session, small_scene, make, lamp)
    got, a, b = floor_light(bpy_session, small_scene, "direct diffuse")
    mean = (a + b) / 2
    noise = np.abs(a - b).sum() / 2 / mean.sum()
    assert len(got) > 500
    assert np.abs(got - mean).sum() / mean.sum() <= 0.02 + noise
    assert got.sum() == pytest.approx(mean.sum(), rel=0.01)


def test_a_ray_passes_as_many_layers_as_in_cycles(bpy_session, small_scene):
    scene_with_card(bpy_session, small_scene, lambda bpy, tree: None, "hard sun")
    card_object = small_scene.objects["Card"]
    card_object.data.materials[0].node_tree.nodes["Principled BSDF"].inputs["Alpha"].default_value = 0.1
    card_object.rotation_euler.z = 0.3          # else rays meet the diagonal, where two triangles are one layer
    small_scene.cycles.transparent_max_bounces = 3
    for k in range(4):
        if k:
            layer = bpy_session.data.objects.new("Layer", card_object.data)
            layer.rotation_euler.z, layer.location.z = 0.3, 0.1 * k
            small_scene.collection.objects.link(layer)
        got, a, _ = floor_light(bpy_session, small_scene, "direct diffuse")
        # along the edge of the shadow Cycles' samples lie on both sides of it
        assert (np.abs(got - a) <= 0.01 * a).mean() > 0.99
    # the fourth is one too many
    assert (got == 0).any() and got.max() > 0.7
