"""Compiled stereo geometry of a point against its NumPy twins."""

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.triangulation import (
    project_stereo,
    stereo_covariance,
    triangulate_stereo,
)
from ovmot.kernels import stereo

SIGMA = np.array([1.0, 1.1, 0.9, 1.2]) / 400.0


@pytest.fixture
def T_cam1_cam0() -> FloatArray:
    return se3.make(so3.exp(np.array([0.01, -0.02, 0.015])), np.array([-0.5, 0.01, 0.02]))


@pytest.fixture
def points() -> FloatArray:
    return np.random.default_rng(0).uniform([-5.0, -2.0, 4.0], [5.0, 2.0, 40.0], (20, 3))


def test_projection_and_its_derivative(points: FloatArray, T_cam1_cam0: FloatArray) -> None:
    for p in points:
        h, J = np.empty(4), np.empty((4, 3))
        stereo.project(p, T_cam1_cam0, h, J)
        twin, J_twin = project_stereo(p, T_cam1_cam0)
        np.testing.assert_allclose(h, twin, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(J, J_twin, rtol=1e-10, atol=1e-14)


def test_a_projected_point_is_triangulated_again(
    points: FloatArray, T_cam1_cam0: FloatArray
) -> None:
    for p in points:
        uv, found = project_stereo(p, T_cam1_cam0)[0], np.empty(3)
        assert stereo.triangulate(uv, T_cam1_cam0, found)
        np.testing.assert_allclose(found, p, rtol=1e-8)
        np.testing.assert_allclose(found, triangulate_stereo(uv, T_cam1_cam0), rtol=1e-10)


def test_a_pair_behind_the_cameras_has_no_point(T_cam1_cam0: FloatArray) -> None:
    assert not stereo.triangulate(np.array([0.0, 0.0, 0.5, 0.0]), T_cam1_cam0, np.empty(3))
    assert not stereo.triangulate(np.full(4, np.nan), T_cam1_cam0, np.empty(3))


def test_the_covariance_of_a_triangulated_point(
    points: FloatArray, T_cam1_cam0: FloatArray
) -> None:
    for p in points:
        C = np.empty((3, 3))
        stereo.stereo_covariance(p, T_cam1_cam0, SIGMA, C)
        twin = stereo_covariance(p, T_cam1_cam0, SIGMA)
        np.testing.assert_allclose(C, twin, rtol=1e-8, atol=1e-12)


def test_the_secant_is_exact_over_any_distance(points: FloatArray, T_cam1_cam0: FloatArray) -> None:
    for a, b in zip(points[:10], points[10:], strict=True):
        D = np.empty((4, 3))
        stereo.secant(a, b, T_cam1_cam0, D)
        moved = project_stereo(b, T_cam1_cam0)[0] - project_stereo(a, T_cam1_cam0)[0]
        np.testing.assert_allclose(D @ (b - a), moved, atol=1e-12)


def test_a_transform_is_the_matrix_product(points: FloatArray, T_cam1_cam0: FloatArray) -> None:
    out = np.empty(3)
    stereo.transform(T_cam1_cam0, points[0], out)
    np.testing.assert_allclose(out, se3.apply(T_cam1_cam0, points[0]), rtol=1e-12)
