"""A home pose for an arm: many postures with the hand before the base are solved for, and the best is kept."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from s2r_host.arm_import.home_asked import Gauge, Measured, place_of, turns
from s2r_host.arm_import.home_reach import Reach, Reached
from s2r_host.motion.arm_model import ArmModel
from s2r_protocol.arms import ArmDescription

_SEED = 0
_STARTS = 16  # at every place
_STEPS = 40
_FULL_STEP_RAD = 0.5
_NARROW = 0.4  # of their ranges, for every other start
_PLACES = tuple(product((1.0, 1.4), (1.0, 0.0, -1.0), (1.0, 1.4, 1.8)))  # ahead, aside, high, as shares
_NEARER = (0.8, 0.6, 0.4, 0.2, 0.6, 0.8)
_LOOKED_AT = 8  # of the best, of which what is reached from them is looked at
_APART_RAD = 0.2
_DIGITS = 3
_FAULT, _REACHED, _STRAIGHT, _ROOMY = 10.0, 4.0, 3.0, 3.0  # against the rest of the cost, about 1
_WEIGHTS = np.array([20.0, 20.0, 20.0, 2.0, 2.0, 2.0])  # of the place [1/m], of the direction


@dataclass(frozen=True, eq=False)
class Home:
    """A home pose, how it was found to be, what is reached from it, and what of the asked it fails.

    ``in_the_way`` are the two links that alone, too near to each other, spoil more poses than were left, of those
    looked through or of those at objects.
    """

    measured: Measured
    reached: Reached
    faults: tuple[str, ...]
    in_the_way: tuple[str, str] | None = None

    @property
    def q(self) -> tuple[float, ...]:
        """The pose [rad]."""
        return tuple(float(v) for v in self.measured.q)

    def told(self) -> str:
        """What it is based on."""
        m, r = self.measured, self.reached
        ahead, left, high = m.p_tip
        side = f"{abs(left):.2f} m {'left' if left >= 0.0 else 'right'}"
        apart = "" if m.links is None else f"nearest links {1e3 * m.links[2]:.0f} mm apart, "
        return (
            f"the fingertip {ahead:.2f} m before, {side} of and {high:.2f} m above the base, the hand "
            f"{np.degrees(m.off_down_rad):.0f}° off straight down, {apart}'{m.limit[0]}' {m.limit[1]:.2g} rad from its "
            f"limit, '{m.torque[0]}' holds {m.torque[1]:.0%} of its torque; of {r.asked} poses before, above and "
            f"behind objects {r.reached} are reached from there, {r.straight} straight"
        )


class HomeSearch:
    """Looks for home poses of one arm, and at given ones. The same arm gives the same pose."""

    def __init__(self, arm: ArmDescription) -> None:
        self._rng = np.random.default_rng(_SEED)
        self.place = place_of(ArmModel(arm), self._rng)
        self._gauge = Gauge(arm, self.place)
        self._reach = Reach(self._gauge.arm, self.place)
        self._low, self._high = turns(self._gauge.arm)
        self._middle, self._half = (
            0.5 * (self._low + self._high),
            np.maximum(0.5 * (self._high - self._low), 1e-3),
        )

    def judge(self, q: np.ndarray) -> Home:
        """Look at a given pose (dof,) [rad]."""
        return self._with_reach(self._gauge.measure(np.asarray(q, float)))

    def search(self) -> Home:
        """The best of many poses, whether or not one without a fault is among them."""
        found = [pair for shares in _PLACES for pair in self._solved(self.place.p_wait * shares, _STARTS)]
        refined = [self._refined(cost, measured) for cost, measured in _distinct(found)]
        judged: list[tuple[float, Home]] = []
        for cost, measured in _distinct(refined + found):
            if any(cost >= total for total, _ in judged):
                break  # what is not reached only adds to it
            home = self._with_reach(measured)
            judged.append((cost + _unreached(home), home))
        home = min(judged, key=lambda pair: pair[0])[1]
        alone = self._in_the_way([measured for _, measured in found])
        return replace(home, in_the_way=alone or home.reached.blocked)

    def _in_the_way(self, found: list[Measured]) -> tuple[str, str] | None:
        alone = Counter(m.links[:2] for m in found if m.links is not None and m.links_alone(self.place))
        pair, count = max(alone.items(), key=lambda item: item[1], default=(None, 0))
        return pair if count > sum(not m.faults(self.place) for m in found) else None

    def _with_reach(self, measured: Measured) -> Home:
        reached = self._reach.from_pose(measured.q)
        faults = measured.faults(self.place)
        if not reached.reached:
            faults.append(f"none of {reached.asked} poses at objects is reached from it")
        return Home(measured, reached, tuple(faults))

    def _solved(self, p: np.ndarray, count: int) -> list[tuple[float, Measured]]:
        """Poses with the fingertip near ``p`` (3,) [m] and the hand down, from so many random starts, with costs."""
        found = []
        for k, share in enumerate(self._rng.uniform(-1.0, 1.0, (count, len(self._half)))):
            q = self._middle + share * self._half * (_NARROW if k % 2 else 1.0)
            measured = self._at(self._solve(p, q))
            found.append((self._cost(measured), measured))
        return found

    def _at(self, q: np.ndarray) -> Measured:
        """A pose as it can be written, within the limits."""
        limits = self._gauge.arm.arm.limits
        return self._gauge.measure(np.clip(np.round(q, _DIGITS) + 0.0, limits.q_min, limits.q_max))

    def _refined(self, cost: float, measured: Measured) -> tuple[float, Measured]:
        """The same place of the hand with the joints nearer to the middle of their ranges, where that is better."""
        for share in _NEARER:
            start = self._middle + share * (measured.q - self._middle)
            other = self._at(self._solve(measured.p_tip, start))
            if self._cost(other) < cost:
                cost, measured = self._cost(other), other
        return cost, measured

    def _solve(self, p: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Damped least squares: place and direction of the hand, and the start where these leave a choice."""
        down, keep = np.array([0.0, 0.0, -1.0]), 0.3 / self._half
        low, high = self._low + 0.1 * self._half, self._high - 0.1 * self._half
        q = start = np.clip(start, low, high)
        for _ in range(_STEPS):
            X, J = self._gauge.jacobian(q)
            z = X[:3, 2]
            off = np.concatenate([_WEIGHTS * np.concatenate([p - X[:3, 3], down - z]), keep * (start - q)])
            turned = np.cross(J[3:].T, z).T
            A = np.vstack([_WEIGHTS[:, None] * np.vstack([J[:3], turned]), np.diag(keep)])
            step = np.linalg.solve(A.T @ A + 1e-2 * np.eye(len(q)), A.T @ off)
            step *= min(1.0, _FULL_STEP_RAD / max(float(np.abs(step).max()), 1e-12))
            q = np.clip(q + step, low, high)
            if np.abs(step).max() < 1e-4:
                break
        return q

    def _cost(self, m: Measured) -> float:
        """The less the better; what is failed counts more than all else."""
        links_m = np.inf if m.links is None else m.links[2]
        height_m = np.inf if m.lowest is None else m.lowest[1]
        return (
            _FAULT * len(m.faults(self.place))
            + float(np.linalg.norm(m.p_tip - self.place.p_wait)) / self.place.object_m
            + 0.5 * m.off_down_rad
            + m.torque[1]
            + 1.5 * float(np.sqrt(np.mean(((m.q - self._middle) / self._half) ** 2)))
            + _short_of(m.limit[1], 0.5)
            + _short_of(links_m, 0.03)
            + _short_of(height_m, 0.1)
            + _short_of(m.agility, 0.15)
            + 2.0 * _short_of(m.view_m, 0.05)
            + _short_of(m.room_m, 0.05)
        )


def _short_of(value: float, wanted: float) -> float:
    return max(0.0, wanted - value) / wanted


def _unreached(home: Home) -> float:
    r = home.reached
    weighted = _REACHED * r.reached + _STRAIGHT * r.straight + _ROOMY * r.roomy
    return _REACHED + _STRAIGHT + _ROOMY - weighted / r.asked


def _distinct(found: list[tuple[float, Measured]]) -> list[tuple[float, Measured]]:
    """The best few that are not the same posture."""
    kept: list[tuple[float, Measured]] = []
    for cost, measured in sorted(found, key=lambda pair: pair[0]):
        if all(np.abs(measured.q - other.q).max() > _APART_RAD for _, other in kept):
            kept.append((cost, measured))
        if len(kept) == _LOOKED_AT:
            break
    return kept
