"""Noise that encoders and effort sensors alone put into a residual: a measure for guesses of the noise floor.

What a generic correction cannot predict is noise, or an effect that is finer than the correction: cogging with more
periods than it has position bins, stick-slip. The channels themselves tell the two apart: their noise is white at
least, so its level above the motion's band holds inside it.

The other way round, a correction that holds the acceleration takes part of that acceleration's own noise away in a slow
motion, where less inertia costs little: what it leaves over is less than what the channels show.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import welch

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session, lowpass
from s2r_host.gap.recordings.recording import Recording

_MIDDLE, _UPPER = 0.33, 0.66  # of the band: above the second a recording holds little but noise
_FLAT = 2.0  # power of the middle third over that of the upper one, up to which it is noise for sure
_HEARD = 1.5  # times the noise of its channel, from which on an acceleration is more than that
_CLEAR = 10.0  # times the power of that noise, from which on a frequency of the motion is none
_LOAD_SHARE = 0.005  # filters and rounding of the model's own effort
# Integrals of x⁰, x² and x⁴ over the squared gain 1 / (1 + x⁴)² of a second-order Butterworth filter run both ways.
_GAIN, _GAIN_SLOPE, _GAIN_BEND = (
    3.0 * np.pi * np.sqrt(2.0) / 16.0,
    np.pi * np.sqrt(2.0) / 16.0,
    np.pi * np.sqrt(2.0) / 16.0,
)


def known_noise(model: RigidModel, s: Session, j: int) -> float:
    """Standard deviation of a joint's residual, below its cut, by the noise of the channels [N·m or N].

    Effort noise adds its power density times the cut; see :func:`motion_noise` for the acceleration. Zero where no
    channel shows any.
    """
    effort = s.rec.get("tau", model.joints[j])
    variance = motion_noise(model, s, j) ** 2
    if effort is not None:
        variance += _GAIN * _white(s.rec, effort) * float(s.cut[j])
    if variance == 0.0:
        return 0.0
    return float(np.sqrt(variance + (_LOAD_SHARE**2) * np.mean(s.load[:, j] ** 2)))


def motion_noise(model: RigidModel, s: Session, j: int, *, sure: bool = False) -> float:
    """Standard deviation of a joint's inertial effort, below its cut, by the noise of its position or speed.

    The acceleration comes from one of them, twice or once differentiated: noise of power density S makes (2π)⁴ S f⁵ or
    (2π)² S f³ of it up to the cut f, but for a factor of the filter. ``sure``: only of a channel whose spectrum is flat
    above the motion; what still falls there is motion.

    Returns:
        Effort [N·m or N]; 0 where no channel shows any noise.
    """
    w = 2.0 * np.pi * float(s.cut[j])
    gain = (_GAIN_SLOPE * w**2 if s.by_speed[j] else _GAIN_BEND * w**4) * float(s.cut[j])
    return float(np.median(np.abs(s.mass[:, j])) * np.sqrt(_motion_white(model, s, j, flat=sure) * gain))


def accelerates(model: RigidModel, s: Session, j: int) -> bool:
    """Is a joint's acceleration, below its cut, more than the noise of the channel that it comes from?

    In a loop that answers to that noise the effort follows it, and with the noise of both an inertia would be told.
    """
    key = ("accelerates", j, float(s.cut[j]))  # asked for at every step of a search
    if key not in s.cache:
        seen = float(np.std(lowpass(s.a[:, j], float(s.cut[j]), s.dt)) * np.median(np.abs(s.mass[:, j])))
        s.cache[key] = seen > _HEARD * motion_noise(model, s, j, sure=True)
    return s.cache[key]


def clear_up_to(model: RigidModel, s: Session, j: int) -> float:
    """Highest frequency at which a joint's acceleration stands clear of the noise of its channel [Hz]."""
    key = ("clear up to", j, float(s.cut[j]))
    if key not in s.cache:
        moved = lowpass(s.a[:, j], float(s.cut[j]), s.dt) * float(np.median(np.abs(s.mass[:, j])))
        f, power = welch(moved, 1.0 / s.dt, nperseg=min(512, len(moved)))
        clear = f[(power > _CLEAR * motion_density(model, s, j, f, flat=False)) & (f <= s.cut[j])]
        s.cache[key] = float(max([f[1], *clear]))
    return s.cache[key]


def motion_density(model: RigidModel, s: Session, j: int, f: np.ndarray, *, flat: bool = True) -> np.ndarray:
    """Power density of a joint's inertial effort by the noise of its position or speed.

    Args:
        model: The nominal model.
        s: The recording.
        j: The joint.
        f: Frequencies [Hz], shape (frequency,).
        flat: Of flat spectra alone: what still falls above the motion may be motion.

    Returns:
        One-sided density below the cut [N²·m²/Hz or N²/Hz], shape (frequency,); zero where no channel shows noise.
    """
    w, cut = 2.0 * np.pi * f, float(s.cut[j])
    white = _motion_white(model, s, j, flat=flat)
    density = white * w ** (2 if s.by_speed[j] else 4) / (1.0 + (f / cut) ** 4) ** 2
    return density * float(np.median(np.abs(s.mass[:, j]))) ** 2


def _motion_white(model: RigidModel, s: Session, j: int, *, flat: bool) -> float:
    """One-sided power density of the noise of the channel that the acceleration comes from [unit²/Hz]."""
    x = s.rec.get("dq" if s.by_speed[j] else "q", model.joints[j])
    return 0.0 if x is None else _white(s.rec, x, flat=flat)


def _white(rec: Recording, x: np.ndarray, *, flat: bool = False) -> float:
    """One-sided power density of a channel's white noise, from the upper third of its band [unit²/Hz].

    ``flat``: zero where the spectrum still falls there.
    """
    if len(x) < 64:
        return 0.0
    x = _evenly(rec, x)
    length = int(np.clip(len(x) // 6, 64, 512))
    f, power = welch(x - np.mean(x), 1.0 / rec.dt, nperseg=length)
    upper = float(np.median(power[f > _UPPER * f[-1]]))
    middle = float(np.median(power[(f > _MIDDLE * f[-1]) & (f <= _UPPER * f[-1])]))
    if flat and middle > _FLAT * upper:
        return 0.0
    # Half overlapping Hann windows: the mean of n of them has 36 n² / (19 n - 1) degrees of freedom (Welch 1967), and
    # the median of a chi-square lies so far below its mean (Wilson and Hilferty 1931).
    n = max(2 * len(x) // length - 1, 1)
    freedom = 36.0 * n * n / (19.0 * n - 1.0)
    return upper / (1.0 - 2.0 / (9.0 * freedom)) ** 3


def _evenly(rec: Recording, x: np.ndarray) -> np.ndarray:
    """A channel with its lost rows filled in: motion across them, taken for one step, would be white noise.

    Rows that were not lost stay as they are, whatever their stamps: interpolated ones have less noise.
    """
    step = np.maximum(np.round(np.diff(rec.t) / rec.dt), 1.0)
    row = np.concatenate([[0.0], np.cumsum(step)])
    return x if row[-1] < len(x) else PchipInterpolator(row, x)(np.arange(row[-1] + 1.0))
