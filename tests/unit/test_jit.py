"""How kernels are shared out to threads: every item once, errors seen, nothing left running."""

from __future__ import annotations

import sys
import threading
import time

import numpy as np
import pytest

from rtgi_addon.kernels import jit
from rtgi_addon.kernels.bvh import build_bvh
from rtgi_addon.kernels.jit import device_jit, kernel_session, pixel_jit, prefetch, scratch, select
from rtgi_addon.kernels.pilot import cast_rays


@pytest.mark.parametrize("threads", [1, 2, 3, 16])
@pytest.mark.parametrize("number", [0, 1, 2, 7, 64, 1000, 100_003])
def test_ranges_cover_every_item_once_and_end_small(number, threads):
    ranges = list(jit._shrinking_ranges(number, threads))
    assert [i for begin, end in ranges for i in range(begin, end)] == list(range(number))
    sizes = [end - begin for begin, end in ranges]
    assert sizes[:-1] == sorted(sizes[:-1], reverse=True)
    assert not sizes or sizes[-1] <= max(1, number // (2 * threads))


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_each_item_is_done_once_on_any_number_of_threads(threads, monkeypatch):
    monkeypatch.setattr(jit, "most_threads", lambda: 4)
    done, seen = np.zeros(1000, np.int64), set()

    def kernel(begin, end, out):
        seen.add(threading.get_ident())
        time.sleep(1e-3)                         # so that a second thread gets its turn
        out[begin:end] += 1

    with kernel_session(threads):
        jit._workers.share(kernel, len(done), (done,))
    assert (done == 1).all()
    assert (len(seen) > 1) == (threads > 1)


def test_outside_of_a_session_the_caller_does_all():
    seen = []
    jit._workers.share(lambda begin, end: seen.append((begin, end, threading.get_ident())), 10, ())
    assert seen == [(0, 10, threading.get_ident())]


def test_an_error_in_any_thread_reaches_the_caller_after_all_have_ended(monkeypatch):
    monkeypatch.setattr(jit, "most_threads", lambda: 2)
    running = []

    def kernel(begin, end):
        running.append(begin)
        time.sleep(1e-3)
        running.remove(begin)
        if begin > 0:                            # whichever thread takes the second range
            raise ZeroDivisionError

    with kernel_session(2), pytest.raises(ZeroDivisionError):
        jit._workers.share(kernel, 100, ())
    assert running == []


def test_a_kernel_that_borrows_its_arguments_leaves_them_to_their_owner():
    corners = np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0]]], np.float32)
    bvh = build_bvh(corners)
    origin = np.tile(np.array([[0, 0, 1]], np.float32), (100, 1))
    direction = np.tile(np.array([[0, 0, -1]], np.float32), (100, 1))
    held = [sys.getrefcount(part) for part in bvh]
    for _ in range(10):
        distance, *_ = cast_rays(origin, direction, bvh, np.float32(0), np.float32(10))
    assert np.allclose(distance, 1, rtol=1e-6)   # float32
    assert [sys.getrefcount(part) for part in bvh] == held


@device_jit
def _larger_halves(numbers, out):
    for k in range(numbers.shape[0]):
        prefetch(numbers, k)
        is_large, half = numbers[k] > np.float32(1), np.float32(0.5) * numbers[k]
        out[0, k], out[1, k] = select(is_large, numbers[k], out[0, k]), select(is_large, half, out[1, k])


def test_selects_take_the_number_that_their_condition_names():
    numbers, out = np.array([0, 1, 2, np.nan, 4, np.inf] * 8, np.float32), np.full((2, 48), -1, np.float32)
    _larger_halves(numbers, out)
    assert np.array_equal(out[0], np.where(numbers > 1, numbers, -1))
    assert np.array_equal(out[1], np.where(numbers > 1, numbers / 2, -1))


ROOM = 5


@pixel_jit
def _reverse_in_scratch(begin, end, rows, out):
    room = scratch(ROOM, np.float32)
    for i in range(begin, end):
        for j in range(ROOM):
            room[j] = rows[i, j]
        for j in range(ROOM):
            out[i, j] = room[ROOM - 1 - j] + np.float32(len(room))


def test_scratch_is_an_array_of_each_thread_and_type():
    rows = np.arange(4000 * ROOM, dtype=np.float32).reshape(-1, ROOM)
    out = np.zeros_like(rows)
    with kernel_session(2):
        _reverse_in_scratch(len(rows), rows, out)
    np.testing.assert_array_equal(out, rows[:, ::-1] + ROOM)
    assert scratch(ROOM, np.float32).shape == (ROOM,)      # in plain Python too
