"""The plots: what stands in them and where, that they can stand in a page, and what there is without matplotlib."""

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from rtgi_addon.compare import plot
from rtgi_addon.compare.pareto import Point, pareto_front
from rtgi_addon.compare.plot import cost_svg, speed_error_svg

SVG = "{http://www.w3.org/2000/svg}"
# error falls with the root of time: 8 % / sqrt(samples)
CYCLES = [Point(f"Cycles {n}", 0.5 * n, 0.08 / n**0.5, "Cycles") for n in (1, 4, 16)]
DENOISED = [Point(f"Cycles {n} + denoiser", 0.6 * n, 0.05 / n**0.5, "Cycles + denoiser") for n in (1, 4)]
ALL = [Point("RTGI", 0.5, 0.03), Point("direct only", 0.3, 0.2), Point("slow", 9.0, 0.09), *CYCLES, *DENOISED]


def texts(svg):
    """The words in a plot, in order."""
    return [node.text for node in ElementTree.fromstring(svg).iter(SVG + "text")]


def markers(svg):
    """{hover text: (x, y, path of the marker)} of the points."""
    root, found = ElementTree.fromstring(svg), {}
    shapes = {node.get("id"): node.get("d") for node in root.iter(SVG + "path") if node.get("id")}
    for group in root.iter(SVG + "g"):
        if group.find(SVG + "title") is not None:
            use = next(group.iter(SVG + "use"))
            shape = shapes[use.get("{http://www.w3.org/1999/xlink}href")[1:]]
            found[group.find(SVG + "title").text] = float(use.get("x")), float(use.get("y")), shape
    return found


def paths(svg):
    """Points (n, 2) of every line of straight pieces."""
    return [np.array(re.findall(r"[ML] (\S+) (\S+)", node.get("d", "")), float)
            for node in ElementTree.fromstring(svg).iter(SVG + "path")]


def settings():
    """matplotlib's; all but the backend, which is chosen when it is looked at."""
    return {name: matplotlib.rcParams[name] for name in matplotlib.rcParams if name != "backend"}


def test_every_point_has_its_label_and_its_numbers_for_the_pointer():
    svg = speed_error_svg(ALL, "RTGI", 0.01)
    assert {"RTGI", "direct only", "slow", "1", "4", "16"} <= set(texts(svg))       # of curves the samples
    assert "RTGI: 0.5 s, 3 %" in markers(svg) and len(markers(svg)) == len(ALL)


def test_legend_names_curves_front_noise_and_where_each_curve_crosses():
    said = texts(speed_error_svg(ALL, "RTGI", 0.01))
    assert {"Cycles, samples beside it", "Cycles + denoiser, samples beside it"} <= set(said)
    assert {"Pareto front", "noise of the reference"} <= set(said)
    # 0.08 / sqrt(2 t) = 0.03 and 0.05 / sqrt(t / 0.6) = 0.03
    assert {"Cycles at equal error: 3.6 s, 7.1\u00d7", "Cycles + denoiser at equal error: 1.7 s, 3.3\u00d7"} <= set(said)


def test_no_crossing_is_drawn_beyond_a_curve():
    said = texts(speed_error_svg([Point("RTGI", 0.5, 0.001), *CYCLES], "RTGI"))
    assert not any("equal error" in text for text in said)


def test_faster_point_is_to_the_left_and_nearer_one_below():
    found = markers(speed_error_svg([Point("a", 1, 0.1), Point("b", 10, 0.01)], "none"))
    (ax, ay, _), (bx, by, _) = found["a: 1 s, 10 %"], found["b: 10 s, 1 %"]
    assert ax < bx and ay < by


def test_front_is_a_staircase_through_its_points():
    svg = speed_error_svg(ALL, "RTGI")
    found = markers(svg)
    front = [found[f"{p.name}: {p.seconds:.3g} s, {100 * p.error:.3g} %"][:2] for p in pareto_front(ALL)]
    # straight on to the time of the next point, then down to it
    corners = [front[0]] + [corner for a, b in zip(front, front[1:], strict=False) for corner in ((b[0], a[1]), b)]
    stairs = [path[:len(corners)] for path in paths(svg) if len(path) > len(corners)]      # and on to the right edge
    assert any(np.allclose(path, corners, atol=1e-5) for path in stairs)           # six digits are written


def test_own_point_and_each_curve_have_a_shape_of_their_own():
    found = markers(speed_error_svg(ALL, "RTGI"))
    shapes = [next(shape for said, (_, _, shape) in found.items() if said.startswith(start))
              for start in ("RTGI:", "slow:", "Cycles 4:", "Cycles 4 + denoiser:")]
    assert len(set(shapes)) == len(shapes)


def test_labels_of_crowded_points_do_not_cover_each_other(monkeypatch):
    rng = np.random.default_rng(3)
    crowd = [Point(f"technique {n}", *np.exp(rng.normal(0, 0.15, 2)) * (0.5, 0.05)) for n in range(12)]
    boxes, save = [], Figure.savefig

    def looked_at(figure, *args, **how):
        boxes.extend(Text.get_window_extent(note) for note in figure.axes[0].texts)
        return save(figure, *args, **how)

    monkeypatch.setattr(Figure, "savefig", looked_at)
    speed_error_svg(crowd, "technique 0")
    assert len(boxes) == len(crowd)
    assert all(box.count_overlaps(boxes[:number]) == 0 for number, box in enumerate(boxes))


@pytest.mark.parametrize("name", ["<a & b>", "$a$"])
def test_names_that_look_like_markup_are_text(name):
    assert name in texts(speed_error_svg([Point(name, 1, 0.1)], name))


@pytest.mark.parametrize("points", [[], [Point("perfect", 1.0, 0.0)]])
def test_plot_of_nothing_that_logarithms_can_show_is_empty(points):
    assert speed_error_svg(points, "RTGI") == ""


def test_cost_plot_names_every_line_and_proportional_growth():
    svg = cost_svg("<a & b>", "lamps", [1, 10, 100], {"total": [10, 20, 110], "stage": [1, 10, 100], "gone": [0, 0, 0]})
    said = texts(svg)
    assert {"total", "stage", "lamps", "proportional growth"} <= set(said) and "gone" not in said
    assert said.index("total") < said.index("stage")           # as the lines end
    found = markers(svg)
    assert len(found) == 6 and "stage: 10 ms at 10" in found
    # ten times the lamps are as far to the right as ten times the milliseconds are far up: once a decade each
    (x0, y0, shape), (x1, y1, _) = found["stage: 1 ms at 1"], found["stage: 10 ms at 10"]
    (_, t0, other), (_, t1, _) = found["total: 10 ms at 1"], found["total: 20 ms at 10"]
    assert x1 > x0 and (t0 - t1) / (y0 - y1) == pytest.approx(np.log10(2), abs=1e-3) and shape != other


@pytest.mark.parametrize(("work", "series"), [([1], {"total": [1.0]}), ([1, 2], {}), ([1, 2], {"total": [0.0, 1.0]})])
def test_cost_plot_of_no_growth_is_empty(work, series):
    assert cost_svg("nothing", "lamps", work, series) == ""


def test_plot_can_stand_inside_a_page():
    svg = speed_error_svg(ALL, "RTGI", 0.01)
    assert svg.startswith("<svg ") and "<style" not in svg and "<metadata" not in svg and "<!" not in svg
    root = ElementTree.fromstring(svg)
    assert root.get("role") == "img" and root.find(SVG + "title").text == "Speed against error"


def test_plots_of_one_page_share_no_id():
    work, series = [1, 10], {"total": [10, 20]}
    ids = [set(re.findall(r' id="([^"]*)"', cost_svg(title, "lamps", work, series))) for title in ("one room", "another")]
    assert ids[0] and not ids[0] & ids[1]


def test_same_numbers_give_the_same_bytes_whatever_the_users_settings_are_and_leave_them():
    first = speed_error_svg(ALL, "RTGI", 0.01)
    with matplotlib.rc_context({"lines.linewidth": 9, "font.size": 30, "axes.facecolor": "red"}):
        before = settings()
        assert speed_error_svg(ALL, "RTGI", 0.01) == first
        assert settings() == before


def test_without_matplotlib_there_is_no_plot_and_no_error(monkeypatch):
    assert plot.available()
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert not plot.available() and speed_error_svg(ALL, "RTGI") == ""
    assert cost_svg("t", "lamps", [1, 10], {"total": [10, 20]}) == ""


def test_home_that_cannot_be_written_is_no_matter_and_gives_no_word(tmp_path):
    # a file where matplotlib's folders would be: they cannot be made, not even by root
    home = tmp_path / "home"
    home.write_text("")
    folders = ("MPLCONFIGDIR", "XDG_CONFIG_HOME", "XDG_CACHE_HOME")
    environment = {name: value for name, value in os.environ.items() if name not in folders} | {"HOME": str(home)}
    code = ("import sys; from rtgi_addon.compare import plot; from rtgi_addon.compare.pareto import Point\n"
            "print(plot.speed_error_svg([Point('a', 1.0, 0.1)], 'a')[:5], 'matplotlib.pyplot' in sys.modules)")
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True,
                          cwd=Path(plot.__file__).parents[2], timeout=120)
    assert (done.returncode, done.stdout.strip(), done.stderr) == (0, "<svg  False", "")
