"""`rtgi compare`: a scene by RTGI, by Cycles one-bounce and by EEVEE, as a page, a table, pictures, CSV and JSON."""

from __future__ import annotations

import dataclasses
import json
import re
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cache_root import references_root
from ..core.settings import Settings
from ..core.techniques import ALWAYS_ON, TECHNIQUE_PARAMS, optional_techniques, preset_params
from ..errors import InputError
from ..imageio import replacing
from ..pipeline import Result, versions
from .eevee import render_eevee
from .flip import mean_flip
from .halves import Reference
from .measure import errors_of, floors_of, noise_of, picture_errors
from .metrics import ssim
from .page import Shown, crossing_words, csv_text, html_page, plot_of
from .progress import say
from .references import reference_for
from .report import ERROR_SCALE, ERROR_WINDOW_PX, error_map, percent, side_by_side, text_table, write_picture

PEER_SAMPLES = (1, 4)       # of denoised Cycles where few peers must do
REPEATS = 3                 # timed frames, of which the median counts: a single one on a busy machine was off by three
NOISY = 0.5                 # a reference whose noise is more than this share of the error is not good enough to judge it
HEAD = ("", "time", "direct", "bounce", "glossy bounce", "picture", "too bright", "after scale", "per pixel")


def settings_for(before: Settings, preset: str | None, techniques: Sequence[str] | None) -> Settings:
    """`before` with a preset's parameters and without a budget, and with exactly these techniques (None: as they are)."""
    settings = before
    if preset is not None:
        settings = dataclasses.replace(settings, preset=preset, params=preset_params(preset), target_time_s=0.0,
                                       target_error=0.0)
    if techniques is not None:
        for name in techniques:
            if name not in TECHNIQUE_PARAMS:
                raise InputError(f"no technique is called {name!r}; known are {', '.join(TECHNIQUE_PARAMS)}")
        wanted = (*ALWAYS_ON, *techniques)
        settings = dataclasses.replace(settings, use_auto=False, enabled={name: name in wanted for name in TECHNIQUE_PARAMS})
    return settings


def peers_for(counts: Sequence[int]) -> list[int]:
    """The sample counts of denoised Cycles to measure: none, with a word about it, where Blender has no denoiser."""
    from . import reference as blender

    if counts and not blender.has_denoiser():
        say("this Blender was built without OpenImageDenoise: denoised Cycles is left out")
        return []
    return list(counts)


def _variants(settings: Settings, techniques: Sequence[str] | None) -> list[tuple[str, Settings]]:
    """(row, settings): everything, direct light alone, and each technique by itself where there are several."""
    enabled = [name for name in optional_techniques() if settings.enabled.get(name, True)]
    single = [name for name in (techniques if techniques is not None else enabled) if name not in ALWAYS_ON]
    rows = [("RTGI", settings), ("direct only", settings_for(settings, None, ()))]
    if techniques is not None and len(single) == 1:
        return rows
    return rows + [(name, settings_for(settings, None, (name,))) for name in single]


def row_cells(name: str, row: dict[str, Any]) -> list[str]:
    """A row of the table; parts that the reference has none of, and parts of peers, are "-"."""
    errors = row["errors"]

    def block(part: str) -> str:
        return percent(errors.get(part, {}).get("block"))

    time = f"{row['seconds']:.2f} s" if "seconds" in row else ""
    picture = errors["picture"]
    return [name, time, block("direct"), block("bounce"), block("glossy bounce"), block("picture"),
            percent(picture.get("luminance_bias")), percent(picture.get("block_after_scale")), percent(picture.get("nrmse"))]


def stage_lines(report: dict[str, Any]) -> str:
    """Stage times in two columns, with the sum and the compile time apart."""
    rows = [[stage["name"], f"{stage['ms']:.1f}"] for stage in report["stages"]]
    rows += [["sum", f"{report['total_ms']:.1f}"], ["compiling, apart", f"{report['jit_ms']:.1f}"]]
    return text_table(("stage", "ms"), rows)


def compare_scene(blend_path: str | Path | None, out_dir: str | Path, techniques: Sequence[str] | None = None,
                  samples: int = 64, size: tuple[int, int] | None = None, preset: str | None = None, threads: int = 0,
                  peers: Sequence[int] = PEER_SAMPLES, reference: str | Path | None = None, noise: float | None = None,
                  eevee: bool = False, flip: bool = False, cache: str | Path | None = None) -> dict[str, Any]:
    """Render a scene with RTGI and with Cycles one-bounce and say how far they are apart.

    Prints the table and the stage times; writes into `out_dir` the page compare.html, compare.png (RTGI, Cycles, error
    map), compare.csv, compare.json, speed_error.svg if there is matplotlib to draw it, and in pictures/ each render and its
    error map.

    Parameters
    ----------
    blend_path : .blend to open, or None for the scene that Blender has open.
    techniques : names that RTGI uses, or None for what the scene's own settings say.
    samples : samples a pixel of each of the reference's two halves; with `noise`, of the first round.
    size : (width, height) px, or None for the scene's own.
    preset : DRAFT, BALANCED or QUALITY, or None for the scene's own settings.
    threads : for all engines; 0 leaves what the scene says.
    peers : sample counts of Cycles renders to show beside RTGI, each without and with its denoiser.
    reference : .npz of a reference, or a folder of them, instead of rendering one.
    noise : block error that the reference's own noise may have, such as 0.01; None for exactly `samples`.
    eevee : whether to render EEVEE too; needs `blend_path`, and a GPU or OpenGL in software.
    flip : whether to measure FLIP too; needs its library.
    cache : folder that keeps references; None for that of the user or the extension.

    Returns
    -------
    dict, as in compare.json: "rows" {name: {kind, seconds, errors, ...}}, "noise", "floors", "crossing" in words, "notes" on
    what was left out, "report" of the RTGI row, "files".

    Raises
    ------
    InputError
        The scene, a technique's name or the reference cannot be used, or a render has a pixel that is not finite.
    CaptureError
        A render failed.
    """
    from . import reference as blender

    out = Path(out_dir)
    path = Path(blend_path) if blend_path is not None else None
    scene = blender.open_scene(path) if path is not None else blender.current_scene()
    try:
        (out / "pictures").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {out}: {error.strerror}; choose another place") from error
    with blender.on_threads(scene, threads):
        wanted = size or blender.picture_size(scene)
        settings = settings_for(blender.scene_settings(scene), preset, techniques)
        truth = reference_for(scene, path, wanted, samples, Path(cache) if cache is not None else references_root(),
                              Path(reference) if reference is not None else None, noise)
        truth_display = blender.displayed(truth.mean("picture"), scene)
        rows = _render_rtgi(blender, scene, _variants(settings, techniques), wanted, truth)
        rows += _render_cycles(blender, scene, peers, wanted, truth)
        notes = []
        if peers and not blender.has_denoiser():
            notes.append("Denoised Cycles is left out: this Blender was built without OpenImageDenoise.")
        if eevee:
            found = (render_eevee(path, scene.frame_current, wanted, threads, blender.blender_binary()) if path is not None
                     else "EEVEE is left out: the scene is not read from a file that was named")
            if isinstance(found, str):
                notes.append(found + ".")
            else:
                rows.append(_shown(blender, scene, "EEVEE", "eevee", found["seconds"], found["combined"], truth))
                notes.append(f"EEVEE, with ray tracing on, was drawn by {found['device'] or 'an unnamed device'}; all other "
                             "renders are by the processor.")
    for row in rows:
        row.errors["picture"]["ssim"] = ssim(row.display / 255, truth_display / 255)
    if flip:
        notes += _measure_flip(rows, truth_display)
    for note in notes:
        say(note)
    title = path.stem if path is not None else scene.name
    return _write(blender, out, title, wanted, rows, truth, truth_display, notes)


def _shown(blender: Any, scene: Any, name: str, kind: str, seconds: float, combined: np.ndarray, truth: Reference,
           result: Result | None = None) -> Shown:
    """A render with its errors, part by part where it is RTGI's `result`; InputError naming it if it is not finite."""
    try:
        errors = errors_of(result, truth) if result is not None else {"picture": picture_errors(combined, truth)}
    except InputError as error:
        raise InputError(f"{name} cannot be compared: {error}") from error
    return Shown(name, kind, seconds, errors, blender.displayed(combined, scene), combined,
                 result.report if result is not None else {})


def _render_rtgi(blender: Any, scene: Any, variants: Sequence[tuple[str, Settings]], size: tuple[int, int],
                 truth: Reference) -> list[Shown]:
    rows = []
    for name, variant in variants:
        say(f"{name}: {REPEATS + 1} frames, all but the first are timed")
        with blender.keeping_data(scene):
            (first, _), *frames = blender.render_rtgi_frames(scene, variant, 1 + REPEATS, size)
        frames.sort(key=lambda frame: frame[1])
        result, seconds = frames[REPEATS // 2]       # the picture is the same in all; stages are those of the median frame
        result.report["jit_ms"] = first.report["jit_ms"]
        rows.append(_shown(blender, scene, name, "rtgi", seconds, result.combined, truth, result))
    return rows


def _render_cycles(blender: Any, scene: Any, counts: Sequence[int], size: tuple[int, int], truth: Reference) -> list[Shown]:
    """Cycles of few samples, without and with its denoiser."""
    rows = []
    for denoise in (False, True) if blender.has_denoiser() else (False,):
        for count in counts:
            name = f"Cycles {count} + denoiser" if denoise else f"Cycles {count}"
            say(f"{name}: {REPEATS + 1} frames, all but the first are timed")
            peer = blender.render_peer(scene, count, denoise, REPEATS, size)
            kind = "denoised" if denoise else "cycles"
            rows.append(_shown(blender, scene, name, kind, statistics.median(peer.seconds), peer.combined, truth))
    return rows


def _measure_flip(rows: Sequence[Shown], truth_display: np.ndarray) -> list[str]:
    """Enter FLIP into the rows' errors; the line that says why it is left out, once, if it is."""
    for row in rows:
        found = mean_flip(row.display, truth_display)
        if isinstance(found, str):
            return [found + "."]
        row.errors["picture"]["flip"] = found
    return []


def _file_name(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def _write(blender: Any, out: Path, title: str, size: tuple[int, int], rows: Sequence[Shown], truth: Reference,
           truth_display: np.ndarray, notes: Sequence[str]) -> dict[str, Any]:
    """All files and the printed table; what `compare_scene` returns."""
    noise, floors, main = noise_of(truth), floors_of(truth), rows[0]
    mean = truth.mean("picture")
    halves = f"two halves of {truth.samples} samples a pixel" if truth.samples else "two halves"
    write_picture(out / "pictures" / "reference.png", truth_display)
    for row in rows:
        write_picture(out / "pictures" / f"{_file_name(row.name)}.png", row.display)
        write_picture(out / "pictures" / f"{_file_name(row.name)}_error.png", error_map(row.linear, mean))
    write_picture(out / "compare.png", side_by_side([
        (f"RTGI  {main.seconds:.2f} s", f"error {percent(main.errors['picture']['block'])}", main.display),
        (f"Cycles one bounce, {halves}", f"its noise {percent(noise['picture'])}", truth_display),
        (f"Relative error, means of {ERROR_WINDOW_PX}x{ERROR_WINDOW_PX} px", "", error_map(main.linear, mean)),
    ], ERROR_SCALE, blender.drawn_text))
    versions_now = {**versions(), "blender": blender.blender_version()}
    facts = [f"{size[0]}\u00d7{size[1]} px", f"Blender {versions_now['blender']}", f"RTGI {versions_now['rtgi']}",
             f"{main.report['threads']} threads", f"reference: {halves}, noise {percent(noise['picture'])}"]
    files = {"picture": str(out / "compare.png"), "json": str(out / "compare.json"), "page": str(out / "compare.html"),
             "csv": str(out / "compare.csv"), "reference": truth.source}
    plot = plot_of(rows, floors)
    if plot:
        files["plot"] = str(out / "speed_error.svg")
    else:
        (out / "speed_error.svg").unlink(missing_ok=True)       # of an earlier comparison
    outcome = {
        "scene": title, "size": list(size), "samples": truth.samples, "noise": noise, "floors": floors,
        "rows": {row.name: {"kind": row.kind, "seconds": row.seconds, "errors": row.errors,
                            **({"stages": row.report["stages"]} if row.report else {})} for row in rows},
        "crossing": crossing_words(rows), "notes": list(notes), "versions": versions_now, "report": main.report,
        "files": files}
    texts = {files["page"]: html_page(f"RTGI against Cycles: {title}", facts, rows, halves, truth_display, mean, noise,
                                      floors, notes),
             files["csv"]: csv_text(rows), files["json"]: json.dumps(outcome, indent=2) + "\n",
             **({files["plot"]: plot + "\n"} if plot else {})}
    for name, text in texts.items():
        with replacing(Path(name)) as partial:
            partial.write_text(text, encoding="utf-8")
    parts = ("direct", "bounce", "glossy bounce", "picture")
    noise_row = ["the reference's own noise", "", *(percent(noise.get(part)) for part in parts), "", "",
                 percent(floors["nrmse"])]
    print(f"{title}, {size[0]}x{size[1]}: error against Cycles one-bounce, {halves} "
          "(relative L1 of 8x8 blocks; per pixel: nrmse without the reference's noise)")
    cells = [row_cells(row.name, {"seconds": row.seconds, "errors": row.errors}) for row in rows]
    print(text_table(HEAD, [*cells, noise_row]))
    for sentence in outcome["crossing"]:
        print(sentence)
    if noise["picture"] > NOISY * main.errors["picture"]["block"]:
        print("The reference's noise is a large part of these errors; more samples (--samples, --noise) tell more.")
    print(f"\n{stage_lines(main.report)}\n\n{files['page']}", flush=True)
    return outcome
