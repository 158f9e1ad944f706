"""Contour lines: of a distance they are circles."""

import numpy as np
import pytest

from jaxlens.figures.contours import contour_lines
from jaxlens.surfaces import DepthMap, geodesic_distance

HEIGHT, WIDTH = 24, 31
SOURCE = (12.3, 10.2)


def test_curves_of_equal_distance_are_circles(x64):
    mask = np.broadcast_to(np.arange(WIDTH) < 29, (HEIGHT, WIDTH))
    distance = geodesic_distance(DepthMap(np.zeros((HEIGHT, WIDTH)), mask=mask), source=SOURCE)
    inner, outer, none = contour_lines(distance, [6.0, 17.0, 100.0])
    assert len(inner) == 1
    np.testing.assert_array_equal(inner[0][0], inner[0][-1])
    np.testing.assert_allclose(np.hypot(*(inner[0] - SOURCE).T), 6, atol=0.03)
    assert max(curve[:, 0].max() for curve in outer) <= 28
    assert none == []
    with pytest.raises(ValueError, match="levels must be finite"):
        contour_lines(distance, [np.nan])
    with pytest.raises(ValueError, match="2×2"):
        contour_lines(distance[0], [1.0])


def test_lines_on_a_grid_that_is_not_of_pixels():
    x, y = np.linspace(0, 1, 5), 10 * np.arange(4)
    ((line,),) = contour_lines(np.broadcast_to(x, (4, 5)), 0.6, x=x, y=y)
    np.testing.assert_allclose(np.sort(line[:, 1]), y)
    np.testing.assert_allclose(line[:, 0], 0.6)
