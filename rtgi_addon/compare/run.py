"""`rtgi compare`: a scene by RTGI and by Cycles one-bounce, as a table, a picture and JSON."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..core.settings import Settings
from ..core.techniques import ALWAYS_ON, TECHNIQUE_PARAMS, optional_techniques, preset_params
from ..errors import InputError
from ..imageio import replacing
from .halves import Reference, load_reference
from .measure import errors_of, noise_of, picture_errors
from .report import ERROR_SCALE, ERROR_WINDOW_PX, error_map, percent, side_by_side, text_table, write_picture

PEER_SAMPLES = (1, 4)
NOISY = 0.5                 # a reference whose noise is more than this share of the error is not good enough to judge it
HEAD = ("", "time", "direct", "bounce", "glossy bounce", "picture", "energy", "per pixel")


def say(text: str) -> None:
    """Progress, for the person who waits."""
    print(f"rtgi: {text}", file=sys.stderr, flush=True)


def settings_for(before: Settings, preset: str | None, techniques: Sequence[str] | None) -> Settings:
    """`before` with a preset's parameters and exactly these techniques (None: as they are)."""
    settings = before
    if preset is not None:
        settings = dataclasses.replace(settings, preset=preset, params=preset_params(preset))
    if techniques is not None:
        for name in techniques:
            if name not in TECHNIQUE_PARAMS:
                raise InputError(f"no technique is called {name!r}; known are {', '.join(TECHNIQUE_PARAMS)}")
        wanted = (*ALWAYS_ON, *techniques)
        settings = dataclasses.replace(settings, use_auto=False, enabled={name: name in wanted for name in TECHNIQUE_PARAMS})
    return settings


def reference_for(scene: Any, blend_path: Path | None, size: tuple[int, int], samples: int, cache: Path,
                  given: Path | None = None) -> Reference:
    """A reference from file `given`, or `<scene>_<W>x<H>.npz` in folder `given`; else from the cache; else rendered.

    The cache knows the .blend's bytes, frame, size, samples and Blender, not the images and libraries that it links to.
    """
    from . import reference as blender

    stem = blend_path.stem if blend_path is not None else scene.name
    if given is not None:
        return load_reference(given / f"{stem}_{size[0]}x{size[1]}.npz" if given.is_dir() else given, size)
    kept = None
    if blend_path is not None:
        digest = hashlib.sha256(blend_path.read_bytes())
        digest.update(repr((scene.frame_current, size, samples, blender.SEEDS, blender.blender_version())).encode())
        kept = cache / f"{stem}_{size[0]}x{size[1]}_{digest.hexdigest()[:12]}.npz"
        if kept.is_file():
            return load_reference(kept, size)
    say(f"{stem}: reference by Cycles, one bounce, 2 x {samples} samples, {size[0]}x{size[1]}")
    reference = blender.render_reference(scene, samples, size)
    if kept is not None:
        cache.mkdir(parents=True, exist_ok=True)
        with replacing(kept) as partial:
            reference.save(partial)
    return reference


def peers_for(counts: Sequence[int]) -> list[int]:
    """The sample counts of denoised Cycles to measure: none, with a word about it, where Blender has no denoiser."""
    from . import reference as blender

    if counts and not blender.has_denoiser():
        say("this Blender was built without OpenImageDenoise: denoised Cycles is left out")
        return []
    return list(counts)


def _variants(settings: Settings, techniques: Sequence[str] | None) -> list[tuple[str, Settings]]:
    """(row, settings): everything, direct light alone, and each technique by itself where there are several."""
    single = [name for name in (techniques if techniques is not None else optional_techniques()) if name not in ALWAYS_ON]
    rows = [("RTGI", settings), ("direct only", settings_for(settings, None, ()))]
    return rows + [(name, settings_for(settings, None, (name,))) for name in single]


def row_cells(name: str, row: dict[str, Any]) -> list[str]:
    """A row of the table; parts that the reference has none of, and parts of peers, are "-"."""
    errors = row["errors"]

    def block(part: str) -> str:
        return percent(errors.get(part, {}).get("block"))

    time = f"{row['seconds']:.2f} s" if "seconds" in row else ""
    energy = errors["picture"].get("energy")
    return [name, time, block("direct"), block("bounce"), block("glossy bounce"), block("picture"),
            f"{energy:.3f}" if energy is not None else "-", percent(errors["picture"].get("nrmse"))]


def stage_lines(report: dict[str, Any]) -> str:
    """Stage times in two columns, with the sum and the compile time apart."""
    rows = [[stage["name"], f"{stage['ms']:.1f}"] for stage in report["stages"]]
    rows += [["sum", f"{report['total_ms']:.1f}"], ["compiling, apart", f"{report['jit_ms']:.1f}"]]
    return text_table(("stage", "ms"), rows)


def compare_scene(blend_path: str | Path | None, out_dir: str | Path, techniques: Sequence[str] | None = None,
                  samples: int = 64, size: tuple[int, int] | None = None, preset: str | None = None, threads: int = 0,
                  peers: Sequence[int] = PEER_SAMPLES, reference: str | Path | None = None) -> dict[str, Any]:
    """Render a scene with RTGI and with Cycles one-bounce and say how far they are apart.

    Prints the table and the stage times; writes compare.png (RTGI, Cycles, error map) and compare.json into `out_dir`.

    Parameters
    ----------
    blend_path : .blend to open, or None for the scene that Blender has open.
    techniques : names that RTGI uses, or None for what the scene's own settings say.
    samples : samples a pixel of each of the reference's two halves.
    size : (width, height) px, or None for the scene's own.
    preset : DRAFT, BALANCED or QUALITY, or None for the scene's own settings.
    threads : for both engines; 0 leaves what the scene says.
    peers : sample counts of denoised Cycles renders to show beside RTGI.
    reference : .npz of a reference, or a folder of them, instead of rendering one.

    Returns
    -------
    dict, as in compare.json: "rows" {name: {seconds, errors, ...}}, "noise", "report" of the RTGI row, "files".

    Raises
    ------
    InputError
        The scene, a technique's name or the reference cannot be used.
    CaptureError
        A render failed.
    """
    from . import reference as blender

    out = Path(out_dir)
    path = Path(blend_path) if blend_path is not None else None
    scene = blender.open_scene(path) if path is not None else blender.current_scene()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {out}: {error.strerror}; choose another place") from error
    with blender.on_threads(scene, threads):
        return _compare(blender, scene, path, out, techniques, samples, size or blender.picture_size(scene), preset, peers,
                        Path(reference) if reference is not None else None)


def _compare(blender: Any, scene: Any, path: Path | None, out: Path, techniques: Sequence[str] | None,
             samples: int, size: tuple[int, int], preset: str | None, peers: Sequence[int],
             given: Path | None) -> dict[str, Any]:
    settings = settings_for(blender.scene_settings(scene), preset, techniques)
    truth = reference_for(scene, path, size, samples, out / "references", given)
    noise = noise_of(truth)
    rows: dict[str, dict[str, Any]] = {}
    main = None
    for name, variant in _variants(settings, techniques):
        say(f"{name}: two frames, the second is timed")
        with blender.keeping_data(scene):
            first, _ = blender.render_rtgi(scene, variant, size)
            result, seconds = blender.render_rtgi(scene, variant, size)
        rows[name] = {"seconds": seconds, "errors": errors_of(result, truth)}
        if main is None:
            main, main.report["jit_ms"] = result, first.report["jit_ms"]
    for count in peers_for(peers):
        name = f"Cycles {count} + denoiser"
        say(f"{name}: two frames, the second is timed")
        peer = blender.render_peer(scene, count, True, 1, size)
        rows[name] = {"seconds": peer.seconds[0], "errors": {"picture": picture_errors(peer.combined, truth)}}
    title = path.stem if path is not None else scene.name
    halves = f"2 x {truth.samples} samples" if truth.samples else "two halves"
    picture = side_by_side([
        (f"RTGI  {rows['RTGI']['seconds']:.2f} s", f"error {percent(rows['RTGI']['errors']['picture']['block'])}",
         blender.displayed(main.combined, scene)),
        (f"Cycles one bounce, {halves}", f"its noise {percent(noise['picture'])}",
         blender.displayed(truth.mean("picture"), scene)),
        (f"Relative error, means of {ERROR_WINDOW_PX}x{ERROR_WINDOW_PX} px", "",
         error_map(main.combined, truth.mean("picture"))),
    ], ERROR_SCALE, blender.drawn_text)
    files = {"picture": str(out / "compare.png"), "json": str(out / "compare.json")}
    write_picture(Path(files["picture"]), picture)
    outcome = {"scene": title, "size": list(size), "samples": truth.samples, "rows": rows, "noise": noise,
               "report": main.report, "files": files}
    with replacing(Path(files["json"])) as partial:
        partial.write_text(json.dumps(outcome, indent=2) + "\n", encoding="utf-8")
    parts = ("direct", "bounce", "glossy bounce", "picture")
    noise_row = ["the reference's own noise", "", *(percent(noise.get(part)) for part in parts), "", ""]
    print(f"{title}, {size[0]}x{size[1]}: error against Cycles one-bounce, {halves} "
          "(relative L1 of 8x8 blocks; per pixel: nrmse without the reference's noise)")
    print(text_table(HEAD, [*(row_cells(name, row) for name, row in rows.items()), noise_row]))
    if noise["picture"] > NOISY * rows["RTGI"]["errors"]["picture"]["block"]:
        print("The reference's noise is a large part of these errors; more samples (--samples) tell more.")
    print(f"\n{stage_lines(main.report)}\n\n{files['picture']}", flush=True)
    return outcome
