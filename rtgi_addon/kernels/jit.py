"""The only file that holds numba's options: three decorators, the cache's place, threads, and the compile clock.

Kernels over many items are serial functions of a range of them, and Python threads share the ranges out. Numba's own
parallel loops took half as long again to compile (26 against 16 s for a frame of the Cornell box), give every thread one
equal part however unequal the work in it is, and abort the process when two threads enter them with some threading layers.

FAST is every fast-math flag but `nnan` and `ninf`: kernels test for NaN, and those two would make the tests lie. The
cache folder is named by a hash of all kernel and pass sources, because numba checks only the file of the caller and
would serve stale code after an edit of a helper elsewhere.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import extending
from numba.core import cgutils, event, types

from ..core.cache_root import cache_root

__all__ = ["borrowed", "cache_dir", "compiled_s", "device_jit", "inline_jit", "kernel_session", "most_threads",
           "pixel_jit", "prefetch", "scratch", "select"]

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
    """A helper that is always put into its caller.

    For small functions without branches in loops over texels, since a loop that calls a function is not vectorised: the
    glossy lobe there costs 1.1 instead of 18 ns. And for those that take tuples of arrays and are called for every pixel
    from one or two places: a call copies each array's nine words, which took half of the time of direct light.
    """
    return _without_literals(
        _with_cache(numba.njit(fastmath=FAST, error_model="numpy", nogil=True, cache=True, forceinline=True))(function))


def _forget_owners(context: Any, builder: Any, kind: types.Type, value: Any) -> Any:
    """`value` with arrays that own nothing, however deep in tuples."""
    if isinstance(kind, types.Array):
        array = cgutils.create_struct_proxy(kind)(context, builder, value)
        array.meminfo, array.parent = (cgutils.get_null_value(getattr(array, name).type) for name in ("meminfo", "parent"))
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        parts = [_forget_owners(context, builder, part, builder.extract_value(value, i)) for i, part in enumerate(kind)]
        return context.make_tuple(builder, kind, parts)
    return value


@extending.intrinsic
def _borrowed(typing_context, items):
    """See `borrowed`."""
    def lower(context, builder, signature, args):
        return _forget_owners(context, builder, signature.args[0], args[0])
    return items(items), lower


def borrowed(items: tuple) -> tuple:
    """The same arrays and tuples of arrays, without their reference counts; for a kernel's own arguments only.

    numba counts every array of a tuple up and down at each call of a helper, atomically, and threads wait for one
    another there. The caller of a kernel keeps its arguments alive anyway.
    """
    return items


@extending.overload(borrowed)
def _borrow(items):
    return lambda items: _borrowed(items)


@extending.intrinsic
def _selected(typing_context, condition, a, b):
    """See `select`."""
    def lower(context, builder, signature, args):
        return builder.select(*args)
    return a(types.boolean, a, a), lower


def select(condition: bool, a: float, b: float) -> float:
    """a if condition else b, for two numbers of one type, without a branch.

    Where one condition chooses what goes to several rows, the compiler makes branches of plain ones, and vectorised
    branches store under a mask, which takes a Zen processor tens of cycles each.
    """
    return a if condition else b


@extending.overload(select)
def _select(condition, a, b):
    return lambda condition, a, b: _selected(condition, a, b)


@extending.intrinsic
def _prefetched(typing_context, array, index):
    """See `prefetch`."""
    def lower(context, builder, signature, args):
        data = cgutils.create_struct_proxy(signature.args[0])(context, builder, args[0]).data
        word, pointer = cgutils.int32_t, builder.bitcast(builder.gep(data, [args[1]]), cgutils.voidptr_t)
        intrinsic = builder.module.declare_intrinsic(
            "llvm.prefetch", [cgutils.voidptr_t], ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, word, word, word]))
        builder.call(intrinsic, [pointer, word(0), word(3), word(1)])       # to read, to keep in every cache, data
        return context.get_dummy_value()
    return types.void(array, types.intp), lower


def prefetch(array: np.ndarray, index: int) -> None:
    """Let the memory bring number `index` of a C-contiguous array, counted over all its axes, while other work goes on."""


@extending.overload(prefetch)
def _prefetch(array, index):
    return lambda array, index: _prefetched(array, index)


@extending.intrinsic(prefer_literal=True)
def _scratch_here(typing_context, count, kind):
    """See `scratch`."""
    result = types.Array(kind.dtype, 1, "C")

    def lower(context, builder, signature, args):
        element = context.get_data_type(result.dtype)
        memory = cgutils.alloca_once(builder, ir.ArrayType(element, count.literal_value))
        memory.align = 64
        number, size = (context.get_constant(types.intp, n) for n in (count.literal_value, context.get_abi_sizeof(element)))
        array = context.make_array(result)(context, builder)
        array.data, array.nitems, array.itemsize = builder.bitcast(memory, element.as_pointer()), number, size
        array.shape, array.strides = cgutils.pack_array(builder, [number]), cgutils.pack_array(builder, [size])
        return _forget_owners(context, builder, result, array._getvalue())
    return result(count, kind), lower


def scratch(count: int, kind: type) -> np.ndarray:
    """np.empty(count, kind) on the kernel's own stack, gone when the kernel returns; `count` is a module's constant.

    numba counts an array of its own up and down, atomically, at each call of a helper that takes it: 4 to 6 % of the kernels
    that trace rays.
    """
    return np.empty(count, kind)


@extending.overload(scratch, prefer_literal=True)
def _scratch(count, kind):
    return lambda count, kind: _scratch_here(count, kind)


class _Workers:
    """Threads of a kernel session beside the one that calls; none outside a session."""

    def __init__(self) -> None:
        self.pool: ThreadPoolExecutor | None = None
        self.number = 0

    def share(self, kernel: Callable, number: int, args: tuple) -> None:
        """Call kernel(begin, end, *args) until range(number) is covered, on all threads.

        Each range is a part of what is left: large ones first, small ones even out the end.
        """
        if self.pool is None or number < 2:
            kernel(0, number, *args)
            return
        ranges = _shrinking_ranges(number, self.number + 1)
        lock = threading.Lock()                  # a generator can't be entered by two threads at once

        def work() -> None:
            while True:
                with lock:
                    begin, end = next(ranges, (number, number))
                if begin >= end:
                    return
                kernel(begin, end, *args)

        others = [self.pool.submit(work) for _ in range(self.number)]
        try:
            work()
        finally:
            for other in others:                 # they write to the caller's arrays: never leave them behind
                other.result()


def _shrinking_ranges(number: int, threads: int) -> Iterator[tuple[int, int]]:
    """Ranges that cover range(number), each a share of what is left and at least a 32nd of a thread's even part."""
    begin, least = 0, max(1, number // (32 * threads))
    while begin < number:
        end = min(number, begin + max(least, (number - begin) // (2 * threads)))
        yield begin, end
        begin = end


_workers = _Workers()


def pixel_jit(function: Callable) -> Callable:
    """A kernel over independent pixels, texels or points, on the threads of the `kernel_session`.

    The function takes (begin, end, *args), handles the items of range(begin, end), writes to arrays among its arguments and
    returns nothing. It is called as kernel(number, *args). The result is bitwise the same on any number of threads.
    """
    kernel = device_jit(function)

    @functools.wraps(function)
    def shared(number: int, *args: Any) -> None:
        _workers.share(kernel, number, args)

    return shared


def most_threads() -> int:
    """Processors that this process may use, or $NUMBA_NUM_THREADS."""
    return numba.config.NUMBA_NUM_THREADS


@contextlib.contextmanager
def kernel_session(threads: int = 0) -> Iterator[None]:
    """Run kernels on `threads` threads (0: `most_threads`), one session at a time; outside of one on their caller's."""
    with _kernel_lock:
        number = min(threads, most_threads()) if threads > 0 else most_threads()
        with ThreadPoolExecutor(max(number - 1, 1), "rtgi kernels") as pool:
            _workers.number = number - 1
            _workers.pool = pool if number > 1 else None
            try:
                yield
            finally:
                _workers.pool, _workers.number = None, 0


_compile_clock = event.TimingListener()
event.register("numba:compile", _compile_clock)


def compiled_s() -> float:
    """Seconds that this process has spent compiling kernels so far; loads from the cache are not among them."""
    return _compile_clock.duration if _compile_clock.done else 0.0
