"""What a recording hides or distorts besides the physics: rates, encoders, missing channels, clocks."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np

LOG_RATE_HZ = 250.0
ARM_RATES_HZ = (100.0, 250.0, 500.0, 1000.0)
NO_LAW_SHARE = 0.3


@dataclass(frozen=True)
class Mask:
    """How a recording was taken; the defaults mask nothing.

    Attributes:
        high_gain: Stiff PID with integral action: feedback hides the mismatch in position.
        no_effort: Neither effort nor controller gains are recorded.
        measured_effort: ``tau`` is what the drive reports instead of what the controller asked for.
        rate_hz: Rows per second.
        coarse_encoder: Encoder step times ten to thirty, also in the loop.
        jitter_s: Rows are taken up to this much off the even grid; the stamps tell it truly.
        dropped: Fraction of rows lost, in bursts.
        clock_ppm: The recorder's clock runs fast by this many parts per million, all channels alike.
        t0_s: First time stamp [s].
        nominal_error: Largest relative error of the values in the model file.
        with_temperature: Whether motor temperature is recorded.
        no_law: Controller gains are not recorded; the effort drives the simulation.
    """

    high_gain: bool = False
    no_effort: bool = False
    measured_effort: bool = False
    rate_hz: float = LOG_RATE_HZ
    coarse_encoder: bool = False
    jitter_s: float = 0.0
    dropped: float = 0.0
    clock_ppm: float = 0.0
    t0_s: float = 0.0
    nominal_error: float = 0.0
    with_temperature: bool = True
    no_law: bool = False

    def names(self) -> list[str]:
        """The masks that are on, for the answer file."""
        on = {
            k: v for k, v in asdict(self).items() if k not in ("t0_s", "measured_effort", "with_temperature")
        }
        on["rate_hz"] = self.rate_hz < 100.0
        on["nominal_error"] = self.nominal_error > 0.011
        return sorted(name for name, value in on.items() if value)


KINDS = ("high_gain", "rate", "coarse_encoder", "jitter", "dropped", "clock", "nominals")


def draw_mask(rng: np.random.Generator, kinds: tuple[str, ...]) -> Mask:
    """A mask of these kinds, with drawn strengths."""
    return Mask(
        high_gain="high_gain" in kinds,
        measured_effort=bool(rng.random() < 0.4),
        rate_hz=float(rng.choice([10.0, 20.0, 25.0, 50.0])) if "rate" in kinds else LOG_RATE_HZ,
        coarse_encoder="coarse_encoder" in kinds,
        jitter_s=0.4 / LOG_RATE_HZ if "jitter" in kinds else 0.0,
        dropped=rng.uniform(0.01, 0.08) if "dropped" in kinds else 0.0,
        clock_ppm=rng.uniform(-200.0, 200.0) if "clock" in kinds else 0.0,
        t0_s=round(float(rng.uniform(0.0, 40.0)), 3) if rng.random() < 0.3 else 0.0,
        nominal_error=0.05 if "nominals" in kinds else 0.01,
        with_temperature=bool(rng.random() < 0.7),
    )


def for_arm(rng: np.random.Generator, mask: Mask) -> Mask:
    """Arms are logged at many rates, and often by whoever does not know the gains."""
    rate_hz = mask.rate_hz if mask.rate_hz < 100.0 else float(rng.choice(ARM_RATES_HZ))
    jitter_s = 0.4 / rate_hz if mask.jitter_s > 0.0 else 0.0
    # Where there is no effort either, nothing would drive the simulation.
    no_law = bool(rng.random() < NO_LAW_SHARE) and not mask.no_effort
    return replace(mask, rate_hz=rate_hz, jitter_s=jitter_s, no_law=no_law)


def rows(mask: Mask, ticks: int, rate_hz: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Which control ticks are recorded, and their time stamps [s], both shape (rows,)."""
    step = rate_hz / mask.rate_hz
    grid = np.arange(0.0, ticks - 1.0, step)
    wander = rng.uniform(-mask.jitter_s, mask.jitter_s, grid.size) * rate_hz
    chosen = np.unique(np.clip(np.rint(grid + wander), 0, ticks - 1).astype(int))
    if mask.dropped > 0.0:
        chosen = chosen[_kept(chosen.size, mask.dropped, rng)]
    t = chosen / rate_hz * (1.0 + 1e-6 * mask.clock_ppm) + mask.t0_s
    return chosen, t


def _kept(count: int, dropped: float, rng: np.random.Generator) -> np.ndarray:
    """Everything but bursts of one to eight rows; the first row always stays."""
    kept = np.ones(count, bool)
    while kept.mean() > 1.0 - dropped:
        begin = int(rng.integers(1, count))
        kept[begin : begin + int(rng.integers(1, 9))] = False
    return kept
