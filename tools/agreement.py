"""Do errors depend on the reference? `python -m tools.agreement SCENE.blend ... --size 640x360` writes docs/comparison.md.

One RTGI render of each scene is measured against two references that share no random number: other seeds, other sample
counts. The two errors may differ by the noise that is stated beside them, and no more.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import rtgi_addon  # noqa: E402
from rtgi_addon.cli import parse_size  # noqa: E402
from rtgi_addon.compare import reference as blender  # noqa: E402
from rtgi_addon.compare.halves import Reference  # noqa: E402
from rtgi_addon.compare.measure import errors_of, floors_of, noise_of  # noqa: E402
from rtgi_addon.compare.report import percent, text_table  # noqa: E402
from tools.parameter_tables import between_marks  # noqa: E402

PAGE = ROOT / "docs" / "comparison.md"
FIRST, SECOND = ((101, 102), 64), ((9001, 9002), 192)       # seeds of the halves, samples a pixel of each
NAMES = {"picture": "picture", "bounce": "bounce", "nrmse": "per pixel", "relmse": "relMSE"}


def _numbers(result: object, reference: Reference) -> dict[str, tuple[float, float]]:
    """{name: (error, the noise that is stated beside it)}."""
    errors, noise, floors = errors_of(result, reference), noise_of(reference), floors_of(reference)
    picture = errors["picture"]
    return {"picture": (picture["block"], noise["picture"]), "bounce": (errors["bounce"]["block"], noise["bounce"]),
            "nrmse": (picture["nrmse"], floors["nrmse"]), "relmse": (picture["relmse"], floors["relmse"])}


def rows_of(scene: str, first: dict[str, tuple[float, float]], second: dict[str, tuple[float, float]]) -> list[list[str]]:
    """Rows of the table; the last cell says whether the two errors differ by no more than their noise allows."""
    rows = []
    for name, label in NAMES.items():
        (a, noise_a), (b, noise_b) = first[name], second[name]
        apart, allowed = abs(a - b), math.hypot(noise_a, noise_b)
        rows.append([scene, label, *map(percent, (a, noise_a, b, noise_b, apart)),
                     "yes" if apart <= allowed else f"no: over {percent(allowed)}"])
    return rows


def main(words: Sequence[str] | None = None) -> int:
    """The command; see the module's text."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path, metavar="SCENE.blend")
    parser.add_argument("--size", default="640x360", metavar="WxH")
    given = parser.parse_args(words)
    size = parse_size(given.size)
    rtgi_addon.register()
    rows: list[list[str]] = []
    for path in given.scenes:
        scene = blender.open_scene(path)
        result, _ = blender.render_rtgi(scene, blender.scene_settings(scene), size)
        found = [_numbers(result, blender.render_reference(scene, samples, size, seeds=seeds))
                 for seeds, samples in (FIRST, SECOND)]
        rows += rows_of(path.stem, *found)
    head = ["scene", "error", f"2x{FIRST[1]} samples", "its noise", f"2x{SECOND[1]} samples", "its noise", "apart",
            "within the noise"]
    text = f"At {given.size}, by `python -m tools.agreement`:\n\n{text_table(head, rows, True)}\n"
    PAGE.write_text(between_marks(PAGE.read_text(encoding="utf-8"), "agreement", text), encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
