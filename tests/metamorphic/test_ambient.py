"""What HBAO and SSAO keep whatever the scene: no light, more light, threads, sizes."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from rtgi_addon.core.synthetic import make_room_frame
from rtgi_addon.core.techniques import HbaoParams, SsaoParams
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.hbao import compute_hbao
from rtgi_addon.passes.ssao import compute_ssao

FORMS = [(compute_hbao, HbaoParams()), (compute_ssao, SsaoParams())]


def light_of(form, width: int, height: int, radiance: float) -> np.ndarray:
    compute, params = form
    frame = make_room_frame(width, height, kinds=(), world_radiance=radiance)
    return compute(frame, params, Context(), 0).light[Transport.WORLD_DIFFUSE]


@pytest.mark.parametrize("form", FORMS)
def test_light_is_linear_in_the_world_and_zero_without_it(form):
    one = light_of(form, 24, 16, 1.0)
    assert one.max() > 0 and not light_of(form, 24, 16, 0.0).any()
    np.testing.assert_allclose(light_of(form, 24, 16, 4.0), 4 * one, rtol=1e-6)      # a power of two: only tables round


@pytest.mark.parametrize("form", FORMS)
def test_same_bits_on_one_and_two_threads(form):
    before, pictures = numba.get_num_threads(), []
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            pictures.append(light_of(form, 40, 24, 1.0))
    finally:
        numba.set_num_threads(before)
    assert np.array_equal(*pictures)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("size", [(1, 1), (7, 5)])
def test_tiny_pictures_are_finite(form, size):
    light = light_of(form, *size, 1.0)
    assert np.isfinite(light).all() and (light >= 0).all()
