"""Progress of measurements, for the person who waits."""

from __future__ import annotations

import sys
import time


def say(text: str) -> None:
    """One line on stderr."""
    print(f"rtgi: {text}", file=sys.stderr, flush=True)


def clock(seconds: float) -> str:
    """Seconds as "0:07", "12:05" or "1:02:05"."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


class Progress:
    """Counts what is done and guesses the time left from the mean so far.

    `total` things are to be done in this run, `done` of them took the `spent_s` seconds before this object was made, which
    lets a process go on counting where another stopped.
    """

    def __init__(self, total: int, done: int = 0, spent_s: float = 0.0) -> None:
        self.total, self.done = total, done
        self._began = time.monotonic() - spent_s

    @property
    def spent_s(self) -> float:
        return time.monotonic() - self._began

    def step(self, what: str) -> str:
        """Count one more as done; the line to say of it."""
        self.done += 1
        left = self.total - self.done
        line = f"{self.done} of {self.total}: {what}"
        return line + (f"; about {clock(self.spent_s / self.done * left)} left" if left else "")
