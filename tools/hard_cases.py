"""Make docs/hard_cases.md: `python tools/hard_cases.py`. Every number in it is computed here; needs no Blender.

"Before" runs the technique on the frame as it is, "after" on the frame as `core/mending.py` hands it on.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from rtgi_addon.core.frame import Frame  # noqa: E402
from rtgi_addon.core.mending import mend_frame  # noqa: E402
from tests.hard_frames import CHEAP, ODD_FRAMES, run_as_it_is  # noqa: E402

_HEAD = """# Hard cases

Made by `tools/hard_cases.py`. Each row is a small room with something broken in it (every fifth pixel, or every seventh
texel of the lamp's view, holds the value); each cell is the number of pixels of {pixels} that are not finite, before and
after `core/mending.py` has put the frame right. Rows without a broken pixel before are left out; "stops" means that the
technique ended with an error. `tests/hard/` runs all {count} frames on every technique.

"""


def broken_pixels(name: str, frame: Frame) -> str:
    """How many pixels of a technique's light are not finite, or "stops"."""
    try:
        light = run_as_it_is(name, frame).light.values()
    except (ValueError, IndexError, AttributeError):
        return "stops"
    return str(int(np.logical_or.reduce([~np.isfinite(image).all(-1) for image in light]).sum()))


def page() -> str:
    """The whole page."""
    lines = ["| frame | " + " | ".join(CHEAP) + " |", "|---" * (len(CHEAP) + 1) + "|"]
    for what, make in ODD_FRAMES.items():
        before = [broken_pixels(name, make()) for name in CHEAP]
        if set(before) == {"0"}:
            continue
        after = [broken_pixels(name, mend_frame(make())) if b != "0" else "" for name, b in zip(CHEAP, before, strict=True)]
        cells = [f"{b}, {a}" if a else "" for b, a in zip(before, after, strict=True)]
        lines.append(f"| {what} | " + " | ".join(cells) + " |")
    pixels = next(iter(ODD_FRAMES.values()))().gbuffer.depth.size
    return _HEAD.format(pixels=pixels, count=len(ODD_FRAMES)) + "\n".join(lines) + "\n"


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    (ROOT / "docs" / "hard_cases.md").write_text(page(), encoding="utf-8")
