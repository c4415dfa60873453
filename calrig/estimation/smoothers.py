"""The paper's smoothing filters: moving average and Savitzky-Golay, as a controller runs them or centred.

Nirmal et al., Proc. SPIE 9912 (2016), doi:10.1117/12.2234255, section 4: a moving average of 10 samples and
Savitzky-Golay filters of 11 samples with orders 1, 2, 4 and 6. *Causal* is the value at the newest sample of
the window, which is what a controller has; *centred* is that in its middle, which only a record allows.

Samples are taken as evenly spaced, as firmware takes them: give one segment without a gap at a time. Where
the window is not full there is no value (NaN).
"""

from __future__ import annotations

import numpy as np

from calrig.estimation.angles import FloatArray

MOVING_AVERAGE_WINDOW = 10
SAVITZKY_GOLAY_WINDOW = 11
SAVITZKY_GOLAY_ORDERS = (1, 2, 4, 6)


def moving_average(
    x: FloatArray, window: int = MOVING_AVERAGE_WINDOW, *, centred: bool = False
) -> FloatArray:
    """Return the mean of the last `window` samples, or of those around each sample.

    An even window has no middle sample. Centred, it spans window + 1 samples, the outer two with half weight,
    and so neither leads nor lags.

    Args:
        x: (n,) evenly spaced samples.
        window: how many samples.
        centred: around each sample instead of up to it.

    Returns:
        (n,) with NaN where the window is not full.
    """
    if window < 1:
        raise ValueError(f"a window of {window} samples holds none")
    weights = np.full(window, 1.0 / window)
    if centred and window % 2 == 0:
        weights = np.convolve(weights, [0.5, 0.5])
    return _weighted(x, weights, len(weights) // 2 if centred else 0)


def savitzky_golay(
    x: FloatArray, order: int, window: int = SAVITZKY_GOLAY_WINDOW, *, centred: bool = False
) -> FloatArray:
    """Return a polynomial fitted to `window` samples, evaluated at the newest or in the middle.

    Savitzky & Golay, Anal. Chem. 36 (1964) 1627, through `scipy.signal.savgol_coeffs`. Centred, an odd order
    is the even one below it, and order 1 is the mean.

    Args:
        x: (n,) evenly spaced samples.
        order: of the polynomial, below `window`.
        window: how many samples, odd.
        centred: evaluated in the middle instead of at the newest sample.

    Returns:
        (n,) with NaN where the window is not full.

    Raises:
        ValueError: an order that the window cannot hold, an even window.
    """
    from scipy.signal import savgol_coeffs

    if window % 2 == 0 or not 0 <= order < window:
        raise ValueError(f"order {order} over {window} samples: the window must be odd and above the order")
    ahead = window // 2 if centred else 0
    weights = np.asarray(savgol_coeffs(window, order, pos=window - 1 - ahead), dtype=np.float64)
    return _weighted(x, weights, ahead)


def _weighted(x: FloatArray, weights: FloatArray, ahead: int) -> FloatArray:
    """Σ weights[j]·x[i + ahead − j]; NaN where that reaches beyond either end."""
    smoothed = np.full(len(x), np.nan)
    before = len(weights) - 1 - ahead
    if len(x) >= len(weights):
        # small numbers about the first sample: no rounding of a large angle
        smoothed[before : len(x) - ahead] = np.convolve(x - x[0], weights, mode="valid") + x[0]
    return smoothed
