"""Compiles every kernel ahead of the first render, by running each technique on a tiny synthetic frame."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .core.frame import LightKind
from .core.params import Params
from .core.synthetic import make_room_frame
from .core.techniques import TECHNIQUE_PARAMS
from .core.transforms import ViewFormat


@dataclass(frozen=True)
class Step:
    """One thing that was compiled or loaded from the cache, and the seconds it took."""

    name: str
    seconds: float


def variants(params: Params) -> Iterator[tuple[str, Params]]:
    """`params` and, for each choice and switch in it, copies with every other value: together they reach all kernels."""
    yield "", params
    for field in dataclasses.fields(params):
        value = getattr(params, field.name)
        others = [c[0] for c in field.metadata["choices"]] or ([True, False] if isinstance(value, bool) else [])
        for other in others:
            if other != value:
                yield f" with {field.name} {other}", dataclasses.replace(params, **{field.name: other})


def warm_up(threads: int = 0) -> Iterator[Step]:
    """Yield a step after each technique's kernels are ready; what is in the cache already takes almost no time."""
    start = time.perf_counter()
    from . import emitter_lamps, light_views
    from .kernels.jit import kernel_session
    from .passes import technique
    from .passes.base import Context
    from .passes.surroundings import surroundings_of
    from .passes.wide_lamps import spread_texels

    frame = make_room_frame(32, 24, tuple(LightKind), world_radiance=0.5)
    context = Context()
    yield Step("loading", time.perf_counter() - start)
    start = time.perf_counter()
    with kernel_session(threads):
        bvh, around = context.bvh(frame.geometry), surroundings_of(frame, frame.geometry)
        for light in frame.lights:
            camera = light_views.camera_of(light, frame, bvh, ViewFormat(192))
            light_views.cast_view(light, camera, frame, bvh, around)
        for view in frame.views:
            if frame.lights[view.light_index].kind.is_area:
                spread_texels(frame, view, bvh)
        shining = dataclasses.replace(frame.geometry, emission=np.ones_like(frame.geometry.emission))
        emitter_lamps.part_emitters(shining, frame.materials, bvh)
    yield Step("light views", time.perf_counter() - start)
    for name, kind in TECHNIQUE_PARAMS.items():
        for words, params in variants(kind()):
            start = time.perf_counter()
            with kernel_session(threads):
                technique(name).compute(frame, params, context, 0)
            yield Step(name + words, time.perf_counter() - start)
