"""The motion that would split the remaining candidates: chosen by simulating each of them."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from s2r_host.gap.effects import catalogue
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session, make_session
from s2r_host.gap.pipeline import Analysis, patched_twin
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.base_terms import PREFIX
from s2r_host.gap.regression.rows import compare
from s2r_host.gap.regression.solution import Term
from s2r_host.gap.simulation.replay import Twin, run
from s2r_host.gap.verdict.decision import Decision
from s2r_host.recording import RunRecorder
from s2r_protocol.whole_file import write_whole

DURATION_S = 8.0
RATE_HZ = 500.0
KNOT_STEP = 10  # 50 knots a second
ROUNDING_S = 0.1
SPLITS_FLOORS = (
    0.3  # rms: over the 300 independent rows of such a motion 14 nats, and less is absorbed by a refit
)
RANGE_MARGIN = 0.05  # of the model's joint range, kept at both ends
FARTHER = 1.1  # times the range seen: a joint range that is no larger offers no other motions
OF_LIMIT = 0.9  # of a declared effort limit


def motions(low: float, high: float, speed: float, acceleration: float) -> dict[str, np.ndarray]:
    """Candidate motions between two positions, inside the speed and acceleration given, each shape (time,)."""
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

    Motions inside the range already seen come first. Where none of them splits the candidates, the joint range of the
    model is used, less a margin; speed and acceleration stay what was seen, efforts below what the model declares. A
    motion that splits nothing is not handed out.

    Returns:
        The contract's entry, empty when nothing is left to split.
    """
    pair = _pair(decision)
    if pair is None or a.problem is None or a.search is None:
        return {}
    j = max(pair[0].joint, 0)
    twins = (_twin_of(a, pair[0], decision), _twin_of(a, pair[1], decision))
    names = [t.effect.removeprefix(PREFIX) for t in pair]
    most = 0.0
    for low, high, beyond in ranges(a.model, j, a.problem.ctx.span(j)):
        found = _most_different(a, j, twins, motions(low, high, *_seen(a, j)))
        if found is None:
            continue
        label, q, floors = found
        most = max(most, floors)
        if floors < SPLITS_FLOORS:
            continue
        path = folder / "next_experiment.csv"
        folder.mkdir(parents=True, exist_ok=True)
        _write(path, a, j, q)
        hints = [catalogue()[t.effect].separating_motion for t in pair if t.effect in catalogue()]
        return {
            "separates": names,
            "trajectory": path.name,
            "predicted_floors": round(floors, 3),
            "why": f"{label}: the two candidates' efforts differ by {floors:.1f} noise floors (rms){beyond}; "
            + "; ".join(hints),
        }
    return {
        "separates": [],
        "trajectory": None,
        "predicted_floors": round(most, 3),
        "why": f"no motion within the limits splits {names[0]} from {names[1]}: they are the same equation here (their "
        f"efforts differ by at most {most:.2g} noise floors); tell them apart by looking at the machine",
    }


def ranges(model: RigidModel, j: int, seen: tuple[float, float]) -> list[tuple[float, float, str]]:
    """Positions to move between, the range seen first, each with what the reader has to know about it."""
    found = [(*seen, "")]
    m, k = model.model, int(model.model.joint(model.joints[j]).id)
    if not m.jnt_limited[k]:
        return found
    low, high = (float(x) for x in m.jnt_range[k])
    margin = RANGE_MARGIN * (high - low)
    low, high = low + margin, high - margin
    if high - low > FARTHER * (seen[1] - seen[0]):
        unit = model.unit(model.joints[j])
        told = (
            f"; it leaves the range seen and moves '{model.joints[j]}' between {low:.3g} and {high:.3g} {unit}, the "
            f"model's joint range less {RANGE_MARGIN:.0%} at each end: see that the way is free"
        )
        found.append((low, high, told))
    return found


def _most_different(
    a: Analysis, j: int, twins: tuple[Twin, Twin], tried: dict[str, np.ndarray]
) -> tuple[str, np.ndarray, float] | None:
    """The motion on which the efforts of two twins differ most, and by how many noise floors (rms), if any runs."""
    assert a.problem is not None
    floor = a.problem.floor.get(j, 1e-09)
    low, high = (OF_LIMIT * float(x[j]) for x in a.model.effort_limits())
    best = None
    for label, q in tried.items():
        s = _session(a, j, q)
        efforts = []
        for twin in twins:
            result = run(twin, s, 0, len(s.t), closed=True)
            u = result.u[:, j]
            if not result.finite or u.min() < low or u.max() > high:
                break
            efforts.append(compare(u, s, j, True))
        else:
            gap = float(np.sqrt(np.mean((efforts[0] - efforts[1])[50:-50] ** 2))) / floor
            if best is None or gap > best[2]:
                best = (label, q, gap)
    return best


def _seen(a: Analysis, j: int) -> tuple[float, float]:
    """Largest speed and acceleration of a joint in the fitted recordings (99.5 percentile)."""
    assert a.problem is not None
    top = max(float(np.percentile(np.abs(s.a[:, j]), 99.5)) for s in a.fit)
    return max(a.problem.ctx.top_speed(j), 1e-6), max(top, 1e-6)


def _pair(decision: Decision) -> tuple[Term, Term] | None:
    """The first name of a place and its rival: one that the answer holds possible, else the next best.

    Where only numbers are off, a rival that the answer does not hold possible is no rival.
    """
    possible = {n for e in decision.effects for n in e.could_also_be}
    possible |= {n for p in decision.parameters_off for n in p.get("could_also_be", ())}
    for slot in decision.solution.slots:
        distinct: list[Term] = []
        for s in slot:
            if s.term.effect not in [t.effect for t in distinct] and np.isfinite(s.score):
                distinct.append(s.term)
        rivals = [t for t in distinct[1:] if t.effect.removeprefix(PREFIX) in possible]
        if not rivals and decision.verdict != "parameter_off":
            rivals = distinct[1:2]
        if rivals:
            return distinct[0], rivals[0]
    return None


def _twin_of(a: Analysis, term: Term, decision: Decision) -> Twin:
    """The machine if this candidate stands in its place, with what else was found."""
    assert a.search is not None
    others = [t for t in decision.solution.terms if t.key not in (term.key, decision.solution.terms[0].key)]
    return patched_twin(a, a.search.finish([term, *others], [], []), "physics_missing")


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
