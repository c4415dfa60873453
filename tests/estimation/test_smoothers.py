"""The smoothers against plain fits of every window, and what they do to a straight line."""

from __future__ import annotations

import numpy as np
import pytest

from calrig.estimation.smoothers import SAVITZKY_GOLAY_ORDERS, moving_average, savitzky_golay

NOISE = np.random.default_rng(0).normal(40.0, 0.3, 60)


def test_moving_average_is_the_mean_of_the_last_ten():
    smoothed = moving_average(NOISE)

    assert np.isnan(smoothed[:9]).all()
    np.testing.assert_allclose(smoothed[9:], [NOISE[i - 9 : i + 1].mean() for i in range(9, 60)], rtol=1e-13)


@pytest.mark.parametrize("order", SAVITZKY_GOLAY_ORDERS)
@pytest.mark.parametrize(("centred", "at"), [(False, 10), (True, 5)])
def test_savitzky_golay_is_a_polynomial_through_each_eleven(order, centred, at):
    smoothed = savitzky_golay(NOISE, order, centred=centred)

    x = np.arange(11.0) - at
    fitted = [np.polynomial.Polynomial.fit(x, NOISE[i : i + 11], order)(0.0) for i in range(50)]
    np.testing.assert_allclose(smoothed[at : at + 50], fitted, rtol=1e-10)
    assert np.isnan(smoothed[:at]).all()
    assert np.isnan(smoothed[at + 50 :]).all()


@pytest.mark.parametrize(
    ("smooth", "late_samples"),
    [
        (moving_average, 4.5),
        (lambda x: moving_average(x, centred=True), 0.0),
        (lambda x: savitzky_golay(x, 1), 0.0),
        (lambda x: savitzky_golay(x, 1, centred=True), 0.0),
    ],
)
def test_only_the_causal_moving_average_comes_late_on_a_straight_line(smooth, late_samples):
    line = 100.0 + 0.1 * np.arange(40.0)

    smoothed = smooth(line)

    known = np.isfinite(smoothed)
    np.testing.assert_allclose(smoothed[known], line[known] - 0.1 * late_samples, atol=1e-12)


def test_a_stretch_shorter_than_the_window_has_no_value():
    for smoothed in (moving_average(NOISE[:9]), savitzky_golay(NOISE[:10], 2), moving_average(NOISE[:0])):
        assert np.isnan(smoothed).all()


@pytest.mark.parametrize(("order", "window"), [(2, 10), (11, 11), (-1, 11)])
def test_a_window_that_cannot_hold_the_order_is_refused(order, window):
    with pytest.raises(ValueError, match=f"order {order} over {window} samples"):
        savitzky_golay(NOISE, order, window)


def test_a_moving_average_of_nothing_is_refused():
    with pytest.raises(ValueError, match="holds none"):
        moving_average(NOISE, 0)
