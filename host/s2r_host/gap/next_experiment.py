"""The motion that would split the remaining candidates: chosen by simulating each of them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from s2r_host.gap.base_terms import PREFIX
from s2r_host.gap.decide import Decision
from s2r_host.gap.effects import catalogue
from s2r_host.gap.pipeline import Analysis
from s2r_host.gap.problem import compare
from s2r_host.gap.recording import Controller, Recording
from s2r_host.gap.replay import Live, Twin, build_twin, run
from s2r_host.gap.search import Term
from s2r_host.gap.session import Session, make_session

DURATION_S = 8.0
RATE_HZ = 500.0


def motions(low: float, high: float, speed: float) -> dict[str, np.ndarray]:
    """Candidate motions inside the travel and speed already seen, each shape (time,)."""
    t = np.arange(0, DURATION_S, 1 / RATE_HZ)
    mid, half = 0.5 * (low + high), 0.5 * (high - low)
    ease = np.clip(t / 1.0, 0, 1) * np.clip((DURATION_S - t) / 1.0, 0, 1)
    f = np.geomspace(0.2, 6.0, len(t))
    phase = 2 * np.pi * np.cumsum(f) / RATE_HZ
    amplitude = np.minimum(half, 0.8 * speed / (2 * np.pi * f))
    slow = half * _triangle(t / 8.0)
    fast = half * _triangle(t / max(2.0, 4.4 * half / max(speed, 1e-9)))
    steps = (
        np.repeat([0.0, 0.5, -0.5, 0.25, -0.25, 0.1, -0.1, 0.0], int(np.ceil(len(t) / 8)))[: len(t)] * half
    )
    steps = _smooth(steps, speed)
    shrink = half * np.geomspace(1.0, 0.02, len(t)) * np.sin(2 * np.pi * 0.7 * t)
    return {
        "chirp from 0.2 to 6 Hz": mid + ease * amplitude * np.sin(phase),
        "slow ramp both ways": mid + ease * slow,
        "fast ramps both ways": mid + ease * fast,
        "steps of several sizes": mid + steps,
        "reversals of shrinking amplitude": mid + ease * shrink,
    }


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
    for label, q in motions(low, high, a.problem.ctx.top_speed(j)).items():
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
    return {
        "separates": separates,
        "trajectory": path.name,
        "why": f"{name}: the two candidates' efforts differ by {best_gap:.1f} noise floors (rms); "
        + "; ".join(hints),
    }


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
    base = [
        (p, float(x))
        for p, x in zip(a.problem.base, solution.base, strict=True)
        if p.name not in ("timing", "edge")
    ]
    return build_twin(a.model, a.problem.ctx, terms, base)


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
    t = np.arange(len(q)) / RATE_HZ
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["t"] + [f"{k}.{joint}" for joint in a.model.joints for k in ("q_cmd", "dq_cmd")])
        for i in range(len(t)):
            row = [f"{t[i]:.6g}"]
            for k in range(len(a.model.joints)):
                still = float(np.median(a.fit[0].q[:, k]))
                row.append(f"{q[i] if k == j else still:.8g}")
                row.append(f"{_slope(q, t, i) if k == j else 0.0:.8g}")
            writer.writerow(row)


def _slope(q: np.ndarray, t: np.ndarray, i: int) -> float:
    a, b = max(i - 1, 0), min(i + 1, len(q) - 1)
    return float((q[b] - q[a]) / (t[b] - t[a]))
