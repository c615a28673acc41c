"""Noise that encoders and effort sensors alone put into a residual: a measure for guesses of the noise floor.

What a generic correction cannot predict is noise, or an effect that is finer than the correction: cogging with more
periods than it has position bins, stick-slip. The channels themselves tell the two apart: their noise is white at
least, so its level above the motion's band holds inside it.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import welch

from s2r_host.gap.model import RigidModel
from s2r_host.gap.session import Session

_UPPER_THIRD = 0.66  # of the band: there a recording holds little but noise
_MEDIAN_OF_CHI2 = 0.7  # the median of a spectrum lies below its mean
_LOAD_SHARE = 0.005  # filters and rounding of the model's own effort


def known_noise(model: RigidModel, s: Session, j: int) -> float:
    """Standard deviation of a joint's residual, below its cut, by the noise of the channels [N·m or N].

    Effort noise of power density S adds S f up to the cut f; the acceleration comes from the better of position and
    velocity, twice or once differentiated: (2π)⁴ S f⁵/5 or (2π)² S f³/3, times the squared inertia. Zero where no
    channel shows any.
    """
    rec, name, cut = s.rec, model.joints[j], float(s.cut[j])
    effort, q, dq = (rec.get(kind, name) for kind in ("tau", "q", "dq"))
    variance = _white(effort, rec.dt) * cut if effort is not None else 0.0
    moved = []
    if q is not None:
        moved.append(_white(q, rec.dt) * (2.0 * np.pi) ** 4 * cut**5 / 5.0)
    if dq is not None:
        moved.append(_white(dq, rec.dt) * (2.0 * np.pi) ** 2 * cut**3 / 3.0)
    inertia = float(np.median(np.abs(s.mass[:, j])))
    variance += inertia**2 * min(moved, default=0.0)
    if variance == 0.0:
        return 0.0
    return float(np.sqrt(variance + (_LOAD_SHARE**2) * np.mean(s.load[:, j] ** 2)))


def _white(x: np.ndarray, dt: float) -> float:
    """One-sided power density of a channel's white noise, from the upper third of its band [unit²/Hz]."""
    if len(x) < 64:
        return 0.0
    f, power = welch(x - np.mean(x), 1.0 / dt, nperseg=int(np.clip(len(x) // 6, 64, 512)))
    return float(np.median(power[f > _UPPER_THIRD * f[-1]]) / _MEDIAN_OF_CHI2)
