"""Before and after: position errors of the nominal and the patched model, closed loop and open loop."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from s2r_host.gap.motion.session import Session
from s2r_host.gap.regression.rows import HOLDOUT_SHARE
from s2r_host.gap.simulation.replay import Twin, has_loop, run, windows

WINDOW_S = 2.0


@dataclass
class Trace:
    """One simulated stretch of one recording."""

    session: Session
    start: int
    held: bool
    closed: bool
    q: np.ndarray
    u: np.ndarray


@dataclass
class Errors:
    """Root mean square position errors per joint [rad or m] and per kind of rows."""

    train: np.ndarray
    held: np.ndarray
    open_train: np.ndarray
    open_held: np.ndarray
    u_held: np.ndarray
    traces: list[Trace] = field(default_factory=list)


def evaluate(
    twin: Twin, fit: list[Session], hold: list[Session], joints: list[int], window_s: float = WINDOW_S
) -> Errors:
    """Simulate every recording closed loop (where the law is known) and open loop in windows.

    Args:
        twin: The model to run.
        fit: Fitted recordings; without ``hold`` their last part counts as held out.
        hold: Recordings that were only predicted.
        joints: Joints whose error counts.
        window_s: Length of an open-loop window; infinite for one window per recording.
    """
    sums = {
        k: np.zeros(len(twin.rigid.joints)) for k in ("train", "held", "open_train", "open_held", "u_held")
    }
    counts = dict.fromkeys(sums, 0)
    traces: list[Trace] = []
    for s in fit + hold:
        split = len(s.t) if hold else first_held(s)
        is_held = s in hold
        if has_loop(twin.rigid, s):
            margin = max(2, min(int(0.1 / s.dt), len(s.t) // 20))
            result = run(twin, s, margin, len(s.t) - margin, closed=True)
            _add(sums, counts, s, margin, result.q, split, is_held, "train", "held")
            if s.has_u.any():
                _add_effort(sums, counts, s, margin, result.u, split, is_held)
            traces.append(Trace(s, margin, is_held, True, result.q, result.u))
        if s.has_u[joints].all() and len(joints) == len(s.has_u):
            for start, stop in windows(s, min(window_s, 1e6)):
                result = run(twin, s, start, stop, closed=False)
                _add(sums, counts, s, start, result.q, split, is_held, "open_train", "open_held")
                if is_held or start >= split:
                    traces.append(Trace(s, start, True, False, result.q, result.u))
    values = {k: np.sqrt(sums[k] / counts[k]) if counts[k] else np.full(len(sums[k]), np.nan) for k in sums}
    return Errors(**values, traces=traces)


def first_held(s: Session) -> int:
    """Where the held-out end of a fitted recording begins in simulated traces, when no other one is held out."""
    return int((1.0 - HOLDOUT_SHARE) * len(s.t))


def _add(
    sums: dict[str, np.ndarray], counts: dict[str, int], s: Session, start: int, q: np.ndarray, split: int,
    is_held: bool, train: str, held: str,
) -> None:  # fmt: skip
    error = q - s.q[start : start + len(q)]
    error = np.where(np.isfinite(error), error, 10.0)  # a simulation that left the world is wrong, not absent
    late = np.full(len(q), is_held) | (np.arange(start, start + len(q)) >= split)
    for key, mask in ((train, ~late), (held, late)):
        sums[key] = sums[key] + np.sum(error[mask] ** 2, axis=0)
        counts[key] += int(mask.sum())


def _add_effort(
    sums: dict[str, np.ndarray],
    counts: dict[str, int],
    s: Session,
    start: int,
    u: np.ndarray,
    split: int,
    is_held: bool,
) -> None:
    late = np.full(len(u), is_held) | (np.arange(start, start + len(u)) >= split)
    error = np.nan_to_num(u - s.u[start : start + len(u)])
    sums["u_held"] = sums["u_held"] + np.sum(error[late] ** 2, axis=0)
    counts["u_held"] += int(late.sum())
