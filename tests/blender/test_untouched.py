"""A render leaves the user's file as it was: settings, datablocks and the dirty flag."""

from pathlib import Path

import pytest

# the dump reads every property, also those that Blender 6 will drop
pytestmark = [pytest.mark.blender, pytest.mark.filterwarnings("ignore::DeprecationWarning")]

# what a render may add to the file's datablocks
ALLOWED = {("images", "RTGI"), ("images", "RTGI Compare"), ("images", "Render Result")}
# data that Blender itself counts or works out, not settings of the user
COMPUTED = {"bl_rna", "rna_type", "session_uid", "users", "is_evaluated", "original", "depsgraph", "preview", "id_data",
            "is_updated", "is_updated_data", "tag", "asset_data"}
COLLECTIONS = ("scenes", "objects", "cameras", "lights", "materials", "worlds", "meshes", "images", "node_groups",
               "textures", "collections", "actions", "linestyles", "texts", "brushes")


def _plain(value):
    """A property's value as something that compares by content."""
    if hasattr(value, "name_full"):
        return ("datablock", value.name_full)
    if hasattr(value, "bl_rna"):
        return ("struct", value.bl_rna.identifier)
    if isinstance(value, (str, bytes, int, float, bool, type(None), set)):
        return value
    try:
        return tuple(_plain(v) for v in value)
    except TypeError:
        return repr(value)


def dump(struct, path, out, seen):
    """All readable settings below `struct` into `out` by path; groups and lists of groups are followed, each once."""
    identity = struct.bl_rna.identifier, struct.as_pointer()
    if identity in seen:                         # node links and sockets point at each other
        return
    seen.add(identity)
    for prop in struct.bl_rna.properties:
        name = prop.identifier
        if name in COMPUTED:
            continue
        value = getattr(struct, name)
        place = f"{path}.{name}"
        if prop.type == "COLLECTION":
            out[f"{place}.len"] = len(value)
            for index, item in enumerate(value):
                if hasattr(item, "name_full"):
                    out[f"{place}[{index}]"] = _plain(item)
                else:
                    dump(item, f"{place}[{index}]", out, seen)
        elif prop.type == "POINTER" and value is not None and not hasattr(value, "name_full"):
            dump(value, place, out, seen)
        else:
            out[place] = _plain(value)


def state(bpy):
    """(settings by path, names of datablocks, dirty flag) of the open file."""
    settings, seen = {}, set()
    for collection in ("scenes", "objects", "cameras", "lights", "materials", "worlds", "node_groups"):
        for datablock in getattr(bpy.data, collection):
            dump(datablock, f"{collection}[{datablock.name!r}]", settings, seen)
            if getattr(datablock, "node_tree", None) is not None:
                dump(datablock.node_tree, f"{collection}[{datablock.name!r}].tree", settings, seen)
    names = {(c, d.name) for c in COLLECTIONS for d in getattr(bpy.data, c)}
    return settings, names, bpy.data.is_dirty


def assert_untouched(before, after):
    changed = {path: (value, after[0].get(path, "gone")) for path, value in before[0].items() if after[0].get(path) != value}
    assert not changed
    assert not set(after[0]) - set(before[0])
    assert after[1] - before[1] <= ALLOWED and not before[1] - after[1]
    assert after[2] == before[2]


@pytest.fixture
def saved_scene(bpy_session, small_scene, tmp_path):
    """The small scene, saved and opened again, so that nothing is dirty; with values that RTGI has reason to change."""
    scene = small_scene
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.max_bounces = 77, True, 5
    scene.render.use_persistent_data = False
    path = str(tmp_path / "small.blend")
    bpy_session.ops.wm.save_as_mainfile(filepath=path)
    bpy_session.ops.wm.open_mainfile(filepath=path)
    return bpy_session.context.scene


def test_dump_sees_a_changed_setting(bpy_session, saved_scene):
    before = state(bpy_session)
    saved_scene.cycles.samples = 78
    after = state(bpy_session)
    with pytest.raises(AssertionError):
        assert_untouched(before, after)


@pytest.mark.parametrize("change", ["energy", "socket", "pass"])
def test_dump_sees_changes_deep_in_the_file(bpy_session, saved_scene, change):
    before = state(bpy_session)
    if change == "energy":
        bpy_session.data.lights["Spot"].energy = 1.0
    elif change == "socket":
        bpy_session.data.materials["Wall"].node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.111
    else:
        saved_scene.view_layers[0].use_pass_normal = not saved_scene.view_layers[0].use_pass_normal
    after = state(bpy_session)
    with pytest.raises(AssertionError):
        assert_untouched(before, after)


def test_render_leaves_the_file_untouched(bpy_session, saved_scene):
    before = state(bpy_session)
    bpy_session.ops.render.render()
    assert_untouched(before, state(bpy_session))


def test_animation_leaves_the_file_untouched(bpy_session, saved_scene, tmp_path):
    saved_scene.frame_end = 2
    saved_scene.render.filepath = str(tmp_path / "frame_")
    bpy_session.ops.wm.save_mainfile()
    before = state(bpy_session)
    bpy_session.ops.render.render(animation=True)
    assert_untouched(before, state(bpy_session))


def test_panoramic_camera_is_an_error_and_leaves_the_file_untouched(bpy_session, saved_scene):
    saved_scene.camera.data.type = "PANO"
    bpy_session.ops.wm.save_mainfile()
    before = state(bpy_session)
    with pytest.raises(RuntimeError, match="panoramic"):
        bpy_session.ops.render.render()
    assert_untouched(before, state(bpy_session))


def test_failure_inside_a_pass_is_an_error_and_leaves_the_file_untouched(bpy_session, saved_scene, monkeypatch):
    from rtgi_addon import pipeline
    from rtgi_addon.errors import CaptureError

    def fail(*_args, **_words):
        raise CaptureError("the pass failed on purpose")

    monkeypatch.setattr(pipeline, "run", fail)
    before = state(bpy_session)
    with pytest.raises(RuntimeError, match="on purpose"):
        bpy_session.ops.render.render()
    assert_untouched(before, state(bpy_session))


def test_cancelled_render_leaves_the_file_untouched(bpy_session, saved_scene, monkeypatch):
    from rtgi_addon import engine, pipeline
    from rtgi_addon.errors import Cancelled

    reached = []

    def cancel(*_args, **_words):
        reached.append(True)
        raise Cancelled("the render was cancelled")

    monkeypatch.setattr(pipeline, "run", cancel)
    last = engine.last_result()
    before = state(bpy_session)
    bpy_session.ops.render.render()
    assert reached and engine.last_result() is last
    assert_untouched(before, state(bpy_session))


def test_second_render_gives_the_same_picture(bpy_session, saved_scene):
    import numpy as np

    from rtgi_addon import engine

    bpy_session.ops.render.render()
    first = engine.last_result().combined.copy()
    bpy_session.ops.render.render()
    assert np.array_equal(first, engine.last_result().combined)


def test_a_comparison_leaves_the_file_as_it_was(bpy_session, saved_scene):
    path, content = bpy_session.data.filepath, Path(bpy_session.data.filepath).read_bytes()
    before = state(bpy_session)
    bpy_session.ops.rtgi.compare(samples=1)
    assert_untouched(before, state(bpy_session))
    assert bpy_session.data.filepath == path and Path(path).read_bytes() == content
