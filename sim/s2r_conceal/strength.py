"""How strongly something shows: runs with it and without it, compared in repeatability floors.

    strength = max over joints and channels of rms(with − without) / floor, over the fit recording

``floor`` is rms(run 1 − run 2) / √2 of two noisy runs of the same motion without the effect; with and without
are noise-free.  Effort counts also where it is not recorded: an effect is no larger for want of it.  An effect that
shows only between sessions is measured on the held-out recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from s2r_conceal.cases import Case
from s2r_conceal.effects.table import EFFECTS, finish_log
from s2r_conceal.parameters import Scale
from s2r_conceal.plant import Active, Column, Trace, simulate
from s2r_conceal.streams import Purpose, words

COARSE_SUBSTEPS = 2  # 2 kHz while searching; the recordings themselves run at 10 kHz
EVERY = 5  # ticks between compared samples
DISTINCT_ENOUGH = 1.5  # floors left after parameter changes, for effects of three floors and more


@dataclass(frozen=True, eq=False)
class Floor:
    """Repeatability per joint: position [rad] and effort [N·m], shape (joints,)."""

    q: np.ndarray
    tau: np.ndarray


@dataclass(eq=False)
class Measured:
    """Outcome of calibration for one case, by position of the hidden effect in the case.

    Attributes:
        strength, strength_q: In floors, over all channels and in position alone.
        distinct: What of the strength wrong values could not also explain.
        distinct_q: What of that in position unknown gains could not either; only where effort is not recorded.
        off: Strength of each wrong value.
    """

    floor: Floor
    strength: dict[int, float] = field(default_factory=dict)
    strength_q: dict[int, float] = field(default_factory=dict)
    distinct: dict[int, float] = field(default_factory=dict)
    distinct_q: dict[int, float] = field(default_factory=dict)
    off: list[float] = field(default_factory=list)


@dataclass(eq=False)
class Sought:
    """One effect whose size is sought: where it stands, how strong it is to be, and what its run is compared with.

    Attributes:
        effects: List of the case in which it stands, at ``k``; its size is set there.
        beside: What is at work with and without it.
        span: Recording on which it is measured.
        without: The run without it.
    """

    case: Case
    effects: list[Active]
    k: int
    target: float
    beside: Sequence[Active]
    span: str
    floor: Floor
    without: Trace

    @property
    def active(self) -> Active:
        """As it is at present."""
        return self.effects[self.k]

    @property
    def scale(self) -> Scale:
        """Of its joint."""
        return self.case.scales[self.active.joint]

    def of_size(self, size: float) -> Active:
        """The effect in another size."""
        return replace(self.active, values=self.active.values | {EFFECTS[self.active.name].size: size})


def runs_of(sought: Sequence[Sought], actives: Sequence[Active]) -> list[Trace]:
    """The runs of effects in these sizes."""
    return runs(
        [s.case for s in sought],
        [[active, *s.beside] for s, active in zip(sought, actives, strict=True)],
        [s.span for s in sought],
    )


def runs(cases: Sequence[Case], effects: Sequence[Sequence[Active]], spans: Sequence[str]) -> list[Trace]:
    """Noise-free runs of every case with these effects."""
    columns = [c.run(s, active) for c, active, s in zip(cases, effects, spans, strict=True)]
    return _simulate(cases[0], columns) if columns else []


def floors_of(cases: Sequence[Case]) -> list[Floor]:
    """Repeatability of every case without its effects."""
    columns = [c.run("fit", (), words(Purpose.FLOOR_NOISE, c.seed, run)) for c in cases for run in (0, 1)]
    traces = _simulate(cases[0], columns)
    return [
        floor_between(case, one, two) for case, one, two in zip(cases, traces[::2], traces[1::2], strict=True)
    ]


def floor_between(case: Case, one: Trace, two: Trace) -> Floor:
    """Repeatability of two runs of one motion."""
    return Floor(
        rms(one.q - two.q) / np.sqrt(2),
        rms(getattr(one, case.effort) - getattr(two, case.effort)) / np.sqrt(2),
    )


def span_of(case: Case) -> str:
    """The recording on which hidden effects are measured."""
    between = any(EFFECTS[active.name].for_role is not None for active in case.effects)
    return "holdout" if between else "fit"


def signals(case: Case, trace: Trace, floor: Floor) -> np.ndarray:
    """Position and effort in floors, shape (channels, samples, joints)."""
    effort = getattr(trace, case.effort)[::EVERY] / floor.tau
    return np.stack([trace.q[::EVERY] / floor.q, effort]).astype(float)


def size_of(difference: np.ndarray) -> float:
    """Largest rms over channels and joints; infinite where the run blew up."""
    value = float(np.sqrt((difference**2).mean(axis=1)).max())
    return value if np.isfinite(value) else np.inf


def _simulate(case: Case, columns: list[Column]) -> list[Trace]:
    traces = simulate(case.rig, columns, COARSE_SUBSTEPS)
    return [finish_log(t, c.effects) for t, c in zip(traces, columns, strict=True)]


def rms(x: np.ndarray) -> np.ndarray:
    """Of every column."""
    return np.sqrt(np.mean(np.square(x, dtype=float), axis=0))
