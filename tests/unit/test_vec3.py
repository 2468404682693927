"""Three-vectors in kernels against numpy."""

from __future__ import annotations

import numpy as np
import pytest

from rtgi_addon.kernels import vec3
from rtgi_addon.kernels.vec3 import Vec3, f32


def vec(a):
    return Vec3(*(f32(x) for x in a))


@pytest.fixture
def pair(rng):
    return rng.normal(size=(2, 3)).astype(np.float32)


@pytest.mark.parametrize(("function", "reference"), [(vec3.add, np.add), (vec3.sub, np.subtract), (vec3.cross, np.cross)])
def test_binary_operations_agree_with_numpy(pair, function, reference):
    np.testing.assert_allclose(function(vec(pair[0]), vec(pair[1])), reference(*pair), rtol=1e-5, atol=1e-6)


def test_dot_and_length_agree_with_numpy(pair):
    assert vec3.dot(vec(pair[0]), vec(pair[1])) == pytest.approx(float(pair[0] @ pair[1]), rel=1e-5)
    assert vec3.length(vec(pair[0])) == pytest.approx(float(np.linalg.norm(pair[0])), rel=1e-6)


def test_along_walks_from_the_origin(pair):
    a, b = pair
    np.testing.assert_allclose(vec3.along(vec(a), vec(b), f32(2.5)), a + 2.5 * b, rtol=1e-5, atol=1e-6)


def test_loads_take_rows_columns_and_pixels():
    a = np.arange(24, dtype=np.float32)
    assert vec3.load(a.reshape(8, 3), 2) == (6, 7, 8)
    assert vec3.load_column(a.reshape(6, 4), 1, 2) == (6, 10, 14)
    assert vec3.load_pixel(a.reshape(2, 4, 3), 1, 2) == (18, 19, 20)


@pytest.mark.parametrize("bad", [(0, 0, 0), (np.nan, 0, 1), (np.inf, 0, 0)])
def test_vector_without_direction_becomes_the_fallback(bad):
    assert vec3.normalized_or(vec(bad), vec((0, 1, 0))) == (0, 1, 0)


def test_normalized_vector_has_length_one(pair):
    assert vec3.length(vec3.normalized_or(vec(1e-12 * pair[0]), vec((0, 1, 0)))) == pytest.approx(1, rel=1e-6)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (0.6, 0, 0.8), (-0.6, 0.48, -0.64), (1, 0, 0)])
def test_tangent_frame_is_right_handed_and_orthonormal(normal):
    t, b = vec3.tangent_frame(vec(normal))
    frame = np.array([t, b, normal])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=2e-6)
    assert np.linalg.det(frame) == pytest.approx(1, abs=5e-6)


def test_to_world_turns_the_local_z_into_the_normal():
    n = vec((0.6, 0, 0.8))
    t, b = vec3.tangent_frame(n)
    np.testing.assert_allclose(vec3.to_world(vec((0, 0, 2)), t, b, n), (1.2, 0, 1.6), rtol=1e-6)


def test_float32_stays_float32():
    v = vec((1, 2, 3))
    vec3.dot(v, v)
    results = {str(c.signature.return_type) for c in vec3.dot.overloads.values() if "float64" not in str(c.signature.args)}
    assert results == {"float32"}
