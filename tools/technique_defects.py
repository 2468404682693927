"""Defects that the literature names, each with and without what is done about it: python -m tools.technique_defects

    python -m tools.technique_defects [--scenes out/scenes] [--cache out/references] [--size 480x270]

Measures on sample scenes, which are built into `--scenes` if they are not there, and writes the tables between the marks
`defects` of docs/passes/. What a number is stands above its table. Needs bpy.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from rtgi_addon.core.frame import Frame  # noqa: E402
from rtgi_addon.core.techniques import SsrParams  # noqa: E402
from rtgi_addon.passes.base import Transport  # noqa: E402
from tools.parameter_tables import between_marks  # noqa: E402
from tools.technique_tables import Way, markdown_table, run_way  # noqa: E402

RUNS = 5                    # of which the least time counts
LAMPS = (1, 4, 10, 30)
OPEN = 0.9                  # visibility by rays from which on a pixel counts as open
FEW_PX = 200                # fewer pixels of a sort are no sample
COMMAND = "`python -m tools.technique_defects`"
SEEDS = (0, 1, 2, 3)
GLOSS = ((0.0, 0.1), (0.1, 0.3), (0.3, 0.6), (0.6, 1.01))


class Bench:
    """Sample scenes, opened and captured when they are asked for."""

    def __init__(self, scenes: Path, cache: Path, size: tuple[int, int]):
        self.scenes, self.cache, self.size = scenes, cache, size

    def frame(self, name: str, light: str = "") -> Frame:
        """The scene's frame under one of `scene_frames.lit_by`'s lights."""
        return self.with_truth(name, light, False)[0]

    def with_truth(self, name: str, light: str = "", wants_truth: bool = True) -> tuple[Frame, Any]:
        """(frame, reference, or None where none is wanted)."""
        from rtgi_addon.compare import reference as blender
        from sample_scenes.build import save_scene
        from tools.scene_frames import captured, lit_by, reference_under

        path = self.scenes / f"{name}.blend"
        if not path.is_file():
            save_scene(name, self.scenes)
        scene = blender.open_scene(path)
        with blender.on_threads(scene, 2), lit_by(scene, light):
            truth = reference_under(scene, path, light or "own_light", self.size, 64, self.cache) if wants_truth else None
            return captured(scene, self.size)[0], truth


def least_ms(frame: Frame, way: Way) -> float:
    """Milliseconds of the way's stage."""
    reports = [run_way(frame, way).report for _ in range(RUNS)]
    return min(sum(s["ms"] for s in report["stages"] if s["name"] == way.technique) for report in reports)


def with_lamps(frame: Frame, count: int) -> Frame:
    """The frame with its first lamps only."""
    views = tuple(view for view in frame.views if view.light_index < count)
    return dataclasses.replace(frame, lights=frame.lights[:count], views=views)


_RSM = (Way("rsm", "as published", "bounce", {"method": "PAPER"}), Way("rsm", "all texels", "bounce", {"method": "ALL"}),
        Way("rsm", "with visibility", "bounce"))
_LEAKY = {
    "rsm": _RSM,
    "vxgi": (Way("vxgi", "cones, as published", "bounce", {"exact_voxels": 0}), Way("vxgi", "rays", "bounce")),
    "lpv": (Way("lpv", "as published", "bounce", {"mode": "PAPER"}),
            Way("lpv", "directions, no blockers", "bounce", {"blockers": False}), Way("lpv", "directions", "bounce")),
}
_AMBIENT = (Way("ssao", "SSAO, ball as published", "", {"method": "SPHERE"}, ("direct",)),
            Way("ssao", "SSAO, hemisphere", "", {}, ("direct",)),
            Way("hbao", "HBAO, as published", "", {"method": "PUBLISHED"}, ("direct",)),
            Way("hbao", "HBAO, by cosine", "", {}, ("direct",)))


def lamps_table(bench: Bench) -> str:
    """Time of reflective shadow maps over the number of lamps."""
    frame = bench.frame("many_lights")
    counts = [n for n in LAMPS if n <= len(frame.lights)]
    rows = [[way.label, *(f"{least_ms(with_lamps(frame, n), way):.0f} ms" for n in counts)] for way in _RSM]
    return (f"Time of the gather over the number of lamps ({COMMAND}, `sample_scenes/many_lights.py`, "
            f"{bench.size[0]}x{bench.size[1]}; views and BVH aside):\n\n"
            + markdown_table(["lamps", *map(str, counts)], rows))


def leak_of(frame: Frame, way: Way) -> float:
    """Mean bounce in the closed room of the maze over that in the rooms with lamps."""
    from sample_scenes import thin_wall_maze as maze

    g = frame.gbuffer
    place = g.position_ws + frame.origin_ws.astype(np.float32)
    cells = np.array(maze.cells(maze.CLOSED_ROOM))
    # half a centimetre inside of the walls, above the floor that both sides share, below the walls' tops
    margin = maze.WALL_M / 2 + 0.005
    low, high = cells.min(0) - 2 * maze.STEP_M + margin, cells.max(0) + 2 * maze.STEP_M - margin
    inside = g.mask & ((place[..., :2] > low) & (place[..., :2] < high)).all(-1) & (place[..., 2] < maze.HEIGHT_M - 0.01)
    around = ((place[..., :2] > low - 2 * margin) & (place[..., :2] < high + 2 * margin)).all(-1)
    light = run_way(frame, way).transports[Transport.BOUNCE_DIFFUSE].mean(-1)
    return float(light[inside].mean() / light[g.mask & ~around].mean())


def leak_tables(bench: Bench) -> dict[str, str]:
    """By technique: what leaks into a closed room."""
    frame = bench.frame("thin_wall_maze")
    head = ("Light in the closed room of `sample_scenes/thin_wall_maze.py`, behind walls of 2 cm, over the mean of the "
            f"other rooms ({COMMAND}):\n\n")
    rows = {name: [[way.label, f"{100 * leak_of(frame, way):.2f} %"] for way in ways] for name, ways in _LEAKY.items()}
    return {name: head + markdown_table(["", "leaks in"], rows[name]) for name in rows}


def errors_table(bench: Bench, scene: str, ways: Sequence[Way]) -> list[list[str]]:
    """Rows (label, error, energy, ms) against Cycles."""
    from rtgi_addon.compare import metrics
    from rtgi_addon.compare.measure import part_of
    from rtgi_addon.compare.report import percent

    frame, truth = bench.with_truth(scene)
    rows = []
    for way in ways:
        got = part_of(run_way(frame, way).transports, way.part, truth.albedo)
        wanted = truth.mean(way.part)
        rows.append([way.label, percent(metrics.block_relative_l1(got, wanted, truth.mask)),
                     f"{metrics.energy_ratio(got, wanted, truth.mask):.2f}", f"{least_ms(frame, way):.0f} ms"])
    return rows


def steps_table(bench: Bench) -> str:
    """Light propagation volumes over steps and cells."""
    ways = [Way("lpv", f"as published, {n} steps", "bounce", {"mode": "PAPER", "iterations": n}) for n in (2, 8, 32)]
    ways += [Way("lpv", f"harmonics until {100 * share:g} % of the flux moves", "bounce",
                 {"mode": "HARMONICS", "residual": share, "max_iterations": 1024}) for share in (0.1, 0.01, 0.001)]
    ways += [Way("lpv", f"directions, {n} cells an edge", "bounce", {"resolution": n}) for n in (16, 32, 64)]
    return (f"Steps and cells in `sample_scenes/cornell_box.py`, {bench.size[0]}x{bench.size[1]} ({COMMAND}): error of the "
            "bounce, its light over that of Cycles, time:\n\n"
            + markdown_table(["", "error", "light", "time"], errors_table(bench, "cornell_box", ways)))


def false_shadow_table(bench: Bench) -> str:
    """Light of an even sky that a method takes away and rays do not, and the other way round."""
    open_rows, rows = ({way.label: [way.label] for way in _AMBIENT} for _ in range(2))
    names = ("courtyard", "sunlit_colonnade", "coloured_corner", "glossy_hall")
    for name in names:
        frame = bench.frame(name, "even_sky")
        mask = frame.gbuffer.mask
        rays = run_way(frame, Way("world", "", "", {"rays": 256, "lattice_px": 1}, ())).visibility
        is_open = mask & (rays > OPEN)
        for way in _AMBIENT:
            seen = run_way(frame, way).visibility
            false, missed = (100 * np.maximum(sign * (rays - seen), 0)[mask].sum() / rays[mask].sum() for sign in (1, -1))
            rows[way.label].append(f"{false:.1f} %, {missed:.0f} %")
            taken = f"{100 * (1 - seen[is_open]).mean():.1f} %" if is_open.sum() > FEW_PX else "-"
            open_rows[way.label].append(taken)
    return (f"False shadows ({COMMAND}): how much of an even sky is taken from pixels that see more than {100 * OPEN:.0f} % "
            "of it by rays of any length:\n\n" + markdown_table(["", *names], list(open_rows.values()))
            + "\nOver all pixels, false shadow (light taken that rays find) and missed shadow (light left that rays find "
              "hidden), of the light that rays find:\n\n" + markdown_table(["", *names], list(rows.values())))


def gloss_table(bench: Bench) -> str:
    """Noise, error and time of reflections over the roughness of what reflects."""
    from rtgi_addon.compare import metrics
    from rtgi_addon.compare.measure import part_of
    from rtgi_addon.compare.report import percent
    from rtgi_addon.passes.base import Context
    from rtgi_addon.passes.ssr import compute_ssr

    frame, truth = bench.with_truth("glossy_hall")
    way = Way("ssr", "", "glossy bounce")
    result = run_way(frame, way)
    wanted, got = truth.mean(way.part), part_of(result.transports, way.part, truth.albedo)
    context = Context()
    own = (Transport.BOUNCE_GLOSSY, Transport.WORLD_GLOSSY)
    context.light = {transport: light for transport, light in result.transports.items() if transport not in own}

    def bounces(**params: Any) -> list[np.ndarray]:
        return [compute_ssr(frame, SsrParams(**params), context, seed).light[own[0]] for seed in SEEDS]

    settings = {"triangles, 8 samples": bounces(), "hierarchy, 8 samples": bounces(method="HIERARCHY"),
                "triangles, 64 samples": bounces(samples=64)}
    seeds = [[name, *(percent(metrics.block_relative_l1(light, wanted, truth.mask)) for light in found),
              f"{max(float(light.max()) for light in found) / wanted.max():.1f}"] for name, found in settings.items()]
    runs = np.stack([light.mean(-1) for light in settings["triangles, 8 samples"]])
    roughness, rows = frame.gbuffer.roughness, []
    for low, high in GLOSS:
        part = truth.mask & (roughness >= low) & (roughness < high) & (frame.gbuffer.specular.max(-1) > 1e-3)
        if part.sum() < FEW_PX or not wanted[part].sum() > 0:
            continue
        noise = float(runs[:, part].std(0, ddof=1).mean() / runs[:, part].mean())
        rows.append([f"{low:g} to {min(high, 1):g}", f"{100 * part.sum() / truth.mask.sum():.0f} %", percent(noise),
                     percent(metrics.block_relative_l1(got, wanted, part)),
                     percent(metrics.block_noise(*truth.halves(way.part), part))])
    return (f"Roughness and noise in `sample_scenes/glossy_hall.py`, {bench.size[0]}x{bench.size[1]} ({COMMAND}): spread "
            "of the finished reflection between seeds over its mean, error of 8x8 blocks, the reference's own noise:\n\n"
            + markdown_table(["roughness", "of the picture", "spread", "error", "reference's noise"], rows)
            + "\nRare bright rays: error of the glossy bounce by seed, and the brightest pixel over that of Cycles:\n\n"
            + markdown_table(["", *(f"seed {seed}" for seed in SEEDS), "brightest"], seeds))


def main() -> int:
    """The command; see the module's text."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="pages to write, such as rsm; all if left out")
    parser.add_argument("--scenes", type=Path, default=Path("out/scenes"))
    parser.add_argument("--cache", type=Path, default=Path("out/references"))
    parser.add_argument("--size", default="480x270")
    words = parser.parse_args()
    from rtgi_addon import register
    from tools.scene_frames import size_of

    register()
    bench = Bench(words.scenes, words.cache, size_of(words.size))
    leaks = functools.cache(lambda: leak_tables(bench))
    false_shadows = functools.cache(lambda: false_shadow_table(bench))
    texts: dict[str, Sequence[Callable[[], str]]] = {
        "rsm": (lambda: lamps_table(bench), lambda: leaks()["rsm"]), "vxgi": (lambda: leaks()["vxgi"],),
        "lpv": (lambda: leaks()["lpv"], lambda: steps_table(bench)), "ssao": (false_shadows,), "hbao": (false_shadows,),
        "ssr": (lambda: gloss_table(bench),)}
    for name in words.names or texts:
        text = "\n".join(part() for part in texts[name])
        print(f"{name}\n{text}", flush=True)
        path = ROOT / "docs" / "passes" / f"{name}.md"
        path.write_text(between_marks(path.read_text(encoding="utf-8"), "defects", text), encoding="utf-8")
    os._exit(0)                 # bpy 4.5 is known to hang at its exit after renders by an engine of its own


if __name__ == "__main__":
    sys.exit(main())
