"""`rtgi compare` and `rtgi bench` end to end, on a scene of three objects and a few pixels."""

import json
import sys

import numpy as np
import pytest

from rtgi_addon.errors import InputError

pytestmark = pytest.mark.blender

SIZE = (48, 28)
SAMPLES = 8


@pytest.fixture
def blend_path(bpy_session, small_scene, tmp_path):
    path = tmp_path / "small.blend"
    bpy_session.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture
def compared(blend_path, tmp_path, capsys):
    """(what compare_scene returned, its folder, what it printed)."""
    from rtgi_addon.compare.run import compare_scene

    out = tmp_path / "compared"
    outcome = compare_scene(blend_path, out, samples=SAMPLES, size=SIZE, peers=(1,), cache=out / "references")
    return outcome, out, capsys.readouterr().out


def test_compare_has_a_row_for_everything_for_direct_light_and_for_each_technique(compared):
    outcome, _, _ = compared
    assert {"RTGI", "direct only", "rsm", "Cycles 1", "Cycles 1 + denoiser"} <= set(outcome["rows"])


def test_compare_saves_what_it_returns(compared):
    outcome, out, _ = compared
    assert json.loads((out / "compare.json").read_text()) == json.loads(json.dumps(outcome))


def test_compare_writes_three_panels_in_one_picture(compared):
    from rtgi_addon.imageio import read_png

    _, out, _ = compared
    pixels = read_png(out / "compare.png")
    assert pixels.shape[1] > 3 * SIZE[0] and pixels.shape[0] > SIZE[1]


def test_compare_writes_a_page_a_csv_a_plot_and_each_picture(compared):
    outcome, out, _ = compared
    assert (out / "compare.html").read_text(encoding="utf-8").count('<tr data-name=') == len(outcome["rows"])
    assert len((out / "compare.csv").read_text().splitlines()) == 1 + len(outcome["rows"])
    assert (out / "speed_error.svg").read_text(encoding="utf-8").startswith("<svg")
    names = {path.name for path in (out / "pictures").iterdir()}
    assert {"reference.png", "rtgi.png", "rtgi_error.png", "cycles_1_denoiser.png", "cycles_1_denoiser_error.png"} <= names
    assert len(names) == 1 + 2 * len(outcome["rows"])


def test_compare_without_matplotlib_writes_all_but_the_plot(blend_path, tmp_path, monkeypatch):
    from rtgi_addon.compare import plot
    from rtgi_addon.compare.run import compare_scene

    out = tmp_path / "compared"
    out.mkdir()
    (out / "speed_error.svg").write_text("of an earlier comparison")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    outcome = compare_scene(blend_path, out, ["rsm"], SAMPLES, SIZE, peers=(), cache=out / "references")
    assert {path.name for path in out.iterdir() if path.is_file()} == {
        "compare.html", "compare.csv", "compare.json", "compare.png"}
    assert "plot" not in outcome["files"] and plot.MISSING in (out / "compare.html").read_text(encoding="utf-8")


def test_no_peer_has_a_seed_of_a_reference():
    from rtgi_addon.compare import reference, references

    rounds = 50              # far more than until_quiet ever takes: each adds what the noise so far asks for
    assert reference.PEER_SEED not in {seed + k * references._NEXT_SEEDS for seed in reference.SEEDS for k in range(rounds)}


def test_every_error_of_the_picture_is_measured(compared):
    outcome, _, _ = compared
    for row in outcome["rows"].values():
        assert {"block", "nrmse", "relmse", "block_95", "luminance_bias", "block_after_scale", "ssim"} <= set(
            row["errors"]["picture"])
    assert set(outcome["floors"]) == {"block", "nrmse", "relmse"} and outcome["crossing"]


def test_reference_of_an_asked_noise_is_as_quiet(blend_path, tmp_path):
    from rtgi_addon.compare import reference, references
    from rtgi_addon.compare.measure import noise_of

    scene = reference.open_scene(blend_path)
    rough = noise_of(reference.render_reference(scene, 2, SIZE))["picture"]
    found = references.reference_for(scene, blend_path, SIZE, 2, tmp_path, noise=rough / 3)
    assert noise_of(found)["picture"] <= rough / 3 and found.samples > 10
    again = references.reference_for(scene, blend_path, SIZE, 2, tmp_path, noise=rough / 3)
    assert again.samples == found.samples and again.source == found.source


def test_render_that_is_not_finite_is_an_error_with_its_name(blend_path, tmp_path, monkeypatch):
    from rtgi_addon.compare import reference
    from rtgi_addon.compare.run import compare_scene

    true_render = reference.render_peer

    def broken(*args, **kwargs):
        peer = true_render(*args, **kwargs)
        peer.combined[14, 24, 1] = np.nan
        return peer

    monkeypatch.setattr(reference, "render_peer", broken)
    with pytest.raises(InputError, match=r"Cycles 1 cannot be compared: .* 1 pixels that are not finite"):
        compare_scene(blend_path, tmp_path / "out", ("rsm",), 1, SIZE, peers=(1,), cache=tmp_path)


def test_eevee_is_a_row_or_a_line_that_says_why_not(blend_path, tmp_path):
    from rtgi_addon.compare.run import compare_scene

    outcome = compare_scene(blend_path, tmp_path / "out", ("rsm",), 1, SIZE, peers=(), eevee=True, cache=tmp_path)
    assert ("EEVEE" in outcome["rows"]) != any(note.startswith("EEVEE is left out") for note in outcome["notes"])


def test_blender_that_dies_over_eevee_is_one_line(blend_path, tmp_path):
    from rtgi_addon.compare.eevee import render_eevee

    program = tmp_path / "blender"
    program.write_text("#!/bin/sh\necho no display >&2\nexit 11\n")
    program.chmod(0o755)
    found = render_eevee(blend_path, 1, SIZE, 0, str(program))
    assert "left out" in found and "code 11" in found and "no display" in found


def test_compare_prints_the_table_and_the_stage_times(compared):
    _, _, text = compared
    assert "RTGI" in text and "the reference's own noise" in text and "camera view" in text and "compiling" in text


def test_bounce_brings_the_picture_nearer_to_cycles(compared):
    outcome, _, _ = compared
    errors = {name: row["errors"]["picture"]["block"] for name, row in outcome["rows"].items()}
    assert errors["RTGI"] < errors["direct only"]


def test_direct_light_alone_has_no_bounce(compared):
    outcome, _, _ = compared
    assert outcome["rows"]["direct only"]["errors"]["bounce"]["energy"] == 0


def test_reference_is_rendered_once_for_the_same_scene(compared, blend_path, monkeypatch):
    from rtgi_addon.compare import reference, run

    _, out, _ = compared
    monkeypatch.setattr(reference, "render_reference", lambda *_args: pytest.fail("rendered again"))
    scene = reference.current_scene()
    again = run.reference_for(scene, blend_path, SIZE, SAMPLES, out / "references")
    assert again.shape == SIZE[::-1]


def test_changed_scene_gets_a_new_reference(compared, blend_path, monkeypatch):
    from rtgi_addon.compare import reference, run

    _, out, _ = compared

    class RenderedAgainError(Exception):
        pass

    def render(*_args):
        raise RenderedAgainError

    monkeypatch.setattr(reference, "render_reference", render)
    blend_path.write_bytes(blend_path.read_bytes() + b" ")
    with pytest.raises(RenderedAgainError):
        run.reference_for(reference.current_scene(), blend_path, SIZE, SAMPLES, out / "references")


def test_unknown_technique_is_refused(blend_path, tmp_path):
    from rtgi_addon.compare.run import compare_scene

    with pytest.raises(InputError, match="no technique is called 'photons'"):
        compare_scene(blend_path, tmp_path / "out", techniques=["photons"], samples=1, size=SIZE)


def test_reference_of_another_size_is_refused(compared, blend_path, tmp_path):
    from rtgi_addon.compare.run import compare_scene

    _, out, _ = compared
    (kept,) = (out / "references").iterdir()
    with pytest.raises(InputError, match="choose the same size"):
        compare_scene(blend_path, tmp_path / "out", size=(32, 18), reference=kept)


def test_rendering_with_rtgi_leaves_the_scene_as_it_was(bpy_session, small_scene):
    from rtgi_addon.compare import reference, run

    small_scene.render.engine, small_scene.rtgi.preset, small_scene.rtgi.rsm.rays = "CYCLES", "DRAFT", 7
    own = reference.scene_settings(small_scene)
    render = (small_scene.render.resolution_x, small_scene.render.threads_mode, small_scene.render.engine)
    reference.render_rtgi(small_scene, run.settings_for(own, "QUALITY", ()), SIZE)
    assert reference.scene_settings(small_scene) == own
    assert (small_scene.render.resolution_x, small_scene.render.threads_mode, small_scene.render.engine) == render


def test_same_settings_give_the_same_picture_in_a_comparison(bpy_session, small_scene):
    from rtgi_addon.compare import reference

    own = reference.scene_settings(small_scene)
    first, _ = reference.render_rtgi(small_scene, own, SIZE)
    second, seconds = reference.render_rtgi(small_scene, own, SIZE)
    assert np.array_equal(first.combined, second.combined) and seconds > 0


def test_bench_measures_in_a_process_of_its_own(blend_path, tmp_path, capfd):
    from rtgi_addon.compare.bench import bench

    out = tmp_path / "bench"
    (record,) = bench([blend_path], out, SIZE, repeats=1, samples=2, presets=("DRAFT",), peers=(1,))
    assert record["rtgi"]["DRAFT"]["seconds"] > 0 and record["rtgi"]["DRAFT"]["errors"]["picture"]["block"] < 0.5
    assert record["cycles"]["1"]["errors"]["picture"]["block"] < 0.5
    assert [json.loads(line) for line in (out / "results.jsonl").read_text().splitlines()] == [record]
    assert "| small " in (out / "results.md").read_text() and "| small " in capfd.readouterr().out


def test_bench_of_a_broken_scene_is_one_error(tmp_path):
    from rtgi_addon.compare.bench import bench
    from rtgi_addon.errors import RtgiError

    broken = tmp_path / "broken.blend"
    broken.write_bytes(b"BLENDER-v405 and nothing more")
    with pytest.raises(RtgiError, match="ended with code 1"):
        bench([broken], tmp_path / "bench", SIZE, repeats=1, samples=0)


def test_sweep_measures_goes_on_and_survives_a_point_that_fails(blend_path, tmp_path, capfd):
    from rtgi_addon.compare.sweeps import FILE, sweep

    def run():
        return sweep([blend_path], tmp_path / "out", ("presets",), (32, 18), 2, 2, presets=("DRAFT", "NONE"), threads=1)

    lines = run()
    assert [("seconds" in line, "failed" in line) for line in lines] == [(True, False), (False, True)]
    draft = lines[0]
    assert len(draft["seconds"]) == 2 and draft["stages_ms"]["direct"] and draft["errors"]["picture"]["block"] < 1
    assert "1 of 2: small, presets draft" in capfd.readouterr().err
    again = run()                    # only the failed point is tried once more
    assert again[0] == draft and len((tmp_path / "out" / FILE).read_text().splitlines()) == 3
    said = capfd.readouterr().err
    assert "1 of 2 points are in" in said and "1 of 1: small, presets none: failed" in said


@pytest.mark.parametrize("axis", ["lights", "triangles"])
def test_room_of_a_sweep_holds_what_its_name_says_and_renders(bpy_session, axis):
    from rtgi_addon.compare import reference, rooms, sweeps

    count = {"lights": 3, "triangles": sweeps.TRIANGLES[0]}[axis]
    rooms.ROOMS[axis](count)
    scene = reference.current_scene()
    triangles = sum(len(o.data.loop_triangles) for o in scene.objects if o.name.startswith("Sphere"))
    lamps = [o for o in scene.objects if o.type == "LIGHT"]
    assert len(lamps) == (3 if axis == "lights" else 1) and triangles == (count if axis == "triangles" else 0)
    result, _ = reference.render_rtgi(scene, reference.scene_settings(scene), SIZE)
    assert np.isfinite(result.combined).all() and result.report["plan"]["facts"]["surface_share"] == 1
    assert 0.05 < result.combined[..., :3].mean() < 5


def test_denoised_cycles_is_left_out_where_blender_has_no_denoiser(bpy_session, monkeypatch, capsys):
    from rtgi_addon.compare import reference, run

    assert run.peers_for([1, 4]) == [1, 4]
    monkeypatch.setattr(reference, "has_denoiser", lambda: False)
    assert run.peers_for([1, 4]) == [] and "left out" in capsys.readouterr().err
