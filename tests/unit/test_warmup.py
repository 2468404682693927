"""Warming up runs what a render runs, on a frame of its own."""

from __future__ import annotations

import itertools

from rtgi_addon.warmup import warm_up


def test_the_first_steps_load_the_kernels_and_see_the_lamps_views():
    steps = list(itertools.islice(warm_up(), 3))
    assert [step.name for step in steps] == ["loading", "light views", "direct"]
    assert all(step.seconds >= 0 for step in steps)
