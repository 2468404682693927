"""The lines of a sweep as a page in Markdown with plots: speed against error of each scene, then time against work."""

from __future__ import annotations

import os
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..imageio import replacing
from . import pareto
from .fit import PowerLaw, fit_power_law
from .page import PART_COLUMNS
from .plot import MISSING, available, cost_svg, speed_error_svg
from .report import percent, text_table
from .sweeps import AXES, DIRECT, ERROR_AXES, ROOM_AXES

OWN = "balanced"            # the render that stands out in a plot of speed against error: what F12 gives by default
SHARE_OF_FRAME = 0.02       # a stage that never takes more of its frame is in "rest": its time is mostly noise
WORK = {"resolutions": ("Resolution", "pixels"), "lights": ("Lamps", "lamps"), "triangles": ("Triangles", "triangles"),
        "threads": ("Threads", "threads")}
_WORDS = {
    "resolutions": "Work is the number of pixels.",
    "lights": "A grey room with boxes under a growing number of lamps that share the same power.",
    "triangles": "A grey room with sixteen spheres that grow finer; each is a mesh of its own.",
    "threads": "-1 would halve the time with twice the threads, 0 is what does not get faster."}

_SPEED_ERROR = """## Speed against error

Each technique alone on top of direct light, the three presets with what the scene asks for, and Cycles at the same one
bounce. The error is the relative L1 of 8x8 blocks against Cycles with many samples, of the picture and of each kind of light
over that light. The dotted line is what the reference's own noise makes of a perfect picture; an error near it says little.
"No change": the picture is that of direct light alone, since the scene has nothing that the technique adds; it is not in the
plot."""

Line = dict[str, Any]


def seconds(line: Line) -> float:
    """The median of a measurement's frames."""
    return statistics.median(line["seconds"])


def _range(line: Line) -> str:
    return f"{min(line['seconds']):.2f} to {max(line['seconds']):.2f}"


def _size(line: Line) -> str:
    return f"{line['size'][0]}x{line['size'][1]}"


def write_page(lines: Sequence[Line], page: Path, images: Path, head: str) -> None:
    """Write the page and, into the folder `images`, its plots. `lines` are as `sweeps.sweep` returns them."""
    images.mkdir(parents=True, exist_ok=True)
    text, plots = page_text(lines, Path(os.path.relpath(images, page.parent)), head)
    for name, svg in plots.items():
        with replacing(images / name) as partial:
            partial.write_text(svg + "\n", encoding="utf-8")
    with replacing(page) as partial:
        partial.write_text(text, encoding="utf-8")


def page_text(lines: Sequence[Line], images: Path, head: str) -> tuple[str, dict[str, str]]:
    """(the page, {file name: SVG}); `images` is where the page finds them."""
    done = [line for line in lines if "seconds" in line]
    parts, plots = [head.rstrip(), *([] if available() else [MISSING]), *_machines(done)], {}
    scenes = list(dict.fromkeys(line["scene"] for line in done if line["axis"] in ERROR_AXES))
    if scenes:
        parts.append(_SPEED_ERROR)
    for scene in scenes:
        parts += _speed_error(scene, [line for line in done if line["scene"] == scene and line["axis"] in ERROR_AXES],
                              images, plots)
    for axis in WORK:
        of_axis = [line for line in done if line["axis"] == axis]
        if of_axis:
            title, _ = WORK[axis]
            parts.append(f"## {title}\n\n{_WORDS[axis]}")
            groups = [""] if axis in ROOM_AXES else list(dict.fromkeys(line["scene"] for line in of_axis))
            for scene in groups:
                parts += _growth(axis, scene, [line for line in of_axis if scene in ("", line["scene"])], images, plots)
    failed = [line for line in lines if "failed" in line]
    if failed:
        parts.append("## Not measured\n\n" + "\n".join(f"- {line['scene']}, {line['axis']} {line['name']}: {line['failed']}"
                                                       for line in failed))
    return "\n\n".join(parts) + "\n", plots


def _machines(lines: Sequence[Line]) -> list[str]:
    found = dict.fromkeys((line["processor"], *(line["versions"][name] for name in ("blender", "rtgi", "numba", "numpy")))
                          for line in lines)
    threads = max((line["threads"] for line in lines), default=0)
    said = [f"{processor}, {threads} threads; Blender {blender}, RTGI {rtgi}, numba {numba}, numpy {numpy}."
            for processor, blender, rtgi, numba, numpy in found]
    jit_s = sum(line.get("jit_ms", 0.0) for line in lines) / 1e3
    loads = [line["load_average"] for line in lines if line["load_average"] is not None]
    if lines:
        said.append(f"Compiling, {jit_s:.1f} s in all, fell into first frames, which are in no time here."
                    + (f" The machine's load average was {statistics.median(loads):.1f} in the middle of the measurements "
                       f"and {max(loads):.1f} at most." if loads else ""))
    return ["\n".join(said)] if said else []


def _speed_error(scene: str, lines: Sequence[Line], images: Path, plots: dict[str, str]) -> list[str]:
    first = lines[0]
    rows, points = [], []
    direct = next((_block(line) for line in lines if line["name"] == DIRECT), None)
    for line in lines:
        errors = line.get("errors", {})
        has_no_work = line["axis"] == "techniques" and line["name"] != DIRECT and _block(line) == direct
        rows.append([line["name"], f"{seconds(line):.2f}", _range(line),
                     "no change" if has_no_work and direct else percent(_block(line)),
                     *(percent(errors.get(part, {}).get("block")) for part in PART_COLUMNS)])
        if errors and not has_no_work:
            points.append(pareto.Point(line["name"], seconds(line), _block(line), _curve(line)))
    svg = speed_error_svg(points, OWN, first.get("noise"))
    parts = [f"### {scene}, {_size(first)}"]
    if svg:
        name = f"{scene}_speed_error.svg"
        plots[name] = svg
        parts.append(f"![Speed against error of {scene}]({(images / name).as_posix()})")
    parts.append(text_table(("", "seconds", "lowest to highest", "picture", *PART_COLUMNS), rows, True))
    own = next((point for point in points if point.name == OWN), None)
    if own is not None:
        parts.append("\n".join(pareto.words(own, points)))
    return parts


def _block(line: Line) -> float | None:
    """The picture's error, None where it was not measured."""
    return line.get("errors", {}).get("picture", {}).get("block")


def _curve(line: Line) -> str:
    return "" if not line["cycles"] else "Cycles + denoiser" if line["denoise"] else "Cycles"


def stage_table(lines: Sequence[Line]) -> dict[str, list[float]]:
    """Median ms by name, an entry a line: "total", the stages of some weight, and "rest" for all that is in none of them."""
    total = [1e3 * seconds(line) for line in lines]
    names = dict.fromkeys(name for line in lines for name in line["stages_ms"])
    medians = {name: [statistics.median(line["stages_ms"].get(name, [0.0])) for line in lines] for name in names}
    kept = {name: ms for name, ms in medians.items()
            if any(part > SHARE_OF_FRAME * whole for part, whole in zip(ms, total, strict=True))}
    rest = [whole - sum(ms[i] for ms in kept.values()) for i, whole in enumerate(total)]
    return {"total": total, **kept, "rest": rest}


def _growth(axis: str, scene: str, lines: Sequence[Line], images: Path, plots: dict[str, str]) -> list[str]:
    lines = sorted(lines, key=lambda line: line["work"])
    work = [line["work"] for line in lines]
    table = stage_table(lines)
    fits = {name: fit_power_law(work, ms) for name, ms in table.items()}
    last = {name: fit_power_law(work[-2:], ms[-2:]) for name, ms in table.items()}
    _, unit = WORK[axis]
    rows = [[line["name"], _range(line), *(f"{ms[i]:.0f}" if ms[i] >= 10 else f"{ms[i]:.1f}" for ms in table.values())]
            for i, line in enumerate(lines)]
    rows += [["exponent", "", *(_exponent(law) for law in fits.values())]]
    if len(lines) > 2:
        rows.append(["of the last step", "", *(_exponent(law) for law in last.values())])
    named = {f"{name}, exponent {law.exponent:z.2f}": table[name] for name, law in fits.items() if law is not None}
    title = scene or f"A room, {_size(lines[0])}"
    if scene and axis != "resolutions":
        title += f", {_size(lines[0])}"
    svg = cost_svg(f"{title}: time against {unit}", unit, work, named) if len(lines) > 2 else ""
    parts = [f"### {title}"] if scene or axis in ROOM_AXES else []
    if svg:
        name = f"{scene + '_' if scene else ''}{axis}.svg"
        plots[name] = svg
        parts.append(f"![{title}: time against {unit}]({(images / name).as_posix()})")
    parts.append(text_table((unit, "seconds, lowest to highest", *(f"{name} (ms)" for name in table)), rows, True))
    return parts


def _exponent(law: PowerLaw | None) -> str:
    return "-" if law is None else str(law)


HEAD = """# Benchmarks

Made by `{command}` from its measurements; nothing here is typed. A time is the median of {repeats} whole F12s by the wall
clock, after one that is not timed, with sessions kept as in an animation; the lowest and the highest stand beside it.

How time grows with work is fitted as a power law, time = factor work^exponent, by least squares in logarithms over the
medians. Exponent 1 is proportional, 0 is no growth. The number after the \u00b1 is the exponent's standard error: it tells
noise, and how far growth is from a power law. A fixed cost beside a growing one bends the line; the exponent of the last
step is then the nearer to what larger scenes cost. "rest" is the frame less the stages beside it: Blender's own work,
composite, small stages. In the plots the dotted line is proportional growth.
"""


def summary(lines: Sequence[Line]) -> str:
    """For the terminal: the fitted exponents of whole frames, and how many points failed."""
    said = []
    for axis in AXES:
        of_axis = [line for line in lines if line["axis"] == axis and "seconds" in line and line["work"]]
        for scene in [""] if axis in ROOM_AXES else list(dict.fromkeys(line["scene"] for line in of_axis)):
            group = sorted((line for line in of_axis if scene in ("", line["scene"])), key=lambda line: line["work"])
            law = fit_power_law([line["work"] for line in group], [seconds(line) for line in group]) if group else None
            if law is not None:
                said.append(f"{scene or 'a room'}: time grows with {WORK[axis][1]} to the power {law}")
    failed = sum("failed" in line for line in lines)
    return "\n".join([*said, *([f"points that failed: {failed}"] if failed else [])])
