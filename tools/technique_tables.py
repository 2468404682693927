"""Every technique on every scene, beside direct light alone: python -m tools.technique_tables

    python -m tools.technique_tables [SCENE.blend ...] --records out/techniques.jsonl [--size 640x360]
    [--references FOLDER] [--samples 64] [--cache out/references] [--threads 2]

Measures the scenes, puts the numbers into the records in place of those of the same scene and size, and makes
docs/techniques.md and the tables of docs/passes/ of all records. Without a scene it only makes the pages. Needs bpy for
measuring.

Each scene is captured as it is, without its lamps under an even white sky, and, where it has square lamps, with emissive
panels in their place. All rows run on the same captured frame, so that they differ in nothing else. `--references` are of
the scenes as they are; the others are rendered, and kept in `--cache`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from rtgi_addon.compare.report import percent  # noqa: E402
from rtgi_addon.core.techniques import LABELS, TECHNIQUE_PARAMS, default_settings  # noqa: E402
from tools.parameter_tables import between_marks  # noqa: E402

WHOLE_SCENE = -1.0          # stands for a radius of the scene's size
TOO_NOISY = 0.5             # noise of a reference that nothing can be held against
MOST_SHOWN = 10.0           # errors above this say no more than that the light is wrong
# diagnostics that pages show: words, and how a value is written
FACTS = {"voxels": ("voxels with surface", "{:,.0f}".format), "lost_flux_share": ("flux outside the grid", percent)}
RUNS = 3                    # of each way; the least time counts, since whatever else the machine does only adds
STRAIGHT = ("direct", "world", "emission")
AS_IT_IS, SKY, PANELS = "as it is", "even sky", "panels for lamps"


@dataclass(frozen=True)
class Way:
    """One row: a technique with some parameters, run after others.

    `part` of the reference is what it is held against; `beside` runs too. A `detail` stands on the technique's page only,
    and runs once. One that `needs_world` is left out of scenes with a black world.
    """

    technique: str
    label: str
    part: str
    params: dict[str, Any] = field(default_factory=dict)
    beside: tuple[str, ...] = STRAIGHT
    light: str = AS_IT_IS
    detail: bool = False
    needs_world: bool = False

    @property
    def key(self) -> str:
        return f"{self.technique}: {self.label}, {self.light}"


_SHADOW_MAPS = "Reflective shadow maps"
_NO_WORLD = ("direct", "emission")
WAYS = (
    Way("direct", "Direct light alone", "direct"),
    Way("rsm", f"{_SHADOW_MAPS}, as published", "bounce", {"method": "PAPER"}),
    Way("rsm", f"{_SHADOW_MAPS}, all texels", "bounce", {"method": "ALL"}),
    Way("rsm", f"{_SHADOW_MAPS}, with visibility", "bounce"),
    Way("rsm", "as published, weight as printed", "bounce", {"method": "PAPER", "weighting": "PUBLISHED"}, detail=True),
    Way("rsm", "as published, 100 samples", "bounce", {"method": "PAPER", "samples": 100}, detail=True),
    Way("rsm", "as published, 1600 samples", "bounce", {"method": "PAPER", "samples": 1600}, detail=True),
    Way("rsm", "with visibility, matt texels only", "bounce", {"glossy_texels": False}, detail=True),
    Way("rsm", "with visibility, 4 rays", "bounce", {"rays": 4}, detail=True),
    Way("rsm", "with visibility, 64 rays, every second pixel", "bounce", {"rays": 64, "lattice_px": 2}, detail=True),
    Way("vxgi", "Voxels, cones as published", "bounce", {"exact_voxels": 0}),
    Way("vxgi", "Voxels, rays", "bounce"),
    Way("vxgi", "rays, matt voxels only", "bounce", {"glossy_voxels": False}, detail=True),
    Way("vxgi", "rays, 8 at every second pixel", "bounce", {"cones": 8, "lattice_px": 2}, detail=True),
    Way("vxgi", "cones as published, bodies filled (`solid`)", "bounce", {"exact_voxels": 0, "solid": True}, detail=True),
    Way("vxgi", "Quality", "bounce", {"resolution": 256, "lattice_px": 2, "cones": 64}, detail=True),
    Way("vxgi", "one cone for glossy pixels (`glossy`)", "glossy bounce", {"glossy": True}, detail=True),
    Way("lpv", "Light propagation volumes, as published", "bounce", {"mode": "PAPER"}),
    Way("lpv", "Light propagation volumes, harmonics", "bounce", {"mode": "HARMONICS"}),
    Way("lpv", "Light propagation volumes, directions", "bounce"),
    Way("lpv", "directions, no blockers", "bounce", {"blockers": False}, detail=True),
    Way("lpv", "directions, matt texels only", "bounce", {"glossy_texels": False}, detail=True),
    Way("lpv", "directions, one grid (`cascades` 1)", "bounce", {"cascades": 1}, detail=True),
    Way("lpv", "directions, Draft", "bounce", {"resolution": 24, "directions": 4, "lattice_px": 8}, detail=True),
    Way("lpv", "directions, Quality", "bounce", {"resolution": 48, "directions": 6, "lattice_px": 3}, detail=True),
    Way("ssdo", "Directional occlusion, as published", "bounce", {"form": "SAMPLES"}, _NO_WORLD),
    Way("ssdo", "Directional occlusion, sectors", "bounce", beside=_NO_WORLD),
    Way("ssdo", "Directional occlusion, sharing with shadow maps (their time apart)", "bounce", {"hand_over": True},
        (*_NO_WORLD, "rsm")),
    Way("ssdo", "sectors, 4 slices of 16 steps at every pixel", "bounce", {"slices": 4, "steps": 16, "lattice_px": 1},
        _NO_WORLD, detail=True),
    Way("ssdo", "sectors, radius of the whole scene", "bounce", {"radius_m": WHOLE_SCENE}, _NO_WORLD, detail=True),
    Way("final_gather", "Shadow maps with visibility, and final gathering of the world's light", "bounce",
        beside=(*STRAIGHT, "rsm"), needs_world=True),
    Way("ssr", "Reflections, even steps in the picture", "glossy bounce", {"method": "LINEAR", "fallback": "WORLD"}),
    Way("ssr", "Reflections, hierarchy in the picture", "glossy bounce", {"method": "HIERARCHY", "fallback": "WORLD"}),
    Way("ssr", "Reflections, hierarchy and rays beyond", "glossy bounce", {"method": "HIERARCHY"}),
    Way("ssr", "Reflections, rays through triangles", "glossy bounce"),
    Way("ssr", "even steps of 1 px in the picture", "glossy bounce",
        {"method": "LINEAR", "fallback": "WORLD", "step_px": 1}, detail=True),
    Way("ssr", "even steps of 16 px in the picture", "glossy bounce",
        {"method": "LINEAR", "fallback": "WORLD", "step_px": 16}, detail=True),
    Way("ssr", "every pixel in the picture", "glossy bounce", {"method": "DDA", "fallback": "WORLD"}, detail=True),
    Way("ssr", "hierarchy in the picture, no fade at its edge", "glossy bounce",
        {"method": "HIERARCHY", "fallback": "WORLD", "edge_fade": 0.0}, detail=True),
    Way("ssr", "rays through triangles, 64 samples", "glossy bounce", {"samples": 64}, detail=True),
    Way("world", "World light by rays", "direct diffuse", beside=("direct",), light=SKY),
    Way("ssao", "Ambient occlusion, ball as published", "direct diffuse", {"method": "SPHERE"}, ("direct",), SKY),
    Way("ssao", "Ambient occlusion, hemisphere", "direct diffuse", beside=("direct",), light=SKY),
    Way("ssao", "hemisphere, 64 points", "direct diffuse", {"samples": 64}, ("direct",), SKY, detail=True),
    Way("ssao", "hemisphere, 4 points without blur", "direct diffuse", {"samples": 4, "blur": 0}, ("direct",), SKY,
        detail=True),
    Way("ssao", "hemisphere, 4 points", "direct diffuse", {"samples": 4}, ("direct",), SKY, detail=True),
    Way("ssao", "hemisphere, overscan 0.15", "direct diffuse", {"overscan": 0.15}, ("direct",), SKY, detail=True),
    Way("hbao", "Ambient occlusion, horizons as published", "direct diffuse", {"method": "PUBLISHED"}, ("direct",), SKY),
    Way("hbao", "Ambient occlusion, horizons by cosine", "direct diffuse", beside=("direct",), light=SKY),
    Way("hbao", "by cosine, radius of the whole scene", "direct diffuse", {"radius_m": WHOLE_SCENE}, ("direct",), SKY,
        detail=True),
    Way("hbao", "by cosine, radius of the whole scene, overscan 0.3", "direct diffuse",
        {"radius_m": WHOLE_SCENE, "overscan": 0.3}, ("direct",), SKY, detail=True),
    Way("ssdo", "Directional occlusion, as published", "direct diffuse", {"form": "SAMPLES"}, ("direct",), SKY),
    Way("ssdo", "Directional occlusion, sectors", "direct diffuse", beside=("direct",), light=SKY),
    Way("vxgi", "Voxels, rays (`world_light`)", "direct diffuse", {"world_light": True}, ("direct",), SKY),
    Way("final_gather", "Final gathering", "bounce", beside=("direct", "world"), light=SKY),
    Way("ssdo", "Directional occlusion, bounce of the sky", "bounce", beside=("direct",), light=SKY),
    Way("ssr", "Reflections of the sky", "direct glossy", beside=("direct", "world"), light=SKY),
    Way("emission", "Emissive surfaces", "direct diffuse", beside=("world",), light=PANELS),
    Way("vxgi", "Voxels, emissive surfaces", "direct diffuse", beside=("world",), light=PANELS),
    Way("final_gather", "Final gathering", "bounce", beside=("world", "emission"), light=PANELS),
)
UNSHADOWED = "Even light, nothing in its way"


# ---- measuring ----

def run_way(frame: Any, way: Way) -> Any:
    """`pipeline.Result` of one way on a captured frame."""
    from rtgi_addon import pipeline
    from rtgi_addon.passes import TECHNIQUES
    from rtgi_addon.planner import Plan

    params = {**way.params, **({"radius_m": frame.scale_m} if way.params.get("radius_m") == WHOLE_SCENE else {})}
    settings = default_settings().with_params(way.technique, **params)
    wanted = {*way.beside, way.technique}
    return pipeline.run(frame, Plan(tuple(name for name in TECHNIQUES if name in wanted)), settings)


def _light_errors(got: np.ndarray, wanted: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    from rtgi_addon.compare import metrics

    return {"light": metrics.block_relative_l1(got, wanted, mask), "energy": metrics.energy_ratio(got, wanted, mask),
            "scaled": metrics.after_best_scale(got, wanted, mask)[1]}


def measure_way(frame: Any, way: Way, truth: Any) -> dict[str, float] | None:
    """{light: error, energy, scaled, picture: error, ms}; None where the scene has none of the light, or too little to tell.

    `scaled` is the error that the best scale leaves.
    """
    from rtgi_addon.compare import metrics
    from rtgi_addon.compare.measure import BLACK, part_of

    wanted, whole, mask = truth.mean(way.part), truth.mean("picture"), truth.mask
    if not wanted[mask].sum() > BLACK * whole[mask].sum() or (way.needs_world and frame.world.is_black):
        return None
    if metrics.block_noise(*truth.halves(way.part), mask) > TOO_NOISY:
        return None
    results = [run_way(frame, way) for _ in range(1 if way.detail else RUNS)]
    times = [sum(s["ms"] for s in r.report["stages"] if s["name"] == way.technique) for r in results]
    got = part_of(results[0].transports, way.part, truth.albedo)
    facts = {k: v for k, v in results[0].report["diagnostics"][way.technique].items() if k in FACTS}
    return {**_light_errors(got, wanted, mask), **facts,
            "picture": metrics.block_relative_l1(results[0].combined[..., :3], whole, mask), "ms": min(times)}


def measure_scene(path: Path, size: tuple[int, int], samples: int, cache: Path, given: Path | None,
                  threads: int) -> dict[str, Any]:
    """The record of one scene."""
    from rtgi_addon.compare import metrics
    from rtgi_addon.compare import reference as blender
    from rtgi_addon.compare.measure import noise_of
    from rtgi_addon.compare.progress import say
    from rtgi_addon.compare.references import reference_for
    from tools.scene_frames import captured, panel_lamps, reference_under, under_even_sky, with_panels

    record: dict[str, Any] = {"scene": path.stem, "size": list(size), "ways": {}, "noise": {}, "samples": {}}
    scene = blender.open_scene(path)
    with blender.on_threads(scene, threads):
        truth = reference_for(scene, path, size, samples, cache, given)
        frame, everything = captured(scene, size)
        record["noise"][AS_IT_IS], record["samples"][AS_IT_IS] = noise_of(truth), truth.samples
        record["everything"] = {
            "picture": metrics.block_relative_l1(everything.combined[..., :3], truth.mean("picture"), truth.mask),
            "ms": sum(s["ms"] for s in everything.report["stages"] if s["name"] in TECHNIQUE_PARAMS)}
        record["threads"] = everything.report["threads"] or os.cpu_count()
        with under_even_sky(scene):
            sky_truth = reference_under(scene, path, "even_sky", size, samples, cache)
            sky_frame, _ = captured(scene, size)
        record["noise"][SKY], record["samples"][SKY] = noise_of(sky_truth), sky_truth.samples
        lit = {AS_IT_IS: (frame, truth), SKY: (sky_frame, sky_truth)}
        if panel_lamps(scene):
            with with_panels(scene):
                panel_truth = reference_under(scene, path, "shining_panels", size, samples, cache)
                lit[PANELS] = captured(scene, size)[0], panel_truth
            record["noise"][PANELS], record["samples"][PANELS] = noise_of(panel_truth), panel_truth.samples
        for way in WAYS:
            found = measure_way(lit[way.light][0], way, lit[way.light][1]) if way.light in lit else None
            if found is not None:
                record["ways"][way.key] = found
                say(f"{path.stem}: {way.key}: {100 * found['light']:.1f} %, {found['ms']:.0f} ms")
    wanted, mask = sky_truth.mean("direct diffuse"), sky_truth.mask
    if wanted[mask].sum() > 0 and metrics.block_noise(*sky_truth.halves("direct diffuse"), mask) <= TOO_NOISY:
        record["unshadowed"] = _light_errors(sky_truth.albedo.astype(np.float64), wanted, mask)
    return record


# ---- pages ----

_HEAD = """# Techniques, measured

Every technique on every scene, beside direct light alone. Made by tools/technique_tables.py, whose first lines say how; each
technique's page has its own rows, with more ways to set it. All rows of a column run on one captured frame, on {threads}
threads. Errors are relative L1 of 8x8 blocks against Cycles at one bounce ([how](comparison.md)); ms is the technique's own
stage, the least of {runs} runs, capture and BVH aside. "noise" is the error that the reference's own noise gives a perfect
render. "-": the scene has none of that light, or too little to tell.

"""
_PICTURE = """Error of the whole picture with direct light (of lamps, world and emissive surfaces) and this technique
alone, and the time of the technique. What it does not supply is missing in its picture: reflections alone leave the diffuse
bounce out, and the other way round.

"""
_LIGHT = """Error of the light that the technique is there for (bounce, or glossy bounce), in brackets its sum over that of
Cycles. 100 % is what nothing at all would have; more is worse than nothing. Where a world shines, the bounce holds that of
the world's light too, which only final gathering and directional occlusion supply.

"""
_SKY = """The scenes without their lamps, under a sky of radiance 1 from all sides: error of the sky's light on surfaces
(after one bounce in the rows of final gathering and "bounce of the sky", in highlights for reflections), in brackets its sum
over that of Cycles, and time. Even light with nothing in its way is what one has without any technique. In a closed room
the sky comes through a window or a door only, and what knows no more of the room than the picture or a radius shows takes
its walls for open.

"""


_SCALED = """Ambient occlusion was made for even light of no certain strength. The same light when each row may have the one
scale that suits it best: what is left is wrong in its places.

"""
_PANELS = """Scenes that have square lamps, with emissive panels in their place and no other lamp: error of
the panels' light on surfaces, or of its bounce.

"""


def _groups(records: Sequence[dict[str, Any]]) -> dict[tuple[int, int], list[dict[str, Any]]]:
    """Records by size, the largest first."""
    sizes = sorted({tuple(r["size"]) for r in records}, reverse=True)
    return {size: [r for r in records if tuple(r["size"]) == size] for size in sizes}


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table whose columns after the first are aligned to the right."""
    rule = ["---", *["---:"] * (len(head) - 1)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, rule, *rows)) + "\n"


def _error(value: float) -> str:
    return percent(value) if value <= MOST_SHOWN else f"> {100 * MOST_SHOWN:.0f} %"


def _light(found: dict[str, float]) -> str:
    energy = found["energy"]
    return f"{_error(found['light'])} ({energy:.{2 if energy < 10 else 0}f})"


def _ms(value: float) -> str:
    return f"{value:.0f} ms" if value >= 10 else f"{value:.1f} ms"


def _scaled(found: dict[str, float]) -> str:
    return _error(found["scaled"])


def _cell(record: dict[str, Any], way: Way, what: str) -> str:
    found = record["ways"].get(way.key)
    if found is None:
        return "-"
    if what == "picture":
        return f"{_error(found['picture'])}, {_ms(found['ms'])}"
    if what == "scaled":
        return _scaled(found)
    return _light(found) if what == "light" else f"{_light(found)}, {_ms(found['ms'])}"


def _markdown_of(records: Sequence[dict[str, Any]], rows: Sequence[list[str]]) -> str:
    """A table with a column for each record's scene."""
    return markdown_table(["", *(r["scene"] for r in records)], rows)


def _table(records: Sequence[dict[str, Any]], ways: Sequence[Way], what: str, extra: Sequence[tuple[str, list[str]]] = (),
           last: Sequence[tuple[str, list[str]]] = ()) -> str:
    """Rows of `ways` that some scene has, between rows that are given as words."""
    shown = [w for w in ways if any(w.key in r["ways"] for r in records)]
    rows = [[w.label, *(_cell(r, w, what) for r in records)] for w in shown]
    return _markdown_of(records, [*([name, *cells] for name, cells in extra), *rows,
                                  *([name, *cells] for name, cells in last)])


def _noise(records: Sequence[dict[str, Any]], light: str, part: str) -> list[str]:
    return [percent(r["noise"].get(light, {}).get(part)) for r in records]


def _unshadowed(records: Sequence[dict[str, Any]]) -> tuple[str, list[str]]:
    return UNSHADOWED, [_light(r["unshadowed"]) if "unshadowed" in r else "-" for r in records]


def _unshadowed_scaled(records: Sequence[dict[str, Any]]) -> tuple[str, list[str]]:
    return UNSHADOWED, [_scaled(r["unshadowed"]) if "unshadowed" in r else "-" for r in records]


def page(records: Sequence[dict[str, Any]]) -> str:
    """docs/techniques.md."""
    parts = [_HEAD.format(threads=records[0]["threads"], runs=RUNS)]
    for size, group in _groups(records).items():
        lamps = [w for w in WAYS if w.light == AS_IT_IS and not w.detail]
        everything = ("Automatic: all that the frame needs",
                      [f"{percent(r['everything']['picture'])}, {_ms(r['everything']['ms'])}" for r in group])
        parts += [f"## {size[0]}x{size[1]}: pictures\n\n", _PICTURE,
                  _table(group, lamps, "picture", last=[everything, ("noise", _noise(group, AS_IT_IS, "picture"))]),
                  f"\n## {size[0]}x{size[1]}: the light itself\n\n", _LIGHT,
                  _table(group, [w for w in lamps if w.technique != "direct"], "light",
                         last=[("noise, bounce", _noise(group, AS_IT_IS, "bounce")),
                               ("noise, glossy bounce", _noise(group, AS_IT_IS, "glossy bounce"))]),
                  f"\n## {size[0]}x{size[1]}: under an even sky\n\n", _SKY,
                  _table(group, [w for w in WAYS if w.light == SKY and not w.detail], "light, ms", [_unshadowed(group)],
                         [("noise, sky's light", _noise(group, SKY, "direct diffuse")),
                          ("noise, bounce", _noise(group, SKY, "bounce")),
                          ("noise, highlights", _noise(group, SKY, "direct glossy"))]), "\n"]
        ambient = [w for w in WAYS if w.light == SKY and w.part == "direct diffuse" and not w.detail]
        parts += [_SCALED, _table(group, ambient, "scaled", [_unshadowed_scaled(group)]), "\n"]
        panels = [r for r in group if PANELS in r["noise"]]
        if panels:
            parts += [f"## {size[0]}x{size[1]}: emissive panels\n\n", _PANELS,
                      _table(panels, [w for w in WAYS if w.light == PANELS], "light, ms", last=[
                          ("noise, direct", _noise(panels, PANELS, "direct diffuse")),
                          ("noise, bounce", _noise(panels, PANELS, "bounce"))]), "\n"]
    return "".join(parts).rstrip("\n") + "\n"


def tables_of(name: str, records: Sequence[dict[str, Any]]) -> str:
    """The tables on a technique's page, each of the scenes of the largest size at which it has light to bring."""
    parts = []

    def scenes_of(light: str) -> tuple[list[Way], list[dict[str, Any]], str]:
        """(ways, records, "At WxH"); no ways where no scene has the light."""
        ways = [w for w in WAYS if w.technique == name and w.light == light]
        for size, group in _groups(records).items():
            group = [r for r in group if light in r["noise"]]
            if any(w.key in r["ways"] for w in ways for r in group):
                return ways, group, f"{size[0]}x{size[1]}"
        return [], [], ""

    ways, group, size = scenes_of(AS_IT_IS)
    if ways:
        main, part = [w for w in ways if not w.detail], ways[0].part
        rows = main if name == "direct" else [next(w for w in WAYS if w.technique == "direct"), *main]
        what = "direct light itself" if name == "direct" else part
        parts += [f"{size}, error of the picture with direct light and this alone, and time of the stage:\n\n"
                  + _table(group, rows, "picture"),
                  f"Error of the {what}, in brackets its sum over that of Cycles, and time:\n\n"
                  + _table(group, ways, "light, ms", last=[("noise", _noise(group, AS_IT_IS, part))])]
        facts = {}
        for key, (word, written) in FACTS.items():
            found = [[r["ways"][w.key][key] for w in main if key in r["ways"].get(w.key, {})] for r in group]
            if any(found):
                facts[word] = [written(values[0]) if values else "-" for values in found]
        if facts:
            parts.append(_markdown_of(group, [[word, *cells] for word, cells in facts.items()]))
    ways, group, size = scenes_of(SKY)
    if ways:
        part = ways[0].part
        parts.append(f"{size}, the scenes without lamps under an even sky, error of the sky's light"
                     + {"bounce": " after one bounce", "direct glossy": " in reflections"}.get(part, "")
                     + ", energy, time:\n\n"
                     + _table(group, ways, "light, ms", [_unshadowed(group)] if part == "direct diffuse" else [],
                              [("noise", _noise(group, SKY, part))]))
        if name in ("ssao", "hbao", "ssdo"):
            parts.append("The same when each row may have the one scale that suits it best, error:\n\n" + _table(
                group, [w for w in ways if w.part == "direct diffuse"], "scaled", [_unshadowed_scaled(group)]))
    ways, group, size = scenes_of(PANELS)
    if ways:
        part = ways[0].part
        parts.append(f"{size}, emissive panels in place of square lamps, error of their light"
                     + (" after one bounce" if part == "bounce" else "") + ", energy, time:\n\n"
                     + _table(group, ways, "light, ms", last=[("noise", _noise(group, PANELS, part))]))
    if not parts:
        return "No scene that was measured has this light.\n"
    head = ("By `python -m tools.technique_tables`; [techniques.md](../techniques.md) says what is measured, and has all "
            "techniques side by side. Rows that stand here only ran once.\n")
    return "\n".join([head, *parts])


def write_pages(records: Sequence[dict[str, Any]]) -> None:
    """docs/techniques.md and the marked place of every technique's page."""
    (ROOT / "docs" / "techniques.md").write_text(page(records), encoding="utf-8")
    for name in LABELS:
        path = ROOT / "docs" / "passes" / f"{name}.md"
        text = path.read_text(encoding="utf-8")
        path.write_text(between_marks(text, "measured", tables_of(name, records)), encoding="utf-8")


def main() -> int:
    """The command; see the module's text."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scenes", nargs="*", type=Path, metavar="SCENE.blend")
    parser.add_argument("--records", type=Path, required=True, metavar="JSONL", help="measurements, read and written")
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--references", type=Path, metavar="FOLDER", help="NAME_WxH.npz of the scenes as they are")
    parser.add_argument("--samples", type=int, default=64, help="of each half of a reference that is rendered")
    parser.add_argument("--cache", type=Path, default=Path("out/references"), help="folder that keeps references")
    parser.add_argument("--threads", type=int, default=2)
    words = parser.parse_args()
    records = ([json.loads(line) for line in words.records.read_text(encoding="utf-8").splitlines()]
               if words.records.is_file() else [])
    if words.scenes:
        from rtgi_addon import register
        from tools.scene_frames import size_of

        register()
        for path in words.scenes:
            new = measure_scene(path, size_of(words.size), words.samples, words.cache, words.references, words.threads)
            same = [i for i, r in enumerate(records) if (r["scene"], r["size"]) == (new["scene"], new["size"])]
            records[same[0] if same else len(records):] = [new, *records[same[0] + 1:]] if same else [new]
            words.records.parent.mkdir(parents=True, exist_ok=True)
            words.records.write_text("".join(json.dumps(r) + "\n" for r in records), encoding="utf-8")
    if not records:
        parser.error("no scene was named and there are no records")
    write_pages(records)
    sys.stdout.flush()
    if words.scenes:
        os._exit(0)             # bpy 4.5 is known to hang at its exit after renders by an engine of its own
    return 0


if __name__ == "__main__":
    sys.exit(main())
