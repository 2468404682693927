"""`rtgi bench --sweep`: how time and error change along one axis while everything else stays: each point a line of JSON.

A scene's points are measured in one fresh process; rooms of lamps and of triangles are made there. A line's key is a hash of
all that decides its numbers: the scene's bytes, the settings, the versions, RTGI's sources, the processor. A point whose
key is in the file already is not measured again, so a command that was stopped goes on when it is repeated. A point that
fails gives a line that says so, and is tried again by the next command.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib
import json
import os
import statistics
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.settings import PRESETS
from ..core.techniques import optional_techniques
from ..errors import InputError
from ..pipeline import versions
from .bench import MAIN_PRESET, REPEATS, SAMPLES, SIZE, checked_places, processor
from .child import child_command, child_environment, end
from .measure import errors_of, floors_of, picture_errors
from .progress import Progress, say
from .references import reference_for
from .run import settings_for

SIZES = ((480, 270), (640, 360), (960, 540), (1280, 720), (1920, 1080))
LIGHTS = (1, 2, 4, 8, 16, 32)
TRIANGLES = tuple(16 * 20 * 4**level for level in range(1, 7))      # sixteen spheres, each four times as fine as before
CYCLES = (1, 4, 16)
PRESET_NAMES = tuple(name for name, _, _ in PRESETS)
# axis: what its points are; the first three have errors, the others an amount of work that time is fitted against
AXES = {"techniques": "each technique alone, on top of direct light",
        "presets": "draft, balanced, quality, with the techniques that the scene asks for",
        "cycles": "Cycles one-bounce at 1, 4 and 16 samples, without and with its denoiser",
        "resolutions": "480x270 to 1920x1080",
        "lights": "a room with 1 to 32 lamps, which needs no SCENE",
        "triangles": "a room with a thousand to a million triangles, which needs no SCENE",
        "threads": "1, 2, 4 ... all"}
ERROR_AXES = ("techniques", "presets", "cycles")
ROOM_AXES = ("lights", "triangles")
DIRECT = "direct only"
# the modules of this package that decide numbers; the others draw and print them
MEASURING = ("halves", "measure", "metrics", "reference", "references", "rooms", "sweeps")
FILE = "sweeps.jsonl"


@dataclass(frozen=True)
class Point:
    """One measurement that is wanted: everything but the machine and the versions that decides its numbers.

    `work` is the amount that time is fitted against, 0 on axes without one. `techniques` None is what the scene asks for;
    `cycles` above 0 is a render by Cycles of so many samples instead. `samples` 0 measures no error; `given` is the
    path of a reference to measure it against. `digest` is that of the scene's bytes, "" for a room.
    """

    axis: str
    scene: str
    name: str
    size: tuple[int, int]
    threads: int
    repeats: int
    digest: str = ""
    work: int = 0
    preset: str = MAIN_PRESET
    techniques: tuple[str, ...] | None = None
    cycles: int = 0
    denoise: bool = False
    samples: int = 0
    given: str = ""


def thread_counts(most: int) -> list[int]:
    """1, 2, 4 ... and `most`."""
    return sorted({most, *(2**k for k in range(most.bit_length()) if 2**k <= most)})


def points_of(axis: str, scene: str, digest: str, size: tuple[int, int] = SIZE, repeats: int = REPEATS,
              samples: int = SAMPLES, presets: Sequence[str] = PRESET_NAMES,
              threads: int = 1, given: str = "") -> list[Point]:
    """The points of an axis for one scene; of `ROOM_AXES`, whose scenes are made, for all of them."""
    base = Point(axis, scene, "", size, threads, repeats, digest)
    if axis in ERROR_AXES:
        base = dataclasses.replace(base, samples=samples, given=given)
    changes: Iterable[dict[str, Any]]
    if axis == "techniques":
        changes = [{"name": DIRECT, "techniques": ()},
                   *({"name": name, "techniques": (name,)} for name in optional_techniques())]
    elif axis == "presets":
        changes = [{"name": name.lower(), "preset": name} for name in presets]
    elif axis == "cycles":
        changes = [{"name": f"Cycles {n}" + " + denoiser" * denoise, "cycles": n, "denoise": denoise}
                   for denoise in (False, True) for n in CYCLES]
    elif axis == "resolutions":
        changes = [{"name": f"{w}x{h}", "size": (w, h), "work": w * h} for w, h in SIZES]
    elif axis == "threads":
        changes = [{"name": str(n), "threads": n, "work": n} for n in thread_counts(threads)]
    else:
        counts = {"lights": LIGHTS, "triangles": TRIANGLES}[axis]
        changes = [{"scene": f"{n} {axis}", "name": f"{n:,}".replace(",", " "), "work": n} for n in counts]
    return [dataclasses.replace(base, **change) for change in changes]


@functools.cache
def sources_hash() -> str:
    """Of the Python files that can change a number: all of RTGI but its panels, and what draws and prints measurements."""
    digest, root = hashlib.sha256(), Path(__file__).resolve().parent.parent
    for path in sorted(root.rglob("*.py")):
        folder = path.relative_to(root).parts[0]
        if folder == "ui" or path.name in ("cli.py", "doctor.py") or folder == "compare" and path.stem not in MEASURING:
            continue
        data = path.read_bytes()
        digest.update(f"{path.relative_to(root).as_posix()} {len(data)} ".encode() + data)
    return digest.hexdigest()[:16]


def machine_now(blender: str) -> dict[str, Any]:
    """What a measurement depends on beside its point; `blender` is Blender's version."""
    return {"processor": processor(), "versions": {**versions(), "blender": blender}, "sources": sources_hash()}


def key_of(point: Point, machine: dict[str, Any]) -> str:
    """The key that a measurement is kept under."""
    return hashlib.sha256(json.dumps([dataclasses.asdict(point), machine], sort_keys=True).encode()).hexdigest()[:16]


def read_lines(path: Path) -> dict[str, dict[str, Any]]:
    """Measurements of a file by key, of each the last; none where there is no file. A half-written last line is left out."""
    found: dict[str, dict[str, Any]] = {}
    for text in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        try:
            line = json.loads(text)
        except ValueError:                       # the command was stopped while it wrote
            continue
        found[line["key"]] = line
    return found


def _count(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines()) if path.is_file() else 0


def pending(points: Sequence[Point], machine: dict[str, Any], lines: dict[str, dict[str, Any]]) -> list[Point]:
    """The points that have no line yet, or one of a failure."""
    return [point for point in points if "seconds" not in lines.get(key_of(point, machine), {})]


def _append(path: Path, point: Point, machine: dict[str, Any], what: dict[str, Any]) -> None:
    line = {"key": key_of(point, machine), **dataclasses.asdict(point), **machine,
            "load_average": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None, **what}
    before = path.read_bytes()[-1:] if path.is_file() else b""
    with path.open("a", encoding="utf-8") as file:
        file.write(("\n" if before not in (b"", b"\n") else "") + json.dumps(line) + "\n")


# ---- in the fresh process ----

def _measured(blender: Any, scene: Any, path: Path | None, point: Point, cache: Path) -> dict[str, Any]:
    """Times of one point, and its errors where it wants them."""
    given = Path(point.given) if point.given else None
    truth = reference_for(scene, path, point.size, point.samples, cache, given) if point.samples or given else None
    floor = {"noise": floors_of(truth)["block"]} if truth is not None else {}
    with blender.on_threads(scene, point.threads):
        if point.cycles:
            peer = blender.render_peer(scene, point.cycles, point.denoise, point.repeats, point.size)
            errors = {"errors": {"picture": picture_errors(peer.combined, truth)}} if truth is not None else {}
            return {"seconds": list(peer.seconds), **errors, **floor}
        settings = settings_for(blender.scene_settings(scene), point.preset, point.techniques)
        with blender.keeping_data(scene):
            (first, first_seconds), *frames = blender.render_rtgi_frames(scene, settings, 1 + point.repeats, point.size)
    stages: dict[str, list[float]] = {}
    for result, _ in frames:
        for stage in result.report["stages"]:
            stages.setdefault(stage["name"], []).append(stage["ms"])
    result = frames[-1][0]
    errors = {"errors": errors_of(result, truth)} if truth is not None else {}
    return {"seconds": [seconds for _, seconds in frames], "stages_ms": stages, "first_seconds": first_seconds,
            "jit_ms": first.report["jit_ms"], "ran": [run["technique"] for run in result.report["plan"]["runs"]],
            **errors, **floor}


def child_main(request: str) -> None:
    """Entry of the fresh process: measure the points of one scene that the JSON `request` lists, a line each, and end."""
    importlib.import_module(__name__.rpartition(".compare.")[0]).register()
    from . import reference as blender

    words = json.loads(request)
    points = [Point(**{name: tuple(value) if isinstance(value, list) else value for name, value in point.items()})
              for point in words["points"]]
    results, machine = Path(words["results"]), words["machine"]
    path = Path(words["path"]) if words["path"] else None
    progress = Progress(**words["progress"])
    scene = None
    for point in points:
        try:
            if scene is None and path is not None:
                scene = blender.open_scene(path)
            elif scene is None:
                from . import rooms

                rooms.ROOMS[point.axis](point.work)
                scene = blender.current_scene()
            what = _measured(blender, scene, path, point, Path(words["cache"]))
            said = f"{statistics.median(what['seconds']):.2f} s"
        except Exception as error:  # noqa: BLE001  whatever it is, it is this point's line, and the next one is measured
            what = {"failed": " ".join(f"{type(error).__name__}: {error}".split())}
            said = f"failed: {what['failed']}"
        _append(results, point, machine, what)
        say(progress.step(f"{point.scene}, {point.axis} {point.name}: {said}"))
    end(0)


# ---- the command ----

def _measure_scene(points: Sequence[Point], path: Path | None, results: Path, machine: dict[str, Any], cache: Path,
                   progress: Progress) -> None:
    """Measure the points of one scene in fresh processes: in one, unless Blender dies over a point."""
    from . import reference as blender

    left = list(points)
    while left:
        request = {"points": [dataclasses.asdict(point) for point in left], "path": str(path or ""),
                   "results": str(results), "machine": machine, "cache": str(cache),
                   "progress": {"total": progress.total, "done": progress.done, "spent_s": progress.spent_s}}
        before = _count(results)
        done = subprocess.run(child_command(__name__, json.dumps(request), blender.blender_binary()),
                              env=child_environment(), stdout=subprocess.DEVNULL, check=False)
        tried = _count(results) - before         # the process writes a line for each, in order
        progress.done += tried
        left = left[tried:]
        if left:
            why = f"the process ended with code {done.returncode}; its messages are above"
            _append(results, left[0], machine, {"failed": why})
            say(progress.step(f"{left[0].scene}, {left[0].axis} {left[0].name}: failed: {why}"))
            left = left[1:]


def check_axes(axes: Sequence[str]) -> None:
    """InputError for an axis that there is not."""
    for axis in axes:
        if axis not in AXES:
            raise InputError(f"no sweep is called {axis!r}; known are {', '.join(AXES)} and all")


def sweep(scenes: Sequence[str | Path], out_dir: str | Path, axes: Sequence[str], size: tuple[int, int] = SIZE,
          repeats: int = REPEATS, samples: int = SAMPLES, presets: Sequence[str] | None = None, threads: int = 0,
          reference: str | Path | None = None) -> list[dict[str, Any]]:
    """Measure along axes, and say what is there already and what failed.

    Appends to sweeps.jsonl in `out_dir` one line a point as soon as it is measured; see `bench.bench` for the parameters.

    Returns
    -------
    The lines of the points that this command asks for, in order.

    Raises
    ------
    InputError
        No such axis or scene, no scene for an axis that needs one, or an output folder that cannot be made.
    """
    check_axes(axes)
    if not scenes and set(axes) - set(ROOM_AXES):
        raise InputError(f"no scene was named; only {' and '.join(ROOM_AXES)} need none")
    out, paths = checked_places(scenes, out_dir, repeats)
    from . import reference as blender

    machine = machine_now(blender.blender_version())
    how = {"size": size, "repeats": repeats, "samples": samples, "threads": threads or os.cpu_count() or 1,
           "presets": presets or PRESET_NAMES, "given": str(Path(reference).resolve()) if reference is not None else ""}
    jobs: list[tuple[Path | None, list[Point]]] = []
    for path in paths:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        jobs.append((path, [point for axis in axes if axis not in ROOM_AXES
                            for point in points_of(axis, path.stem, digest, **how)
                            if not point.denoise or blender.has_denoiser()]))
    jobs += [(None, [point]) for axis in axes if axis in ROOM_AXES for point in points_of(axis, "", "", **how)]
    results = out.resolve() / FILE
    lines = read_lines(results)
    wanted = [point for _, points in jobs for point in points]
    progress = Progress(len(pending(wanted, machine, lines)))
    if progress.total < len(wanted):
        say(f"{len(wanted) - progress.total} of {len(wanted)} points are in {results} already and are not measured again")
    for path, points in jobs:
        _measure_scene(pending(points, machine, lines), path, results, machine, out.resolve() / "references", progress)
    lines = read_lines(results)
    return [lines[key_of(point, machine)] for point in wanted]
