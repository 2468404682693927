"""Make docs/benchmarks.md and its plots: `python tools/benchmarks.py`, some twenty minutes on two quiet cores.

Builds the sample scenes, measures them by `rtgi bench --sweep`, and writes the page. Needs the bpy module. What is measured
is kept in out/benchmarks, so that the command goes on where it was stopped.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import rtgi_addon  # noqa: E402
from rtgi_addon.cli import parse_size  # noqa: E402
from rtgi_addon.compare import sweep_page, sweeps  # noqa: E402
from rtgi_addon.compare.progress import say  # noqa: E402
from rtgi_addon.errors import InputError  # noqa: E402
from sample_scenes import SCENES  # noqa: E402

GROWTH_SCENES = ("cornell_box", "sunlit_colonnade")  # of resolutions and threads: a small room, a large view
SIZE, SAMPLES, REPEATS = "480x270", 64, 3            # so that nine scenes are done in a quarter of an hour


def built(names: list[str], folder: Path) -> list[Path]:
    """The scenes' files; built anew where a script is newer, else left, since no build has the bytes of another."""
    from sample_scenes.build import save_scene

    newest = max(path.stat().st_mtime for path in (ROOT / "sample_scenes").glob("*.py"))
    for name in names:
        path = folder / f"{name}.blend"
        if not path.is_file() or path.stat().st_mtime < newest:
            say(f"building {save_scene(name, folder)}")
    return [folder / f"{name}.blend" for name in names]


def main() -> int:
    """The command; see the module's text."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", metavar="NAME", help="sample scenes; all if left out")
    parser.add_argument("--size", default=SIZE, metavar="WxH", help=SIZE)
    parser.add_argument("--samples", type=int, default=SAMPLES, metavar="N", help=f"of each half of a reference; {SAMPLES}")
    parser.add_argument("--repeats", type=int, default=REPEATS, metavar="N", help=f"timed frames; {REPEATS}")
    parser.add_argument("--measured", type=Path, default=ROOT / "out" / "benchmarks", metavar="DIR",
                        help="where scenes, references and measurements are kept; out/benchmarks")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "benchmarks.md", metavar="PAGE.md")
    words = parser.parse_args()
    names = words.scenes or list(SCENES)
    how = {"repeats": words.repeats, "samples": words.samples}
    try:
        if unknown := set(names) - set(SCENES):
            raise InputError(f"no scene is called {sorted(unknown)[0]!r}; known are {', '.join(SCENES)}")
        how["size"] = parse_size(words.size)
        rtgi_addon.register()
        scenes = built(names, words.measured / "scenes")
        lines = sweeps.sweep(scenes, words.measured, sweeps.ERROR_AXES, **how)
        growing = [path for path in scenes if path.stem in GROWTH_SCENES] or scenes[:1]
        lines += sweeps.sweep(growing, words.measured, ("resolutions", "lights", "triangles", "threads"), **how)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    command = f"python tools/benchmarks.py --size {words.size} --samples {words.samples} --repeats {words.repeats}"
    sweep_page.write_page(lines, words.output, words.output.parent / "images" / "benchmarks",
                          sweep_page.HEAD.format(command=command, repeats=words.repeats))
    print(sweep_page.summary(lines))
    print(words.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
