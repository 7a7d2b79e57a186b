"""What the camera models share: the radius at which a radial polynomial folds back."""

import numpy as np
import pytest

from ovmot.cameras.models.model import fold_squared


def test_a_polynomial_that_only_grows_never_folds() -> None:
    assert fold_squared((0.1, 0.2, 0.0)) == np.inf
    assert fold_squared(()) == np.inf


@pytest.mark.parametrize("k1", [-0.3, -0.05])
def test_one_term_folds_where_its_slope_is_zero(k1: float) -> None:
    # d/dr (r + k1 r³) = 1 + 3 k1 r²
    assert fold_squared((k1,)) == pytest.approx(-1.0 / (3.0 * k1))


def test_the_nearest_fold_counts() -> None:
    radial = (-0.5, 0.06)
    r = np.sqrt(fold_squared(radial)) + np.array([-1e-4, 0.0, 1e-4])
    image = r * (1.0 + radial[0] * r**2 + radial[1] * r**4)
    assert image[0] < image[1] > image[2]
