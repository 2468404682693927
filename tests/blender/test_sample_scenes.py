"""The sample scenes: each builds, can be rendered as it is, is the same every time, and has what its docstring promises."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sample_scenes import SCENES

pytestmark = pytest.mark.blender

# What a look at the modelling lets one expect, about a third either way: an empty modifier or a lost instance falls outside.
TRIANGLES = {
    "cornell_box": (150, 300),
    "coloured_corner": (20_000, 40_000),
    "flashlight": (10_000, 20_000),
    "glossy_hall": (12_000, 25_000),
    "thin_wall_maze": (9_000, 18_000),
    "sunlit_colonnade": (14_000, 28_000),
    "animated_door": (4_000, 8_000),
    "courtyard": (16_000, 32_000),
    "many_lights": (36_000, 73_000),
    "caustics": (2_500, 6_000),
}


@pytest.fixture
def build(bpy_session):
    """Builds a sample scene by name and returns it."""
    from sample_scenes.build import build_scene

    return build_scene


def world_vertices(bpy) -> tuple[np.ndarray, int]:
    """(N, 3) vertices in metres of all evaluated meshes and instances, in the depsgraph's order, and the triangle count."""
    vertices, triangle_count = [], 0
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        if instance.object.type not in {"MESH", "FONT"}:
            continue
        mesh = instance.object.to_mesh()
        positions = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", positions)
        matrix = np.array(instance.matrix_world)
        vertices.append(positions.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
        mesh.calc_loop_triangles()
        triangle_count += len(mesh.loop_triangles)
        instance.object.to_mesh_clear()
    return np.concatenate(vertices), triangle_count


def test_every_scene_has_its_triangle_range():
    assert set(TRIANGLES) == set(SCENES)


@pytest.mark.parametrize("name", SCENES)
def test_scene_can_be_rendered_as_it_is(build, name):
    scene = build(name)
    lamps = [thing for thing in scene.objects if thing.type == "LIGHT" and not thing.hide_render]
    assert scene.camera is not None
    assert lamps
    assert (scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage) == (960, 540, 100)
    assert scene.view_settings.view_transform == "AgX"


@pytest.mark.parametrize("name", SCENES)
def test_scene_uses_rtgi_where_it_is_registered(build, name):
    assert build(name).render.engine == "RTGI"


@pytest.mark.parametrize("name", SCENES)
def test_triangle_count_is_in_its_range(bpy_session, build, name):
    build(name)
    lowest, highest = TRIANGLES[name]
    _, triangle_count = world_vertices(bpy_session)
    assert lowest <= triangle_count <= highest


@pytest.mark.parametrize("name", SCENES)
def test_two_builds_give_the_same_geometry(bpy_session, build, name):
    build(name)
    first_vertices, first_count = world_vertices(bpy_session)
    build(name)
    second_vertices, second_count = world_vertices(bpy_session)
    assert second_count == first_count
    # Blender sums vertex normals on several threads in any order, so a displacement along them may move by a last digit
    np.testing.assert_allclose(second_vertices, first_vertices, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", SCENES)
def test_camera_looks_at_surfaces(bpy_session, build, name):
    """Rays through a 16x9 lattice of pixels: at least 60 % meet something, so no scene is a picture of its sky."""
    scene = build(name)
    camera = scene.camera
    top_right, bottom_right, bottom_left, _ = (np.array(corner) for corner in camera.data.view_frame(scene=scene))
    depsgraph = bpy_session.context.evaluated_depsgraph_get()
    rotation = np.array(camera.matrix_world)[:3, :3]
    hits = 0
    for u in (np.arange(16) + 0.5) / 16:
        for v in (np.arange(9) + 0.5) / 9:
            direction = rotation @ (bottom_left + u * (bottom_right - bottom_left) + v * (top_right - bottom_right))
            start = np.array(camera.matrix_world.translation) + direction * (camera.data.clip_start / -bottom_left[2])
            hits += scene.ray_cast(depsgraph, tuple(start), tuple(direction))[0]
    assert hits >= 0.6 * 16 * 9


def test_closed_room_of_the_maze_has_no_opening(bpy_session, build):
    """2000 directions from two places in the room all meet its own walls, floor or ceiling, no farther than its diagonal."""
    from sample_scenes import thin_wall_maze as maze

    scene = build("thin_wall_maze")
    depsgraph = bpy_session.context.evaluated_depsgraph_get()
    cells = np.array(maze.cells(maze.CLOSED_ROOM))
    low, high = cells.min(0) - 2 * maze.STEP_M, cells.max(0) + 2 * maze.STEP_M
    lattice = np.arange(2000) + 0.5  # Fibonacci sphere: even in all directions, and also along no wall exactly
    z, azimuth = 1 - 2 * lattice / 2000, lattice * math.pi * (3 - math.sqrt(5))
    directions = np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], -1)
    for x, y in cells:
        for direction in directions:
            is_hit, point, *_ = scene.ray_cast(depsgraph, (x, y, 0.9), tuple(direction))
            assert is_hit
            assert np.all(np.array(point[:2]) >= low) and np.all(np.array(point[:2]) <= high)


def test_no_lamp_of_the_maze_hangs_in_the_closed_room(build):
    from sample_scenes import thin_wall_maze as maze

    scene = build("thin_wall_maze")
    cells = np.array(maze.cells(maze.CLOSED_ROOM))
    low, high = cells.min(0) - 2 * maze.STEP_M, cells.max(0) + 2 * maze.STEP_M
    places = np.array([thing.location[:2] for thing in scene.objects if thing.type == "LIGHT"])
    is_inside = np.all((places > low) & (places < high), axis=1)
    assert len(places) == 4
    assert not is_inside.any()


def test_door_opens_a_little_more_in_every_frame(bpy_session, build):
    from sample_scenes import animated_door

    scene = build("animated_door")
    assert (scene.frame_start, scene.frame_end) == (1, 20)
    angles_deg = []
    for frame in range(1, 21):
        scene.frame_set(frame)
        leaf = bpy_session.data.objects["door leaf"].evaluated_get(bpy_session.context.evaluated_depsgraph_get())
        edge = leaf.matrix_world.to_3x3().col[0]
        angles_deg.append(math.degrees(math.atan2(-edge.y, edge.x)))
    assert np.all(np.diff(angles_deg) > 0)
    # float32 matrices keep about 1e-5 degrees
    assert angles_deg[0] == pytest.approx(animated_door.AJAR_DEG, abs=1e-3)
    assert angles_deg[-1] == pytest.approx(animated_door.OPEN_DEG, abs=1e-3)


def test_town_has_thirty_lamps_of_every_shape_and_a_sun_that_is_off(build):
    scene = build("many_lights")
    lamps = [thing for thing in scene.objects if thing.type == "LIGHT"]
    shining = [thing.data for thing in lamps if not thing.hide_render]
    kinds = [light.shape if light.type == "AREA" else light.type for light in shining]
    assert len(shining) == 30
    assert set(kinds) == {"POINT", "SPOT", "RECTANGLE", "DISK"}
    assert [thing.data.type for thing in lamps if thing.hide_render] == ["SUN"]


def test_every_image_is_packed(bpy_session, build):
    for name in SCENES:
        build(name)
        assert all(image.packed_file for image in bpy_session.data.images if image.type == "IMAGE")


def test_saved_scene_opens_with_its_textures(bpy_session, tmp_path):
    from sample_scenes.build import save_scene

    path = save_scene("courtyard", tmp_path)
    bpy_session.ops.wm.open_mainfile(filepath=str(path))
    sky = bpy_session.data.images["sky"]
    values = np.empty(len(sky.pixels), np.float32)
    sky.pixels.foreach_get(values)
    assert bpy_session.context.scene.name == "courtyard"
    assert values.max() > 5.0  # the glow round the sun is brighter than white: packing kept the floats
    assert list(tmp_path.iterdir()) == [path]


def test_unknown_name_ends_with_status_2(bpy_session, capsys):
    from sample_scenes.build import main

    with pytest.raises(SystemExit) as stop:
        main(["cornel_box"])
    assert stop.value.code == 2
    assert "'cornel_box'" in capsys.readouterr().err


def test_list_names_every_scene_with_what_it_shows(bpy_session, capsys):
    from sample_scenes.build import main

    assert main(["--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(SCENES)
    assert all(len(line.split()) > 5 for line in lines)
