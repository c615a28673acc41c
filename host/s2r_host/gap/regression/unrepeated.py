"""Forces that come anew in every run: a second run of one motion differs by them, and so they pass for noise.

Noise of sensors and drives forgets itself within tenths of a second. What still knows itself half a second later, and
is no small part of the effort, is something that acts, only not the same way twice (a slipping belt, a hand). So is
what swings at one frequency: it begins at another moment in every run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import COMPARE_CUT_HZ, Session, lowpass
from s2r_host.gap.regression.rows import residual
from s2r_host.gap.regression.second_run import find_partner

SLOW_HZ = 5.0
LATER_S = (0.25, 0.5)
KNOWN = (
    0.5,
    0.25,
)  # correlation of the difference with itself so much later; clean recordings reach 0.35 and 0.17
LEAST_SHARE = 0.025  # of the effort
LINE_HZ, LINE_BINS, LINE_SHARE = 0.5, 3, 0.5  # lowest line; its half width in 1/T; of the power, to be one
MARGIN_S, LEAST_S = 0.5, 8.0


@dataclass(frozen=True)
class Wander:
    """A force of one joint that no second run repeats.

    Attributes:
        joint: Index.
        size, effort: Its rms, and that of the effort [N·m or N].
        line_Hz: Where it swings at one frequency.
    """

    joint: int
    size: float
    effort: float
    line_Hz: float | None = None

    def words(self, name: str, unit: str) -> str:
        """For the reasons of the answer."""
        how = "slowly" if self.line_Hz is None else f"at {self.line_Hz:.2f} Hz"
        return (
            f"two runs of one motion differ at '{name}' by {self.size:.3g} {unit} ({self.size / self.effort:.0%} of "
            f"the effort), {how}: a force that no second run repeats, and no noise"
        )


def wandering(model: RigidModel, joint: int, fit: list[Session], repeats: list[Session]) -> Wander | None:
    """What differs slowly, or at one frequency, between two runs of one motion on a joint, in every pair of them.

    Returns:
        None for mere noise.
    """
    found = []
    for again in repeats:
        first = find_partner(again, fit)
        if first is None or not (first.has_u[joint] and again.has_u[joint]):
            continue
        n, dt = min(len(first.t), len(again.t)), first.dt
        if n * dt < LEAST_S:
            return None
        difference = (residual(model, first, joint)[:n] - residual(model, again, joint)[:n]) / np.sqrt(2.0)
        margin = int(MARGIN_S / dt)
        x = lowpass(difference, SLOW_HZ, dt)[margin:-margin]
        effort = float(np.std(first.u[:, joint]))
        if _knows_itself(x - x.mean(), dt) and np.std(x) >= LEAST_SHARE * effort:
            found.append(Wander(joint, float(np.std(x)), effort))
            continue
        line_Hz, size = _line(lowpass(difference, COMPARE_CUT_HZ, dt)[margin:-margin], dt)
        if size < LEAST_SHARE * effort:
            return None
        found.append(Wander(joint, size, effort, line_Hz))
    return max(found, key=lambda w: w.size) if found else None


def _line(x: np.ndarray, dt: float) -> tuple[float, float]:
    """Frequency [Hz] and rms of the line that is most of a signal; rms 0 where none is."""
    power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)))) ** 2
    f = np.fft.rfftfreq(len(x), dt)
    power[f < LINE_HZ] = 0.0
    top = int(np.argmax(power))
    share = float(np.sum(power[max(0, top - LINE_BINS) : top + LINE_BINS + 1]) / max(np.sum(power), 1e-30))
    return float(f[top]), float(np.std(x)) * np.sqrt(share) if share > LINE_SHARE else 0.0


def _knows_itself(x: np.ndarray, dt: float) -> bool:
    power = float(np.mean(x**2))
    later = [max(1, round(s / dt)) for s in LATER_S]
    return power > 0.0 and all(
        float(np.mean(x[k:] * x[:-k])) > least * power for k, least in zip(later, KNOWN, strict=True)
    )
