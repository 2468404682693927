"""The command line on real files: pictures, reports, exit codes."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from rtgi_addon import cli, imageio

pytestmark = pytest.mark.blender

SIZE = "64x36"


@pytest.fixture
def scene_file(bpy_session, small_scene, tmp_path):
    """The small scene as a file, as another program's user would have saved it: set to Cycles."""
    small_scene.render.engine = "CYCLES"
    path = tmp_path / "small.blend"
    bpy_session.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def rtgi(*argv):
    """Run the command line in this process; returns its exit code."""
    return cli.main([str(a) for a in argv])


def last_line(capsys):
    return capsys.readouterr().err.splitlines()[-1]


def test_render_writes_the_linear_composite_as_float32(scene_file, tmp_path):
    from rtgi_addon import engine

    assert rtgi("render", scene_file, "-o", tmp_path / "o.exr", "--size", SIZE) == 0
    channels = imageio.read_exr(tmp_path / "o.exr")
    picture = np.stack([channels[c] for c in "RGBA"], -1)
    assert picture.dtype == np.float32 and picture.shape == (36, 64, 4)
    assert np.array_equal(picture, engine.last_result().combined) and picture[..., :3].max() > 0


def test_render_does_not_change_the_scene_file(scene_file, tmp_path):
    before = scene_file.read_bytes()
    rtgi("render", scene_file, "-o", tmp_path / "o.exr", "--size", SIZE, "--preset", "draft")
    assert scene_file.read_bytes() == before


def test_passes_hold_every_transport_and_add_up_with_the_report(scene_file, tmp_path):
    from rtgi_addon import engine

    words = ("--passes", tmp_path / "p.exr", "--report", tmp_path / "r.json", "--threads", 1)
    assert rtgi("render", scene_file, "-o", tmp_path / "o.exr", "--size", SIZE, *words) == 0
    channels = imageio.read_exr(tmp_path / "p.exr")
    for transport, light in engine.last_result().transports.items():
        assert np.array_equal(np.stack([channels[f"{transport.value}.{c}"] for c in "RGB"], -1), light)
    assert channels["visibility.V"].shape == (36, 64)
    report = json.loads((tmp_path / "r.json").read_text())
    assert {"plan", "stages", "total_ms", "jit_ms", "peak_memory_mb", "threads", "versions", "warnings"} <= set(report)
    assert report["threads"] == 1


def test_png_is_seen_through_the_view_transform(bpy_session, scene_file, tmp_path):
    assert rtgi("render", scene_file, "-o", tmp_path / "o.png", "--size", SIZE) == 0
    image = bpy_session.data.images.load(str(tmp_path / "o.png"))
    assert tuple(image.size) == (64, 36) and image.depth == 24


def test_sequence_is_numbered_and_goes_on_after_a_stop(scene_file, tmp_path, capsys):
    words = ("render", scene_file, "-o", tmp_path / "f_##.exr", "--frames", "1-3", "--size", SIZE)
    (tmp_path / "f_02.exr").write_bytes(b"there")
    assert rtgi(*words, "--skip-existing") == 0
    assert sorted(p.name for p in tmp_path.glob("f_*")) == ["f_01.exr", "f_02.exr", "f_03.exr"]
    assert (tmp_path / "f_02.exr").read_bytes() == b"there"
    lines = capsys.readouterr().err
    assert "skipped" in lines and "1 frames and about" in lines


def test_direct_light_alone_has_no_bounce(scene_file, tmp_path):
    from rtgi_addon import engine
    from rtgi_addon.passes.base import Transport

    assert rtgi("render", scene_file, "-o", tmp_path / "o.exr", "--size", SIZE, "--techniques", "direct") == 0
    assert Transport.BOUNCE_DIFFUSE not in engine.last_result().transports


def test_scene_without_camera_is_refused(bpy_session, scene_file, tmp_path, capsys):
    bpy_session.context.scene.camera = None
    bpy_session.ops.wm.save_mainfile()
    assert rtgi("render", scene_file, "-o", tmp_path / "o.exr") == 2
    assert "has no camera" in last_line(capsys)


def test_scene_without_light_is_refused(bpy_session, scene_file, tmp_path, capsys):
    bpy_session.data.lights.remove(bpy_session.data.lights["Spot"])
    bpy_session.ops.wm.save_mainfile()
    assert rtgi("render", scene_file, "-o", tmp_path / "o.exr") == 2
    assert "has no light" in last_line(capsys)


def test_emission_counts_as_light(bpy_session, scene_file):
    bpy_session.data.lights.remove(bpy_session.data.lights["Spot"])
    shader = bpy_session.data.materials["Wall"].node_tree.nodes["Principled BSDF"]
    shader.inputs["Emission Strength"].default_value = 1.0
    assert cli.has_light(bpy_session.context.scene)


def test_render_that_fails_is_one_line_and_code_1(bpy_session, scene_file, tmp_path, capsys):
    bpy_session.context.scene.camera.data.type = "PANO"
    bpy_session.ops.wm.save_mainfile()
    assert rtgi("render", scene_file, "-o", tmp_path / "o.exr", "--size", SIZE) == 1
    assert "panoramic" in last_line(capsys) and not (tmp_path / "o.exr").exists()


def test_file_of_a_newer_blender_is_refused(scene_file, tmp_path, capsys):
    newer = tmp_path / "newer.blend"
    newer.write_bytes(b"BLENDER17-01v9900" + bytes(100))
    assert rtgi("render", newer, "-o", tmp_path / "o.exr") == 2
    assert "saved by Blender 99.0" in last_line(capsys)


def test_open_file_is_rendered_when_no_scene_is_named(scene_file, tmp_path):
    assert rtgi("render", "-o", tmp_path / "o.exr", "--size", SIZE) == 0
    assert (tmp_path / "o.exr").exists()


def test_exr_survives_the_way_to_the_file_and_back(bpy_session, tmp_path, rng):
    channels = {"a b.R": rng.random((5, 7), np.float32), "a b.G": rng.random((5, 7), np.float32)}
    imageio.write_exr(tmp_path / "x.exr", channels)
    read = imageio.read_exr(tmp_path / "x.exr")
    assert set(read) == set(channels) and all(np.array_equal(read[k], v) for k, v in channels.items())


def test_interrupted_write_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt), imageio.replacing(tmp_path / "x.exr"):
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


def test_module_renders_in_a_process_of_its_own_and_ends(request, scene_file, tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "rtgi_addon", "render", scene_file, "-o", tmp_path / "o.exr", "--size", SIZE],
        capture_output=True, text=True, timeout=500, check=False, cwd=request.config.rootpath, env=os.environ)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "o.exr").stat().st_size > 0


@pytest.mark.parametrize("codec", ["NONE", "ZIP", "ZIPS", "RLE"])
@pytest.mark.parametrize("depth", ["16", "32"])
def test_exr_of_blender_is_read_as_blender_reads_it(bpy_session, empty_scene, tmp_path, rng, codec, depth):
    picture = rng.random((19, 7, 4), np.float32)
    picture[..., 3] = 1
    image = bpy_session.data.images.new("noise", 7, 19, alpha=True, float_buffer=True)
    image.pixels.foreach_set(picture[::-1].ravel())
    settings = empty_scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth, settings.exr_codec = "OPEN_EXR", "RGBA", depth, codec
    path = tmp_path / "noise.exr"
    image.save_render(str(path), scene=empty_scene)
    read = np.stack([imageio.read_exr(path)[c] for c in "RGBA"], -1)
    # half floats keep 11 bits
    assert np.allclose(read, picture, rtol=0 if depth == "32" else 2**-11, atol=0)


def test_blender_reads_the_exr_as_it_was_written(bpy_session, tmp_path, rng):
    picture = rng.random((19, 7, 4), np.float32)
    picture[..., 3] = 1
    imageio.write_composite_exr(tmp_path / "x.exr", picture)
    image = bpy_session.data.images.load(str(tmp_path / "x.exr"))
    pixels = np.empty(19 * 7 * 4, np.float32)
    image.pixels.foreach_get(pixels)
    assert tuple(image.size) == (7, 19) and np.array_equal(pixels.reshape(19, 7, 4)[::-1], picture)


def test_file_that_is_no_exr_is_named(tmp_path):
    (tmp_path / "x.exr").write_text("hello")
    with pytest.raises(imageio.InputError, match="x.exr"):
        imageio.read_exr(tmp_path / "x.exr")
