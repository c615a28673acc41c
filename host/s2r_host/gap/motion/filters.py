"""Zero-phase low-pass filters, designed once; the tool filters thousands of columns per run.

Forward and backward second-order sections with odd extension at both ends, as ``scipy.signal.sosfiltfilt``
does it (Gustafsson, Determining the initial states in forward-backward filtering, 1996, discusses the ends).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.signal import butter, sosfilt_zi

from s2r_host._native import forward_backward


def zero_phase(x: np.ndarray, cuts_hz: tuple[float, ...], dt: float, order: int = 2) -> np.ndarray:
    """Butterworth low-passes in a row, forward and backward along the first axis.

    Args:
        x: Signal, shape (time,) or (time, k).
        cuts_hz: Corner frequencies [Hz], each below half the rate.
        dt: Sampling time [s].
        order: Order of each low-pass.
    """
    sections, start = _design(tuple(round(c, 9) for c in cuts_hz), round(dt, 12), order)
    x = np.asarray(x, dtype=float)
    pad = min(len(x) - 1, int(3 / (min(cuts_hz) * dt)))
    columns = np.ascontiguousarray(x.reshape(len(x), -1))
    return forward_backward(x=columns, sections=sections, start=start, pad=pad).reshape(x.shape)


@cache
def _design(cuts_hz: tuple[float, ...], dt: float, order: int) -> tuple[np.ndarray, np.ndarray]:
    sections = np.concatenate([np.asarray(butter(order, c, fs=1.0 / dt, output="sos")) for c in cuts_hz])
    return sections, np.ascontiguousarray(sosfilt_zi(sections))
