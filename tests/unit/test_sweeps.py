"""Sweeps without Blender: which points there are, what is measured again, progress, and the page."""

import dataclasses
import json
import re
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from rtgi_addon import cli
from rtgi_addon.compare import plot, progress, sweep_page, sweeps
from rtgi_addon.core.techniques import ALWAYS_ON, TECHNIQUE_PARAMS
from rtgi_addon.errors import InputError

MACHINE = {"processor": "a processor", "sources": "abc",
           "versions": {"rtgi": "0", "python": "3", "numpy": "2", "numba": "0", "embree": "", "blender": "5"}}
SCENES = ("room", "hall")


def points(axis, scene="room", **how):
    return sweeps.points_of(axis, scene, "digest of " + scene, **{"threads": 4, **how})


def line_of(point, **what):
    """A measured line; time is 0.1 s plus 1 ms for each unit of work."""
    seconds = 0.1 + 1e-3 * point.work
    measured = {"seconds": [seconds, seconds, 2 * seconds], "jit_ms": 500.0, "ran": [], "load_average": 0.5,
                "stages_ms": {"fixed": [90.0] * 3, "growing": [float(point.work)] * 3}}
    if point.samples:
        block = 0.3 if point.axis == "techniques" and point.name in (sweeps.DIRECT, "hbao") else 0.02
        measured |= {"errors": {"picture": {"block": block}, "direct": {"block": 0.01}}, "noise": 0.005}
    key = sweeps.key_of(point, MACHINE)
    return json.loads(json.dumps({"key": key, **dataclasses.asdict(point), **MACHINE, **measured, **what}))


def test_techniques_are_direct_light_and_each_other_one_alone():
    found = points("techniques")
    assert found[0].techniques == () and {p.name for p in found[1:]} == set(TECHNIQUE_PARAMS) - set(ALWAYS_ON)
    assert all(p.techniques == (p.name,) for p in found[1:])


def test_every_axis_has_points_that_differ():
    for axis in sweeps.AXES:
        found = points(axis)
        assert len(found) > 1 and len({sweeps.key_of(point, MACHINE) for point in found}) == len(found)


def test_only_some_axes_have_errors_and_the_others_have_growing_work():
    for axis in sweeps.AXES:
        found = points(axis, samples=16)
        if axis in sweeps.ERROR_AXES:
            assert all(point.samples == 16 for point in found)
        else:
            work = [point.work for point in found]
            assert all(point.samples == 0 for point in found) and work == sorted(set(work)) and work[0] > 0


@pytest.mark.parametrize(("most", "counts"), [(1, [1]), (2, [1, 2]), (6, [1, 2, 4, 6]), (8, [1, 2, 4, 8])])
def test_threads_double_up_to_the_machine(most, counts):
    assert sweeps.thread_counts(most) == counts


def test_measured_point_is_not_pending_and_a_changed_setting_is():
    found = points("resolutions")
    lines = {line["key"]: line for line in map(line_of, found[:2])}
    assert sweeps.pending(found, MACHINE, lines) == found[2:]
    changed = [dataclasses.replace(point, repeats=point.repeats + 1) for point in found]
    assert sweeps.pending(changed, MACHINE, lines) == changed


@pytest.mark.parametrize("what", ["processor", "sources", "versions"])
def test_another_machine_version_or_source_is_measured_anew(what):
    found = points("presets")
    lines = {line["key"]: line for line in map(line_of, found)}
    assert sweeps.pending(found, {**MACHINE, what: "another"}, lines) == found


def test_changed_scene_is_measured_anew():
    lines = {line["key"]: line for line in map(line_of, points("presets"))}
    changed = sweeps.points_of("presets", "room", "another digest", threads=4)
    assert sweeps.pending(changed, MACHINE, lines) == changed


def test_failed_point_is_tried_again():
    (point, *_) = points("presets")
    key = sweeps.key_of(point, MACHINE)
    assert sweeps.pending([point], MACHINE, {key: {"key": key, "failed": "no memory"}}) == [point]


def test_half_written_line_is_no_measurement_and_spoils_none(tmp_path):
    path = tmp_path / sweeps.FILE
    first, second, third = points("presets")
    sweeps._append(path, first, MACHINE, {"seconds": [1.0]})
    with path.open("a") as file:
        file.write('{"key": "' + sweeps.key_of(second, MACHINE))
    sweeps._append(path, third, MACHINE, {"seconds": [2.0]})
    assert sweeps.pending([first, second, third], MACHINE, sweeps.read_lines(path)) == [second]


def test_only_axes_with_errors_depend_on_the_reference():
    for axis in sweeps.AXES:
        same = points(axis, samples=4, given="a.npz") == points(axis, samples=4, given="b.npz")
        assert same == (axis not in sweeps.ERROR_AXES)


def test_last_line_of_a_key_stands(tmp_path):
    path = tmp_path / sweeps.FILE
    (point, *_) = points("presets")
    sweeps._append(path, point, MACHINE, {"failed": "no memory"})
    sweeps._append(path, point, MACHINE, {"seconds": [1.0]})
    (line,) = sweeps.read_lines(path).values()
    assert line["seconds"] == [1.0] and "failed" not in line


def test_sources_hash_sees_a_kernel_and_not_a_page(monkeypatch):
    read, before = Path.read_bytes, sweeps.sources_hash()

    def edited(name):
        monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b"#" * (path.name == name))
        return sweeps.sources_hash.__wrapped__()

    assert edited("sweep_page.py") == edited("panels.py") == before
    assert len({before, *map(edited, ("bvh.py", "planner.py", "metrics.py", "techniques.py"))}) == 5


def test_time_left_is_the_mean_so_far_for_each_that_is_left(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    counted = progress.Progress(4)
    now[0] += 10
    assert counted.step("first") == "1 of 4: first; about 0:30 left"
    now[0] += 20
    assert counted.step("second") == "2 of 4: second; about 0:30 left"
    again = progress.Progress(counted.total, counted.done, counted.spent_s)     # another process goes on
    now[0] += 30
    assert again.step("third") == "3 of 4: third; about 0:20 left"
    assert again.step("last") == "4 of 4: last"


@pytest.mark.parametrize("words", ["light", "lights,", "all,lights"])
def test_unknown_sweep_is_one_line_with_the_known_ones(capsys, tmp_path, words):
    code = cli.main(["bench", "-o", str(tmp_path / "out"), "--sweep", words])
    (line,) = capsys.readouterr().err.splitlines()
    assert code == 2 and "no sweep is called" in line and "techniques, presets" in line and not (tmp_path / "out").exists()


def test_words_of_sweeps_are_names_or_all():
    assert cli.parse_axes("Lights, threads,lights") == ["lights", "threads"] and cli.parse_axes("all") == list(sweeps.AXES)


def test_help_names_every_sweep(capsys):
    assert cli.main(["bench", "--help"]) == 0
    said = capsys.readouterr().out
    assert all(f"  {axis} " in said and what in said for axis, what in sweeps.AXES.items())


def all_lines():
    found = [point for scene in SCENES for axis in sweeps.AXES if axis not in sweeps.ROOM_AXES
             for point in points(axis, scene, samples=8)]
    return [line_of(point) for point in [*found, *(point for axis in sweeps.ROOM_AXES for point in points(axis, ""))]]


def test_page_has_a_plot_for_each_scene_and_each_growth_and_links_them():
    text, plots = sweep_page.page_text(all_lines(), Path("images"), "# Benchmarks\n")
    wanted = {f"{scene}_{what}.svg" for scene in SCENES for what in ("speed_error", "resolutions", "threads")}
    assert set(plots) == wanted | {"lights.svg", "triangles.svg"}
    assert set(re.findall(r"\]\(images/([^)]*)\)", text)) == set(plots)
    for svg in plots.values():
        ElementTree.fromstring(svg)


def test_page_holds_median_range_and_the_fitted_exponents():
    text, _ = sweep_page.page_text([line_of(point) for point in points("lights", "")], Path("images"), "# Benchmarks\n")
    (row,) = re.findall(r"^\| 32 .*", text, re.M)
    assert "0.13 to 0.26" in row and "| 132 " in re.sub(" +", " ", row) and re.search(r"\| +32 \|", row)
    (exponents,) = re.findall(r"^\| exponent .*", text, re.M)
    assert re.search(r"1\.00 ± 0\.00", exponents)      # of "growing"
    assert re.search(r"0\.00 ± 0\.00", exponents)      # of "fixed"


def test_technique_that_changes_nothing_is_named_and_not_in_the_plot():
    text, plots = sweep_page.page_text([line_of(p) for p in points("techniques", samples=8)], Path("images"), "# B\n")
    (row,) = re.findall(r"^\| hbao .*", text, re.M)
    assert "no change" in row and "hbao" not in plots["room_speed_error.svg"] and "rsm" in plots["room_speed_error.svg"]


def test_page_says_how_long_compiling_took_and_what_failed():
    good, bad = points("presets", samples=8)[:2]
    failed = {**line_of(bad), "failed": "no memory"}
    del failed["seconds"]
    text, _ = sweep_page.page_text([line_of(good), failed], Path("images"), "# Benchmarks\n")
    assert "Compiling, 0.5 s in all" in text and "room, presets balanced: no memory" in text


def test_page_of_nothing_but_failures_is_a_page(tmp_path):
    failed = {name: value for name, value in line_of(points("presets")[0]).items() if name != "seconds"} | {"failed": "no"}
    sweep_page.write_page([failed], tmp_path / "page.md", tmp_path / "plots", "# Benchmarks\n")
    assert "## Not measured" in (tmp_path / "page.md").read_text()
    assert "points that failed: 1" in sweep_page.summary([failed])


def test_small_stages_are_in_the_rest_and_all_adds_up():
    line = line_of(points("lights", "")[0], seconds=[0.1], stages_ms={"large": [60.0], "small": [1.0]})
    assert sweep_page.stage_table([line]) == {"total": [100.0], "large": [60.0], "rest": [40.0]}


def test_page_without_matplotlib_has_its_tables_and_says_what_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    text, plots = sweep_page.page_text(all_lines(), Path("images"), "# Benchmarks\n")
    assert plots == {} and "![" not in text and text.count(plot.MISSING) == 1
    assert "### room, " in text and "| exponent " in text


def test_bad_scenes_repeats_and_axes_are_refused_before_anything_is_written(tmp_path, monkeypatch):
    scene = tmp_path / "a.blend"
    scene.write_bytes(b"BLENDER17-01v0502REND")
    for scenes, axes, repeats, said in [((tmp_path / "none.blend",), ("threads",), 1, "there is no file"),
                                        ((), ("threads",), 1, "no scene was named"),
                                        ((scene,), ("threads",), 0, "repeats must be 1"), ((scene,), ("x",), 1, "no sweep")]:
        with pytest.raises(InputError, match=said):
            sweeps.sweep(scenes, tmp_path / "out", axes, repeats=repeats)
    assert not (tmp_path / "out").exists()
