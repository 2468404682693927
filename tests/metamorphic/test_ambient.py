"""Laws that hold exactly for ambient occlusion of the screen, and inputs that must not break it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rtgi_addon.core.frame import Frame, World
from rtgi_addon.core.synthetic import cast_view, make_room_frame
from rtgi_addon.core.techniques import HbaoParams, SsaoParams
from rtgi_addon.core.transforms import Camera, Projection
from rtgi_addon.kernels.jit import kernel_session
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.hbao import bent_normals, compute_hbao
from rtgi_addon.passes.ssao import compute_ssao
from tests.height_frames import frame_from

FORMS = ((compute_hbao, HbaoParams()), (compute_hbao, HbaoParams(method="PUBLISHED")),
         (compute_ssao, SsaoParams(method="SPHERE")), (compute_ssao, SsaoParams()))
forms = pytest.mark.parametrize(("compute", "params"), FORMS, ids=("sectors", "horizons", "ball", "hemisphere"))


def sound(frame: Frame, compute, params) -> np.ndarray:
    """The visibility, once light and visibility are known to be finite and in bounds."""
    result = compute(frame, params, Context(), 0)
    light = result.light[Transport.WORLD_DIFFUSE]
    assert np.isfinite(light).all() and (light >= 0).all() and light.shape == frame.gbuffer.albedo.shape
    # sums of float32 weights leave a last digit over 1
    assert np.isfinite(result.visibility).all() and result.visibility.min() >= 0 and result.visibility.max() <= 1 + 1e-6
    return result.visibility


@forms
def test_one_and_two_threads_give_the_same_bits(compute, params):
    frame = make_room_frame(33, 19, kinds=(), world_radiance=0.5)
    shown = []
    for threads in (1, 2):
        with kernel_session(threads):
            shown.append(compute(frame, params, Context(), 5).visibility)
    assert np.array_equal(*shown)


@forms
def test_light_is_linear_in_the_world_and_black_without_it(compute, params):
    frame = make_room_frame(24, 16, kinds=(), world_radiance=0.5)
    light = [compute(dataclasses.replace(frame, world=World(np.full((1, 1, 3), value, np.float32))), params, Context(), 0)
             .light[Transport.WORLD_DIFFUSE] for value in (0.0, 0.5, 2.0)]
    assert not light[0].any() and light[1].any() and np.array_equal(light[2], 4 * light[1])


@forms
@pytest.mark.parametrize("size", [(1, 1), (7, 5), (1, 40), (40, 1)])
def test_pictures_of_any_size(compute, params, size):
    for lattice in (1, 2, 8):
        sound(make_room_frame(*size, kinds=(), world_radiance=1.0), compute, dataclasses.replace(params, lattice_px=lattice))


@forms
def test_nothing_but_background(compute, params):
    camera = Camera(Projection.PERSPECTIVE, np.eye(4), 16, 12, -1, 1, -1, 1)
    frame = frame_from(camera, np.full((12, 16), np.inf), (0, 0, 1))
    assert (sound(frame, compute, params) == 1).all()


@forms
@pytest.mark.parametrize("projection", [Projection.PERSPECTIVE, Projection.ORTHOGRAPHIC])
def test_depths_from_a_millimetre_to_a_thousand_kilometres(compute, params, projection):
    depth = np.exp(np.random.default_rng(2).uniform(np.log(1e-3), np.log(1e6), (24, 32)))
    depth[::5, ::7] = np.inf
    camera = Camera(projection, np.eye(4), 32, 24, -1, 1, -1, 1)
    for radius in (1e-6, 1.0, 1e6):
        sound(frame_from(camera, depth, (0, 0, 1)), compute, dataclasses.replace(params, radius_m=radius))


@forms
def test_a_camera_inside_an_object_and_one_whose_near_plane_cuts_it(compute, params):
    room = make_room_frame(24, 16, kinds=(), world_radiance=1.0)
    low, high = room.geometry.bounds_ws
    for share in (0.02, 0.5):
        place = room.camera.world_from_view.copy()
        place[:3, 3] = low + share * (high - low)
        camera = dataclasses.replace(room.camera, world_from_view=place)
        frame = dataclasses.replace(room, camera=camera, gbuffer=cast_view(camera, room.geometry))
        sound(frame, compute, params)
        # normals that look away from the viewer, as the inside of a solid shows them
        turned = dataclasses.replace(frame.gbuffer, normal_ws=-frame.gbuffer.normal_ws)
        sound(dataclasses.replace(frame, gbuffer=turned), compute, params)


def test_bent_normals_are_no_longer_than_a_direction_and_point_up_from_the_surface():
    frame = make_room_frame(33, 19, kinds=(), world_radiance=1.0)
    visibility, bent = bent_normals(frame, HbaoParams(), Context(), 0)
    assert np.isfinite(bent).all() and (np.linalg.norm(bent, axis=-1) <= visibility + 0.1).all()
    open_pixels = frame.gbuffer.mask & (visibility > 0.5)
    assert ((bent * frame.gbuffer.normal_ws).sum(-1)[open_pixels] > 0.2).all()
