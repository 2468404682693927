"""The only file that holds numba's options: three decorators, the cache's place, threads, and the compile clock.

FAST is every fast-math flag but `nnan` and `ninf`: kernels test for NaN, and those two would make the tests lie. The
cache folder is named by a hash of all kernel and pass sources, because numba checks only the file of the caller and
would serve stale code after an edit of a helper elsewhere.
"""

from __future__ import annotations

import contextlib
import hashlib
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import prange
from numba.core import event, types

from ..core.cache_root import cache_root

__all__ = ["cache_dir", "compiled_s", "device_jit", "inline_jit", "kernel_session", "pixel_jit", "prange",
           "probe_threading_layer", "threading_layer"]

# loops are parallel where they say so. Array expressions are not: numba would compile each as a kernel of its own, and
# compiling takes a sixth less without
PRANGE_ONLY = {"prange": True, "comprehension": False, "reduction": False, "inplace_binop": False, "setitem": False,
               "numpy": False, "stencil": False, "fusion": False}
FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}
_PACKAGE = Path(__file__).resolve().parent.parent
_kernel_lock = threading.Lock()


def _sources_hash() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for folder in ("kernels", "passes"):
        for path in sorted((_PACKAGE / folder).glob("*.py")):
            digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def cache_dir() -> Path:
    """Folder of this source state's compiled kernels: under $NUMBA_CACHE_DIR, the set root, or the user's cache."""
    folder = cache_root() / _sources_hash()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:                              # a read-only home: compile for this process only
        folder = Path(tempfile.mkdtemp(prefix="rtgi_numba_"))
    return folder


_CACHE = str(cache_dir())


def _with_cache(decorate: Callable) -> Callable:
    """numba reads CACHE_DIR at decoration: point it to ours just then, so that other add-ons keep theirs."""
    def wrapper(function: Callable) -> Callable:
        before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _CACHE
        try:
            return decorate(function)
        finally:
            numba.config.CACHE_DIR = before
    return wrapper


def _without_literals(dispatcher: Any) -> Any:
    """Callers' literal numbers become plain integers: numba would compile a helper anew for each of them."""
    if numba.config.DISABLE_JIT:
        return dispatcher                        # the plain function
    template = dispatcher.get_call_template
    dispatcher.get_call_template = lambda args, kws: template(
        tuple(map(types.unliteral, args)), {name: types.unliteral(kind) for name, kind in kws.items()})
    return dispatcher


def device_jit(function: Callable) -> Callable:
    """A helper that kernels call, or a serial kernel."""
    return _without_literals(_with_cache(numba.njit(fastmath=FAST, error_model="numpy", nogil=True, cache=True))(function))


def inline_jit(function: Callable) -> Callable:
    """A helper that is always put into its caller: a loop that calls a function is not vectorised.

    For small functions without branches in loops over texels; the glossy lobe there costs 1.1 instead of 18 ns.
    """
    return _without_literals(
        _with_cache(numba.njit(fastmath=FAST, error_model="numpy", nogil=True, cache=True, forceinline=True))(function))


def pixel_jit(function: Callable) -> Callable:
    """A kernel over independent pixels, texels or points with `prange`; bitwise the same on any number of threads."""
    return _with_cache(
        numba.njit(fastmath=FAST, error_model="numpy", nogil=True, parallel=PRANGE_ONLY, cache=True))(function)


@contextlib.contextmanager
def kernel_session(threads: int = 0) -> Iterator[None]:
    """Run kernels on `threads` threads (0: all); one session at a time, since some threading layers abort otherwise."""
    with _kernel_lock:
        before = numba.get_num_threads()
        most = numba.config.NUMBA_NUM_THREADS
        numba.set_num_threads(min(threads, most) if threads > 0 else most)
        try:
            yield
        finally:
            numba.set_num_threads(before)


def threading_layer() -> str:
    """Name of numba's threading layer, or "none yet" before the first parallel kernel ran."""
    try:
        return numba.threading_layer()
    except ValueError:
        return "none yet"


@pixel_jit
def _count_up(out: np.ndarray) -> None:
    for i in prange(out.size):
        out[i] = np.float32(i)


def probe_threading_layer() -> tuple[str, int]:
    """Name of the threading layer and the number of its threads, after a kernel of a few numbers ran on it."""
    with kernel_session():
        _count_up(np.zeros(64, np.float32))
        return numba.threading_layer(), numba.get_num_threads()


_compile_clock = event.TimingListener()
event.register("numba:compile", _compile_clock)


def compiled_s() -> float:
    """Seconds that this process has spent compiling kernels so far; loads from the cache are not among them."""
    return _compile_clock.duration if _compile_clock.done else 0.0
