"""Lamps' views between the frames of an animation: what stays, what is redone, and that neither changes a picture."""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = pytest.mark.blender


@pytest.fixture
def looks(monkeypatch):
    """How many views Cycles rendered of lamps, by frame."""
    from rtgi_addon.capture.views import ViewCapture

    found, look = {}, ViewCapture.looking_through

    def count(self, *args):
        frame = self.depsgraph.scene.frame_current
        found[frame] = found.get(frame, 0) + 1
        return look(self, *args)

    monkeypatch.setattr(ViewCapture, "looking_through", count)
    return found


def animate(bpy, scene, owner, name, *values):
    for frame, value in enumerate(values, 1):
        setattr(owner, name, value)
        owner.keyframe_insert(name, frame=frame)
    scene.frame_start, scene.frame_end = 1, len(values)


def rendered(bpy, scene, tmp_path, monkeypatch):
    """{frame: transports} of an animation render."""
    from rtgi_addon import engine, pipeline

    found, run = {}, pipeline.run

    def keep(*args, **kwargs):
        result = run(*args, **kwargs)
        found[scene.frame_current] = {t: light.copy() for t, light in result.transports.items()}
        return result

    scene.render.filepath = str(tmp_path / "frame_")
    with monkeypatch.context() as patch:
        patch.setattr(pipeline, "run", keep)
        bpy.ops.render.render(animation=True)
    assert engine.last_result() is not None
    return found


def assert_same_without_keeping(bpy, scene, tmp_path, monkeypatch, kept):
    from rtgi_addon import engine

    with engine.every_view_anew():
        anew = rendered(bpy, scene, tmp_path, monkeypatch)
    assert kept.keys() == anew.keys()
    for frame, transports in anew.items():
        for transport, light in transports.items():
            np.testing.assert_array_equal(kept[frame][transport], light, err_msg=f"{frame}, {transport}")


def test_a_moving_camera_leaves_the_views_of_lamps(bpy_session, small_scene, tmp_path, monkeypatch, looks):
    x, y, z = small_scene.camera.location
    animate(bpy_session, small_scene, small_scene.camera, "location", (x, y, z), (x + 0.1, y, z), (x + 0.2, y, z))
    found = rendered(bpy_session, small_scene, tmp_path, monkeypatch)
    assert looks == {1: 1}
    assert any((found[1][t] != found[3][t]).any() for t in found[1])
    assert_same_without_keeping(bpy_session, small_scene, tmp_path, monkeypatch, found)


def test_what_moves_in_a_lamps_view_is_seen_anew(bpy_session, small_scene, tmp_path, monkeypatch, looks):
    cube = bpy_session.data.objects["Cube"]
    x, y, z = cube.location
    animate(bpy_session, small_scene, cube, "location", (x, y, z), (x + 0.1, y, z), (x + 0.1, y, z))
    found = rendered(bpy_session, small_scene, tmp_path, monkeypatch)
    assert looks[1] == looks[2] == 1
    assert_same_without_keeping(bpy_session, small_scene, tmp_path, monkeypatch, found)


def test_what_moves_beside_a_lamps_view_leaves_it(bpy_session, small_scene, tmp_path, monkeypatch, looks):
    bpy_session.ops.mesh.primitive_cube_add(size=0.2, location=(0, 0, 40))
    beside = bpy_session.context.active_object
    animate(bpy_session, small_scene, beside, "location", (0, 0, 40), (0, 1, 40), (0, 0, 39))
    found = rendered(bpy_session, small_scene, tmp_path, monkeypatch)
    assert looks == {1: 1}
    assert_same_without_keeping(bpy_session, small_scene, tmp_path, monkeypatch, found)


def test_what_a_moving_empty_instances_is_seen_anew(bpy_session, small_scene, tmp_path, monkeypatch, looks):
    bpy, cube = bpy_session, bpy_session.data.objects["Cube"]
    kept_out = bpy.data.collections.new("Cubes")
    kept_out.objects.link(cube)
    small_scene.collection.objects.unlink(cube)
    empty = bpy.data.objects.new("Cubes", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", kept_out
    small_scene.collection.objects.link(empty)
    animate(bpy, small_scene, empty, "location", (0, 0, 0), (0.2, 0, 0), (0.2, 0, 0))
    found = rendered(bpy, small_scene, tmp_path, monkeypatch)
    assert looks[1] == looks[2] == 1
    assert_same_without_keeping(bpy, small_scene, tmp_path, monkeypatch, found)


@pytest.mark.parametrize("what", ["material", "lamp's cone", "lamp's place", "hidden", "deformed"])
def test_every_other_change_is_seen(bpy_session, small_scene, tmp_path, monkeypatch, looks, what):
    cube, lamp = bpy_session.data.objects["Cube"], small_scene.objects["Spot"]
    if what == "material":
        shader = bpy_session.data.materials["Wall"].node_tree.nodes["Principled BSDF"]
        animate(bpy_session, small_scene, shader.inputs["Base Color"], "default_value", (1, 0, 0, 1), (0, 1, 0, 1))
    elif what == "lamp's cone":
        animate(bpy_session, small_scene, lamp.data, "spot_size", 1.0, 1.3)
    elif what == "lamp's place":
        x, y, z = lamp.location
        animate(bpy_session, small_scene, lamp, "location", (x, y, z), (x + 0.2, y, z))
    elif what == "hidden":
        animate(bpy_session, small_scene, cube, "hide_render", False, True)
    else:
        cast = cube.modifiers.new("Cast", "CAST")
        animate(bpy_session, small_scene, cast, "factor", 0.0, 1.0)
    found = rendered(bpy_session, small_scene, tmp_path, monkeypatch)
    assert looks == {1: 1, 2: 1}
    assert_same_without_keeping(bpy_session, small_scene, tmp_path, monkeypatch, found)


def test_a_lamp_that_only_dims_is_not_looked_through_again(bpy_session, small_scene, tmp_path, monkeypatch, looks):
    animate(bpy_session, small_scene, small_scene.objects["Spot"].data, "energy", 100.0, 50.0)
    found = rendered(bpy_session, small_scene, tmp_path, monkeypatch)
    assert looks == {1: 1}
    assert_same_without_keeping(bpy_session, small_scene, tmp_path, monkeypatch, found)
