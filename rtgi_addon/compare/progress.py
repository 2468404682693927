"""Progress of measurements, for the person who waits."""

from __future__ import annotations

import sys


def say(text: str) -> None:
    """One line on stderr."""
    print(f"rtgi: {text}", file=sys.stderr, flush=True)
