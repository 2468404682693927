"""Plots as SVG, all axes in logarithms: speed against error with the Pareto front, and time against amount of work.

Drawn by matplotlib, which Blender does not bring: `available` tells whether there is one, and `MISSING` what to say where
there is none. A plot is dark on white, so that it can be read on a page of any colour and alone; its text stays text. The
same numbers give the same bytes: no setting of the user's matplotlib is read, and none is left changed. Points are told
apart by shape as well as by colour.
"""

from __future__ import annotations

import io
import itertools
import logging
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any
from xml.dom import minidom

from .pareto import Point, crossing_point, pareto_front

MISSING = ("The plot needs matplotlib, which Blender does not bring. rtgi compare and rtgi bench draw it outside Blender, "
           "by python -m rtgi_addon in the environment that ./demo sets up, or in any other after pip install matplotlib.")
_WIDTH_PX, _HEIGHT_PX = 900, 480
_PX_PER_INCH = 96           # of CSS
_STYLE = {
    # the font that matplotlib carries measures the same on every machine; the other is for a browser without it
    "font.family": ["DejaVu Sans", "sans-serif"], "font.sans-serif": ["DejaVu Sans"], "font.size": 9.5,
    "svg.fonttype": "none", "text.parse_math": False,
    "axes.grid": True, "axes.edgecolor": "#999", "grid.color": "#ddd", "text.color": "#222",
    "xtick.color": "#222", "ytick.color": "#222", "axes.labelcolor": "#222", "axes.axisbelow": True, "legend.frameon": False,
    "figure.dpi": 72}       # an SVG's unit is a point, so that labels are measured in it
_INK, _OWN, _OTHER = "#222", "#2a5bd7", "#7b6fa8"
_CURVE_LOOKS = (("#c2571a", "s"), ("#1c7c54", "D"))         # (colour, marker)
_FRONT_LOOK = {"color": _INK, "alpha": 0.3, "linewidth": 5, "solid_capstyle": "butt"}
_MARKER_PT = 4              # half a marker's width
# where a label may stand, as directions from its point and distances in points; beyond the first a line leads to the point
_DIRECTIONS = ((1, 1), (-1, -1), (1, -1), (-1, 1), (0, 1.3), (0, -1.3), (1.3, 0), (-1.3, 0))
_DISTANCES_PT = (6, 18, 32, 48)
_SIDES = {1: "left", 0: "center", -1: "right"}
_HEIGHTS = {1: "bottom", 0: "center", -1: "top"}


def _matplotlib() -> ModuleType | None:
    """matplotlib with the parts that are used here; None where it is not installed."""
    log = logging.getLogger("matplotlib")
    level = log.level
    # a home that cannot be written, or the first look at the system's fonts: it helps itself, and warns of it
    log.setLevel(logging.ERROR)
    try:
        import matplotlib.figure
        import matplotlib.style
        import matplotlib.ticker
    except ImportError:
        return None
    finally:
        log.setLevel(level)
    return matplotlib


def available() -> bool:
    """Whether plots can be drawn here."""
    return _matplotlib() is not None


def _svg(title: str, draw: Callable[[ModuleType, Any], dict[str, str]]) -> str:
    """SVG text of what `draw` puts on a figure, matplotlib and the figure given; it returns hover texts by artists' gid.

    "" where matplotlib is missing.
    """
    matplotlib = _matplotlib()
    if matplotlib is None:
        return ""
    written = io.BytesIO()
    # ids are hashes, salted so that the plots of one page share none
    with matplotlib.style.context({**_STYLE, "svg.hashsalt": title}, after_reset=True):
        figure = matplotlib.figure.Figure((_WIDTH_PX / _PX_PER_INCH, _HEIGHT_PX / _PX_PER_INCH), layout="constrained")
        hover = draw(matplotlib, figure)
        figure.savefig(written, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    return _inline(written.getvalue(), title, hover)


def _inline(svg: bytes, title: str, hover: Mapping[str, str]) -> str:
    """matplotlib's SVG fit to stand inside HTML: no head, no style for the whole page, groups with hover texts, not ids."""
    document = minidom.parseString(svg)
    root = document.documentElement

    def entitle(element: minidom.Element, text: str) -> None:
        node = document.createElement("title")
        node.appendChild(document.createTextNode(text))
        element.insertBefore(node, element.firstChild)

    for style in root.getElementsByTagName("style"):
        style.parentNode.removeChild(style)
    root.setAttribute("style", "stroke-linejoin: round; stroke-linecap: butt")      # what the style said, by inheritance
    root.setAttribute("role", "img")
    for group in root.getElementsByTagName("g"):
        if group.getAttribute("id") in hover:
            entitle(group, hover[group.getAttribute("id")])
        if group.hasAttribute("id"):
            group.removeAttribute("id")             # "axes_1" in every plot
    entitle(root, title)
    return root.toxml()


def _log_axes(matplotlib: ModuleType, figure: Any, x_title: str, y_title: str, x_text: Any, y_text: Any) -> Any:
    """Axes in logarithms with numbers at 1, 2, 5, by `x_text` and `y_text`: format strings, functions, formatters."""
    axes = figure.add_subplot()
    axes.margins(0.08)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set(xscale="log", yscale="log", xlabel=x_title, ylabel=y_title)
    for axis, text in ((axes.xaxis, x_text), (axes.yaxis, y_text)):
        axis.set_major_locator(matplotlib.ticker.LogLocator(subs=(1, 2, 5)))
        axis.set_minor_locator(matplotlib.ticker.NullLocator())
        axis.set_major_formatter(text)
        axis.set_tick_params(length=0)
    return axes


# ---- speed against error ----

def _label(point: Point) -> str:
    """What stands beside a point: of a curve only its setting, since the legend names the curve."""
    return point.name.removeprefix("Cycles ").removesuffix(" + denoiser") if point.curve else point.name


def _place(matplotlib: ModuleType, axes: Any, wanted: Sequence[tuple[float, float, str]]) -> None:
    """Labels near their points (x, y, text), each at the first place where it covers no marker, no curve and no other label.

    One without such a place, and one without text, is left out.
    """
    axes.figure.draw_without_rendering()            # places are known only now
    at = axes.transData.transform([(x, y) for x, y, _ in wanted])
    taken = [matplotlib.transforms.Bbox.from_extents(x - _MARKER_PT, y - _MARKER_PT, x + _MARKER_PT, y + _MARKER_PT)
             for x, y in at]
    lines = [line.get_transform().transform_path(line.get_path()) for line in axes.lines]
    for x, y, text in wanted:
        if not text:
            continue
        note = axes.annotate(text, (x, y), (0, 0), textcoords="offset points", in_layout=False, zorder=4,
                             bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.7},
                             arrowprops={"arrowstyle": "-", "color": "#888", "linewidth": 0.7, "shrinkA": 0, "shrinkB": 4})
        for distance, (dx, dy) in itertools.product(_DISTANCES_PT, _DIRECTIONS):
            note.set(position=(dx * distance, dy * distance), horizontalalignment=_SIDES[round(dx)],
                     verticalalignment=_HEIGHTS[round(dy)])
            note.arrow_patch.set_visible(distance > _DISTANCES_PT[0])
            note.get_window_extent()                # moves it there; with the line to its point
            box = matplotlib.text.Text.get_window_extent(note)
            if (axes.bbox.containsx(box.x0) and axes.bbox.containsx(box.x1) and axes.bbox.containsy(box.y0)
                    and axes.bbox.containsy(box.y1) and not box.count_overlaps(taken)
                    and not any(line.intersects_bbox(box, filled=False) for line in lines)):
                taken.append(box)
                break
        else:
            note.remove()


def speed_error_svg(points: Sequence[Point], own: str, noise: float | None = None) -> str:
    """SVG text; "" without a point that logarithms can show, or without matplotlib.

    `own` names the point that stands out, from which a dashed line leads to where each curve has come down to its error;
    `noise` is the error that the reference's own noise gives.
    """
    shown = [p for p in points if p.seconds > 0 and p.error > 0]
    if not shown:
        return ""

    def draw(matplotlib: ModuleType, figure: Any) -> dict[str, str]:
        axes = _log_axes(matplotlib, figure, "seconds a frame", "error of the picture", "{x:g}",
                         lambda error, _: f"{100 * error:g} %")
        wanted, hover = [], {}
        mine = next((p for p in shown if p.name == own), None)
        looks = dict(zip(dict.fromkeys(p.curve for p in shown if p.curve), itertools.cycle(_CURVE_LOOKS), strict=False))
        for name, (colour, marker) in looks.items():
            curve = sorted((p for p in shown if p.curve == name), key=lambda p: p.seconds)
            axes.plot([p.seconds for p in curve], [p.error for p in curve], color=colour, marker=marker,
                      label=f"{name}, samples beside it")
            found = crossing_point(mine, curve, name) if mine is not None else None
            if found is not None:
                seconds, said = found
                axes.plot([mine.seconds, seconds], [mine.error] * 2, color=_OWN, linestyle="--", linewidth=1, zorder=2)
                axes.plot(seconds, mine.error, color=colour, marker="x", markeredgewidth=2, markersize=8, zorder=3,
                          linestyle="none", label=said)
                wanted.append((seconds, mine.error, ""))
        # the own one first, so that its name stands nearest
        for number, point in enumerate(sorted(shown, key=lambda p: p.name != own)):
            colour, marker, size = *looks.get(point.curve, (_OTHER, "o")), 1.5 * _MARKER_PT
            if point.name == own and not point.curve:
                colour, marker, size = _OWN, "*", 3.5 * _MARKER_PT
            gid = f"point {number}"
            axes.plot(point.seconds, point.error, color=colour, marker=marker, markersize=size, gid=gid,
                      zorder=3.5 if point.name == own else 3)
            hover[gid] = f"{point.name}: {point.seconds:.3g} s, {100 * point.error:.3g} %"
            wanted.append((point.seconds, point.error, _label(point)))
        if noise:
            axes.axhline(noise, color=_INK, linestyle=":", linewidth=1, label="noise of the reference")
        front = pareto_front(shown)
        end = axes.get_xlim()[1]
        axes.plot([*(p.seconds for p in front), end], [*(p.error for p in front), front[-1].error], drawstyle="steps-post",
                  label="Pareto front", scalex=False, **_FRONT_LOOK)
        # above the axes, so that no point lies below it, in two rows: what a curve comes to stands below its name
        figure.legend(loc="outside upper right", ncols=-(-len(axes.get_legend_handles_labels()[0]) // 2))
        _place(matplotlib, axes, wanted)
        return hover

    return _svg("Speed against error", draw)


# ---- time against work ----

_SERIES_LOOKS = ((_INK, "o"), ("#2a5bd7", "s"), ("#c2571a", "D"), ("#1c7c54", "^"), ("#a03a8c", "v"), ("#8a7a00", "p"),
                 ("#0f8296", "X"), ("#b03030", "h"))        # (colour, marker), at most as many lines


def cost_svg(title: str, work_title: str, work: Sequence[float], series: Mapping[str, Sequence[float]]) -> str:
    """SVG text of times in ms against work, a line a name.

    "" without two amounts of work, a time above zero, or matplotlib. The first of `series` is the one that stands out, and
    where it starts so does a dotted line of proportional growth. Of the others those with the longest times are drawn.
    """
    shown = {name: ms for name, ms in series.items() if min(ms) > 0}
    names = [*list(shown)[:1], *sorted(list(shown)[1:], key=lambda name: -max(shown[name]))][:len(_SERIES_LOOKS)]
    if not names or len(set(work)) < 2:
        return ""

    def draw(matplotlib: ModuleType, figure: Any) -> dict[str, str]:
        axes = _log_axes(matplotlib, figure, work_title, "ms a frame", matplotlib.ticker.EngFormatter(sep=""), "{x:g}")
        handles, hover = {}, {}
        for name, (colour, marker) in zip(names, _SERIES_LOOKS, strict=False):
            wide = 2.5 if name == names[0] else 1.3
            (handles[name],) = axes.plot(work, shown[name], color=colour, marker=marker, markersize=5, linewidth=wide,
                                         label=name)
            for w, ms in zip(work, shown[name], strict=True):
                gid = f"point {len(hover)}"
                axes.plot(w, ms, color=colour, marker=marker, markersize=5, gid=gid)
                hover[gid] = f"{name}: {ms:.3g} ms at {w:g}"
        start = shown[names[0]][0]
        (growth,) = axes.plot([work[0], work[-1]], [start, start * work[-1] / work[0]], color=_INK, linestyle=":",
                              linewidth=1, scaley=False, label="proportional growth")
        # from top to bottom as the lines end
        figure.legend(handles=[*sorted(handles.values(), key=lambda line: -line.get_ydata()[-1]), growth],
                      loc="outside right upper")
        return hover

    return _svg(title, draw)
