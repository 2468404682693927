"""Reflections against Cycles' Glossy Indirect, with and without what answers beyond the picture: python -m tools.reflections

    python -m tools.reflections SCENE.blend ... [--size 640x360] [--samples 96] [--cache FOLDER | --references FOLDER]
    [--figure OUT.png] [--seed N]

Prints a table in Markdown. A pixel counts as in the picture if what its mirror ray meets is seen by the camera. Needs bpy.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from rtgi_addon import register
from rtgi_addon.compare import metrics
from rtgi_addon.compare.report import ERROR_SCALE, error_map, side_by_side, write_picture
from rtgi_addon.core.frame import Frame, World
from rtgi_addon.core.techniques import SsrParams, default_settings
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.ssr import compute_ssr

HEAD = ("scene", "glossy bounce in the picture", "picture without", "picture with", "glossy bounce", "its noise", "energy",
        "in the picture: rays", "world alone", "beyond: rays", "world alone", "beyond")


def mirrors_show(frame: Frame) -> np.ndarray:
    """(H, W) bool: pixels whose mirror ray meets what the camera sees."""
    g = frame.gbuffer
    white = dataclasses.replace(g, specular=np.ones_like(g.specular), roughness=np.zeros_like(g.roughness),
                                albedo=np.ones_like(g.albedo))
    context = Context()
    context.light = {Transport.EMISSION_DIFFUSE: np.full_like(g.albedo, np.pi)}
    dark = dataclasses.replace(frame, gbuffer=white, lights=(), world=World())
    shown = compute_ssr(dark, SsrParams(method="HIERARCHY", edge_fade=0.0), context).light[Transport.BOUNCE_GLOSSY]
    return shown[..., 0] > 0.5


class Scene:
    """One scene with its reference, its picture without reflections, and these with and without rays beyond the picture."""

    def __init__(self, path: Path, size: tuple[int, int], samples: int, cache: Path, given: Path | None, seed: int):
        from rtgi_addon.compare.reference import on_threads, open_scene
        from rtgi_addon.compare.run import reference_for
        from tools.scene_frames import captured

        self.path, self.scene = path, open_scene(path)
        with on_threads(self.scene, 2):
            self.reference = reference_for(self.scene, path, size, samples, cache, given)
            frame, result = captured(self.scene, size, default_settings(techniques=["rsm"]))
        self.bare, self.shown, self.light = result.combined[..., :3], mirrors_show(frame), {}
        context = Context()
        context.light = result.transports
        for fallback in ("RAYS", "WORLD"):
            self.light[fallback] = compute_ssr(frame, SsrParams(fallback=fallback), context, seed).light

    def bounce(self, fallback: str) -> np.ndarray:
        """(H, W, 3) the glossy bounce."""
        return self.light[fallback][Transport.BOUNCE_GLOSSY]

    def picture(self, fallback: str) -> np.ndarray:
        """(H, W, 3) the whole picture."""
        return self.bare + self.bounce(fallback) + self.light[fallback][Transport.WORLD_GLOSSY]


def row_of(s: Scene) -> list[str]:
    """Cells of the table for one scene."""
    mask, truth, whole = s.reference.mask, s.reference.mean("glossy bounce"), s.reference.mean("picture")
    inside, outside = mask & s.shown, mask & ~s.shown

    def share(fallback: str, part: np.ndarray) -> str:
        # the part's own error over its own light
        return f"{100 * metrics.block_relative_l1(s.bounce(fallback), truth, part):.1f} %" if truth[part].sum() > 0 else "-"

    def of_picture(image: np.ndarray) -> str:
        return f"{100 * metrics.block_relative_l1(image, whole, mask):.2f} %"

    return [s.path.stem, f"{100 * truth[mask].sum() / whole[mask].sum():.1f} %", of_picture(s.bare),
            of_picture(s.picture("RAYS")), share("RAYS", mask),
            f"{100 * metrics.block_noise(*s.reference.halves('glossy bounce'), mask):.1f} %",
            f"{metrics.energy_ratio(s.bounce('RAYS'), truth, mask):.3f}", share("RAYS", inside), share("WORLD", inside),
            share("RAYS", outside), share("WORLD", outside), f"{100 * truth[outside].sum() / truth[mask].sum():.0f} %"]


def draw(s: Scene, out: Path) -> None:
    """A picture of what the picture alone cannot reflect, beside what rays beyond it give, and Cycles."""
    from rtgi_addon.compare.reference import displayed, drawn_text

    mask, truth, whole = s.reference.mask, s.reference.mean("glossy bounce"), s.reference.mean("picture")
    panels = []
    for fallback, title in (("WORLD", "In the picture alone"), ("RAYS", "Rays beyond the picture")):
        energy = metrics.energy_ratio(s.bounce(fallback), truth, mask)
        panels.append((title, f"{100 * energy:.0f} % of the glossy bounce", displayed(s.picture(fallback), s.scene)))
    panels.append(("Cycles, one bounce", "", displayed(whole, s.scene)))
    panels.append(("Error of the first", "", error_map(s.picture("WORLD"), whole)))
    pixels = side_by_side(panels, ERROR_SCALE, drawn_text)
    out.parent.mkdir(parents=True, exist_ok=True)
    if out.suffix != ".jpg":
        write_picture(out, pixels)
        return
    from tools.scene_frames import write_jpeg

    write_jpeg(out, pixels)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--samples", type=int, default=96)
    parser.add_argument("--cache", type=Path, default=Path("out/references"))
    parser.add_argument("--references", type=Path, help="folder of references, NAME_WxH.npz, instead of rendering them")
    parser.add_argument("--figure", type=Path, help=".png or .jpg of the first scene: what the picture alone lacks")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    width, height = (int(n) for n in args.size.split("x"))
    register()
    rows = []
    for path in args.scenes:
        scene = Scene(path, (width, height), args.samples, args.cache, args.references, args.seed)
        rows.append(row_of(scene))
        if args.figure and path == args.scenes[0]:
            draw(scene, args.figure)
    print("\n".join(f"| {' | '.join(cells)} |" for cells in (HEAD, ["---"] * len(HEAD), *rows)))


if __name__ == "__main__":
    main()
