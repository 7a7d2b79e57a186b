"""The compiled log-likelihoods of classes equal their plain NumPy twins."""

import numpy as np
from scipy.special import log_ndtr

from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.objects.motion_class_kernel import (
    Classes,
    log_normal_cdf,
    size_log_likelihood_compiled,
    speed_log_likelihood_compiled,
)

CLASSES = Classes(
    size=np.array([[0.5, 0.5, 1.7], [1.8, 0.6, 1.7], [4.5, 1.8, 1.5]]), size_spread=0.15,
    greatest_mps=np.array([4.0, 10.0, 40.0]), pace=np.array([1.3, 4.2]),
    pace_spread=np.array([0.25, 1.0]), odd_share=0.1,
)  # fmt: skip


def of_speed(speed: FloatArray, sigma: FloatArray) -> FloatArray:
    v, s = speed[:, None], sigma[:, None]
    spread = np.hypot(CLASSES.pace_spread, s)
    usual = -0.5 * ((v - CLASSES.pace) / spread) ** 2 - np.log(spread * np.sqrt(2.0 * np.pi))
    most = CLASSES.greatest_mps
    anywhere = log_ndtr((most - v) / s) - np.log(most)
    share = CLASSES.odd_share
    named = np.logaddexp(np.log1p(-share) + usual, np.log(share) + anywhere[:, :2])
    return np.concatenate([named, anywhere[:, 2:]], axis=1)


def of_size(size: FloatArray, sigma: FloatArray, faces: BoolArray) -> FloatArray:
    order = np.concatenate([np.argsort(-size[:, :2], axis=1), np.full((len(size), 1), 2)], axis=1)
    seen, noise = (np.take_along_axis(x, order, 1)[:, None] for x in (size, sigma))
    both = np.take_along_axis(faces, order, 1)[:, None]
    spread = np.hypot(CLASSES.size_spread * CLASSES.size, noise)
    bounded = np.array([[[True], [True], [False]]])  # the last class has no greatest size
    fits = np.asarray(log_ndtr((CLASSES.size - seen) / spread), dtype=np.float64)
    each = np.where(bounded, fits, 0.0) - np.where(both, np.log(CLASSES.size), 0.0)
    return np.asarray(np.where(np.isfinite(seen), each, 0.0).sum(axis=-1))


def test_the_distribution_far_out_and_near() -> None:
    x = np.array([-300.0, -45.0, -20.1, -19.9, -3.0, -0.1, 0.0, 0.3, 2.0, 9.0])
    np.testing.assert_allclose([log_normal_cdf(v) for v in x], log_ndtr(x), rtol=1e-4, atol=1e-12)


def test_of_speeds_and_of_sizes() -> None:
    rng = np.random.default_rng(3)
    speed, sigma = rng.uniform(0.0, 30.0, 50), rng.uniform(0.01, 0.6, 50)
    found = speed_log_likelihood_compiled(speed, sigma, CLASSES)
    np.testing.assert_allclose(found, of_speed(speed, sigma), rtol=1e-4)
    size, noise = rng.uniform(0.2, 6.0, (50, 3)), rng.uniform(0.02, 0.6, (50, 3))
    size[3, 0] = size[4, 1] = size[5, 2] = np.nan
    faces = rng.random((50, 3)) < 0.5
    found = size_log_likelihood_compiled(size, noise, faces, CLASSES)
    np.testing.assert_allclose(found, of_size(size, noise, faces), rtol=1e-4)
