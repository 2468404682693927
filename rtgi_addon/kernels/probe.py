"""How fast this machine runs kernels: a fixed amount of arithmetic, timed."""

from __future__ import annotations

import math
import time

import numpy as np

from .jit import device_jit, pixel_jit
from .sampling import uniform
from .vec3 import ZERO

ITEMS, ROUNDS, RUNS = 1 << 14, 128, 5


@device_jit
def _item(k):
    total = ZERO
    for i in range(ROUNDS):
        total += math.sqrt(uniform(k, i, 0))
    return total


@pixel_jit
def _work(begin, end, sums):
    for k in range(begin, end):
        sums[k] = _item(k)


def probe_ms() -> float:
    """Milliseconds of two million hashes and roots, the least of five runs, on the threads of the `kernel_session`."""
    sums, times = np.empty(ITEMS, np.float32), []
    for run in range(RUNS + 1):                  # the first may compile
        start = time.perf_counter()
        _work(ITEMS, sums)
        if run:
            times.append(time.perf_counter() - start)
    return 1e3 * min(times)
