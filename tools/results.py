"""Make docs/results.md of measurements: `python tools/results.py RESULTS.jsonl ... [-o docs/results.md]`.

The files come from `rtgi bench`, one for each size or machine. Needs no Blender. The table in README.md is taken from the
page; without files only that is done.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from rtgi_addon.compare.bench import markdown  # noqa: E402
from tools.parameter_tables import between_marks  # noqa: E402

_HEAD = """# Results

Measured by `rtgi bench`; this page is made from its results.jsonl by tools/results.py. How to read it: the first table of
a size is time, of a whole F12 by the wall clock, the second is error. Cycles stands beside RTGI with the same one bounce,
the same pixel filter and its denoiser, timed in the same process. The machine is shared: read times as ratios of one line,
and with care, since load comes and goes; errors do not depend on it. The error metrics are described in
`rtgi_addon/compare/metrics.py`.

"""


_RENDERERS = {"RTGI": "picture", "Cycles 1": "picture, Cycles 1", "Cycles 4": "picture, Cycles 4",
              "Cycles 16": "picture, Cycles 16"}          # column of time: column of error


def _tables(text: str) -> Iterator[list[dict[str, str]]]:
    """The tables of a page, each a list of its rows by column."""
    for lines in re.findall(r"^(?:\|.*\n)+", text, re.M):
        head, _, *rows = ([cell.strip() for cell in line.strip().strip("|").split("|")] for line in lines.splitlines())
        yield [dict(zip(head, row, strict=True)) for row in rows]


def readme_table(results: str) -> str:
    """Time and error of a whole picture, from the first size of the results' page that has all of Cycles beside it."""
    for size, text in re.findall(r"^## (\S+)\n(.*?)(?=^## |\Z)", results, re.M | re.S):
        wanted = [[table for table in _tables(text) if columns <= table[0].keys()]
                  for columns in (set(_RENDERERS), set(_RENDERERS.values()))]
        if not all(wanted):
            continue
        errors = {row["scene"]: row for row in wanted[1][0]}
        lines = [f"| {size} | {' | '.join(_RENDERERS)} |", "| --- |" + " ---: |" * len(_RENDERERS)]
        for row in wanted[0][0]:
            cells = [f"{row[time]}, {errors[row['scene']][error]}" for time, error in _RENDERERS.items()]
            lines.append(f"| {row['scene']} | {' | '.join(cells)} |")
        return "\n".join(lines) + "\n"
    return ""


def page(records: list[dict]) -> str:
    """The whole page."""
    return _HEAD + markdown(records)


def main() -> int:
    """The command; see the module's text."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path, metavar="RESULTS.jsonl")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "results.md")
    words = parser.parse_args()
    try:
        records = [json.loads(line) for path in words.files for line in path.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError) as error:
        print(f"cannot read the measurements: {error}", file=sys.stderr)
        return 2
    if records:
        words.output.write_text(page(records), encoding="utf-8")
    table = readme_table(words.output.read_text(encoding="utf-8"))
    if table:
        readme = ROOT / "README.md"
        readme.write_text(between_marks(readme.read_text(encoding="utf-8"), "results", table), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
