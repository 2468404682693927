"""A budget of time or of error: every planned technique gets that setting of its measured front that fits.

`calibration.json` holds, for each technique, settings from fast to near, none of which another beats in both time and
error over the scenes that tools/calibrate.py measured; for each a law of its time and the error that it leaves. Both
searches start with everything at its fastest and take, again and again, the step that removes the most error for its
time: until the next one would not fit (target time), or until little enough error is left (target error).
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .core.params import Params
from .core.settings import Settings
from .core.techniques import LABELS, TECHNIQUE_PARAMS
from .planner import Plan

TABLE = Path(__file__).with_name("calibration.json")
UNIT_PIXELS, UNIT_TRIANGLES = 1e5, 1e3      # amounts of work at which a law's time is written down
_WILDEST = 8.0              # times by which frames may say that the table is off; beyond it something else took the time
_corrections: dict[int, float] = {}


@dataclass(frozen=True)
class Work:
    """What a technique's time grows with: surface pixels, triangles, lamps, share of the pixels that are glossy."""

    pixels: float
    triangles: float = 0.0
    lamps: float = 0.0
    glossy_share: float = 0.0

    @classmethod
    def of(cls, plan: Plan) -> Work:
        """The work of a planned frame."""
        facts = plan.facts
        return cls(facts["surface_pixels"], facts["triangles"], facts["lights"], facts["glossy_share"])


@dataclass(frozen=True)
class TimeLaw:
    """ms (pixels / 1e5)^a (triangles / 1e3)^b lamps^c glossy_share^d, where amounts of work count as one unit's at least."""

    ms: float
    pixels: float
    triangles: float = 0.0
    lamps: float = 0.0
    glossy_share: float = 0.0

    def __call__(self, work: Work) -> float:
        return (self.ms * max(work.pixels / UNIT_PIXELS, 1e-3) ** self.pixels
                * max(work.triangles / UNIT_TRIANGLES, 1.0) ** self.triangles * max(work.lamps, 1.0) ** self.lamps
                * max(work.glossy_share, 1e-2) ** self.glossy_share)


@dataclass(frozen=True)
class Step:
    """A setting on a technique's front: its parameters, its time, and its errors as shares of the picture's light.

    `error` is the geometric mean over the calibration's scenes that have the light, `high_error` the upper quartile.
    """

    params: dict[str, Any]
    time: TimeLaw
    error: float
    high_error: float


@dataclass(frozen=True)
class Table:
    """The calibration: steps by technique, fast to near; `rest`: what a frame takes beside capture and techniques."""

    steps: dict[str, tuple[Step, ...]]
    rest: TimeLaw
    probe_ms: float


@dataclass(frozen=True)
class Choice:
    """What a budget came to: the settings that run, and the plan with the reasons and the forecast in it."""

    settings: Settings
    plan: Plan
    techniques_ms: float        # forecast of the techniques whose settings it chose


def table_from_json(words: dict[str, Any]) -> Table:
    """The table in the form of calibration.json."""
    steps = {name: tuple(Step(s["params"], TimeLaw(**s["time"]), s["mean_error"], s["high_error"]) for s in entry["steps"])
             for name, entry in words["techniques"].items()}
    return Table(steps, TimeLaw(**words["rest"]), words["probe_ms"])


@functools.cache
def own_table() -> Table:
    """The table that comes with RTGI."""
    return table_from_json(json.loads(TABLE.read_text(encoding="utf-8")))


def within_budget(plan: Plan, settings: Settings, spent_ms: float, speed: float = 1.0, table: Table | None = None) -> Choice:
    """Settings for the target time or target error of `settings`; without either, `settings` as they are.

    Parameters
    ----------
    plan : what runs; `facts` hold the frame's work.
    settings : a technique whose method the user changed keeps its settings, since nothing is known of it.
    spent_ms : what capture took.
    speed : how many times as long as on the calibration's machine things take here.
    table : another calibration than `own_table()`.

    Notes
    -----
    The same arguments give the same choice.
    """
    if not settings.target_time_s and not settings.target_error:
        return Choice(settings, plan, 0.0)
    table = table or own_table()
    work = Work.of(plan)
    ladders = {name: table.steps[name] for name in plan.techniques
               if name in table.steps and _is_as_measured(settings.params[name], table.steps[name][0])}
    times = {name: [speed * step.time(work) for step in steps] for name, steps in ladders.items()}
    fixed_ms = spent_ms + speed * table.rest(work)
    at = dict.fromkeys(ladders, 0)
    if settings.target_time_s:
        _climb(at, ladders, times, lambda more_ms: fixed_ms + _total(at, times) + more_ms <= 1e3 * settings.target_time_s)
    else:
        _climb(at, ladders, times, lambda _: _error(at, ladders) > settings.target_error)
    chosen = settings
    for name, number in at.items():
        chosen = chosen.with_params(name, **ladders[name][number].params)
    techniques_ms, error = _total(at, times), _error(at, ladders)
    high = sum(ladders[name][number].high_error for name, number in at.items())
    forecast = {"forecast_s": (fixed_ms + techniques_ms) / 1e3, "forecast_error": error, "forecast_error_high": high}
    words = list(_words(settings, spent_ms, fixed_ms + techniques_ms, error, high, at, ladders))
    left = [LABELS[name] for name in plan.techniques if name not in ladders]
    if left:
        words.append(f"{', '.join(left)} keep their own settings: nothing was measured for these")
    return Choice(chosen, dataclasses.replace(plan, facts={**plan.facts, **forecast}, budget=tuple(words)), techniques_ms)


def _is_as_measured(params: Params, step: Step) -> bool:
    """Whether all parameters that it does not vary are the defaults that the calibration was measured with.

    Those that tell what to capture have had their effect when a budget is shared out.
    """
    default = type(params)()
    captured = {name: getattr(default, name) for name in params.for_capture()}
    return dataclasses.replace(params, **captured, **step.params) == dataclasses.replace(default, **step.params)


def _total(at: dict[str, int], times: dict[str, list[float]]) -> float:
    return sum(times[name][number] for name, number in at.items())


def _error(at: dict[str, int], ladders: dict[str, tuple[Step, ...]]) -> float:
    """Errors of parts add up: they rarely lie in the same place with opposite signs."""
    return sum(ladders[name][number].error for name, number in at.items())


def _climb(at: dict[str, int], ladders: dict[str, tuple[Step, ...]], times: dict[str, list[float]],
           may_go: Callable[[float], bool]) -> None:
    """Take the best steps in turn into `at`, each as long as `may_go(more ms)`."""
    open_to = set(ladders)
    while open_to:
        gains = {}
        for name in sorted(open_to):
            steps, here = ladders[name], at[name]
            if here + 1 == len(steps):
                continue
            more_ms = max(times[name][here + 1] - times[name][here], 1e-6)
            gains[name] = (steps[here].error - steps[here + 1].error) / more_ms, more_ms
        if not gains:
            return
        best = max(gains, key=lambda name: gains[name][0])
        if may_go(gains[best][1]):
            at[best] += 1
        else:
            open_to.discard(best)


def _words(settings: Settings, spent_ms: float, forecast_ms: float, error: float, high: float, at: dict[str, int],
           ladders: dict[str, tuple[Step, ...]]) -> Iterator[str]:
    """The choice in words."""
    expected = f"{forecast_ms / 1e3:.2f} s and an error of {100 * error:.1f} % are expected (up to {100 * high:.1f} %)"
    if settings.target_time_s:
        yield f"For a target time of {settings.target_time_s:g} s: {expected}"
        if forecast_ms > 1e3 * settings.target_time_s:
            yield (f"The target time cannot be met: capture took {spent_ms / 1e3:.2f} s, and everything else runs at its "
                   "fastest; a smaller picture or fewer techniques take less")
    else:
        yield f"For a target error of {100 * settings.target_error:g} %: {expected}"
        if error > settings.target_error:
            yield "The target error cannot be met by any measured setting: everything runs at its nearest"
    for name, number in at.items():
        values = ", ".join(f"{field} {value}" for field, value in ladders[name][number].params.items())
        yield f"{LABELS[name]}: {values} (setting {number + 1} of {len(ladders[name])})"


def speed_of(threads: int) -> float:
    """How many times as long as in the table kernels take on this machine with `threads`, and as frames have shown since.

    The first call of a process runs a probe of some 0.1 s.
    """
    return _probed(threads) * _corrections.get(threads, 1.0)


@functools.cache
def _probed(threads: int) -> float:
    from .kernels.jit import kernel_session
    from .kernels.probe import probe_ms

    with kernel_session(threads):
        return probe_ms() / own_table().probe_ms


def learn(choice: Choice, stages: list[dict[str, Any]], threads: int) -> None:
    """Let what a frame's techniques took, compiling aside, correct the next forecast of this process."""
    names = {name for name in TECHNIQUE_PARAMS if name in choice.plan.techniques}
    took = sum(stage["ms"] for stage in stages if stage["name"] in names)
    if choice.techniques_ms <= 0 or took <= 0:
        return
    # half of what is seen, in logarithms: one frame on a busy machine is not all that is known
    found = _corrections.get(threads, 1.0) * (took / choice.techniques_ms) ** 0.5
    _corrections[threads] = min(max(found, 1 / _WILDEST), _WILDEST)
