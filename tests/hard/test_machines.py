"""The same picture on one and on many threads, and from kernels run as plain Python."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from rtgi_addon.kernels.jit import kernel_session
from tests.hard_cases import as_plain_python, plain_python_light
from tests.hard_frames import CHEAP, room, run

ROUNDING = 1e-5             # of the mean: compiled sums are taken in another order and with fused steps (measured: 2e-6)


@pytest.mark.parametrize("name", CHEAP)
def test_one_two_and_all_threads_give_the_same_bits(name):
    frame, found = room(33, 19), []
    for threads in (1, 2, numba.config.NUMBA_NUM_THREADS):
        with kernel_session(threads):
            found.append(run(name, frame))
    for other in found[1:]:
        assert set(other.light) == set(found[0].light)
        for transport, image in found[0].light.items():
            np.testing.assert_array_equal(other.light[transport], image)


@pytest.fixture(scope="module")
def plain_python(tmp_path_factory):
    return plain_python_light(tmp_path_factory.mktemp("plain"))


@pytest.mark.parametrize("name", CHEAP)
def test_kernels_as_plain_python_give_the_same_light(name, plain_python):
    assert as_plain_python(plain_python, name) <= ROUNDING
