"""What Table 1 says about itself, from its own numbers."""

import numpy as np
import pytest

from jaxlens.experiments import paper


def test_rmse_and_psnr_are_tied_by_a_peak_of_193_but_in_the_copied_row():
    for row in paper.TABLE_1:
        peak = paper.implied_peak(row.psnr, row.rmse)
        assert (peak == pytest.approx(193.0, abs=5e-5)) != row.copied


def test_the_copied_row_repeats_another_and_implies_an_rmse_of_its_own():
    (copied,) = (row for row in paper.TABLE_1 if row.copied)
    original = paper.row_of((1.0, 2.0))
    assert original is not None
    assert copied.kappa == (2, 3)
    assert (copied.rmse, copied.mae) == (original.rmse, original.mae)
    assert f"{paper.implied_rmse(copied.psnr):.3f}" == "61.742"


def test_psnr_less_snr_is_constant_so_snr_is_a_ratio_of_powers():
    offsets = [row.psnr - row.snr for row in paper.TABLE_1]
    np.testing.assert_allclose(offsets, 6.97548, rtol=0, atol=5.5e-6)  # six digits are printed
    assert paper.root_mean_square(float(np.mean(offsets))) == pytest.approx(86.4537, abs=1e-4)


def test_every_psnr_falls_down_the_table():
    psnr = [row.psnr for row in paper.TABLE_1]
    assert psnr == sorted(psnr, reverse=True)
    assert [row.kappa for row in paper.TABLE_1[:4]] == list(paper.FALLING)


def test_rows_are_found_by_their_lens():
    row = paper.row_of([3.0, 1.0])
    assert row is not None
    assert row.psnr == 8.839413
    assert paper.row_of([3.0, 1.5]) is None
    assert paper.row_of([3.0]) is None


def test_distance_is_the_root_of_the_mean_square():
    assert paper.distance([1.0, 5.0], [4.0, 1.0]) == pytest.approx(np.sqrt(12.5))
