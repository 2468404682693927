"""How much of an error lies where surfaces are doubled? `python -m tools.doubled_surfaces SCENE.blend ... --size 640x360`

Two triangles in one place, as where walls were modelled into each other, have no defined picture: a path tracer's rays hit
the twin or miss it by rounding, and it shows stripes and black there. The command measures errors over all surfaces and
over those that are not doubled, and writes the table into docs/comparison.md. Needs bpy.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import rtgi_addon  # noqa: E402
from rtgi_addon.cli import parse_size  # noqa: E402
from rtgi_addon.compare import metrics  # noqa: E402
from rtgi_addon.compare import reference as blender  # noqa: E402
from rtgi_addon.compare.measure import part_of  # noqa: E402
from rtgi_addon.compare.references import reference_for  # noqa: E402
from rtgi_addon.compare.report import percent, text_table  # noqa: E402
from rtgi_addon.core.frame import Frame  # noqa: E402
from rtgi_addon.core.transforms import normalized  # noqa: E402
from tools.agreement import PAGE  # noqa: E402
from tools.parameter_tables import between_marks  # noqa: E402
from tools.scene_frames import captured  # noqa: E402

APART = 1e-5                # of the scene's size: nearer than this two triangles lie in one place
HEAD = ("scene", "pixels doubled", "bounce energy", "without them", "bounce", "without them", "direct", "without them",
        "picture", "without them")


def doubled_pixels(frame: Frame) -> np.ndarray:
    """(H, W) bool: surface pixels whose place lies inside two or more triangles."""
    g, corners = frame.gbuffer, frame.geometry.corners_ws.astype(np.float64)
    edges = np.roll(corners, -1, 1) - corners
    normal = np.cross(edges[:, 0], edges[:, 1])
    normal = normalized(np.where(np.abs(normal).sum(1, keepdims=True) > 0, normal, (0.0, 0.0, 1.0)))
    apart_m = APART * frame.scale_m
    place = g.position_ws[g.mask].astype(np.float64)
    by_height = np.argsort(place[:, 2])
    height, count = place[by_height, 2], np.zeros(len(place), np.int64)
    for triangle, edge, n in zip(corners, edges, normal, strict=True):
        low, high = np.searchsorted(height, (triangle[:, 2].min() - apart_m, triangle[:, 2].max() + apart_m))
        near = by_height[low:high]
        near = near[np.abs((place[near] - triangle[0]) @ n) < apart_m]
        if len(near):
            # strictly inside, so that the seam between two triangles of one wall is not taken for a double
            sides = [np.cross(e, place[near] - corner) @ n for e, corner in zip(edge, triangle, strict=True)]
            count[near[np.min(sides, 0) > 0]] += 1
    out = np.zeros(g.shape, bool)
    out[g.mask] = count > 1
    return out


def row_of(path: Path, size: tuple[int, int], samples: int, cache: Path) -> list[str]:
    """Cells of the table for one scene."""
    scene = blender.open_scene(path)
    reference = reference_for(scene, path, size, samples, cache, None)
    frame, result = captured(scene, size, blender.scene_settings(scene))
    doubled = doubled_pixels(frame)
    masks = reference.mask, reference.mask & ~doubled
    tests = {part: part_of(result.transports, part, reference.albedo) for part in ("bounce", "direct")}
    tests["picture"] = result.combined[..., :3]
    cells = [f"{metrics.energy_ratio(tests['bounce'], reference.mean('bounce'), mask):.3f}" for mask in masks]
    cells += [percent(metrics.block_relative_l1(test, reference.mean(part), mask))
              for part, test in tests.items() for mask in masks]
    return [path.stem, percent((doubled & reference.mask).sum() / reference.mask.sum()), *cells]


def main(words: Sequence[str] | None = None) -> int:
    """The command; see the module's text."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path, metavar="SCENE.blend")
    parser.add_argument("--size", default="640x360", metavar="WxH")
    parser.add_argument("--samples", type=int, default=64, metavar="N", help="of each half of the references")
    parser.add_argument("--cache", type=Path, default=ROOT / "out" / "references", metavar="FOLDER")
    given = parser.parse_args(words)
    rtgi_addon.register()
    rows = [row_of(path, parse_size(given.size), given.samples, given.cache) for path in given.scenes]
    text = f"At {given.size}, by `python -m tools.doubled_surfaces`:\n\n{text_table(list(HEAD), rows, True)}\n"
    PAGE.write_text(between_marks(PAGE.read_text(encoding="utf-8"), "doubled", text), encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
