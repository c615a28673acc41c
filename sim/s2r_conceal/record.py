"""From cases to recordings at full rate, and to the truth about each: sizes, regimes, floors, best prediction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from s2r_conceal.cases import ROLES, Case, with_parameters_off
from s2r_conceal.effects.table import EFFECTS, finish_log
from s2r_conceal.masks import rows
from s2r_conceal.motions import RATE_HZ
from s2r_conceal.plant import Column, Trace, simulate
from s2r_conceal.streams import Purpose, stream, words
from s2r_conceal.strength import DISTINCT_ENOUGH, Measured, floor_between, rms

ACTIVE_SHARE = 0.2  # an effect is at work where its contribution exceeds this share of its 98th percentile
MERGE_S = 0.06  # intervals closer than this are one, as each is widened by half of it; below a sixth they are dropped


@dataclass(eq=False)
class Recording:
    """One table as the tool sees it: shared time, per-joint columns of shape (rows, joints)."""

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray
    q_cmd: np.ndarray
    dq_cmd: np.ndarray
    tau_ff: np.ndarray
    temp_C: np.ndarray


@dataclass(eq=False)
class Recorded:
    """A finished case: its recordings and the truth that goes under seal."""

    case: Case
    recordings: dict[str, Recording]
    truth: dict[str, Any]


def record(cases: Sequence[Case], measured: Sequence[Measured], substeps: int = 10) -> list[Recorded]:
    """Simulate every case at full rate: fit, repeat, held out, and the held-out run as truth and model see it."""
    columns = [column for case in cases for column in _columns(case)]
    traces = simulate(cases[0].rig, columns, substeps)
    finished = [finish_log(t, c.effects) for t, c in zip(traces, columns, strict=True)]
    per_case = len(finished) // len(cases)
    return [
        _finish(case, m, finished[i * per_case : (i + 1) * per_case])
        for i, (case, m) in enumerate(zip(cases, measured, strict=True))
    ]


def _columns(case: Case) -> list[Column]:
    told, told_controller = with_parameters_off(case)
    at_work = [*case.effects, *case.in_model]
    noisy = [case.run(role, at_work, words(Purpose.NOISE, case.seed, k)) for k, role in enumerate(ROLES)]
    oracle = case.run("holdout", at_work)
    believed = replace(oracle, machine=told, controller=told_controller, effects=tuple(case.in_model))
    return [*noisy, oracle, believed]


def _finish(case: Case, measured: Measured, traces: list[Trace]) -> Recorded:
    recordings, shown = {}, {}
    for k, (role, trace) in enumerate(zip(ROLES, traces[:3], strict=True)):
        chosen, t = rows(case.mask, len(trace.q), RATE_HZ, stream(Purpose.ROWS, case.seed, k))
        recordings[role] = _table(case, role, trace, chosen, t)
        shown[role] = _Shown(role, trace, chosen, t)
    fit, repeat, holdout, oracle, believed = traces
    floor = floor_between(case, fit, repeat)
    blown = not all(np.isfinite(t.q).all() for t in traces[:4])
    truth = {
        "rig": case.rig.name,
        "group": case.group,
        "variant": case.variant,
        "expected": expected_of(case, measured),
        "stable": not blown,
        "masks": case.mask.names(),
        "floor": {"q_rmse": _worst(floor.q), "tau_rmse": _worst(floor.tau)},
        "holdout": {
            "believed": _worst(rms(believed.q - holdout.q)),
            "oracle": _worst(rms(oracle.q - holdout.q)),
            "per_joint_believed": rms(believed.q - holdout.q).tolist(),
            "per_joint_oracle": rms(oracle.q - holdout.q).tolist(),
        },
        "tracking_error_share": _tracking_share(case, fit),
        "effects": [
            _effect_truth(case, k, measured, shown["holdout" if EFFECTS[a.name].for_role else "fit"])
            for k, a in enumerate(case.effects)
        ],
        "in_model": [{"name": a.name, "joint": case.rig.joint_names[a.joint]} for a in case.in_model],
        "parameters_off": [
            entry | {"joint": case.rig.joint_names[int(entry["joint"])], "strength": strength}
            for entry, strength in zip(case.parameters_off, measured.off, strict=True)
        ],
    }
    return Recorded(case, recordings, truth)


def expected_of(case: Case, measured: Measured) -> list[str]:
    """Right verdicts; without effort and gains those that positions allow, what they tell best first.

    To ask for effort is right on all of these. Whoever has positions alone sees nothing of an effect that the loop
    takes up, so that nobody can exclude one on a clean machine either.
    """
    expected = list(case.expected)
    if not case.mask.no_effort:
        return expected
    if not case.effects or max(measured.distinct_q.values()) >= DISTINCT_ENOUGH:
        return [*expected, "insufficient"]
    seen = max(measured.strength_q.values()) >= DISTINCT_ENOUGH  # though other gains could explain it
    return ["insufficient", *expected] if seen else ["insufficient"]


def _worst(x: np.ndarray) -> float:
    return float(np.max(x))


def _tracking_share(case: Case, fit: Trace) -> float:
    """Root mean square position error over the range of the motion, worst joint."""
    span = np.ptp(fit.q, axis=0)
    return float(np.max(rms(fit.q - case.motions["fit"].q_cmd) / np.maximum(span, 1e-9)))


def _table(case: Case, role: str, trace: Trace, chosen: np.ndarray, t: np.ndarray) -> Recording:
    tau = getattr(trace, case.effort)
    motion = case.motions[role]
    degrees = np.degrees(1.0) if case.variant == "degrees" else 1.0
    q, dq = trace.q[chosen] * degrees, trace.dq[chosen] * degrees
    if case.variant == "swapped_joints":
        q, dq, tau = q[:, ::-1], dq[:, ::-1], tau[:, ::-1]
    return Recording(
        t=t,
        q=q,
        dq=dq,
        tau=tau[chosen],
        q_cmd=motion.q_cmd[chosen] * degrees,
        dq_cmd=motion.dq_cmd[chosen] * degrees,
        tau_ff=motion.tau_ff[chosen],
        temp_C=trace.temp_C[chosen],
    )


# -- the truth about one effect -----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Shown:
    """The run on which an effect shows, and which of its ticks were written with which stamps."""

    role: str
    trace: Trace
    chosen: np.ndarray
    t: np.ndarray


def _effect_truth(case: Case, k: int, measured: Measured, shown: _Shown) -> dict[str, Any]:
    active = case.effects[k]
    effect = EFFECTS[active.name]
    at_work = active_mask(shown.trace.contributions[k])
    distinct = measured.distinct.get(k, float("nan"))
    return {
        "name": active.name,
        "known": effect.known,
        "joint": case.rig.joint_names[active.joint],
        "same_as": list(effect.same_as),
        "parameters": {n: {"value": v, "unit": effect.units[n]} for n, v in active.values.items()},
        "size_parameter": effect.size,
        "target": case.targets[k],
        "strength": measured.strength.get(k),
        "strength_q": measured.strength_q.get(k),
        "distinct": distinct,
        "distinct_q": measured.distinct_q.get(k),
        "decidable": bool(distinct >= 1.0),
        "clear": bool(distinct >= DISTINCT_ENOUGH),
        "regime": _regime(at_work, active.joint, shown) | {"words": effect.words},
    }


def active_mask(contribution: np.ndarray) -> np.ndarray:
    """Ticks at which an effect is at work, blips removed and the rest widened over short gaps, shape (ticks,)."""
    size = np.abs(contribution.astype(float))
    if size.size == 0 or not np.isfinite(size).all():
        return np.zeros(size.size, bool)
    threshold = ACTIVE_SHARE * np.percentile(size, 98.0)
    if threshold <= 0.0:
        threshold = ACTIVE_SHARE * size.max()
    raw = size > max(threshold, 1e-12)
    width = round(MERGE_S * RATE_HZ)
    joined = np.zeros(raw.size, bool)
    for start, stop in runs(raw):
        if stop - start >= width // 6:
            joined[max(start - width // 2, 0) : stop + width // 2] = True
    return joined


def runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Half-open index ranges where the mask is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _regime(at_work: np.ndarray, joint: int, shown: _Shown) -> dict[str, Any]:
    """Intervals on the time axis of the recording named, and the box in q and dq they cover."""
    stamps = np.interp(np.arange(at_work.size), shown.chosen, shown.t)
    if not at_work.any():
        return {"recording": shown.role, "t": [], "q": None, "dq": None}
    q, dq = shown.trace.q[at_work, joint], shown.trace.dq[at_work, joint]
    return {
        "recording": shown.role,
        "t": [[round(float(stamps[a]), 4), round(float(stamps[b - 1]), 4)] for a, b in runs(at_work)],
        "q": [float(np.percentile(q, 1)), float(np.percentile(q, 99))],
        "dq": [float(np.percentile(dq, 1)), float(np.percentile(dq, 99))],
    }
