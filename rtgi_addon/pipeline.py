"""Runs a plan over a frame and times it: the one way from a Frame to a picture, in Blender and without it."""

from __future__ import annotations

import contextlib
import platform
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .composite import combine, merge
from .core.frame import Frame
from .core.mending import mend_frame
from .core.settings import Settings
from .kernels.embree import embree_version
from .kernels.jit import compiled_s, kernel_session, most_threads
from .passes import TECHNIQUES
from .passes.base import Context, Transport
from .planner import Plan

CAPTURE_SHARE = 0.4         # of a frame's progress that is behind it when the techniques start


class Stages:
    """Names and milliseconds of what was done, in order; a name that comes again adds up. Compiling is counted apart."""

    def __init__(self) -> None:
        self._ms: dict[str, float] = {}
        self._compiled_before = compiled_s()

    @contextlib.contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        start = time.perf_counter() - compiled_s()
        try:
            yield
        finally:
            self._ms[name] = self._ms.get(name, 0.0) + (time.perf_counter() - compiled_s() - start) * 1e3

    def to_json(self) -> list[dict[str, Any]]:
        return [{"name": name, "ms": round(ms, 2)} for name, ms in self._ms.items()]

    @property
    def total_ms(self) -> float:
        return sum(self._ms.values())

    @property
    def jit_ms(self) -> float:
        """Spent compiling since this object was made."""
        return (compiled_s() - self._compiled_before) * 1e3


@dataclass(frozen=True)
class Result:
    """A finished frame.

    combined (H, W, 4) float32 linear; transports: (H, W, 3) float32 each, units as `Transport`; visibility (H, W) float32;
    report: the plan, stages and versions as the JSON report holds them; pictures: what techniques drew of themselves, by
    technique and name.
    """

    combined: np.ndarray
    transports: dict[Transport, np.ndarray]
    visibility: np.ndarray
    report: dict[str, Any] = field(default_factory=dict)
    pictures: dict[str, np.ndarray] = field(default_factory=dict)


def peak_memory_mb() -> float:
    """Largest resident size of this process so far in MB; 0 where the system does not tell."""
    try:
        import resource
    except ImportError:                          # Windows
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024 * 1024 if sys.platform == "darwin" else 1024)


def versions() -> dict[str, str]:
    """Of RTGI, Python, numpy, numba and the Embree that rays go through ("" for our own tree); the engine adds Blender's."""
    import numba

    from . import __version__

    return {"rtgi": __version__, "python": platform.python_version(), "numpy": np.__version__, "numba": numba.__version__,
            "embree": embree_version()}


def _span(number: int, count: int) -> tuple[float, float]:
    """Shares of a frame's progress between which technique `number` of `count` lies."""
    first, last = (CAPTURE_SHARE + (1 - CAPTURE_SHARE) * n / count for n in (number, number + 1))
    return first, last


def run(frame: Frame, plan: Plan, settings: Settings, context: Context | None = None, stages: Stages | None = None,
        film_transparent: bool = False) -> Result:
    """Run the plan's techniques on `frame` and add them up.

    Raises
    ------
    InputError
        A parameter out of range, or two techniques for one transport.
    Cancelled
        The user asked to stop.
    """
    settings.validate()
    context, stages = context or Context(), stages or Stages()
    frame = mend_frame(frame)
    results = []
    with kernel_session(settings.threads):
        sharing = [TECHNIQUES[name] for name in plan.techniques if TECHNIQUES[name].near_m]
        context.near_m = max((t.near_m(frame, settings.params[t.name]) for t in sharing), default=0.0)
        for number, name in enumerate(plan.techniques):
            technique = TECHNIQUES[name]
            context.span = _span(number, len(plan.techniques))
            context.checkpoint(technique.label, 0.0)
            if technique.needs_geometry and frame.geometry is not None:
                with stages("bvh"):
                    context.bvh(frame.geometry)
            context.light = merge(results)
            later = plan.techniques[number + 1:]
            context.to_come = frozenset().union(*(TECHNIQUES[other].transports for other in later))
            context.near_left_m = max((result.near_left_m for _, result in results), default=0.0)
            with stages(name):
                results.append((name, technique.compute(frame, settings.params[name], context, settings.seed)))
        context.light, context.to_come, context.span = {}, frozenset(), (0.0, 1.0)
        context.near_m = context.near_left_m = 0.0
    with stages("composite"):
        light = merge(results)
        combined = combine(frame.gbuffer, light, film_transparent)
        visibility = np.ones(frame.gbuffer.shape, np.float32)
        for _, result in results:
            if result.visibility is not None:
                visibility = visibility * result.visibility
    report = {
        "plan": plan.to_json(), "stages": stages.to_json(), "total_ms": round(stages.total_ms, 2),
        "jit_ms": round(stages.jit_ms, 2),
        "peak_memory_mb": round(peak_memory_mb(), 1), "threads": min(settings.threads or most_threads(), most_threads()),
        "versions": versions(), "warnings": list(frame.warnings),
        "diagnostics": {name: result.diagnostics for name, result in results},
    }
    pictures = {f"{name} {what}": image for name, result in results for what, image in result.pictures.items()}
    return Result(combined, light, visibility, report, pictures)
