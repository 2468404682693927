"""Reflections against Cycles' Glossy Indirect, with and without what answers beyond the picture: python -m tools.reflections

    python -m tools.reflections SCENE.blend ... [--size 640x360] [--samples 96] [--cache FOLDER | --references FOLDER]
    [--seed N]

Prints a table in Markdown. A pixel counts as in the picture if what its mirror ray meets is seen by the camera. Needs bpy.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from rtgi_addon import pipeline, register
from rtgi_addon.compare import metrics
from rtgi_addon.core.frame import Frame, World
from rtgi_addon.core.techniques import SsrParams, default_settings
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.ssr import compute_ssr

HEAD = ("scene", "glossy bounce in the picture", "picture without", "picture with", "glossy bounce", "its noise", "energy",
        "in the picture: rays", "world alone", "beyond: rays", "world alone", "beyond")


def frame_of(scene, size: tuple[int, int]) -> tuple[Frame, dict[Transport, np.ndarray], np.ndarray]:
    """The captured frame, the light of direct, world and rsm on it, and their picture."""
    from rtgi_addon.compare.reference import render_rtgi

    kept = []

    def keep(frame, *args, **kwargs):
        kept.append(frame)
        return run(frame, *args, **kwargs)

    run, pipeline.run = pipeline.run, keep
    try:
        result, _ = render_rtgi(scene, default_settings(techniques=["rsm"]), size)
    finally:
        pipeline.run = run
    return kept[-1], result.transports, result.combined


def mirrors_show(frame: Frame) -> np.ndarray:
    """(H, W) bool: pixels whose mirror ray meets what the camera sees."""
    g = frame.gbuffer
    white = dataclasses.replace(g, specular=np.ones_like(g.specular), roughness=np.zeros_like(g.roughness),
                                albedo=np.ones_like(g.albedo))
    context = Context()
    context.light = {Transport.EMISSION_DIFFUSE: np.full_like(g.albedo, np.pi)}
    dark = dataclasses.replace(frame, gbuffer=white, lights=(), world=World())
    shown = compute_ssr(dark, SsrParams(edge_fade=0.0), context).light[Transport.BOUNCE_GLOSSY]
    return shown[..., 0] > 0.5


def row_of(path: Path, size: tuple[int, int], samples: int, cache: Path, given: Path | None, seed: int) -> list[str]:
    """Cells of the table for one scene."""
    from rtgi_addon.compare.reference import on_threads, open_scene
    from rtgi_addon.compare.run import reference_for

    scene = open_scene(path)
    with on_threads(scene, 2):
        reference = reference_for(scene, path, size, samples, cache, given)
        frame, light, picture = frame_of(scene, size)
    mask, truth, whole = reference.mask, reference.mean("glossy bounce"), reference.mean("picture")
    context = Context()
    context.light = light
    shown, images = mirrors_show(frame), {}
    for fallback in ("RAYS", "WORLD"):
        result = compute_ssr(frame, SsrParams(fallback=fallback), context, seed)
        images[fallback] = result.light[Transport.BOUNCE_GLOSSY]
        if fallback == "RAYS":
            added = images[fallback] + result.light[Transport.WORLD_GLOSSY]

    def share(image: np.ndarray, part: np.ndarray) -> str:
        # the part's own error over its own light
        return f"{100 * metrics.block_relative_l1(image, truth, part):.1f} %" if truth[part].sum() > 0 else "-"

    def of_picture(image: np.ndarray) -> str:
        return f"{100 * metrics.block_relative_l1(image, whole, mask):.2f} %"

    inside, outside = mask & shown, mask & ~shown
    return [path.stem, f"{100 * truth[mask].sum() / whole[mask].sum():.1f} %", of_picture(picture[..., :3]),
            of_picture(picture[..., :3] + added), share(images["RAYS"], mask),
            f"{100 * metrics.block_noise(*reference.halves('glossy bounce'), mask):.1f} %",
            f"{metrics.energy_ratio(images['RAYS'], truth, mask):.3f}",
            share(images["RAYS"], inside), share(images["WORLD"], inside), share(images["RAYS"], outside),
            share(images["WORLD"], outside), f"{100 * truth[outside].sum() / truth[mask].sum():.0f} %"]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--samples", type=int, default=96)
    parser.add_argument("--cache", type=Path, default=Path("out/references"))
    parser.add_argument("--references", type=Path, help="folder of references, NAME_WxH.npz, instead of rendering them")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    width, height = (int(n) for n in args.size.split("x"))
    register()
    rows = [row_of(path, (width, height), args.samples, args.cache, args.references, args.seed) for path in args.scenes]
    print("\n".join(f"| {' | '.join(cells)} |" for cells in (HEAD, ["---"] * len(HEAD), *rows)))


if __name__ == "__main__":
    main()
