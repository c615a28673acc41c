"""Positions of recordings set against each other, by what their efforts show of one place.

A joint that is followed by what pushes it is known to a millimetre of where it was taken hold of, and every recording
counts its position from another place then (``position_sigma`` of the side file). What depends on the place, notches or
a friction that changes along the way, is out of step with itself, and no effect of the catalogue explains that.

The shifts are those at which one function of the place explains all efforts best, each held by its declared accuracy:
point registration with a smooth curve instead of a surface. They are made only where such a function explains nearly
all there is, and far more of it than without them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session, make_session

ROWS = 60  # of a recording that are enough to see its curve
TOGETHER_S = 0.1  # errors of an effort go together for about so long
ACCURACY = 0.05  # of an effort, where its side file does not say
KNOT = 1.2  # deviations of a position between two knots: finer curves could not be set against each other
MOST_KNOTS = 60
FARTHEST = 3.0  # deviations: a recording that asks for more is not the place it was taken for
STEPS, ROUNDS = 25, 6
FINER, FINE = 2, 0.3  # from this round on steps of a tenth of a deviation, so far to either side
SETTLED = 0.02  # deviations
LEAST_GAIN = 25.0  # of the misfit, in squared standard deviations: five of them
LEAST_SHARE = 0.5  # of what a function of the place had left over without shifts
PLACE_SHARE = 0.3  # of the misfit without such a function that may be left over with it
RIDGE = 1e-6  # of the mean curvature: knots where nothing was recorded stay put
# Functions of the place: one alike both ways, and one that changes its sign with the motion.
FORMS = ("force", "friction")


@dataclass(frozen=True, eq=False)
class _Curve:
    """Some rows of one recording of a joint: position, speed, effort beyond the model, weight, each (rows,).

    Attributes:
        sign: Direction of most of the motion.
        u: Effort as recorded, for a scale that may be off by ``gain`` as a share, (rows,).
    """

    q: np.ndarray
    v: np.ndarray
    rest: np.ndarray
    weight: np.ndarray
    sign: float
    u: np.ndarray
    gain: float


def registered(model: RigidModel, sessions: Sequence[Session], notes: list[str]) -> list[Session]:
    """The sessions with shifted positions where that makes them agree; what was shifted goes to ``notes``.

    Args:
        model: The nominal model.
        sessions: All recordings; those without ``position_sigma`` of a joint take no part in that joint's shifts.
        notes: For people.
    """
    found = list(sessions)
    for j, joint in enumerate(model.joints):
        own = [k for k, s in enumerate(found) if joint in s.rec.position_sigma and s.has_u[j]]
        if len(own) < 2:
            continue
        sigma = np.array([found[k].rec.position_sigma[joint] for k in own])
        shifts = shifts_of([_curve(found[k], j, joint) for k in own], sigma)
        if shifts is None:
            continue
        for k, shift in zip(own, shifts, strict=True):
            rec = found[k].rec
            table = {**rec.channels["q"], joint: rec.channels["q"][joint] + shift}
            moved = replace(rec, channels={**rec.channels, "q": table})
            found[k] = make_session(model, moved, found[k].index)
        told = ", ".join(
            f"{found[k].rec.name} {shift:+.3g}" for k, shift in zip(own, shifts, strict=True) if shift
        )
        notes.append(
            f"positions of {joint} agree with one another once shifted [{model.unit(joint)}]: {told} "
            f"(stated accuracy {np.median(sigma):.2g})"
        )
    return found


def shifts_of(curves: Sequence[_Curve], sigma: np.ndarray) -> np.ndarray | None:
    """Shift of each recording's position, (recordings,); None where none is called for.

    Args:
        curves: Of one joint.
        sigma: Standard deviation of each recording's position, (recordings,).
    """
    plain = _Laws(curves, sigma, None).misfit()
    tried = [_Laws(curves, sigma, form).registered() for form in FORMS]
    shifts, before, after = min(tried, key=lambda one: one[2])
    clear = before - after > LEAST_GAIN and after < LEAST_SHARE * before and after < PLACE_SHARE * plain
    near = np.all(np.abs(shifts) < FARTHEST * sigma)
    return shifts if clear and near else None


def _curve(s: Session, j: int, joint: str) -> _Curve:
    rows = np.unique(np.linspace(0, len(s.t) - 1, ROWS).astype(int))
    u = s.u[:, j]
    accuracy = s.rec.effort_sigma.get(joint) or ACCURACY * float(np.std(u)) or 1.0
    independent = max(s.t[-1] / TOGETHER_S, 3.0)
    weight = np.full(len(rows), np.sqrt(independent / len(rows)) / accuracy)
    sign = 1.0 if float(np.median(s.v[:, j])) >= 0.0 else -1.0
    rest = (u - s.load[:, j])[rows]
    gain = s.rec.effort_gain_sigma.get(joint, 0.0)
    return _Curve(s.q[rows, j], s.v[rows, j], rest, weight, sign, u[rows], gain)


class _Laws:
    """Least squares of an effort that is friction, damping, and one function of the place alike in all recordings.

    The misfit is that of the rows, in squared standard deviations, with the shifts, the recordings' scales and the
    function's bends held by how far each of them may go.
    """

    def __init__(self, curves: Sequence[_Curve], sigma: np.ndarray, form: str | None) -> None:
        """Args: the recordings; how far their positions may be off; one of ``FORMS``, None for no such function."""
        self._curves, self._sigma, self._form = curves, sigma, form
        q = np.concatenate([one.q for one in curves])
        low, high = float(q.min() - FARTHEST * sigma.max()), float(q.max() + FARTHEST * sigma.max())
        step = max(KNOT * float(np.median(sigma)), (high - low) / MOST_KNOTS)
        self._knots = np.arange(low - step, high + 2.0 * step, step)
        self._size = 0 if form is None else len(self._knots) + 2
        turned = np.concatenate([one.sign * one.rest for one in curves])
        self._bend = float(np.ptp(turned)) or 1.0  # the whole of what there is, from one knot to the next
        self._prior = self._held()

    def misfit(self) -> float:
        """Of the recordings as they are."""
        still = np.zeros(len(self._curves))
        return self._of([self._normal(k, 0.0) for k in range(len(still))], still)

    def registered(self) -> tuple[np.ndarray, float, float]:
        """The shifts with the least misfit, one recording after the other; the misfit before and after."""
        shifts = np.zeros(len(self._curves))
        parts = [self._normal(k, 0.0) for k in range(len(shifts))]
        still = least = self._of(parts, shifts)
        for round_ in range(ROUNDS):
            before = shifts.copy()
            for k, sigma in enumerate(self._sigma):
                if round_ < FINER:
                    tried = np.linspace(-FARTHEST, FARTHEST, STEPS) * sigma
                else:
                    tried = shifts[k] + np.linspace(-FINE, FINE, 7) * sigma
                for shift in np.clip(tried, -FARTHEST * sigma, FARTHEST * sigma):
                    others = [*parts[:k], self._normal(k, float(shift)), *parts[k + 1 :]]
                    moved = np.where(np.arange(len(shifts)) == k, shift, shifts)
                    misfit = self._of(others, moved)
                    if misfit < least:
                        least, shifts, parts = misfit, moved, others
            if round_ >= FINER and np.all(np.abs(shifts - before) < SETTLED * self._sigma):
                break
        return shifts, still, least

    def _normal(self, k: int, shift: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Normal matrix (n, n), right side (n,) and squared efforts of one recording, shifted."""
        one = self._curves[k]
        gains = np.zeros((len(one.q), len(self._curves)))
        gains[:, k] = one.gain * one.u
        ones = np.ones((len(one.q), 1))
        columns = [one.v[:, None], ones, one.sign * ones, gains]
        if self._form is not None:
            place = _splines(one.q + shift, self._knots)
            columns.append(place if self._form == "force" else one.sign * place)
        A = np.hstack(columns) * one.weight[:, None]
        y = one.rest * one.weight
        return A.T @ A, A.T @ y, float(y @ y)

    def _held(self) -> np.ndarray:
        """What the prior adds to the normal matrix, (n, n)."""
        first = 3 + len(self._curves)
        held = np.zeros((first + self._size, first + self._size))
        held[range(3, first), range(3, first)] = 1.0
        if self._size:
            bends = np.diff(np.eye(self._size), 2, axis=0) / self._bend
            held[first:, first:] = bends.T @ bends
        return held

    def _of(self, parts: Sequence[tuple[np.ndarray, np.ndarray, float]], shifts: np.ndarray) -> float:
        N = self._prior + sum(part[0] for part in parts)
        N = N + RIDGE * float(np.mean(np.diag(N))) * np.eye(len(N))
        b = np.sum([part[1] for part in parts], axis=0)
        squares = sum(part[2] for part in parts)
        return float(squares - b @ np.linalg.solve(N, b) + np.sum((shifts / self._sigma) ** 2))


def _splines(q: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Cubic B-splines at positions (rows,), shape (rows, knots + 2)."""
    t = np.concatenate([knots[:1].repeat(3), knots, knots[-1:].repeat(3)])
    return BSpline.design_matrix(np.clip(q, knots[0], np.nextafter(knots[-1], knots[0])), t, 3).toarray()
