"""The pictures of docs/passes/: a technique's light beside Cycles' and the error: python -m tools.technique_pictures

    python -m tools.technique_pictures [NAME ...] [--scenes out/scenes] [--out docs/images] [--cache out/references]

NAME is a picture, such as rsm; all of them if left out. Sample scenes are built into `--scenes` if they are not there, and
references are kept in `--cache`. A row is one way of doing it; all panels of a picture have one exposure. Needs bpy.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

BRIGHT = 0.4                # radiance that the brightest twentieth of the reference is shown with
MOST_BYTES = 120e3          # of one picture


@dataclass(frozen=True)
class Row:
    """A technique with parameters, after `beside`; the words above its light."""

    title: str
    technique: str
    params: dict[str, Any] = field(default_factory=dict)
    beside: tuple[str, ...] = ("direct", "world", "emission")


@dataclass(frozen=True)
class Picture:
    """A sample scene, how it is lit (see `scene_frames.lit_by`), the light that is compared, and the rows."""

    scene: str
    part: str
    rows: tuple[Row, ...]
    light: str = ""
    size: tuple[int, int] = (400, 225)
    samples: int = 128


_NO_WORLD = ("direct", "emission")
PICTURES = {
    "direct": Picture("many_lights", "direct", (Row("Direct light", "direct", beside=("world",)),)),
    "world": Picture("courtyard", "direct diffuse", (Row("World light", "world", beside=()),), "own_sky"),
    "emission": Picture("cornell_box", "direct diffuse", (Row("Emissive surfaces", "emission", beside=()),),
                        "shining_panels"),
    "rsm": Picture("flashlight", "bounce", (
        Row("As published", "rsm", {"method": "PAPER"}), Row("With visibility", "rsm"))),
    "caustics": Picture("caustics", "bounce", (
        Row("Lobes widened", "rsm", {"photons": 0}), Row("Photons", "rsm")), samples=1024),
    "vxgi": Picture("thin_wall_maze", "bounce", (
        Row("Cones, as published", "vxgi", {"exact_voxels": 0}), Row("Rays through voxels", "vxgi"))),
    "lpv": Picture("thin_wall_maze", "bounce", (
        Row("As published", "lpv", {"mode": "PAPER"}), Row("Directions", "lpv"))),
    "ssao": Picture("courtyard", "direct diffuse", (
        Row("Ball, as published", "ssao", {"method": "SPHERE"}, ("direct",)), Row("Hemisphere", "ssao", {}, ("direct",))),
        "own_sky"),
    "hbao": Picture("courtyard", "direct diffuse", (
        Row("As published", "hbao", {"method": "PUBLISHED"}, ("direct",)), Row("By cosine", "hbao", {}, ("direct",))),
        "own_sky"),
    "ssdo_cycles": Picture("coloured_corner", "bounce", (
        Row("As published", "ssdo", {"form": "SAMPLES"}, _NO_WORLD), Row("Sectors", "ssdo", {}, _NO_WORLD),
        Row("Sharing with shadow maps", "ssdo", {"hand_over": True}, (*_NO_WORLD, "rsm")))),
    "final_gather": Picture("courtyard", "bounce", (Row("Final gathering", "final_gather", beside=("world",)),), "own_sky"),
}


def draw(picture: Picture, path: Path, cache: Path) -> np.ndarray:
    """(H, W, 3) uint8: for each row its light, Cycles' light and the error map."""
    from rtgi_addon.compare import metrics
    from rtgi_addon.compare import reference as blender
    from rtgi_addon.compare.measure import part_of
    from rtgi_addon.compare.report import ERROR_SCALE, ERROR_WINDOW_PX, error_map, percent, side_by_side
    from tools.scene_frames import captured, lit_by, reference_under
    from tools.technique_tables import Way, run_way

    scene = blender.open_scene(path)
    with blender.on_threads(scene, 2), lit_by(scene, picture.light):
        truth = reference_under(scene, path, picture.light or "own_light", picture.size, picture.samples, cache)
        frame, _ = captured(scene, picture.size)
        wanted, mask = truth.mean(picture.part), truth.mask
        exposure = BRIGHT / np.quantile(metrics.luminance_of(wanted)[mask], 0.95) / 2**scene.view_settings.exposure
        panels = []
        for row in picture.rows:
            result = run_way(frame, Way(row.technique, row.title, picture.part, row.params, row.beside))
            light = part_of(result.transports, picture.part, truth.albedo)
            error = percent(metrics.block_relative_l1(light, wanted, mask))
            energy = metrics.energy_ratio(light, wanted, mask)
            panels.append(side_by_side([
                (row.title, f"error {error}, {100 * energy:.0f} % of the light", blender.displayed(exposure * light, scene)),
                ("Cycles, the same light", f"2 x {truth.samples} samples", blender.displayed(exposure * wanted, scene)),
                (f"Relative error, {ERROR_WINDOW_PX}x{ERROR_WINDOW_PX} px", "", error_map(light, wanted)),
            ], ERROR_SCALE, blender.drawn_text))
    return np.concatenate(panels)


def main() -> int:
    """The command; see the module's text."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--scenes", type=Path, default=Path("out/scenes"))
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images")
    parser.add_argument("--cache", type=Path, default=Path("out/references"))
    words = parser.parse_args()
    unknown = [name for name in words.names if name not in PICTURES]
    if unknown:
        parser.error(f"no picture is called {unknown[0]!r}; known are {', '.join(PICTURES)}")
    from rtgi_addon import register
    from sample_scenes.build import save_scene
    from tools.scene_frames import write_jpeg

    register()
    for name in words.names or PICTURES:
        picture = PICTURES[name]
        path = words.scenes / f"{picture.scene}.blend"
        if not path.is_file():
            save_scene(picture.scene, words.scenes)
        pixels = draw(picture, path, words.cache)
        out = words.out / f"{name}.jpg"
        for quality in range(88, 40, -8):
            write_jpeg(out, pixels, quality)
            if out.stat().st_size <= MOST_BYTES:
                break
        print(f"{out} {out.stat().st_size} bytes", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
