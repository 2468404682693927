"""The same picture on one and on many threads, and from kernels run as plain Python."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from rtgi_addon.kernels.jit import kernel_session
from tests.hard_frames import CHEAP, room, run

ROOT = Path(__file__).resolve().parents[2]
ROUNDING = 1e-5             # of the mean: compiled sums are taken in another order and with fused steps (measured: 2e-6)
_ALL_TECHNIQUES = """\
import sys
import numpy as np
from tests.hard_frames import CHEAP, room, run
np.savez(sys.argv[1], **{f"{name}|{transport.value}": image for name in CHEAP
                         for transport, image in run(name, room()).light.items()})
"""


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
    """{"technique|transport": light} of the room, made without compiling anything."""
    path = tmp_path_factory.mktemp("plain") / "light.npz"
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", _ALL_TECHNIQUES, str(path)], cwd=ROOT, env=environment,
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with np.load(path) as data:
        return dict(data)


@pytest.mark.parametrize("name", CHEAP)
def test_kernels_as_plain_python_give_the_same_light(name, plain_python):
    light = run(name, room()).light
    assert {f"{name}|{transport.value}" for transport in light} == {key for key in plain_python if key.split("|")[0] == name}
    for transport, image in light.items():
        difference = np.abs(plain_python[f"{name}|{transport.value}"].astype(float) - image).mean()
        assert difference <= ROUNDING * max(float(image.mean()), 1e-30), transport
