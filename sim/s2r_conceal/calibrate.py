"""Setting strengths: how many repeatability floors an effect moves position or effort.

    strength = max over joints and channels of rms(with − without) / floor, over the fit recording

``floor`` is rms(run 1 − run 2) / √2 of two noisy runs of the same motion without the effect; with and without
are noise-free.  Effort counts only where it is recorded.  An effect that shows only between sessions is measured on
the held-out recording.  ``distinct`` is the same measure after everything that
small changes of the rigid-body and friction values could also explain has been projected out: an effect whose
``distinct`` is below one cannot be told from wrong parameters by anyone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from s2r_conceal.cases import Case, feed_forward_of_the_file, with_parameters_off
from s2r_conceal.effects.table import EFFECTS, finish_log
from s2r_conceal.parameters import Controller, Machine
from s2r_conceal.plant import Active, Column, Trace, simulate
from s2r_conceal.streams import Purpose, words

COARSE_SUBSTEPS = 2  # 2 kHz while searching; the recordings themselves run at 10 kHz
ITERATIONS = 7
EVERY = 5  # ticks between compared samples
DISTINCT_ENOUGH = 1.5  # floors left after parameter changes, for effects of three floors and more
REDRAWN = ("single", "unknown", "pairs", "triples", "masked")  # groups whose strengths have to come out
SIZE_OFFSETS = {"reduction": 0.11, "factor": -1.0}  # sizes whose "nothing" is not at zero


@dataclass(frozen=True, eq=False)
class Floor:
    """Repeatability per joint: position [rad] and effort [N·m], shape (joints,)."""

    q: np.ndarray
    tau: np.ndarray


@dataclass(eq=False)
class Measured:
    """Outcome of calibration for one case, by position of the effect in the case."""

    floor: Floor
    strength: dict[int, float]
    strength_q: dict[int, float]
    distinct: dict[int, float]


def usable(case: Case, measured: Measured) -> bool:
    """Whether the wanted strengths came out, and whether anyone could tell them from wrong parameters."""
    if case.group not in REDRAWN:
        return True
    for k, target in enumerate(case.targets):
        strength, distinct = measured.strength[k], measured.distinct[k]
        low_enough = strength < 1.5 * target or distinct < 2.0 * DISTINCT_ENOUGH
        if not np.isfinite(strength) or strength < 0.75 * target or not low_enough:
            return False
        if target >= 3.0 and distinct < 1.0:
            return False
    return True


def calibrate(cases: Sequence[Case]) -> list[Measured]:
    """Set the size of every effect (and of every wrong parameter) in place and say what came out."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        floors = _floors(cases)
        without = _runs(cases, [()] * len(cases), [span_of(c) for c in cases])
        measured = [Measured(f, {}, {}, {}) for f in floors]
        for k in range(max((len(_tuned(c)) for c in cases), default=0)):
            chosen = [i for i, c in enumerate(cases) if len(_tuned(c)) > k]
            _search(cases, chosen, k, floors, without)
            _distinct([(i, k) for i in chosen], cases, floors, without, measured)
            faint = [i for i in chosen if _lift(cases[i], k, measured[i].distinct[k])]
            _distinct([(i, k) for i in faint], cases, floors, without, measured)
        _search_parameters(cases, floors, without, measured)
    for case in cases:
        feed_forward_of_the_file(case)  # sizes are set now; what they move is the same to first order
    return measured


def _tuned(case: Case) -> list[Active]:
    return case.in_model or case.effects


def _column(case: Case, role: str, effects: Sequence[Active], noise: tuple[int, ...] | None = None) -> Column:
    shaped = [
        a if (change := EFFECTS[a.name].for_role) is None else replace(a, values=change(a.values, role))
        for a in effects
    ]
    return Column(
        machine=case.machine,
        controller=case.controller,
        motion=case.motions[role],
        sensing=case.sensing,
        heating=case.heating,
        effects=tuple(shaped),
        noise=noise,
    )


def _simulate(case: Case, columns: list[Column]) -> list[Trace]:
    traces = simulate(case.rig, columns, COARSE_SUBSTEPS)
    return [finish_log(t, c.effects) for t, c in zip(traces, columns, strict=True)]


def _floors(cases: Sequence[Case]) -> list[Floor]:
    columns = [
        _column(c, "fit", (), words(Purpose.FLOOR_NOISE, c.seed, run)) for c in cases for run in (0, 1)
    ]
    traces = _simulate(cases[0], columns)
    floors = []
    for case, one, two in zip(cases, traces[::2], traces[1::2], strict=True):
        tau = "tau_measured" if case.mask.measured_effort else "tau_commanded"
        floors.append(
            Floor(_rms(one.q - two.q) / np.sqrt(2), _rms(getattr(one, tau) - getattr(two, tau)) / np.sqrt(2))
        )
    return floors


def _rms(x: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(np.square(x, dtype=float), axis=0))


def _signals(case: Case, trace: Trace, floor: Floor) -> np.ndarray:
    """Position and effort in floors, shape (channels, samples, joints)."""
    tau = "tau_measured" if case.mask.measured_effort else "tau_commanded"
    parts = [trace.q[::EVERY] / floor.q]
    if not case.mask.no_effort or case.group == "masked":
        parts.append(getattr(trace, tau)[::EVERY] / floor.tau)
    return np.stack(parts).astype(float)


def span_of(case: Case) -> str:
    """The recording on which strength is measured."""
    between = any(EFFECTS[active.name].for_role is not None for active in case.effects)
    return "holdout" if between else "fit"


def _runs(cases: Sequence[Case], effects: Sequence[Sequence[Active]], spans: Sequence[str]) -> list[Trace]:
    """Noise-free runs of every case with these effects."""
    columns = [_column(c, s, active) for c, active, s in zip(cases, effects, spans, strict=True)]
    return _simulate(cases[0], columns) if columns else []


def _size(difference: np.ndarray) -> float:
    """Largest rms over channels and joints; infinite where the run blew up."""
    value = float(np.sqrt((difference**2).mean(axis=1)).max())
    return value if np.isfinite(value) else np.inf


def _with_size(case: Case, k: int, size: float) -> Active:
    active = _tuned(case)[k]
    return replace(active, values=active.values | {EFFECTS[active.name].size: size})


def _search(
    cases: Sequence[Case],
    chosen: list[int],
    k: int,
    floors: Sequence[Floor],
    without: Sequence[Trace],
) -> None:
    """Secant search of log strength over log size, all cases at once; the best size seen is kept."""
    searches = {i: _Secant(cases[i], k) for i in chosen}
    for _ in range(ITERATIONS):
        active = [i for i in chosen if not searches[i].done]
        trial = [[_with_size(cases[i], k, searches[i].size)] for i in active]
        spans = [span_of(cases[i]) for i in active]
        for i, trace in zip(active, _runs([cases[i] for i in active], trial, spans), strict=True):
            signals = _signals(cases[i], trace, floors[i]) - _signals(cases[i], without[i], floors[i])
            searches[i].tell(_size(signals))
    for i, search in searches.items():
        _tuned(cases[i])[k] = _with_size(cases[i], k, search.best)


class _Secant:
    """One-dimensional search on a monotone but unknown curve, inside plausible limits."""

    def __init__(self, case: Case, k: int) -> None:
        active = _tuned(case)[k]
        effect, scale = EFFECTS[active.name], case.scales[active.joint]
        self._low, self._high = effect.sizes(scale, active.values)
        self._shift = SIZE_OFFSETS.get(effect.size, 0.0)
        self._target = np.log(case.targets[k])
        self._x = np.log(active.values[effect.size] + self._shift)
        self._bounds = (np.log(self._low + self._shift), np.log(self._high + self._shift))
        self._under, self._over = self._bounds
        self._seen: list[tuple[float, float]] = []
        self.best, self._miss, self.done = active.values[effect.size], np.inf, False

    @property
    def size(self) -> float:
        """The next size to try."""
        return float(np.exp(self._x) - self._shift)

    def tell(self, strength: float) -> None:
        """Strength measured at ``size``; moves on to the next size."""
        y = np.log(max(strength, 1e-6)) if np.isfinite(strength) else 12.0
        self._seen.append((self._x, y))
        miss = abs(y - self._target)
        if miss < self._miss:
            self._miss, self.best = miss, self.size
        self.done = miss < 0.07
        if y < self._target:
            self._under = max(self._under, self._x)
        else:
            self._over = min(self._over, self._x)
        self._x = self._next(y)

    def _next(self, y: float) -> float:
        slope = 1.0
        if len(self._seen) > 1:
            (x0, y0), (x1, y1) = self._seen[-2:]
            slope = (y1 - y0) / (x1 - x0) if abs(x1 - x0) > 1e-9 else 1.0
        step = (self._target - y) / np.clip(slope, 0.25, 4.0)
        x = self._x + float(np.clip(step, -3.0, 3.0))
        if not self._under < x < self._over and self._under < self._over:
            x = 0.5 * (self._under + self._over)
        return float(np.clip(x, *self._bounds))


def _lift(case: Case, k: int, distinct: float) -> bool:
    """Enlarge an effect that parameter changes nearly explain, where the plausible range allows it."""
    if case.targets[k] < 3.0 or not 1e-3 < distinct < DISTINCT_ENOUGH:
        return False
    active = _tuned(case)[k]
    effect = EFFECTS[active.name]
    _, high = effect.sizes(case.scales[active.joint], active.values)
    shift = SIZE_OFFSETS.get(effect.size, 0.0)
    size = (active.values[effect.size] + shift) * 1.15 * DISTINCT_ENOUGH / distinct - shift
    _tuned(case)[k] = _with_size(case, k, min(size, high))
    return True


# -- what wrong parameters could also explain ---------------------------------------------------------


def _variations(case: Case, joint: int, name: str) -> list[Machine]:
    """Machines that differ a little in one value each; values the effect itself stands for are left out."""
    m, found = case.machine, []
    length = float(np.linalg.norm(m.com[joint])) or 0.1
    for axis in (0, 2) if case.rig.joints < 3 else (0, 1, 2):
        com = m.com.copy()
        com[joint, axis] += 0.01 * length
        found.append(replace(m, com=com))
    for field, factor in (("mass", 0.01), ("inertia", 0.03), ("armature", 0.03)):
        value = getattr(m, field).copy()
        value[joint] = value[joint] * (1.0 + factor)
        found.append(replace(m, **{field: value}))
    for field, own in (("viscous", "viscous_friction"), ("coulomb", "coulomb_friction")):
        value = getattr(m, field).copy()
        if name != own and value[joint] > 0.0:
            value[joint] *= 1.05
            found.append(replace(m, **{field: value}))
    return found


PARAMETER_LIKE = ("payload", "armature", "effort_scale", "gravity_tilt", "encoder_offset")


def _distinct(
    chosen: list[tuple[int, int]],
    cases: Sequence[Case],
    floors: Sequence[Floor],
    without: Sequence[Trace],
    measured: list[Measured],
) -> None:
    """Fill strength, its position part and the part no parameter change explains."""
    varied, owners = [], []
    for i, k in chosen:
        active = _tuned(cases[i])[k]
        for machine in _variations(cases[i], active.joint, active.name):
            varied.append(replace(cases[i], machine=machine))
            owners.append(i)
    spans = [span_of(cases[i]) for i, _ in chosen]
    changed = _runs([cases[i] for i, _ in chosen], [[_tuned(cases[i])[k]] for i, k in chosen], spans)
    sensitivities = _runs(varied, [()] * len(varied), [span_of(c) for c in varied])
    for (i, k), trace in zip(chosen, changed, strict=True):
        base = _signals(cases[i], without[i], floors[i])
        difference = _signals(cases[i], trace, floors[i]) - base
        basis = [
            _signals(cases[i], t, floors[i]) - base
            for t, owner in zip(sensitivities, owners, strict=True)
            if owner == i
        ]
        q_part = ((trace.q - without[i].q)[::EVERY] / floors[i].q)[None].astype(float)
        measured[i].strength[k] = _size(difference)
        measured[i].strength_q[k] = _size(q_part)
        name = _tuned(cases[i])[k].name
        alone = name in PARAMETER_LIKE
        measured[i].distinct[k] = _size(difference if alone else _left_over(difference, basis))


def _left_over(difference: np.ndarray, basis: list[np.ndarray]) -> np.ndarray:
    if not np.isfinite(difference).all():
        return difference
    A = np.stack([b.ravel() for b in basis if np.isfinite(b).all()], axis=1)
    A = A / np.maximum(np.linalg.norm(A, axis=0), 1e-12)
    solution, *_ = np.linalg.lstsq(A, difference.ravel(), rcond=1e-6)
    return difference - (A @ solution).reshape(difference.shape)


# -- decoys: a wrong value in the model file ----------------------------------------------------------


def _search_parameters(
    cases: Sequence[Case],
    floors: Sequence[Floor],
    without: Sequence[Trace],
    measured: list[Measured],
) -> None:
    """Scale ``relative`` of every wrong parameter until the model's prediction misses by the target."""
    chosen = [i for i, c in enumerate(cases) if c.parameters_off]
    for left in (4, 3, 2, 1, 0):  # values to try after this one; the last run says what the last one does
        machines: list[tuple[Machine, Controller]] = [with_parameters_off(cases[i]) for i in chosen]
        trial = [
            replace(cases[i], machine=m, controller=c) for i, (m, c) in zip(chosen, machines, strict=True)
        ]
        for i, trace in zip(chosen, _runs(trial, [()] * len(trial), ["fit"] * len(trial)), strict=True):
            difference = _signals(cases[i], trace, floors[i]) - _signals(cases[i], without[i], floors[i])
            strength = max(_size(difference), 1e-9)
            measured[i].strength[0] = strength
            entry = cases[i].parameters_off[0]
            wanted = float(entry["relative"]) * np.clip(cases[i].targets[0] / strength, 0.2, 5.0)
            if left and abs(np.log(cases[i].targets[0] / strength)) > 0.07:
                entry["relative"] = float(np.clip(wanted, -0.6, 1.5))
