"""Materials of the evaluated scene: constants, means of textures, closures, warnings, numbers."""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = pytest.mark.blender


@pytest.fixture
def bpy(bpy_session, empty_scene):
    return bpy_session


@pytest.fixture
def shown(bpy):
    """A new material named "Paint" on a plane; gives the material, its Principled node and a link function."""

    class Shown:
        def __init__(self):
            bpy.ops.mesh.primitive_plane_add()
            self.material = bpy.data.materials.new("Paint")
            if bpy.app.version < (5, 0, 0):
                self.material.use_nodes = True
            bpy.context.object.data.materials.append(self.material)
            self.tree = self.material.node_tree
            self.principled = self.tree.nodes["Principled BSDF"]
            self.output = self.tree.nodes["Material Output"]

        def set(self, **values):
            for name, value in values.items():
                self.principled.inputs[name.replace("_", " ")].default_value = value

        def add(self, kind, **inputs):
            node = self.tree.nodes.new(kind)
            for name, value in inputs.items():
                node.inputs[name].default_value = value
            return node

        def link(self, source, target):
            self.tree.links.new(source, target)

        def surface(self, node):
            self.link(node.outputs[0], self.output.inputs["Surface"])

        def read(self):
            from rtgi_addon.capture.materials import read_materials
            table = read_materials(bpy.context.evaluated_depsgraph_get())
            return next(m for m in table.materials if m.name == "Paint"), table

    return Shown()


def textured(shown, image, target="Base Color"):
    node = shown.add("ShaderNodeTexImage")
    node.image = image
    shown.link(node.outputs["Color"], shown.principled.inputs[target])
    return node


def halves(left, right):
    """(8, 8, 4): the left columns hold `left`, the right ones `right`."""
    pixels = np.ones((8, 8, 4), np.float32)
    pixels[:, :4, :3], pixels[:, 4:, :3] = left, right
    return pixels


def test_a_scene_without_materials_has_the_default_one(bpy):
    from rtgi_addon.capture.materials import read_materials
    bpy.ops.mesh.primitive_plane_add()
    table = read_materials(bpy.context.evaluated_depsgraph_get())
    assert [m.albedo for m in table.materials] == [pytest.approx((0.8, 0.8, 0.8))]


def test_a_rough_principled_without_specular_shows_its_base_colour(shown):
    shown.set(Base_Color=(0.2, 0.4, 0.6, 1), Specular_IOR_Level=0.0)
    material, table = shown.read()
    assert material.albedo == pytest.approx((0.2, 0.4, 0.6), abs=1e-6)
    assert max(material.specular) == 0 and not table.has_glossy


def test_the_specular_layer_takes_what_it_reflects_from_a_white_base(shown):
    shown.set(Base_Color=(1, 1, 1, 1), Roughness=0.5)
    material, table = shown.read()
    # Cycles gives 0.0587 for IOR 1.5 at roughness 0.5, as the mean over a sphere; the fit is within 0.0005
    assert 1 - material.albedo[0] == pytest.approx(0.0587, abs=6e-4)
    assert material.specular[0] + material.albedo[0] == pytest.approx(1, abs=1e-6)
    assert table.has_glossy


def test_a_metal_reflects_nothing_diffusely(shown):
    shown.set(Base_Color=(0.9, 0.6, 0.3, 1), Metallic=1.0, Roughness=0.2)
    material, _ = shown.read()
    assert material.albedo == (0, 0, 0)
    assert material.specular == pytest.approx((0.9, 0.6, 0.3), abs=1e-6)
    assert material.roughness == pytest.approx(0.2, abs=1e-6)


@pytest.mark.parametrize(("settings", "f0"), [
    ({"IOR": 1.5}, 0.04), ({"IOR": 1.45}, (0.45 / 2.45) ** 2), ({"IOR": 1.5, "Specular_IOR_Level": 0.2}, 0.016),
    ({"IOR": 1.5, "Metallic": 0.5}, 0.0), ({"IOR": 1.5, "Coat_Weight": 1.0, "Coat_IOR": 1.5}, 0.04)])
def test_reflectance_at_normal_incidence_is_that_of_the_index_and_unknown_of_metals(shown, settings, f0):
    shown.set(**settings)
    material, table = shown.read()
    assert material.f0 == pytest.approx(f0, rel=1e-4) == table.f0[1]


def test_a_plain_glossy_node_reflects_alike_from_all_sides(shown):
    node = shown.add("ShaderNodeBsdfGlossy")
    shown.link(node.outputs[0], shown.output.inputs["Surface"])
    assert shown.read()[0].f0 == pytest.approx(1.0)


@pytest.mark.parametrize(("settings", "asks"), [({}, False), ({"IOR": 1.33}, True), ({"Specular_IOR_Level": 0.1}, True),
                                                ({"IOR": 1.33, "Metallic": 1.0}, False), ({"Alpha": 0.9}, True)])
def test_materials_are_numbered_only_where_one_is_no_common_dielectric_or_lets_light_through(bpy, shown, settings, asks):
    from rtgi_addon.capture.needs import read_needs
    from rtgi_addon.capture.versions import HAS_ROUGHNESS_PASS

    shown.set(IOR=1.5)
    shown.set(**settings)
    assert read_needs(bpy.context.scene).material_index == (asks or not HAS_ROUGHNESS_PASS)


def test_emission_is_colour_times_strength(shown):
    shown.set(Emission_Color=(1, 0.5, 0.25, 1), Emission_Strength=8.0)
    material, table = shown.read()
    assert material.emission == pytest.approx((8, 4, 2))
    assert table.has_emission


def test_an_srgb_image_is_averaged_after_decoding(shown, make_image):
    shown.set(Specular_IOR_Level=0.0)
    textured(shown, make_image(halves(0.0, 0.5)))
    material, _ = shown.read()
    # byte 128 decodes to 0.2159; its mean with black is half of that
    assert material.albedo[0] == pytest.approx(0.2159 / 2, abs=2e-3)


def test_a_data_image_is_averaged_as_stored(shown, make_image):
    shown.set(Specular_IOR_Level=0.0)
    textured(shown, make_image(halves(0.0, 0.5), is_data=True))
    material, _ = shown.read()
    assert material.albedo[0] == pytest.approx(0.251, abs=2e-3)  # byte 128 of 255, halved; the mean is by 576 points


def test_a_float_image_is_linear_as_stored(shown, make_image):
    textured(shown, make_image(halves(3.0, 3.0), is_float=True), "Emission Color")
    shown.set(Emission_Strength=2.0)
    material, _ = shown.read()
    assert material.emission == pytest.approx((6, 6, 6), rel=1e-5)


def test_an_image_without_pixels_leaves_the_typed_in_colour(bpy, shown):
    image = bpy.data.images.new("Gone", 4, 4)
    image.source, image.filepath = "FILE", "//nowhere.png"
    shown.set(Base_Color=(0.3, 0.3, 0.3, 1), Specular_IOR_Level=0.0)
    textured(shown, image)
    material, _ = shown.read()
    assert material.albedo == pytest.approx((0.3, 0.3, 0.3), abs=1e-6)


def test_a_threshold_comes_before_the_mean_over_texels(shown, make_image):
    node = textured(shown, make_image(halves(0.4, 0.6), is_data=True))
    above = shown.add("ShaderNodeMath")
    above.operation = "GREATER_THAN"
    above.inputs[1].default_value = 0.5
    shown.link(node.outputs["Color"], above.inputs[0])
    shown.link(above.outputs[0], shown.principled.inputs["Alpha"])
    material, _ = shown.read()
    assert material.alpha == pytest.approx(0.5, abs=0.02)  # half of the texels, by 576 points


def test_changed_pixels_are_read_again(bpy, shown, make_image):
    from rtgi_addon.capture.materials import MaterialCache, read_materials
    shown.set(Specular_IOR_Level=0.0)
    image = make_image(halves(0.0, 0.0), is_data=True)
    textured(shown, image)
    cache = MaterialCache()
    read_materials(bpy.context.evaluated_depsgraph_get(), cache)
    image.pixels.foreach_set(halves(1.0, 1.0).ravel())
    image.update()
    table = read_materials(bpy.context.evaluated_depsgraph_get(), cache)
    assert table.materials[1].albedo == pytest.approx((1, 1, 1), abs=1e-5)


def test_multiplied_colours_multiply(shown):
    mix = shown.add("ShaderNodeMix")
    mix.data_type, mix.blend_type = "RGBA", "MULTIPLY"
    inputs = {socket.identifier: socket for socket in mix.inputs}
    inputs["Factor_Float"].default_value = 1.0
    inputs["A_Color"].default_value, inputs["B_Color"].default_value = (0.5, 0.5, 1, 1), (0.5, 1, 0.25, 1)
    shown.link(next(s for s in mix.outputs if s.identifier == "Result_Color"), shown.principled.inputs["Base Color"])
    shown.set(Specular_IOR_Level=0.0)
    material, _ = shown.read()
    assert material.albedo == pytest.approx((0.25, 0.5, 0.25), abs=1e-6)


def test_mixed_shaders_mix_by_their_factor(shown):
    mix = shown.add("ShaderNodeMixShader")
    mix.inputs[0].default_value = 0.25
    red = shown.add("ShaderNodeBsdfDiffuse", Color=(0.8, 0, 0, 1))
    mirror = shown.add("ShaderNodeBsdfAnisotropic", Color=(0.4, 0.4, 0.4, 1), Roughness=0.1)
    shown.link(red.outputs[0], mix.inputs[1])
    shown.link(mirror.outputs[0], mix.inputs[2])
    shown.surface(mix)
    material, _ = shown.read()
    assert material.albedo == pytest.approx((0.6, 0, 0), abs=1e-6)
    assert material.specular == pytest.approx((0.1, 0.1, 0.1), abs=1e-6)
    assert material.roughness == pytest.approx(0.1, abs=1e-6)


def test_a_node_group_is_read_through_its_sockets(bpy, shown):
    group = bpy.data.node_groups.new("Half", "ShaderNodeTree")
    group.interface.new_socket("In", in_out="INPUT", socket_type="NodeSocketColor")
    group.interface.new_socket("Out", in_out="OUTPUT", socket_type="NodeSocketColor")
    start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    gamma = group.nodes.new("ShaderNodeGamma")
    gamma.inputs["Gamma"].default_value = 2.0
    group.links.new(start.outputs[0], gamma.inputs["Color"])
    group.links.new(gamma.outputs[0], end.inputs[0])
    node = shown.add("ShaderNodeGroup")
    node.node_tree = group
    node.inputs[0].default_value = (0.5, 0.5, 0.5, 1)
    shown.link(node.outputs[0], shown.principled.inputs["Base Color"])
    shown.set(Specular_IOR_Level=0.0)
    material, _ = shown.read()
    assert material.albedo == pytest.approx((0.25, 0.25, 0.25), abs=1e-6)


def test_an_unconnected_output_is_black(shown):
    shown.tree.links.clear()
    material, _ = shown.read()
    assert material.albedo == (0, 0, 0) and material.alpha == 1


def test_a_material_that_no_object_shows_is_not_listed(bpy, shown):
    bpy.data.materials.new("Elsewhere").use_fake_user = True
    _, table = shown.read()
    assert [m.name for m in table.materials] == ["(no material)", "Paint"]


def test_refraction_is_warned_of_with_the_materials_name(shown):
    shown.surface(shown.add("ShaderNodeBsdfGlass"))
    _, table = shown.read()
    assert len(table.warnings) == 1 and table.warnings[0].startswith("material 'Paint': light is not refracted")


@pytest.mark.parametrize("what", ["Subsurface", "Sheen"])
def test_what_is_taken_as_matt_is_warned_of_only_when_it_has_weight(shown, what):
    _, without = shown.read()
    shown.set(**{f"{what}_Weight": 0.5})
    _, table = shown.read()
    assert without.warnings == () and len(table.warnings) == 1 and what.lower() in table.warnings[0]


def test_a_volume_is_warned_of(shown):
    volume = shown.add("ShaderNodeVolumeScatter")
    shown.link(volume.outputs[0], shown.output.inputs["Volume"])
    _, table = shown.read()
    assert table.warnings == ("material 'Paint': its volume is left out",)


def test_numbering_writes_evaluated_copies_only(bpy, shown):
    from rtgi_addon.capture.materials import number_materials, read_materials
    shown.material.pass_index = 7
    depsgraph = bpy.context.evaluated_depsgraph_get()
    table = read_materials(depsgraph)
    number_materials(depsgraph, table)
    assert shown.material.evaluated_get(depsgraph).pass_index == table.of(shown.material.evaluated_get(depsgraph)) == 1
    assert shown.material.pass_index == 7


def test_reading_and_numbering_leave_the_file_clean(bpy, shown, make_image, tmp_path):
    from rtgi_addon.capture.materials import number_materials, read_materials
    textured(shown, make_image(halves(0.0, 1.0))).image.pack()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "clean.blend"))
    before = bpy.data.is_dirty  # the bpy module of 4.5 always says True
    depsgraph = bpy.context.evaluated_depsgraph_get()
    number_materials(depsgraph, read_materials(depsgraph))
    assert bpy.data.is_dirty == before


def stepped(shown, kind, output, threshold):
    """The material's base colour is 1 where a procedural texture is above a threshold, 0 elsewhere."""
    pattern, above = shown.add(kind), shown.add("ShaderNodeMath")
    above.operation = "GREATER_THAN"
    above.inputs[1].default_value = threshold
    shown.link(pattern.outputs[output], above.inputs[0])
    shown.link(above.outputs[0], shown.principled.inputs["Base Color"])
    shown.set(Specular_IOR_Level=0.0)


# shares measured in renders of a plane by Cycles, 65 536 points each
@pytest.mark.parametrize(("kind", "output", "threshold", "share"), [
    ("ShaderNodeTexNoise", 0, 0.443, 0.75), ("ShaderNodeTexNoise", 0, 0.607, 0.10),
    ("ShaderNodeTexVoronoi", "Distance", 0.288, 0.90), ("ShaderNodeTexVoronoi", "Distance", 0.653, 0.25),
    ("ShaderNodeTexWave", 1, 0.849, 0.25), ("ShaderNodeTexWave", 1, 0.029, 0.90)])
def test_a_threshold_of_a_procedural_texture_keeps_its_share(shown, kind, output, threshold, share):
    stepped(shown, kind, output, threshold)
    material, _ = shown.read()
    assert material.albedo[0] == pytest.approx(share, abs=0.035)


def test_two_procedural_textures_vary_by_themselves(shown):
    first, second = shown.add("ShaderNodeTexWhiteNoise"), shown.add("ShaderNodeTexWhiteNoise")
    product = shown.add("ShaderNodeMath")
    product.operation = "MULTIPLY"
    shown.link(first.outputs["Value"], product.inputs[0])
    shown.link(second.outputs["Value"], product.inputs[1])
    shown.link(product.outputs[0], shown.principled.inputs["Base Color"])
    shown.set(Specular_IOR_Level=0.0)
    material, _ = shown.read()
    assert material.albedo[0] == pytest.approx(0.25, abs=0.01)     # of one texture squared it would be 1/3


def test_bricks_and_mortar_take_the_shares_of_their_sizes(shown):
    bricks = shown.add("ShaderNodeTexBrick", Color1=(1, 0, 0, 1), Color2=(0, 1, 0, 1), Mortar=(0, 0, 1, 1))
    bricks.inputs["Mortar Size"].default_value = 0.05
    shown.link(bricks.outputs["Color"], shown.principled.inputs["Base Color"])
    shown.set(Specular_IOR_Level=0.0)
    material, _ = shown.read()
    bare = (1 - 0.1 / 0.5) * (1 - 0.1 / 0.25)                       # a brick is 0.5 wide and 0.25 high
    assert material.albedo == pytest.approx((bare / 2, bare / 2, 1 - bare), abs=0.02)


def test_leaves_cut_out_of_a_procedural_texture_are_there(shown):
    stepped(shown, "ShaderNodeTexVoronoi", "Distance", 0.401)
    link = next(link for link in shown.tree.links if link.to_socket.name == "Base Color")
    shown.link(link.from_socket, shown.principled.inputs["Alpha"])
    material, table = shown.read()
    assert material.alpha == pytest.approx(0.75, abs=0.035) and table.has_transparency
