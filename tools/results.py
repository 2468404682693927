"""Make docs/results.md of measurements: `python tools/results.py RESULTS.jsonl ... [-o docs/results.md]`.

The files come from `rtgi bench`, one for each size or machine. Needs no Blender.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from rtgi_addon.compare.bench import markdown  # noqa: E402

_HEAD = """# Results

Measured by `rtgi bench`; this page is made from its results.jsonl by tools/results.py. How to read it: the first table of
a size is time, of a whole F12 by the wall clock, the second is error. Cycles stands beside RTGI with the same one bounce,
the same pixel filter and its denoiser, timed in the same process. The machine is shared: read times as ratios of one line,
and with care, since load comes and goes; errors do not depend on it. The error metrics are described in
`rtgi_addon/compare/metrics.py`.

"""


def page(records: list[dict]) -> str:
    """The whole page."""
    return _HEAD + markdown(records)


def main() -> int:
    """The command; see the module's text."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path, metavar="RESULTS.jsonl")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "results.md")
    words = parser.parse_args()
    try:
        records = [json.loads(line) for path in words.files for line in path.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError) as error:
        print(f"cannot read the measurements: {error}", file=sys.stderr)
        return 2
    words.output.write_text(page(records), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
