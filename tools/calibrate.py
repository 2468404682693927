"""Measures what each technique's settings take and leave: python -m tools.calibrate

    python -m tools.calibrate SCENE.blend ... [--samples 64] [--references FOLDER] [--cache out/references] [--threads 2]
    python -m tools.calibrate --page

Writes `rtgi_addon/calibration.json`, by which `rtgi_addon/budget.py` chooses, and docs/calibration.md; `--page` only the
page. Needs bpy, and a quiet machine.

On each scene every technique runs with every setting of `GRIDS`, on the same captured frame, all others as in the preset
Quality. Errors are those of the technique's part at 640x360, over the light of the whole picture, with the reference's own
noise taken off. Times are the lesser of two runs, or one long one's, at each of `SIZES`. At the largest size, and in the
rooms of `rtgi bench --sweep`, which have up to a million triangles and 32 lamps, the presets' settings add times alone.
Scenes with square lamps run once more with shining panels in their place, for what lights by emission.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import statistics
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from rtgi_addon.budget import TABLE, UNIT_PIXELS, UNIT_TRIANGLES, TimeLaw, Work  # noqa: E402
from rtgi_addon.compare.report import percent  # noqa: E402
from rtgi_addon.core.settings import PRESETS  # noqa: E402
from rtgi_addon.core.techniques import (  # noqa: E402
    ALWAYS_ON,
    LABELS,
    PRESET_PARAMS,
    TECHNIQUE_PARAMS,
    default_settings,
    preset_params,
)
from tools.technique_tables import markdown_table  # noqa: E402

SIZES = ((320, 180), (640, 360), (960, 540))
ERROR_SIZE = (640, 360)
LONG_MS = 400               # a time that is not taken twice
LAMPS, TRIANGLES = (1, 4, 16, 32), (5120, 81920, 1310720)      # of the rooms
LIKELY_POWER, LIKELY_WEIGHT = 0.8, 0.5      # of the pixels in a law, and how many measurements that is worth
LEAST_ERROR = 5e-4          # errors below this are none: the reference's noise was taken off them
REST = "rest"
OWN_STAGES = ("composite", "write")     # of the frame itself: neither of capture nor of a technique
PAGE = ROOT / "docs" / "calibration.md"
PRESET_NAMES = tuple(name for name, _, _ in PRESETS)


def _grid(**fields: Sequence[Any]) -> list[dict[str, Any]]:
    """Settings from columns of values."""
    return [dict(zip(fields, values, strict=True)) for values in zip(*fields.values(), strict=True)]


def _of_presets(name: str) -> list[dict[str, Any]]:
    """The presets' settings but for what they tell to capture: every setting runs on the same frame."""
    captured = TECHNIQUE_PARAMS[name].for_capture()
    return [{field: value for field, value in PRESET_PARAMS[preset][name].items() if field not in captured}
            for preset in PRESET_NAMES]


_RAYS = _grid(lattice_px=(8, 8, 8, 4, 4, 4, 4, 2, 2, 2, 2), rays=(4, 8, 16, 8, 16, 24, 48, 8, 16, 32, 64))


def _clustered(also: dict[str, Any]) -> list[dict[str, Any]]:
    """`_RAYS` with 512 clusters, with as many as the presets have, and `also`."""
    return [*({**s, "clusters": 512} for s in _RAYS), {"lattice_px": 8, "rays": 12, "clusters": 256},
            {"lattice_px": 4, "rays": 16, "clusters": 256}, {"lattice_px": 4, "rays": 16, "clusters": 1024},
            {"lattice_px": 2, "rays": 64, "clusters": 1024}, also]


GRIDS: dict[str, list[dict[str, Any]]] = {
    "direct": _grid(soft_shadow_rays=(4, 8, 16, 32, 64, 128)),
    "world": [*_RAYS, {"lattice_px": 4, "rays": 32}, {"lattice_px": 2, "rays": 12}],
    "emission": _clustered({"lattice_px": 8, "rays": 16, "clusters": 256}),
    "rsm": _clustered({"lattice_px": 8, "rays": 24, "clusters": 256}),
    "final_gather": [*_RAYS, {"lattice_px": 8, "rays": 12}, {"lattice_px": 4, "rays": 12}],
    "ssr": _grid(samples=(1, 2, 4, 8, 16, 32, 64)),
    **{name: _of_presets(name) for name in ("vxgi", "lpv")},
}
# the part of the reference that a technique's light is held against
PARTS = {"direct": "direct", "world": "direct", "emission": "direct", "ssr": "glossy bounce"}


@dataclass(frozen=True)
class Sample:
    """One setting of one technique on one frame; `error` is its part's over the picture's light, None where not measured."""

    technique: str
    setting: int
    scene: str
    pixels: float
    triangles: float
    lamps: float
    glossy_share: float
    ms: float
    error: float | None = None


# ---- measuring ----

def _plans(frame: Any) -> Iterator[tuple[str, tuple[str, ...]]]:
    """(technique, what runs before and with it) for every technique that the frame has light for."""
    from rtgi_addon.passes import TECHNIQUES
    from rtgi_addon.planner import CapturePlan, plan_frame

    everything = plan_frame(frame, default_settings(), CapturePlan()).techniques
    for name in TECHNIQUE_PARAMS:
        alone = dataclasses.replace(default_settings(techniques=(name,)), use_auto=True)
        if name in everything:
            yield name, everything
        elif name in GRIDS and name not in ALWAYS_ON and name in plan_frame(frame, alone, CapturePlan()).techniques:
            mine = TECHNIQUES[name].transports
            yield name, tuple(t for t in TECHNIQUE_PARAMS
                              if t == name or (t in everything and mine.isdisjoint(TECHNIQUES[t].transports)))


def _work_of(frame: Any) -> tuple[float, float, float, float]:
    """Fields of a Sample: surface pixels, triangles, lamps, share of the pixels that are glossy."""
    from rtgi_addon.planner import CapturePlan, plan_frame

    facts = plan_frame(frame, default_settings(), CapturePlan()).facts
    return facts["surface_pixels"], facts["triangles"], facts["lights"], facts["glossy_share"]


def _samples(scene: str, frame: Any, truth: Any, settings: dict[str, Sequence[int]]) -> Iterator[Sample]:
    """The settings, by technique and place in `GRIDS`, on a captured frame."""
    from rtgi_addon.composite import merge
    from rtgi_addon.core.mending import mend_frame
    from rtgi_addon.kernels.jit import compiled_s, kernel_session
    from rtgi_addon.passes import TECHNIQUES
    from rtgi_addon.passes.base import Context

    context, frame = Context(), mend_frame(frame)
    best = preset_params("QUALITY")

    def computed(name: str, before: list, names: tuple[str, ...], params: Any) -> Any:
        context.light = merge(before)
        later = names[names.index(name) + 1:]
        context.to_come = frozenset().union(*(TECHNIQUES[other].transports for other in later))
        return TECHNIQUES[name].compute(frame, params, context, 0)

    with kernel_session(ARGUMENTS.threads):
        context.bvh(frame.geometry)
        done: dict[tuple[str, ...], Any] = {}

        def result_of(name: str, names: tuple[str, ...]) -> Any:
            """Of the preset Quality; kept, since the next technique asks for most of the same."""
            before = tuple(names[:names.index(name)])
            key = (*before, name)
            if key not in done:
                done[key] = name, computed(name, [result_of(other, names) for other in before], names, best[name])
            return done[key]

        for name, names in _plans(frame):
            before = [result_of(other, names) for other in names[:names.index(name)]]
            # reflections only read other light; they add none to the other parts
            after = [] if truth is None else [
                result_of(other, names) for other in names[names.index(name) + 1:] if other != "ssr"]
            for number in settings.get(name, ()):
                made = dataclasses.replace(TECHNIQUE_PARAMS[name](), **GRIDS[name][number])
                times: list[float] = []
                while len(times) < 2 and sum(times) < LONG_MS:
                    start = time.perf_counter() - compiled_s()
                    result = computed(name, before, names, made)
                    times.append(1e3 * (time.perf_counter() - compiled_s() - start))
                error = None if truth is None else _error(merge([*before, (name, result), *after]), name, truth)
                yield Sample(name, number, scene, *_work_of(frame), min(times), error)


def _error(light: dict[Any, np.ndarray], name: str, truth: Any) -> float | None:
    """Error of the technique's part over the light of the picture, the reference's noise taken off; None without light."""
    from rtgi_addon.compare import metrics
    from rtgi_addon.compare.measure import BLACK, part_of

    part, mask = PARTS.get(name, "bounce"), truth.mask
    mean, whole = truth.mean(part), float(truth.mean("picture")[mask].sum())
    if mean[mask].sum() <= BLACK * whole:
        return None
    share = float(mean[mask].sum()) / whole
    seen = metrics.block_relative_l1(part_of(light, part, truth.albedo), mean, mask)
    noise = metrics.block_noise(*truth.halves(part), mask)
    # noise and error are independent of each other: they add by their squares
    return share * math.sqrt(max(seen * seen - noise * noise, 0.0))


def _kept(path: Path | None) -> dict[str, list[dict[str, Any]]]:
    """Samples by scene and size that an earlier run of the command left there."""
    return json.loads(path.read_text(encoding="utf-8")) if path is not None and path.is_file() else {}


def measure(paths: Sequence[Path]) -> tuple[list[Sample], list[Sample]]:
    """(samples of techniques, samples of the rest of a frame) of all scenes and rooms."""
    from rtgi_addon.compare import reference as blender
    from rtgi_addon.compare.progress import say
    from rtgi_addon.compare.references import reference_for
    from rtgi_addon.compare.rooms import ROOMS
    from tools.scene_frames import captured, panel_lamps, reference_under, with_panels

    found: list[Sample] = []
    rest: list[Sample] = []
    kept = _kept(ARGUMENTS.records)

    def add(name: str, scene: Any, truth: Any, size: tuple[int, int], settings: dict[str, Sequence[int]]) -> None:
        place = f"{name} {size[0]}x{size[1]}"
        if place not in kept:
            measured = list(measured_at(name, scene, truth, size, settings))
            kept[place] = [dataclasses.asdict(sample) for sample in measured]
            if ARGUMENTS.records:
                ARGUMENTS.records.write_text(json.dumps(kept))
        for words in kept[place]:
            (rest if words["technique"] == REST else found).append(Sample(**words))

    def measured_at(name: str, scene: Any, truth: Any, size: tuple[int, int],
                    settings: dict[str, Sequence[int]]) -> Iterator[Sample]:
        with blender.on_threads(scene, ARGUMENTS.threads):
            say(f"{name}, {size[0]}x{size[1]}")
            frame, _ = captured(scene, size)
            with blender.keeping_data(scene):
                frames = blender.render_rtgi_frames(scene, default_settings(), 3, size)[1:]
            beside = [1e3 * seconds - sum(s["ms"] for s in result.report["stages"] if s["name"] not in OWN_STAGES)
                      for result, seconds in frames]
            yield Sample(REST, 0, name, *_work_of(frame), max(min(beside), 1.0))
            yield from _samples(name, frame, truth, settings)

    everything = {name: range(len(settings)) for name, settings in GRIDS.items()}
    presets = {name: [settings.index(s) for s in _of_presets(name)] for name, settings in GRIDS.items()}
    shining = {name: everything[name] for name in ("emission", "final_gather")}
    for path in paths:
        for size in SIZES:
            scene, truth = blender.open_scene(path), None
            if size == ERROR_SIZE:
                truth = reference_for(scene, path, size, ARGUMENTS.samples, ARGUMENTS.cache, ARGUMENTS.references)
            add(path.stem, scene, truth, size, presets if size == SIZES[-1] else everything)
        if panel_lamps(scene):
            with with_panels(scene):
                add(f"{path.stem} with panels", scene, None, SIZES[0], shining)
                truth = reference_under(scene, path, "shining_panels", ERROR_SIZE, ARGUMENTS.samples, ARGUMENTS.cache)
                add(f"{path.stem} with panels", scene, truth, ERROR_SIZE, shining)
    for what, counts in (("lights", LAMPS), ("triangles", TRIANGLES)):
        for count in counts:
            ROOMS[what](count)
            add(f"room of {count} {what}", blender.current_scene(), None, ERROR_SIZE, presets)
    return found, rest


# ---- fitting ----

_COLUMNS = ("triangles", "lamps", "glossy_share")


def _amounts(sample: Sample) -> list[float]:
    """Logarithms of the amounts of work that all settings of a technique share a power of."""
    return [math.log(max(sample.triangles / UNIT_TRIANGLES, 1.0)), math.log(max(sample.lamps, 1.0)),
            math.log(max(sample.glossy_share, 1e-2))]


def fit_laws(samples: Sequence[Sample]) -> dict[int, dict[str, float]]:
    """`budget.TimeLaw` fields by setting: least squares in logarithms.

    Each setting has its own time and its own power of the pixels, which few sizes leave near `LIKELY_POWER`; triangles,
    lamps and glossy share have powers that the settings share. A power that would be negative is left out: more work
    never takes less time.
    """
    settings = sorted({s.setting for s in samples})
    kept = list(range(len(_COLUMNS)))
    while True:
        rows = np.zeros((len(samples), 2 * len(settings) + len(kept)))
        for row, s in zip(rows, samples, strict=True):
            place = settings.index(s.setting)
            row[2 * place:2 * place + 2] = 1.0, math.log(s.pixels / UNIT_PIXELS)
            row[2 * len(settings):] = [_amounts(s)[i] for i in kept]
        wanted = np.log([s.ms for s in samples])
        likely = np.zeros((len(settings), rows.shape[1]))
        likely[np.arange(len(settings)), 1 + 2 * np.arange(len(settings))] = LIKELY_WEIGHT
        found = np.linalg.lstsq(np.concatenate([rows, likely]), np.concatenate(
            [wanted, np.full(len(settings), LIKELY_WEIGHT * LIKELY_POWER)]), rcond=None)[0]
        shared = found[2 * len(settings):]
        if not (shared < 0).any():
            break
        del kept[int(np.argmin(shared))]
    powers = {**dict.fromkeys(_COLUMNS, 0.0), **{_COLUMNS[i]: float(p) for i, p in zip(kept, shared, strict=True)}}
    return {setting: {"ms": math.exp(found[2 * i]), "pixels": max(float(found[2 * i + 1]), 0.0), **powers}
            for i, setting in enumerate(settings)}


def spread_of(samples: Sequence[Sample], laws: dict[int, dict[str, float]]) -> float:
    """Root mean square of log(measured / law), as a factor: 1.3 is off by 30 % typically."""
    misses = [math.log(s.ms / TimeLaw(**laws[s.setting])(Work(s.pixels, s.triangles, s.lamps, s.glossy_share)))
              for s in samples]
    return math.exp(math.sqrt(statistics.fmean(miss * miss for miss in misses)))


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the lower convex hull of (time, error) from the fastest to the least error: what is worth its time."""
    order = sorted(range(len(points)), key=lambda i: points[i])
    hull: list[int] = []
    for i in order:
        if hull and points[i][1] >= points[hull[-1]][1]:
            continue
        while len(hull) > 1:
            (x0, y0), (x1, y1), (x2, y2) = points[hull[-2]], points[hull[-1]], points[i]
            if (y1 - y0) * (x2 - x0) < (y2 - y0) * (x1 - x0):
                break
            hull.pop()
        hull.append(i)
    return hull


def table_of(samples: Sequence[Sample], rest: Sequence[Sample]) -> dict[str, Any]:
    """What calibration.json holds of the measurements: laws, errors, and which settings are steps of the front."""
    techniques = {}
    for name in GRIDS:
        own = [s for s in samples if s.technique == name]
        if not own:
            continue
        laws = fit_laws(own)
        settings = []
        for number, params in enumerate(GRIDS[name]):
            errors = sorted(s.error for s in own if s.setting == number and s.error is not None)
            if number not in laws or not errors:
                continue
            typical = statistics.fmean(math.log(s.ms) for s in own if s.setting == number and s.error is not None)
            settings.append({"params": params, "time": {k: float(f"{v:.4g}") for k, v in laws[number].items()},
                             "median_error": float(f"{statistics.median(errors):.4g}"),
                             "high_error": float(f"{np.quantile(errors, 0.75):.4g}"),
                             "mean_error": float(f"{statistics.geometric_mean(max(e, LEAST_ERROR) for e in errors):.4g}"),
                             "typical_ms": float(f"{math.exp(typical):.4g}")})
        if not settings:
            continue
        steps = front([(s["typical_ms"], s["mean_error"]) for s in settings])
        techniques[name] = {"steps": [settings[i] for i in steps], "spread": float(f"{spread_of(own, laws):.3g}"),
                            "scenes": len({s.scene for s in own if s.error is not None}),
                            "off": [s for i, s in enumerate(settings) if i not in steps]}
    law = fit_laws(rest)[0]
    return {"techniques": techniques, "rest": {k: float(f"{v:.4g}") for k, v in law.items()}}


# ---- page ----

_HEAD = """# Calibration

What each technique's settings take and leave, by which a target time or a target error is met and on which the presets lie.
Made by `python -m tools.calibrate`, whose first lines say how it measures; measured on {machine}, {threads} threads,
Blender {blender}, with {scenes}.

A technique's table has its front, from fast to near: the settings that are worth their time, the lower convex hull of time
and error over the scenes, both by geometric means. Time is that at 640x360, error the share of the picture's light that is
in the wrong place when everything else is right: median, upper quartile and geometric mean over the scenes that have the
light. Settings that were measured and lie off the front stand below it. The laws that a forecast uses are in
`rtgi_addon/calibration.json`; "off by" is how far a single time lies from them typically.

"""


def page_of(words: dict[str, Any]) -> str:
    """docs/calibration.md."""
    parts = [_HEAD.format(machine=words["machine"], threads=words["threads"], blender=words["blender"],
                          scenes=", ".join(words["scenes"]))]
    for name, entry in words["techniques"].items():
        rows = []
        for kind in ("steps", "off"):
            for setting in entry[kind]:
                presets = [p.lower() for p in PRESET_NAMES if PRESET_PARAMS[p][name].items() <= _all(name, setting).items()]
                errors = (percent(setting[k]) for k in ("median_error", "high_error", "mean_error"))
                cells = [", ".join(f"`{field}` {value}" for field, value in setting["params"].items()),
                         f"{setting['typical_ms']:.0f} ms", *errors,
                         "yes" if kind == "steps" else "", ", ".join(presets)]
                rows.append((setting["typical_ms"], cells))
        table = markdown_table(["setting", "time", "error: median", "quartile", "mean", "on the front", "preset"],
                               [cells for _, cells in sorted(rows, key=lambda row: row[0])])
        parts.append(f"## {LABELS[name]}\n\n{entry['scenes']} scenes have its light; times are off by a factor of "
                     f"{entry['spread']:.2f}.\n\n{table}\n")
    return "".join(parts).rstrip() + "\n"


def _all(name: str, setting: dict[str, Any]) -> dict[str, Any]:
    return dataclasses.asdict(dataclasses.replace(TECHNIQUE_PARAMS[name](), **setting["params"]))


def calibrate(paths: Sequence[Path]) -> dict[str, Any]:
    """Measure everything; what calibration.json holds."""
    import rtgi_addon
    from rtgi_addon.compare import reference as blender
    from rtgi_addon.compare.bench import processor
    from rtgi_addon.kernels.jit import kernel_session
    from rtgi_addon.kernels.probe import probe_ms

    rtgi_addon.register()
    samples, rest = measure(paths)
    with kernel_session(ARGUMENTS.threads):
        probe = probe_ms()
    return {"machine": processor(), "threads": ARGUMENTS.threads or os.cpu_count(), "blender": blender.blender_version(),
            "scenes": [p.stem for p in paths], "probe_ms": float(f"{probe:.3g}"), **table_of(samples, rest)}


def main(words: Sequence[str] | None = None) -> None:
    global ARGUMENTS
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path, metavar="SCENE.blend")
    parser.add_argument("--samples", type=int, default=64, help="samples of each half of a reference; 64")
    parser.add_argument("--references", type=Path, help="folder of references rendered before")
    parser.add_argument("--cache", type=Path, default=Path("out/references"), help="folder that keeps references")
    parser.add_argument("--threads", type=int, default=0, help="all if left out")
    parser.add_argument("--records", type=Path, help="keep every measurement here, and go on from those that are there")
    parser.add_argument("--page", action="store_true", help="only make the page")
    ARGUMENTS = parser.parse_args(words)
    if not ARGUMENTS.page:
        if not ARGUMENTS.scenes:
            parser.error("name the scenes to measure")
        TABLE.write_text(json.dumps(calibrate(ARGUMENTS.scenes), indent=1) + "\n", encoding="utf-8")
    found = json.loads(TABLE.read_text(encoding="utf-8"))
    PAGE.write_text(page_of(found), encoding="utf-8")
    print(TABLE, PAGE)


if __name__ == "__main__":
    main()
