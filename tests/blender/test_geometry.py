"""World triangles: which there are, where they lie, and their colours."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytestmark = pytest.mark.blender


@pytest.fixture
def bpy(bpy_session, empty_scene):
    return bpy_session


@pytest.fixture
def read(bpy):
    """Reads the current scene; the same cache serves all reads of a test."""
    from rtgi_addon.capture.geometry import GeometryCache, read_geometry
    from rtgi_addon.capture.materials import read_materials
    cache = GeometryCache()

    def read_scene(origin=(0, 0, 0)):
        depsgraph = bpy.context.evaluated_depsgraph_get()
        table = read_materials(depsgraph, cache.materials)
        return read_geometry(depsgraph, table, np.array(origin, np.float64), cache)

    return read_scene


def new_object(bpy, vertices, faces, name="Thing", **placement):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    thing = bpy.data.objects.new(name, mesh)
    for key, value in placement.items():
        setattr(thing, key, value)
    bpy.context.scene.collection.objects.link(thing)
    return thing


TRIANGLE = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]


def triangle(bpy, **placement):
    return new_object(bpy, TRIANGLE, [(0, 1, 2)], **placement)


def paint(bpy, thing, **values):
    """A Principled material without specular on `thing`; gives its tree and node."""
    material = bpy.data.materials.new("Paint")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    node = material.node_tree.nodes["Principled BSDF"]
    node.inputs["Specular IOR Level"].default_value = 0.0
    for key, value in values.items():
        node.inputs[key.replace("_", " ")].default_value = value
    thing.data.materials.append(material)
    return material.node_tree, node


def areas(geometry):
    a, b, c = np.moveaxis(geometry.corners_ws.astype(np.float64), 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=-1) / 2


def test_an_empty_scene_has_no_triangles(read):
    geometry = read()
    assert len(geometry) == 0 and geometry.material.dtype == np.int32


def test_a_mesh_without_faces_has_no_triangles(bpy, read):
    new_object(bpy, TRIANGLE, [])
    assert len(read()) == 0


def test_a_triangle_lies_where_its_object_puts_it(bpy, read):
    triangle(bpy, location=(1, 2, 3), scale=(2, 1, 1))
    np.testing.assert_allclose(read().corners_ws, [[(1, 2, 3), (3, 2, 3), (1, 3, 3)]], atol=1e-6)


def test_the_origin_is_taken_off_in_double_precision(bpy, read):
    # float32 resolves 1/16 m at 1e6 m: a vertex 0.25 m away from the origin keeps its digits only in float64
    triangle(bpy, location=(1e6, 0, 0))
    np.testing.assert_array_equal(read((1e6, 0, 0)).corners_ws[0], TRIANGLE)


def test_faces_of_any_size_become_triangles_of_the_same_area(bpy, read):
    ring = [(math.cos(k * math.pi / 3), math.sin(k * math.pi / 3), 0) for k in range(6)]
    new_object(bpy, ring + [(2, 0, 0), (3, 0, 0), (3, 1, 0), (2, 1, 0)], [range(6), (6, 7, 8, 9)])
    geometry = read()
    assert len(geometry) == 4 + 2
    assert areas(geometry).sum() == pytest.approx(1.5 * math.sqrt(3) + 1, rel=1e-6)  # float32 corners


def test_a_mirrored_object_is_mirrored(bpy, read):
    triangle(bpy, scale=(-1, 1, 1))
    np.testing.assert_allclose(read().corners_ws[0], [(0, 0, 0), (-1, 0, 0), (0, 1, 0)], atol=1e-6)


def test_an_array_modifier_adds_its_copies(bpy, read):
    thing = triangle(bpy)
    modifier = thing.modifiers.new("Array", "ARRAY")
    modifier.count, modifier.relative_offset_displace = 3, (2, 0, 0)
    corners = read().corners_ws
    np.testing.assert_allclose(np.sort(corners[:, 0, 0]), [0, 2, 4], atol=1e-6)


def test_two_objects_that_share_a_mesh_keep_their_own_modifiers(bpy, read):
    first = triangle(bpy)
    second = bpy.data.objects.new("Second", first.data)
    bpy.context.scene.collection.objects.link(second)
    second.modifiers.new("Array", "ARRAY").count = 4
    assert len(read()) == 1 + 4


def test_collection_instances_are_read_at_each_place(bpy, read):
    collection = bpy.data.collections.new("Kit")
    mesh = bpy.data.meshes.new("Part")
    mesh.from_pydata(TRIANGLE, [], [(0, 1, 2)])
    collection.objects.link(bpy.data.objects.new("Part", mesh))
    for x, scale in ((0, (1, 1, 1)), (5, (1, 1, 1)), (10, (-1, 1, 1))):
        empty = bpy.data.objects.new("Place", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        empty.location, empty.scale = (x, 0, 0), scale
        bpy.context.scene.collection.objects.link(empty)
    corners = read().corners_ws
    np.testing.assert_allclose(np.sort(corners[:, 1, 0]), [1, 6, 9], atol=1e-6)


def test_the_parent_of_instanced_faces_is_left_out_when_it_is_not_rendered(bpy, read):
    parent = new_object(bpy, [(0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0)], [(0, 1, 2, 3)])
    child = triangle(bpy)
    child.parent = parent
    parent.instance_type = "FACES"
    parent.show_instancer_for_render = parent.show_instancer_for_viewport = False
    # the child and its copy in the middle of the face, but not the face itself
    assert np.unique(read().corners_ws[:, 0, 0]).tolist() == [0, 2]


def test_curves_and_text_give_their_surface(bpy, read):
    bpy.ops.curve.primitive_bezier_circle_add()
    bpy.context.object.data.bevel_depth = 0.1
    curve = len(read())
    bpy.ops.object.text_add()
    both = len(read())
    assert curve > 0 and both > curve


def test_a_metaball_is_closed_around_its_element(bpy, read):
    bpy.ops.object.metaball_add(type="BALL", radius=1)
    low, high = read().bounds_ws
    # its surface lies where the field falls to the threshold, inside the element's own radius of 1
    assert (high > 0.5).all() and (low < -0.5).all() and (high <= 1).all()


def test_reading_leaves_no_mesh_behind(bpy, read):
    bpy.ops.object.text_add()
    read()
    assert len(bpy.data.meshes) == 0


def test_hidden_objects_are_left_out(bpy, read):
    triangle(bpy).hide_viewport = True
    assert len(read()) == 0


def test_an_object_that_no_bounced_or_shadow_ray_sees_is_left_out(bpy, read):
    thing = triangle(bpy)
    thing.visible_diffuse = thing.visible_glossy = thing.visible_shadow = False
    assert len(read()) == 0


def test_an_object_hidden_from_the_camera_still_blocks_rays(bpy, read):
    triangle(bpy).visible_camera = False
    assert len(read()) == 1


def test_a_holdout_blocks_and_reflects_nothing(bpy, read):
    thing = triangle(bpy)
    paint(bpy, thing, Base_Color=(0.5, 0.5, 0.5, 1), Emission_Color=(1, 1, 1, 1), Emission_Strength=3.0)
    thing.is_holdout = True
    geometry = read()
    assert len(geometry) == 1 and not geometry.albedo.any() and not geometry.emission.any()


def test_a_broken_vertex_is_handed_on(bpy, read):
    thing = triangle(bpy)
    thing.data.vertices[1].co.x = math.nan
    geometry = read()
    assert np.isnan(geometry.corners_ws[0, 1, 0]) and np.isfinite(geometry.albedo).all()


def test_a_constant_colour_is_at_every_corner(bpy, read):
    paint(bpy, triangle(bpy), Base_Color=(0.2, 0.4, 0.6, 1))
    np.testing.assert_allclose(read().albedo, np.broadcast_to((0.2, 0.4, 0.6), (1, 3, 3)), atol=1e-6)


def test_a_metal_has_no_albedo(bpy, read):
    paint(bpy, triangle(bpy), Base_Color=(1, 1, 1, 1), Metallic=1.0)
    assert not read().albedo.any()


def test_emission_is_radiance(bpy, read):
    paint(bpy, triangle(bpy), Emission_Color=(1, 0.5, 0, 1), Emission_Strength=10.0)
    np.testing.assert_allclose(read().emission, [(10, 5, 0)], rtol=1e-6)


def test_each_face_takes_the_material_of_its_slot(bpy, read):
    thing = new_object(bpy, [*TRIANGLE, (1, 1, 0)], [(0, 1, 2), (1, 3, 2)])
    paint(bpy, thing, Base_Color=(1, 0, 0, 1))
    paint(bpy, thing, Base_Color=(0, 1, 0, 1))
    thing.data.polygons[1].material_index = 1
    geometry = read()
    np.testing.assert_allclose(geometry.albedo[:, 0], [(1, 0, 0), (0, 1, 0)], atol=1e-6)
    assert geometry.material.tolist() == [1, 2]


def test_a_material_linked_to_the_object_wins_over_the_meshs(bpy, read):
    thing = triangle(bpy)
    paint(bpy, thing, Base_Color=(1, 0, 0, 1))
    other = triangle(bpy, hide_viewport=True)
    paint(bpy, other, Base_Color=(0, 0, 1, 1))
    thing.material_slots[0].link = "OBJECT"
    thing.material_slots[0].material = other.data.materials[0]
    np.testing.assert_allclose(read().albedo[0, 0], (0, 0, 1), atol=1e-6)


def test_a_fully_transparent_surface_is_left_out(bpy, read):
    paint(bpy, triangle(bpy), Alpha=0.0)
    assert len(read()) == 0


def grid_with_image(bpy, image, cells=8, extension="REPEAT", uv_scale=1.0):
    """A plane of cells x cells quads over the unit square with UVs alike, showing `image`."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=cells, y_subdivisions=cells, size=1, location=(0.5, 0.5, 0))
    grid = bpy.context.object
    layer = grid.data.uv_layers.active.data
    for k, loop in enumerate(grid.data.loops):
        position = grid.data.vertices[loop.vertex_index].co
        layer[k].uv = ((position.x + 0.5) * uv_scale, (position.y + 0.5) * uv_scale)
    tree, principled = paint(bpy, grid)
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image, node.extension = image, extension
    tree.links.new(node.outputs["Color"], principled.inputs["Base Color"])
    return grid, tree, node


def checker(cells, block_px):
    """(N, N, 4) black and white, the square at the lower left white."""
    odd = np.add.outer(np.arange(cells), np.arange(cells)) % 2
    pixels = np.ones((cells * block_px, cells * block_px, 4), np.float32)
    pixels[..., :3] = np.kron(1 - odd, np.ones((block_px, block_px)))[..., None]
    return pixels


def squares(geometry, cells):
    """Which (column, row) of the grid each triangle is in."""
    return np.floor(geometry.corners_ws.mean(1)[:, :2] * cells).astype(int)


def test_a_texture_is_sampled_inside_the_triangle_that_shows_it(bpy, read, make_image):
    grid_with_image(bpy, make_image(checker(8, 16)))
    geometry = read()
    white = squares(geometry, 8).sum(1) % 2 == 0
    # each triangle lies in one square: the sample points and their blur stay inside
    expected = np.where(white, 1.0, 0.0)[:, None, None]
    np.testing.assert_allclose(geometry.albedo, np.broadcast_to(expected, geometry.albedo.shape), atol=1e-5)


def test_a_triangle_over_many_texels_shows_their_mean(bpy, read, make_image):
    grid_with_image(bpy, make_image(checker(32, 4)), cells=1)
    # two triangles over 32 x 32 squares: a level of the pyramid in which no square is left
    np.testing.assert_allclose(read().albedo, 0.5, atol=0.02)


def test_a_repeated_texture_shows_its_mean_too(bpy, read, make_image):
    grid_with_image(bpy, make_image(checker(8, 16)), cells=1, uv_scale=50.0)
    np.testing.assert_allclose(read().albedo, 0.5, atol=1e-3)


def test_a_ramp_over_a_large_triangle_reaches_the_corners(bpy, read, make_image):
    pixels = np.ones((64, 64, 4), np.float32)
    pixels[..., :3] = ((np.arange(64) + 0.5) / 64)[None, :, None]
    grid_with_image(bpy, make_image(pixels, is_float=True), cells=1, extension="EXTEND")
    geometry = read()
    # blur of 1/8 of the image at the ends, where the texture stops, is all that is lost
    np.testing.assert_allclose(geometry.albedo[..., 0], geometry.corners_ws[..., 0], atol=0.07)


def test_a_mapping_node_moves_the_texture(bpy, read, make_image):
    _, tree, node = grid_with_image(bpy, make_image(checker(8, 16)))
    mapping, layer = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeUVMap")
    mapping.inputs["Location"].default_value = (1 / 8, 0, 0)
    tree.links.new(layer.outputs[0], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs[0], node.inputs["Vector"])
    geometry = read()
    white = squares(geometry, 8).sum(1) % 2 == 1
    np.testing.assert_allclose(geometry.albedo[:, 0, 0], np.where(white, 1.0, 0.0), atol=1e-4)


def test_a_mesh_without_texture_coordinates_shows_the_mean(bpy, read, make_image):
    grid, _, _ = grid_with_image(bpy, make_image(checker(8, 16)))
    grid.data.uv_layers.remove(grid.data.uv_layers[0])
    np.testing.assert_allclose(read().albedo, 0.5, atol=0.01)


def test_a_colour_attribute_is_read_at_its_corners(bpy, read):
    thing = triangle(bpy)
    tree, principled = paint(bpy, thing)
    colours = thing.data.color_attributes.new("Tint", "FLOAT_COLOR", "POINT")
    for k, colour in enumerate([(1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1)]):
        colours.data[k].color = colour
    node = tree.nodes.new("ShaderNodeVertexColor")
    node.layer_name = "Tint"
    tree.links.new(node.outputs["Color"], principled.inputs["Base Color"])
    np.testing.assert_allclose(read().albedo[0], np.eye(3), atol=1e-6)


def test_an_alpha_map_drops_triangles_that_are_wholly_outside(bpy, read, make_image):
    pixels = np.ones((64, 64, 4), np.float32)
    pixels[:, 32:, 3] = 0
    _, tree, node = grid_with_image(bpy, make_image(pixels), extension="EXTEND")
    principled = tree.nodes["Principled BSDF"]
    tree.links.new(node.outputs["Alpha"], principled.inputs["Alpha"])
    geometry = read()
    assert len(geometry) == 64
    assert geometry.corners_ws[..., 0].max() <= 0.5 + 1e-6


def test_a_second_read_of_an_unchanged_scene_is_the_same(bpy, read, make_image):
    grid_with_image(bpy, make_image(checker(8, 16)))
    first, second = read(), read()
    np.testing.assert_array_equal(first.albedo, second.albedo)
    np.testing.assert_array_equal(first.corners_ws, second.corners_ws)


def test_textures_are_not_sampled_again_when_only_vertices_move(bpy, read, make_image, monkeypatch):
    from rtgi_addon.capture.images import Pyramid
    image = make_image(checker(8, 16))
    image.pack()
    grid, _, _ = grid_with_image(bpy, image)
    before = read()
    calls, sample = [], Pyramid.sample

    def counted(*args):
        calls.append(args)
        return sample(*args)

    monkeypatch.setattr(Pyramid, "sample", counted)
    grid.data.vertices[0].co.z = 1.0
    grid.data.update()
    after = read()
    assert not calls
    assert not np.array_equal(before.corners_ws, after.corners_ws)


def test_changed_texture_coordinates_are_noticed(bpy, read, make_image):
    grid, _, _ = grid_with_image(bpy, make_image(checker(8, 16)))
    before = read().albedo
    for item in grid.data.uv_layers.active.data:
        item.uv = (item.uv[0] + 1 / 8, item.uv[1])
    grid.data.update()
    np.testing.assert_allclose(read().albedo, 1 - before, atol=1e-4)


def test_a_changed_colour_is_noticed(bpy, read):
    _, principled = paint(bpy, triangle(bpy), Base_Color=(1, 0, 0, 1))
    read()
    principled.inputs["Base Color"].default_value = (0, 1, 0, 1)
    np.testing.assert_allclose(read().albedo[0, 0], (0, 1, 0), atol=1e-6)


def test_a_quad_that_folds_is_cut_anew(bpy, read):
    thing = new_object(bpy, [(0, 0, 0), (4, 0, 0), (1, 1, 0), (0, 4, 0)], [(0, 1, 2, 3)])
    first = areas(read()).sum()
    for vertex, place in zip(thing.data.vertices, [(0, 4, 0), (3, 3, 0), (4, 0, 0), (4, 4, 0)], strict=True):
        vertex.co = place
    thing.data.update()
    # arrowheads, the notch at the third corner and then at the second: cut along the wrong diagonal, they overlap
    assert first == pytest.approx(4, rel=1e-6)
    assert areas(read()).sum() == pytest.approx(4, rel=1e-6)


def test_reading_leaves_the_file_clean(bpy, read, tmp_path):
    triangle(bpy)
    bpy.ops.object.text_add()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "clean.blend"))
    before = bpy.data.is_dirty  # the bpy module of 4.5 always says True
    read()
    assert bpy.data.is_dirty == before


def add_sphere(bpy, **placement):
    """A unit sphere of 32 x 16 quads, shaded smooth, of which one quad in the middle faces +X."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16, radius=1)
    sphere = bpy.context.object
    sphere.data.polygons.foreach_set("use_smooth", np.ones(len(sphere.data.polygons), bool))
    for key, value in placement.items():
        setattr(sphere, key, value)
    return sphere


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def middle_normals(geometry):
    """(T, 3): the corners' normals interpolated to the middle of each triangle."""
    return unit(geometry.normals_ws.astype(np.float64).sum(1))


def face_normals(geometry):
    """(T, 3): normals of the triangles by their winding."""
    a, b, c = np.moveaxis(geometry.corners_ws.astype(np.float64), 1, 0)
    return unit(np.cross(b - a, c - a))


def degrees_apart(a, b):
    return np.degrees(2 * np.arcsin(np.linalg.norm(a - b, axis=-1) / 2))


def ellipsoid_normals(geometry, axes, centre=(0, 0, 0)):
    """(T, 3): outward normals of an ellipsoid at the middles of the triangles."""
    return unit((geometry.corners_ws.mean(1) - np.array(centre)) / np.square(axes))


# normals at vertices are means of those of faces, by angle: as far off the sphere's own where quads become triangles
SPHERE_DEG = 1.0


def test_flat_objects_hold_no_normals(bpy, read):
    bpy.ops.mesh.primitive_cube_add()
    triangle(bpy)
    assert read().normals_ws is None


def test_a_smooth_sphere_has_the_normals_of_the_sphere(bpy, read):
    add_sphere(bpy)
    geometry = read()
    assert geometry.normals_ws.dtype == np.int16 and geometry.normals_ws.shape == (len(geometry), 3, 3)
    np.testing.assert_allclose(np.linalg.norm(geometry.normals_ws.astype(float), axis=-1), 32767, atol=1)
    assert degrees_apart(middle_normals(geometry), ellipsoid_normals(geometry, (1, 1, 1))).max() < SPHERE_DEG


def test_a_turned_and_stretched_object_has_the_normals_of_its_shape(bpy, read):
    add_sphere(bpy, scale=(3, 1, 0.5), location=(5, 0, 0))
    geometry = read()
    # a long axis bends the middle of a triangle off the mean of its corners
    apart = degrees_apart(middle_normals(geometry), ellipsoid_normals(geometry, (3, 1, 0.5), (5, 0, 0)))
    assert np.median(apart) < SPHERE_DEG and apart.max() < 6
    bpy.context.object.rotation_euler = (0, 0, math.pi / 2)
    turned = read()
    expected = middle_normals(geometry)[:, [1, 0, 2]] * [-1, 1, 1]
    assert degrees_apart(middle_normals(turned), expected).max() < 0.02


@pytest.mark.parametrize("scale", [(-1, 1, 1), (-1, -1, -1), (1, 1, -2)])
def test_normals_of_a_mirrored_object_are_on_the_side_of_its_winding(bpy, read, scale):
    add_sphere(bpy, scale=scale)
    geometry = read()
    winding = face_normals(geometry)
    # mirrored, the corners go round the other way, and the winding says that the inside is out
    assert (winding * geometry.corners_ws.mean(1)).sum(-1).max() < 0
    assert degrees_apart(middle_normals(geometry), -ellipsoid_normals(geometry, scale)).max() < 2 * SPHERE_DEG


def test_instances_have_normals_of_their_own(bpy, read):
    collection = bpy.data.collections.new("Kit")
    sphere = add_sphere(bpy)
    collection.objects.link(sphere)
    bpy.context.scene.collection.objects.unlink(sphere)
    for x, scale in ((0, (1, 1, 1)), (10, (1, 1, -1))):
        empty = bpy.data.objects.new("Place", None)
        empty.instance_type, empty.instance_collection = "COLLECTION", collection
        empty.location, empty.scale = (x, 0, 0), scale
        bpy.context.scene.collection.objects.link(empty)
    geometry = read()
    is_mirrored = geometry.corners_ws[:, 0, 0] > 5
    outwards = unit(geometry.corners_ws.mean(1) - np.where(is_mirrored, 10.0, 0.0)[:, None] * [1, 0, 0])
    outwards[is_mirrored] *= -1
    assert is_mirrored.sum() * 2 == len(geometry)
    assert degrees_apart(middle_normals(geometry), outwards).max() < SPHERE_DEG


def test_a_flat_object_beside_a_smooth_one_holds_zeros(bpy, read):
    add_sphere(bpy)
    bpy.ops.mesh.primitive_cube_add(location=(9, 0, 0))
    geometry = read()
    is_cube = geometry.corners_ws[:, 0, 0] > 5
    assert is_cube.sum() == 12 and not geometry.normals_ws[is_cube].any()
    assert geometry.normals_ws[~is_cube].any((1, 2)).all()


def test_flat_faces_of_a_smooth_mesh_hold_zeros(bpy, read):
    sphere = add_sphere(bpy)
    for polygon in sphere.data.polygons:
        polygon.use_smooth = polygon.center.z > 0
    geometry = read()
    is_smooth = geometry.corners_ws.mean(1)[:, 2] > 0
    assert not geometry.normals_ws[~is_smooth].any()
    assert geometry.normals_ws[is_smooth].any((1, 2)).all()


def test_sharp_edges_part_the_normals_of_their_sides(bpy, read):
    bpy.ops.mesh.primitive_cylinder_add(vertices=32)
    mesh = bpy.context.object.data
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), bool))
    mesh.set_sharp_from_angle(angle=math.radians(30))
    geometry = read()
    is_cap = np.abs(face_normals(geometry)[:, 2]) > 0.9
    # the caps are plane, and the side is a circle's, to the corner
    corners = unit(geometry.normals_ws.astype(np.float64))
    assert degrees_apart(corners[is_cap], face_normals(geometry)[is_cap][:, None]).max() < 0.02
    assert degrees_apart(corners[~is_cap], unit(geometry.corners_ws[~is_cap] * [1, 1, 0])).max() < 0.1


def test_custom_normals_are_read(bpy, read):
    mesh = new_object(bpy, [*TRIANGLE, (1, 1, 0)], [(0, 1, 2), (1, 3, 2)]).data
    mesh.normals_split_custom_set([(0.6, 0, 0.8)] * 3 + [(0, 0, 1)] * 3)
    # of triangles these corners are in order; Blender keeps an angle in 16 bits
    expected = np.repeat([[[0.6, 0, 0.8]], [[0, 0, 1]]], 3, 1)
    assert degrees_apart(unit(read().normals_ws.astype(np.float64)), expected).max() < 0.02


def test_normals_come_with_the_triangles_of_cut_quads_and_with_modifiers(bpy, read):
    sphere = add_sphere(bpy)
    sphere.data.polygons[0].use_smooth = False                # so that corners tell, not vertices
    sphere.modifiers.new("Subdivision", "SUBSURF")
    geometry = read()
    is_smooth = geometry.normals_ws.any((1, 2))
    assert len(geometry) > 3 * 960 and is_smooth.mean() > 0.99
    apart = degrees_apart(unit(geometry.normals_ws[is_smooth].astype(float).sum(1)), face_normals(geometry)[is_smooth])
    assert np.quantile(apart, 0.99) < 6                       # within a facet of 32


def test_curves_have_normals(bpy, read):
    bpy.ops.curve.primitive_bezier_circle_add()
    bpy.context.object.data.bevel_depth = 0.1
    geometry = read()
    ring = unit(geometry.corners_ws.mean(1) * [1, 1, 0])
    outwards = unit(geometry.corners_ws.mean(1) - ring)
    # the tube is round and its ring of radius 1, to what a Bezier circle is off
    assert np.median(degrees_apart(middle_normals(geometry) * np.sign((face_normals(geometry) * outwards).sum(-1))[:, None],
                                   outwards)) < 5


def test_triangles_that_are_left_out_take_their_normals_along(bpy, read):
    sphere = add_sphere(bpy)
    paint(bpy, sphere)
    paint(bpy, sphere, Alpha=0.0)
    for polygon in sphere.data.polygons:
        polygon.material_index = int(polygon.center.z > 0)
    geometry = read()
    assert geometry.corners_ws[..., 2].max() < 1e-6
    assert degrees_apart(middle_normals(geometry), ellipsoid_normals(geometry, (1, 1, 1))).max() < SPHERE_DEG


def test_a_broken_vertex_or_a_flattened_object_has_normals_without_direction_or_sound_ones(bpy, read):
    sphere = add_sphere(bpy)
    sphere.data.vertices[40].co.x = math.nan
    add_sphere(bpy, scale=(1, 1, 0))
    add_sphere(bpy, scale=(0, 0, 0))
    size = np.linalg.norm(read().normals_ws.astype(float), axis=-1)
    assert ((size == 0) | (np.abs(size - 32767) < 1)).all()
