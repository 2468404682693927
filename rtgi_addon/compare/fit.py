"""How time grows with work: a power law through measured times, by least squares in logarithms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class PowerLaw:
    """time = factor work^exponent. Exponent 1 is proportional, 0 is no growth, -1 halves the time when the work doubles.

    `standard_error` is that of the exponent, from how far the points lie off the line; None for two points, which no line
    misses. It tells noise and curvature together: a fixed cost beside a growing one bends the line.
    """

    exponent: float
    standard_error: float | None
    factor: float

    def __call__(self, work: float) -> float:
        return self.factor * work**self.exponent

    def __str__(self) -> str:
        error = "" if self.standard_error is None else f" \u00b1 {self.standard_error:.2f}"
        return f"{self.exponent:z.2f}{error}"


def fit_power_law(work: Sequence[float], times: Sequence[float]) -> PowerLaw | None:
    """The power law nearest to the points in logarithms; None for less than two amounts of work or a time of zero."""
    if len(set(work)) < 2 or min(*work, *times) <= 0:
        return None
    x, y = [math.log(value) for value in work], [math.log(value) for value in times]
    mean_x, mean_y, n = sum(x) / len(x), sum(y) / len(y), len(x)
    spread = sum((a - mean_x) ** 2 for a in x)
    exponent = sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True)) / spread
    misses = sum((b - mean_y - exponent * (a - mean_x)) ** 2 for a, b in zip(x, y, strict=True))
    error = math.sqrt(misses / (n - 2) / spread) if n > 2 else None
    return PowerLaw(exponent, error, math.exp(mean_y - exponent * mean_x))
