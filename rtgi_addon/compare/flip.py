"""FLIP, by its authors' library, where it is installed: a metric of what the eye sees between two displayed pictures [1]_.

It runs in a process of its own, since the library ends the whole process on a black reference. It judges display values: a
picture a tenth too bright looks worse to it than one full of fine noise, so it stands beside the other errors, never alone.

References
----------
.. [1] Andersson et al. FLIP: A Difference Evaluator for Alternating Images. PACMCGIT 3(2), 2020.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from ..errors import InputError

PACKAGE = "flip-evaluator"
_SECONDS = 300              # 1920x1080 takes three; a machine that is a hundred times busier is not waited for
_CODE = """\
import sys
import numpy as np
try:
    import flip_evaluator
except ImportError:
    sys.exit(77)
test, reference = np.load(sys.argv[1]), np.load(sys.argv[2])
print(flip_evaluator.evaluate(reference, test, "LDR", inputsRGB=True, applyMagma=False)[1])
"""
_NOT_INSTALLED = 77         # exit code of `_CODE` that Python itself does not use


def mean_flip(test: np.ndarray, reference: np.ndarray, python: str = sys.executable) -> float | str:
    """Mean FLIP of (H, W, 3) uint8 display values at 67 px a degree, 0 to 1; or in one line why there is none.

    InputError for pictures of different size or kind; uint8 holds no value that is not finite.
    """
    for name, image in (("test image", test), ("reference", reference)):
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape != test.shape:
            raise InputError(f"FLIP needs two (H, W, 3) uint8 pictures of one size; the {name} is {image.shape} "
                             f"{image.dtype}")
    with tempfile.TemporaryDirectory(prefix="rtgi_flip_") as folder:
        paths = [Path(folder) / "test.npy", Path(folder) / "reference.npy"]
        for path, image in zip(paths, (test, reference), strict=True):
            np.save(path, image.astype(np.float32) / 255)
        try:
            done = subprocess.run([python, "-c", _CODE, *map(str, paths)], capture_output=True, text=True, timeout=_SECONDS,
                                  check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            return f"FLIP did not run: {error}"
    if done.returncode == _NOT_INSTALLED:
        return f"FLIP is left out: its library is not installed in {python} (pip install {PACKAGE})"
    try:
        return float(done.stdout)
    except ValueError:
        why = (done.stderr or done.stdout).strip().splitlines()
        return f"FLIP ended with code {done.returncode}" + (f": {why[-1]}" if why else "")
