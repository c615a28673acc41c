"""The motion that would split the remaining candidates: chosen by simulating each of them."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from s2r_host.gap.effects import catalogue
from s2r_host.gap.motion.session import Session, make_session
from s2r_host.gap.pipeline import Analysis
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.base_terms import PREFIX
from s2r_host.gap.regression.rows import compare
from s2r_host.gap.regression.solution import Term
from s2r_host.gap.simulation.replay import Live, Twin, build_twin, run
from s2r_host.gap.verdict.decision import Decision
from s2r_host.recording import RunRecorder
from s2r_protocol.whole_file import write_whole

DURATION_S = 8.0
RATE_HZ = 500.0
KNOT_STEP = 10  # 50 knots a second
ROUNDING_S = 0.1
_TELLS_FLOORS = 0.1  # a smaller difference (rms) is lost even in thousands of rows


def motions(low: float, high: float, speed: float, acceleration: float) -> dict[str, np.ndarray]:
    """Candidate motions inside the travel, speed and acceleration already seen, each shape (time,)."""
    t = np.arange(0, DURATION_S, 1 / RATE_HZ)
    mid, half = 0.5 * (low + high), 0.5 * (high - low)
    ease = np.clip(t / 1.0, 0, 1) * np.clip((DURATION_S - t) / 1.0, 0, 1)
    f = np.geomspace(0.2, 6.0, len(t))
    phase = 2 * np.pi * np.cumsum(f) / RATE_HZ
    w = 2 * np.pi * f
    amplitude = np.minimum(half, np.minimum(0.8 * speed / w, 0.8 * acceleration / w**2))
    slow = half * _triangle(t / 8.0)
    fast = half * _triangle(t / max(2.0, 4.4 * half / max(speed, 1e-9)))
    steps = (
        np.repeat([0.0, 0.5, -0.5, 0.25, -0.25, 0.1, -0.1, 0.0], int(np.ceil(len(t) / 8)))[: len(t)] * half
    )
    steps = _smooth(steps, speed)
    shrink = half * np.geomspace(1.0, 0.02, len(t)) * np.sin(2 * np.pi * 0.7 * t)
    shapes = {
        "chirp from 0.2 to 6 Hz": ease * amplitude * np.sin(phase),
        "slow ramp both ways": _rounded(ease * slow),
        "fast ramps both ways": _rounded(ease * fast),
        "steps of several sizes": steps,
        "reversals of shrinking amplitude": ease * shrink,
    }
    return {name: mid + _tamed(x, speed, acceleration) for name, x in shapes.items()}


def _rounded(x: np.ndarray) -> np.ndarray:
    """The same with corners rounded over a tenth of a second: no machine turns on the spot."""
    kernel = np.hanning(int(ROUNDING_S * RATE_HZ) + 2)
    return np.convolve(np.pad(x, len(kernel), mode="edge"), kernel / kernel.sum(), mode="same")[
        len(kernel) : -len(kernel)
    ]


def _tamed(x: np.ndarray, speed: float, acceleration: float) -> np.ndarray:
    """A motion about zero, made smaller until its speed and acceleration were seen before."""
    v = np.gradient(x) * RATE_HZ
    a = np.gradient(v) * RATE_HZ
    return x / max(1.0, float(np.max(np.abs(v))) / speed, float(np.max(np.abs(a))) / acceleration)


def _triangle(x: np.ndarray) -> np.ndarray:
    return 1.0 - 4.0 * np.abs((x + 0.25) % 1.0 - 0.5)


def _smooth(x: np.ndarray, speed: float) -> np.ndarray:
    width = max(3, int(RATE_HZ * min(0.3, 2.0 * float(np.ptp(x)) / max(speed, 1e-9) / 4)))
    kernel = np.hanning(width + 2)
    return np.convolve(np.pad(x, width, mode="edge"), kernel / kernel.sum(), mode="same")[width:-width]


def propose(a: Analysis, decision: Decision, folder: Path) -> dict:
    """Simulate the two best candidates on each motion; write the motion on which their efforts differ most.

    Returns:
        The contract's entry, empty when nothing is left to split.
    """
    pair = _pair(decision)
    if pair is None or a.problem is None or a.search is None:
        return {}
    j = max(pair[0].joint, 0)
    twins = [_twin_of(a, t, decision) for t in pair]
    low, high = a.problem.ctx.span(j)
    floor = a.problem.floor.get(j, 1e-09)
    best, best_gap, name = None, -1.0, ""
    for label, q in motions(low, high, *_seen(a, j)).items():
        s = _session(a, j, q)
        efforts = []
        for twin in twins:
            result = run(twin, s, 0, len(s.t), closed=True)
            efforts.append(compare(np.nan_to_num(result.u[:, j]), s, j, True) if result.finite else None)
        if efforts[0] is None or efforts[1] is None:
            continue
        gap = float(np.sqrt(np.mean((efforts[0] - efforts[1])[50:-50] ** 2))) / floor
        if gap > best_gap:
            best, best_gap, name = q, gap, label
    if best is None:
        return {}
    path = folder / "next_experiment.csv"
    folder.mkdir(parents=True, exist_ok=True)
    _write(path, a, j, best)
    separates = [t.effect.removeprefix(PREFIX) for t in pair]
    hints = [catalogue()[t.effect].separating_motion for t in pair if t.effect in catalogue()]
    differ = f"differ by {best_gap:.1f} noise floors (rms)"
    if best_gap < _TELLS_FLOORS:
        differ = (
            f"differ by less than {_TELLS_FLOORS:g} noise floors, so look where no recording has been yet"
        )
    return {
        "separates": separates,
        "trajectory": path.name,
        "why": f"{name}: the two candidates' efforts {differ}; " + "; ".join(hints),
    }


def _seen(a: Analysis, j: int) -> tuple[float, float]:
    """Largest speed and acceleration of a joint in the fitted recordings (99.5 percentile)."""
    assert a.problem is not None
    top = max(float(np.percentile(np.abs(s.a[:, j]), 99.5)) for s in a.fit)
    return max(a.problem.ctx.top_speed(j), 1e-6), max(top, 1e-6)


def _pair(decision: Decision) -> tuple[Term, Term] | None:
    for slot in decision.solution.slots:
        distinct = []
        for s in slot:
            if s.term.effect not in [t.effect for t in distinct] and np.isfinite(s.score):
                distinct.append(s.term)
        if len(distinct) >= 2:
            return distinct[0], distinct[1]
    return None


def _twin_of(a: Analysis, term: Term, decision: Decision) -> Twin:
    assert a.problem is not None
    assert a.search is not None
    others = [t for t in decision.solution.terms if t.key not in (term.key, decision.solution.terms[0].key)]
    solution = a.search.finish([term, *others], [], [])
    terms = [
        Live(t.effect, t.joint, dict(t.shape), th)
        for t, th in zip(solution.terms, solution.theta, strict=True)
        if not t.effect.startswith(PREFIX)
    ]
    return build_twin(a.model, a.problem.ctx, terms, a.problem.moved(solution.base))


def _session(a: Analysis, j: int, q: np.ndarray) -> Session:
    """A recording that exists only as a command."""
    reference = a.fit[0]
    t = np.arange(len(q)) / RATE_HZ
    channels: dict[str, dict[str, np.ndarray]] = {"q": {}, "q_cmd": {}, "dq_cmd": {}}
    kp, kd = {}, {}
    for i, joint in enumerate(a.model.joints):
        path = q if i == j else np.full(len(t), float(np.median(reference.q[:, i])))
        channels["q"][joint] = path
        channels["q_cmd"][joint] = path
        channels["dq_cmd"][joint] = np.gradient(path, t)
        inertia = float(np.mean(reference.mass[:, i]))
        law = reference.rec.controller
        kp[joint] = law.kp.get(joint, inertia * 400.0)
        kd[joint] = law.kd.get(joint, inertia * 40.0)
    rec = Recording("next", t, channels, Controller("pd", kp, kd), "commanded", "q_cmd", "next", "", ())
    return make_session(a.model, rec, 10_000)


def _write(path: Path, a: Analysis, j: int, q: np.ndarray) -> None:
    """The motion as a table of commands, and as a plan that `s2r replay` sends to an arm with these joints."""
    t, dq, still = _plan(a, j, q)
    table = io.StringIO()
    writer = csv.writer(table)
    writer.writerow(["t"] + [f"{k}.{joint}" for joint in a.model.joints for k in ("q_cmd", "dq_cmd")])
    for i in range(len(t)):
        row = [f"{t[i]:.6g}"]
        for k in range(len(a.model.joints)):
            row.append(f"{q[i] if k == j else still[k]:.8g}")
            row.append(f"{dq[i] if k == j else 0.0:.8g}")
        writer.writerow(row)
    write_whole(path, table.getvalue())
    picks = np.arange(0, len(t), KNOT_STEP)
    shape = (len(picks), len(a.model.joints))
    knots = {k: np.zeros(shape) for k in ("q", "dq", "ddq")}
    knots["q"][:] = still
    knots["q"][:, j], knots["dq"][:, j] = q[picks], dq[picks]
    knots["ddq"][:, j] = (np.gradient(dq) * RATE_HZ)[picks]
    knots["dq"][[0, -1]] = knots["ddq"][[0, -1]] = 0.0  # a plan starts and ends at rest
    with RunRecorder(path.with_suffix(".mcap"), "/gap/next", a.model.joints) as recorder:
        recorder.add_plan(_Knots(t[picks], **knots), "next experiment", 0)


@dataclass(frozen=True)
class _Knots:
    """A plan of the executor: times [s], shape (n,), and knots, shape (n, joint)."""

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray


def _plan(a: Analysis, j: int, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Time [s] and velocity of a motion, and where the other joints stay."""
    t = np.arange(len(q)) / RATE_HZ
    return (
        t,
        np.gradient(q) * RATE_HZ,
        [float(np.median(a.fit[0].q[:, k])) for k in range(len(a.model.joints))],
    )
