"""Visibility in closed form: open planes, edges, corners, walls, pits, trenches, bowls (T15 to T22)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtgi_addon.core.frame import Frame
from rtgi_addon.core.techniques import HbaoParams, SsaoParams
from rtgi_addon.core.transforms import Camera, Projection
from rtgi_addon.passes.base import Context, Transport
from rtgi_addon.passes.hbao import bent_normals, compute_hbao
from rtgi_addon.passes.ssao import compute_ssao
from tests.height_frames import height_frame, planes_frame
from tests.plane_frames import looking

SIZE = 201                  # of the pictures; the middle pixel is 100
FAR = 1e4                   # m, a radius that leaves nothing out
FINE = {"slices": 32, "steps": 200, "thickness": 10.0, "blur": 0}


def cosine(frame: Frame, radius_m: float = FAR, **kwargs) -> np.ndarray:
    return compute_hbao(frame, HbaoParams(radius_m=radius_m, **{**FINE, **kwargs}), Context(), 0).visibility


def published(frame: Frame, radius_m: float = FAR, **kwargs) -> np.ndarray:
    params = HbaoParams(method="PUBLISHED", radius_m=radius_m, bias_rad=0.0, falloff=False, **{**FINE, **kwargs})
    return compute_hbao(frame, params, Context(), 0).visibility


def ball(frame: Frame, radius_m: float, method: str = "SPHERE") -> np.ndarray:
    """Visibility by 1024 points, averaged over as many mirrors as there are seeds: 8."""
    params = SsaoParams(method=method, radius_m=radius_m, samples=1024, blur=0)
    return np.mean([compute_ssao(frame, params, Context(), seed).visibility for seed in range(8)], 0)


def middle(image: np.ndarray) -> float:
    return float(image[image.shape[0] // 2, image.shape[1] // 2])


def from_middle(r: float, frame: Frame) -> tuple[int, int]:
    """Pixel at r metres right of the middle."""
    size = frame.gbuffer.shape[0]
    return size // 2, size // 2 + round(r / frame.camera.pixel_size[0])


# T18: an open plane


def plane_seen(projection: Projection, tilt_deg: float) -> Frame:
    """The plane z = 0, from above and tilted; the perspective picture's corners lie 50 degrees off its axis."""
    tilt = math.radians(tilt_deg)
    place = looking(np.array([0.0, -10 * math.sin(tilt), 10 * math.cos(tilt)]), np.zeros(3))
    half = math.tan(math.radians(50)) / math.sqrt(2) if projection is Projection.PERSPECTIVE else 8.0
    return planes_frame(Camera(projection, place, 96, 96, -half, half, -half, half), [(np.zeros(3), (0, 0, 1))])


@pytest.mark.parametrize("projection", [Projection.PERSPECTIVE, Projection.ORTHOGRAPHIC])
@pytest.mark.parametrize("tilt_deg", [0, 25, 48])
def test_open_plane_reads_one_up_to_50_degrees_off_axis(projection, tilt_deg):
    frame = plane_seen(projection, tilt_deg)
    mask = frame.gbuffer.mask
    for blur in (0, 2):
        visibility = compute_hbao(frame, HbaoParams(radius_m=3.0, blur=blur), Context(), 0).visibility[mask]
        assert np.abs(visibility - 1).max() <= 0.002
    assert np.abs(published(frame, 3.0, slices=4, steps=8)[mask] - 1).max() <= 0.002
    oriented = SsaoParams(radius_m=3.0, blur=0)
    assert np.abs(compute_ssao(frame, oriented, Context(), 0).visibility[mask] - 1).max() <= 0.002


def test_open_plane_bends_no_normal():
    frame = plane_seen(Projection.PERSPECTIVE, 25)
    visibility, bent = bent_normals(frame, HbaoParams(radius_m=3.0, slices=16, blur=0), Context(), 0)
    mask = frame.gbuffer.mask
    # the mean direction of a cosine lobe is 2/3 of its normal; 16 slices and a table of eighths leave 1 % of it
    np.testing.assert_allclose(bent[mask], np.tile([0, 0, 2 / 3], (mask.sum(), 1)), atol=0.012)
    assert np.abs(visibility - 1).max() <= 0.002


# T15, T16: edges and corners of planes


def edge_frame(angle_deg: float) -> Frame:
    """A floor that ends at x = 0 in a plane rising from its extension by an angle, seen along their bisector."""
    b = math.radians(angle_deg)
    towards = np.array([math.sin(b / 2), 0.0, -math.cos(b / 2)]) if b else np.array([0, 0, -1.0])
    place = looking(-20 * towards, np.zeros(3))
    camera = Camera(Projection.ORTHOGRAPHIC, place, SIZE, SIZE, -1, 1, -1, 1)
    return planes_frame(camera, [(np.zeros(3), (0, 0, 1)), (np.zeros(3), (-math.sin(b), 0, math.cos(b)))])


def beside_edge(visibility: np.ndarray) -> float:
    """Mean of the two pixels on either side of the edge, which are half a pixel off it."""
    row = visibility[SIZE // 2]
    return float(np.sort(row[SIZE // 2 - 1:SIZE // 2 + 2])[:2].mean())


@pytest.mark.parametrize(("angle_deg", "wanted"), [(0, 1.0), (60, 0.75), (90, 0.5), (120, 0.25)])
def test_edge_of_two_planes_leaves_half_of_one_plus_the_cosine(angle_deg, wanted):
    # half a pixel beside a wall of 100 pixels: the wall's far parts leave 0.5 % of the half sky, nearer ones a pixel's step
    assert abs(beside_edge(cosine(edge_frame(angle_deg))) - wanted) <= 0.012


def corner_frame() -> Frame:
    """The corner of three planes at right angles, seen along the space diagonal."""
    place = looking(np.array([20.0, 20.0, 20.0]), np.zeros(3), (0.0, 0.0, 1.0))
    camera = Camera(Projection.ORTHOGRAPHIC, place, SIZE, SIZE, -1, 1, -1, 1)
    return planes_frame(camera, [(np.zeros(3), n) for n in np.eye(3)])


def test_corner_of_three_planes_leaves_a_quarter():
    # T16; the three pixels around the corner's tip lie within a pixel of both other planes
    v = cosine(corner_frame())
    near = np.sort(v[SIZE // 2 - 1:SIZE // 2 + 2, SIZE // 2 - 1:SIZE // 2 + 2].ravel())[:3]
    assert abs(near.mean() - 0.25) <= 0.015


# T17: a wall of elevation f; what lies behind its edge is as high


def wall_frame(distance: float, height: float) -> Frame:
    """A floor seen from above and a block whose side stands right of the middle."""
    return height_frame(lambda x, y: np.where(x > distance, height, 0.0), 601, 6.0)


@pytest.mark.parametrize("elevation_deg", [30, 45, 60])
def test_wall_hides_by_cosine_or_by_angle(elevation_deg):
    f = math.radians(elevation_deg)
    frame = wall_frame(0.5, 0.5 * math.tan(f) * 0.505 / 0.5)     # its edge is seen in the first pixel behind it, at 0.51 m
    # half a pixel of 50 to the edge: 0.6 degrees of elevation, 0.004; the wall ends at 12 times its distance: 0.002
    assert abs(middle(cosine(frame)) - (1 + math.cos(f)) / 2) <= 0.008
    assert abs(middle(published(frame)) - (1 - f / math.pi)) <= 0.01


# T19: a round pit; T22: a trench


@pytest.mark.parametrize("depth", [0.5, 1.0, 2.0])
def test_bottom_of_a_round_pit_sees_its_opening(depth):
    frame = height_frame(lambda x, y: np.where(np.hypot(x, y) < 1, -depth, 0.0), 401, 2.0)
    # the rim is seen half a pixel, 0.5 % of the radius, behind its edge
    assert abs(middle(cosine(frame)) - 1 / (1 + depth**2)) <= 0.006
    assert abs(middle(published(frame)) - (1 - depth / math.sqrt(1 + depth**2))) <= 0.01


def test_point_off_the_middle_of_a_pit_sees_the_disk_that_is_its_sky():
    h, s = 0.6, 0.5
    frame = height_frame(lambda x, y: np.where(np.hypot(x, y) < 1, -h, 0.0), 401, 2.0)
    wanted = 0.5 * (1 + (1 - h**2 - s**2) / math.sqrt((h**2 + s**2 + 1)**2 - 4 * s**2))      # T2
    assert abs(cosine(frame)[from_middle(s, frame)] - wanted) <= 0.006


def test_bottom_of_a_trench():
    w = 51 * 12 / 601                                        # its edges lie between two pixels
    frame = height_frame(lambda x, y: np.where(np.abs(x) < w / 2, -w / 2, 0.0), 601, 6.0)
    wanted = (w / 2) / math.hypot(w / 2, w / 2)
    assert abs(middle(cosine(frame)) - wanted) <= 0.01       # edges half a pixel of 25 off, ends at 12 widths


# T20: a bowl, the half of a sphere


def bowl_frame(**kwargs) -> Frame:
    def bowl(x, y):
        return -np.sqrt(np.maximum(1 - x * x - y * y, 0.0))

    return height_frame(bowl, 401, 1.2, **kwargs)


def test_every_point_of_a_bowl_sees_half_the_sky():
    frame = bowl_frame()
    v = cosine(frame)
    for r in (0.0, 0.3, 0.6, 0.8):
        assert abs(v[from_middle(r, frame)] - 0.5) <= 0.008


def test_bounces_in_a_bowl_add_up_to_the_exact_series():
    frame = bowl_frame(albedo=0.8)
    params = HbaoParams(radius_m=FAR, multi_bounce=True, **FINE)
    light = compute_hbao(frame, params, Context(), 0).light[Transport.WORLD_DIFFUSE]
    for r in (0.0, 0.3, 0.6, 0.8):
        assert np.allclose(light[from_middle(r, frame)] / np.pi, 0.5 / (1 - 0.8 * 0.5), atol=0.006)


# T21: the ball of the published SSAO


def test_ball_over_a_plane_reads_one_after_the_rule_of_one_half():
    frame = plane_seen(Projection.ORTHOGRAPHIC, 25)
    inner = ball(frame, 1.0)[30:-30, 30:-30]
    # half of the ball is seen; the rule cuts what is more, so noise pulls the mean below 1
    assert abs(inner.mean() - 1) <= 0.01 and inner.max() == 1


@pytest.mark.parametrize("method", ["SPHERE", "HEMISPHERE"])
def test_ball_in_an_edge_and_a_corner(method):
    # half a pixel off the planes, 1 % of the radius: 0.0075 of the ball's half
    assert abs(beside_edge(ball(edge_frame(90), 0.5, method)) - 0.5) <= 0.02
    v = ball(corner_frame(), 0.5, method)
    near = np.sort(v[SIZE // 2 - 1:SIZE // 2 + 2, SIZE // 2 - 1:SIZE // 2 + 2].ravel())[:3]
    assert abs(near.mean() - 0.25) <= 0.02


@pytest.mark.parametrize("method", ["SPHERE", "HEMISPHERE"])
@pytest.mark.parametrize("u", [0.25, 0.5, 0.75])
def test_ball_beside_a_wall_loses_a_cap(method, u):
    frame = edge_frame(90)
    # along the bisector a pixel of the floor lies sqrt(2) times as far from the wall as its offset in the picture
    column = SIZE // 2 - round(u * 0.5 / math.sqrt(2) / frame.camera.pixel_size[0])
    p = frame.gbuffer.position_ws[SIZE // 2, column]
    u = float(max(abs(p[0]), abs(p[2]))) / 0.5
    v = ball(frame, 0.5, method)[SIZE // 2 - 5:SIZE // 2 + 6, column].mean()
    assert abs(v - (1 - (1 - u)**2 * (2 + u) / 4)) <= 0.01
