"""Where a lens folds in a picture, and the rectangle that --crop keeps."""

import numpy as np
import pytest

from jaxlens.cli.coverage import find_fold, inner_rectangle
from jaxlens.cli.lenses import LensChoice


def test_inner_rectangle_of_the_identity():
    assert inner_rectangle(LensChoice((0.0, 0.0)), "undistort", 24, 32) == (0, 0, 24, 32)


@pytest.mark.parametrize(
    ("direction", "kappa", "radius"),
    [
        ("distort", (-0.1, 0.0), None),
        ("distort", (0.5, 0.0), None),
        # It folds beyond the picture's corner, at 1.05, but what it shows ends at two thirds of that.
        ("distort", (-0.3, 0.0), np.sqrt(1 / 0.9)),
        ("undistort", (-0.3, 0.0), None),
        ("undistort", (-0.5, 0.0), np.sqrt(1 / 1.5)),
    ],
)
def test_folds(direction, kappa, radius):
    fold = find_fold(LensChoice(kappa), direction, 24, 32)
    if radius is None:
        assert fold is None
    else:
        assert fold.radius == pytest.approx(radius, rel=1e-6)
        assert fold.pixels == pytest.approx(20 * radius, rel=1e-6)
        assert 0 < fold.share < 1
