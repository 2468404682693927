"""Speed against error: which renders are on the Pareto front, and where a curve of another renderer crosses them, in words.

A point is a render: seconds and error, both above zero. A curve is one renderer at rising sample counts; between its points
it is straight in logarithms, as the error of path tracing falls with a power of the time. Nothing is said beyond its ends.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Point:
    """A render by name: `seconds` of a frame and relative `error`; `curve` names the renderer that it is a setting of."""

    name: str
    seconds: float
    error: float
    curve: str = ""


def pareto_front(points: Sequence[Point]) -> list[Point]:
    """The points that no other beats in both time and error, the fastest first; of equal ones the first."""
    front: list[Point] = []
    for point in sorted(points, key=lambda p: (p.seconds, p.error)):
        if not front or point.error < front[-1].error:
            front.append(point)
    return front


def seconds_for_error(curve: Sequence[Point], error: float) -> float | None:
    """The time at which the curve first falls to `error`; None where it never does, or is below it from the start."""
    ordered = sorted(curve, key=lambda p: p.seconds)
    for before, after in zip(ordered, ordered[1:], strict=False):
        if before.error > error >= after.error:
            share = math.log(before.error / error) / math.log(before.error / after.error)
            return before.seconds * (after.seconds / before.seconds) ** share
    return None


def error_at_seconds(curve: Sequence[Point], seconds: float) -> float | None:
    """The curve's error after `seconds`; None before its first point and after its last."""
    ordered = sorted(curve, key=lambda p: p.seconds)
    for before, after in zip(ordered, ordered[1:], strict=False):
        if before.seconds <= seconds <= after.seconds:
            span = math.log(after.seconds / before.seconds)
            share = math.log(seconds / before.seconds) / span if span else 0.0
            return before.error * (after.error / before.error) ** share
    return None


def _times(factor: float) -> str:
    return f"{factor:.2g}" if factor < 1 else f"{factor:.1f}" if factor < 10 else f"{factor:.0f}"


def crossing_point(own: Point, curve: Sequence[Point], name: str) -> tuple[float, str] | None:
    """Where the curve comes down to the error of `own`: seconds, and what a plot says there; None where it does not."""
    needed = None if own in curve else seconds_for_error(curve, own.error)
    if needed is None:
        return None
    return needed, f"{name} at equal error: {needed:.2g} s, {_times(needed / own.seconds)}\u00d7"


def crossing(own: Point, curve: Sequence[Point], name: str) -> str:
    """In one sentence where the curve of another renderer stands beside a render."""
    ordered = sorted(curve, key=lambda p: p.seconds)
    first, last = ordered[0], ordered[-1]
    needed, at_once = seconds_for_error(ordered, own.error), error_at_seconds(ordered, own.seconds)
    mine = f"{own.name}'s error of {100 * own.error:.2g} %"
    if needed is not None and needed >= own.seconds:
        said = (f"{name} comes down to {mine} after {needed:.2g} s, {_times(needed / own.seconds)} times its "
                f"{own.seconds:.2g} s")
        return said + ("." if at_once is None else f"; in {own.name}'s time it is at {100 * at_once:.2g} %.")
    if needed is not None:
        said = f"{name} comes down to {mine} after {needed:.2g} s, sooner than {own.name} ({own.seconds:.2g} s)"
        return said + ("." if at_once is None else f"; in {own.name}'s time it is at {100 * at_once:.2g} %.")
    if first.error <= own.error:
        if first.seconds > own.seconds:
            return (f"{name} is below {mine} from its first picture on, {first.name} at {first.seconds:.2g} s with "
                    f"{100 * first.error:.2g} %, {_times(first.seconds / own.seconds)} times as long as {own.name}'s "
                    f"{own.seconds:.2g} s.")
        return (f"{name} is faster and nearer than {own.name} from its first picture on: {first.name} takes "
                f"{first.seconds:.2g} s with {100 * first.error:.2g} %.")
    return (f"{name} does not come down to {mine} in what was measured: {last.name} takes {last.seconds:.2g} s, "
            f"{_times(last.seconds / own.seconds)} times as long as {own.name}, with {100 * last.error:.2g} %.")


def words(own: Point, points: Sequence[Point]) -> list[str]:
    """Sentences: the Pareto front, then where each curve crosses `own`."""
    front = pareto_front(points)
    said = ["On the Pareto front (nothing measured is both faster and nearer): "
            + ", ".join(f"{p.name} ({p.seconds:.2g} s, {100 * p.error:.2g} %)" for p in front) + "."]
    if own not in front:
        better = next(p for p in front if p.seconds <= own.seconds and p.error <= own.error)
        said.append(f"{own.name} is not on it: {better.name} is faster and nearer.")
    for name in dict.fromkeys(p.curve for p in points if p.curve):
        curve = [p for p in points if p.curve == name]
        if len(curve) > 1 and own not in curve:
            said.append(crossing(own, curve, name))
    return said
