"""`rtgi bench`: speed and error of RTGI beside denoised Cycles, one fresh process a scene.

Times are wall-clock seconds of a whole F12, the second and later frames, medians. First frame, compile time and peak
memory are those of a fresh process that has rendered the main preset only. The error columns need a reference; without
one the times are measured all the same.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import statistics
import subprocess
import tempfile
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..core.settings import PRESETS
from ..core.techniques import TECHNIQUE_PARAMS
from ..errors import InputError, RtgiError
from ..imageio import replacing
from ..pipeline import peak_memory_mb, versions
from . import targets
from .child import child_command, child_environment, end
from .measure import errors_of, noise_of, picture_errors
from .report import percent, text_table
from .run import PEER_SAMPLES, peers_for, reference_for, say, settings_for

SIZE = (960, 540)
REPEATS = 3
SAMPLES = 256
MAIN_PRESET = "BALANCED"
# stages of a frame as the table groups them, then every technique by its name; whatever is in none of them is "rest"
STAGE_GROUPS = {"views": ("camera view", "fit light views", "light views"), "triangles": ("triangles", "bvh")}


def processor() -> str:
    """The processor's name, as far as the system tells."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _medians(reports: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Median ms of every stage over several frames."""
    names = [stage["name"] for stage in reports[0]["stages"]]
    times = [{stage["name"]: stage["ms"] for stage in report["stages"]} for report in reports]
    return {name: round(statistics.median(t.get(name, 0.0) for t in times), 2) for name in names}


def measure_scene(path: Path, cache: Path, size: tuple[int, int] = SIZE, repeats: int = REPEATS, samples: int = SAMPLES,
                  presets: Sequence[str] = (MAIN_PRESET,), peers: Sequence[int] = PEER_SAMPLES, threads: int = 0,
                  given: Path | None = None) -> dict[str, Any]:
    """Times, memory and errors of one scene, in this process; see `bench`."""
    from . import reference as blender

    scene = blender.open_scene(path)
    record: dict[str, Any] = {
        "scene": path.stem, "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), "frame": scene.frame_current,
        "size": list(size), "threads": threads or os.cpu_count(), "processor": processor(),
        "load_average": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "versions": {**versions(), "blender": blender.blender_version()}, "rtgi": {}, "cycles": {}}
    pictures = {}
    peers = peers_for(peers)
    with blender.on_threads(scene, threads):
        own = blender.scene_settings(scene)
        # the main preset first: its first frame is the process's first, its peak memory nobody else's
        for preset in sorted(presets, key=lambda name: name != MAIN_PRESET):
            say(f"{path.stem}: RTGI, {preset.lower()}, {repeats + 1} frames")
            settings = settings_for(own, preset, None)
            with blender.keeping_data(scene):
                (first, first_seconds), *frames = blender.render_rtgi_frames(scene, settings, 1 + repeats, size)
            pictures[preset] = frames[-1][0]
            record["rtgi"][preset] = {
                "first_seconds": first_seconds, "jit_ms": first.report["jit_ms"],
                "seconds": statistics.median(s for _, s in frames), "all_seconds": [s for _, s in frames],
                "stages_ms": _medians([result.report for result, _ in frames]), "peak_memory_mb": round(peak_memory_mb(), 1),
                "plan": first.report["plan"],
                "warnings": first.report["warnings"]}
        record["rtgi"] = {preset: record["rtgi"][preset] for preset in presets}
        for count in peers:
            say(f"{path.stem}: Cycles, {count} samples and denoiser, {repeats + 1} frames")
            peer = blender.render_peer(scene, count, True, repeats, size)
            pictures[count] = peer.combined
            record["cycles"][str(count)] = {"seconds": statistics.median(peer.seconds), "all_seconds": list(peer.seconds)}
        if samples or given:
            truth = reference_for(scene, path, size, samples, cache, given)
            record["reference"] = {"samples": truth.samples, "noise": noise_of(truth)}
            for preset in presets:
                record["rtgi"][preset]["errors"] = errors_of(pictures[preset], truth)
            for count in peers:
                record["cycles"][str(count)]["errors"] = {"picture": picture_errors(pictures[count], truth)}
    return record


def child_main(request: str) -> None:
    """Entry of the fresh process: measure what the JSON `request` says, and write the record."""
    from .. import register

    words = json.loads(request)
    status = 1
    try:
        register()
        given = Path(words["given"]) if words["given"] else None
        record = measure_scene(Path(words["path"]), Path(words["cache"]), tuple(words["size"]), words["repeats"],
                               words["samples"], words["presets"], words["peers"], words["threads"], given)
        Path(words["record"]).write_text(json.dumps(record), encoding="utf-8")
        status = 0
    except RtgiError as error:
        say(str(error))
    except Exception:  # noqa: BLE001  the parent needs an exit code, the person the traceback
        traceback.print_exc()
    end(status)


def _measure_in_child(request: dict[str, Any]) -> dict[str, Any]:
    from . import reference as blender

    with tempfile.TemporaryDirectory(prefix="rtgi_bench_") as folder:
        record = Path(folder) / "record.json"
        command = child_command(__name__, json.dumps({**request, "record": str(record)}), blender.blender_binary())
        done = subprocess.run(command, env=child_environment(), stdout=subprocess.DEVNULL, check=False)
        if done.returncode or not record.is_file():
            raise RtgiError(f"measuring {request['path']} ended with code {done.returncode}; its messages are above")
        return json.loads(record.read_text(encoding="utf-8"))


def checked_places(scenes: Sequence[str | Path], out_dir: str | Path, repeats: int) -> tuple[Path, list[Path]]:
    """(folder for the results, which is made, absolute paths of the scenes); InputError for what can't be measured."""
    out, paths = Path(out_dir), [Path(scene).resolve() for scene in scenes]
    for path in paths:
        if not path.is_file():
            raise InputError(f"there is no file {path}; check the name and the folder")
    if repeats < 1:
        raise InputError(f"repeats must be 1 or more, got {repeats}")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {out}: {error.strerror}; choose another place") from error
    return out, paths


def bench(scenes: Sequence[str | Path], out_dir: str | Path, size: tuple[int, int] = SIZE, repeats: int = REPEATS,
          samples: int = SAMPLES, presets: Sequence[str] | None = None, peers: Sequence[int] = PEER_SAMPLES,
          threads: int = 0, reference: str | Path | None = None) -> list[dict[str, Any]]:
    """Measure scenes, one after another, each in a process of its own.

    Writes results.jsonl (one line a scene, as soon as it is measured) and results.md into `out_dir`, prints the tables.

    Parameters
    ----------
    scenes : .blend files.
    size : (width, height) px.
    repeats : frames that are timed, after one that is not.
    samples : samples a pixel of each half of the reference; 0 leaves the errors out.
    presets : of RTGI; None for all.
    peers : sample counts of denoised one-bounce Cycles.
    threads : for both engines; 0 for all.
    reference : .npz of a reference, or a folder of `<scene>_<W>x<H>.npz`, instead of rendering them. Rendered ones are kept
        in `out_dir`/references.

    Returns
    -------
    The records as in results.jsonl.

    Raises
    ------
    InputError
        No such scene, or an output folder that cannot be made.
    RtgiError
        A scene could not be measured; those before it are in results.jsonl.
    """
    if not scenes:
        raise InputError("no scene was named; write rtgi bench SCENE.blend -o DIR")
    out, paths = checked_places(scenes, out_dir, repeats)
    wanted = list(presets) if presets is not None else [name for name, _, _ in PRESETS]
    records: list[dict[str, Any]] = []
    with (out / "results.jsonl").open("w", encoding="utf-8") as lines:
        for path in paths:
            records.append(_measure_in_child({
                "path": str(path), "cache": str((out / "references").resolve()), "size": list(size),
                "repeats": repeats, "samples": samples, "presets": wanted, "peers": list(peers), "threads": threads,
                "given": str(Path(reference).resolve()) if reference is not None else ""}))
            lines.write(json.dumps(records[-1]) + "\n")
            lines.flush()
    text = markdown(records)
    with replacing(out / "results.md") as partial:
        partial.write_text(text, encoding="utf-8")
    print(text, end="", flush=True)
    return records


# ---- tables ----

def markdown(records: Sequence[dict[str, Any]]) -> str:
    """Tables of the records: times, then errors where they were measured, then presets where there are several."""
    parts = []
    for size in dict.fromkeys(tuple(r["size"]) for r in records):
        group = [r for r in records if tuple(r["size"]) == size]
        first, of = group[0], group[0]["versions"]
        parts.append(f"## {size[0]}x{size[1]}\n\n{first['processor']}, {first['threads']} threads; Blender {of['blender']}, "
                     f"numba {of['numba']}, numpy {of['numpy']}.")
        parts.append(_times(group))
        measured = [r for r in group if "reference" in r]
        if measured:
            parts.append(_errors_table(measured))
        if any(len(r["rtgi"]) > 1 for r in group):
            parts.append(_presets(group))
        parts.append(targets.table(group))
    return "\n\n".join(parts) + "\n"


def _main(record: dict[str, Any]) -> dict[str, Any]:
    """The row of the main preset, or the only one."""
    return record["rtgi"].get(MAIN_PRESET) or next(iter(record["rtgi"].values()))


def _times(records: Sequence[dict[str, Any]]) -> str:
    peers = list(records[0]["cycles"])
    ran = {stage for record in records for stage in _main(record)["stages_ms"]}
    groups = {**STAGE_GROUPS, **{name: (name,) for name in TECHNIQUE_PARAMS if name in ran}}
    head = ["scene", "RTGI", *(f"Cycles {n}" for n in peers), *(["of Cycles " + peers[0]] if peers else []),
            *(f"{group} (ms)" for group in groups), "rest (ms)", "peak memory", "first frame", "compiling in it"]
    rows = []
    for record in records:
        main = _main(record)
        stages = main["stages_ms"]
        grouped = [sum(stages.get(name, 0.0) for name in names) for names in groups.values()]
        cycles = [record["cycles"][n]["seconds"] for n in peers]
        rows.append([record["scene"], f"{main['seconds']:.2f} s", *(f"{s:.2f} s" for s in cycles),
                     *([f"{main['seconds'] / cycles[0]:.2f}"] if cycles else []),
                     *(f"{ms:.0f}" for ms in grouped), f"{main['seconds'] * 1e3 - sum(grouped):.0f}",
                     f"{main['peak_memory_mb']:.0f} MB", f"{main['first_seconds']:.2f} s", f"{main['jit_ms'] / 1e3:.2f} s"])
    return ("Whole frame, wall clock, median of the second and later frames. Cycles: one bounce, denoised by "
            "OpenImageDenoise. \"rest\" is the frame less the stages: composite, write-back, Blender's own work.\n\n"
            + text_table(head, rows, True))


def _errors_table(records: Sequence[dict[str, Any]]) -> str:
    peers = list(records[0]["cycles"])
    head = ["scene", "direct within 1 %", "direct", "bounce", "bounce energy", "bounce in the picture",
            "glossy bounce in the picture", "picture", *(f"picture, Cycles {n}" for n in peers), "noise: picture", "bounce"]
    rows = []
    for record in records:
        errors, noise = _main(record)["errors"], record["reference"]["noise"]
        direct, bounce = errors["direct"], errors["bounce"]
        energy = bounce.get("energy")
        cycles = [record["cycles"][n]["errors"]["picture"]["block"] for n in peers]
        rows.append([record["scene"], percent(direct.get("within_1_percent")), percent(direct.get("block")),
                     percent(bounce.get("block")), f"{energy:.3f}" if energy is not None else "-",
                     percent(bounce["of_picture"]), percent(errors["glossy bounce"]["of_picture"]),
                     percent(errors["picture"]["block"]), *map(percent, cycles), percent(noise["picture"]),
                     percent(noise.get("bounce"))])
    return ("Relative L1 of 8x8 blocks against Cycles one-bounce (two halves of many samples), over surfaces. \"in the "
            "picture\": the part's error over the light of the whole picture, everything else being right. \"noise\": what "
            "the reference's own noise gives a perfect render; it is in all errors but energy.\n\n"
            + text_table(head, rows, True))


def _presets(records: Sequence[dict[str, Any]]) -> str:
    names = list(records[0]["rtgi"])
    head = ["scene", *(f"{name.lower()}: time, picture, bounce" for name in names)]

    def cell(row: dict[str, Any]) -> str:
        errors = row.get("errors")
        text = f"{row['seconds']:.2f} s"
        if errors:
            text += f", {percent(errors['picture']['block'])}, {percent(errors['bounce'].get('block'))}"
        return text

    rows = [[record["scene"], *(cell(record["rtgi"][name]) for name in names)] for record in records]
    return "Presets: seconds of a frame, error of the picture and of the bounce.\n\n" + text_table(head, rows, True)
