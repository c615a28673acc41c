"""One verdict against one truth. Pure functions on dictionaries, so that the scorer itself can be tested.

``truth`` is an entry of the sealed answers, ``verdict`` a file of ``verdicts/``; both are described in
``docs/conceal.md``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

# Counted as right under either list (contract), with the words a parameter list may use for them.
EITHER_LIST: dict[str, tuple[str, ...]] = {
    "payload": ("payload", "payload_mass", "mass"),
    "armature": ("armature", "rotor_inertia"),
    "effort_scale": ("effort_scale", "torque_constant", "gear"),
    "gravity_tilt": ("gravity_tilt", "gravity"),
}

# Wrong values that these names state as well: a body's inertia about its own joint is one with the motor's.
VALUES_OF: dict[str, tuple[str, ...]] = {"payload": ("mass",), "armature": ("armature", "inertia")}


@dataclass(frozen=True)
class Interval:
    """One stated 90 % interval against the true value."""

    effect: str
    parameter: str
    inside: bool
    relative_error: float


@dataclass(frozen=True)
class CaseScore:
    """What one case contributes to the table; None where a measure does not apply.

    Attributes:
        answered: ``verdict`` of the tool, ``refused`` for exit code 4, ``none`` for no answer.
        named: Effects named, best first; empty unless the verdict is ``physics_missing``.
        top1: First name is a true one.
        top1_or_class: First name is true or in its declared equivalence class.
        in_set: First name or its ``could_also_be`` holds a true name; ``set_size`` counts that set.
        all_named: Every true effect is among the names (or its class is); ``extra`` counts invented ones.
        all_named_exactly: Every true effect is among the names itself; None in scores of older versions.
        expected: Verdicts that were right; none in scores of older versions.
        probability: What the tool stated of its first name, whatever the case hides.
        name_right: Naming was right and the first name is a true one; None where no probability is stated, and in
            scores of older versions.
    """

    case: str
    group: str
    variant: str
    strength: float | None
    clear: bool
    answered: str
    right_verdict: bool
    truth_names: tuple[str, ...] = ()
    named: tuple[str, ...] = ()
    top1: bool | None = None
    top1_or_class: bool | None = None
    in_set: bool | None = None
    set_size: int | None = None
    joint_right: bool | None = None
    iou: float | None = None
    false_alarm: bool | None = None
    wrong_name: bool | None = None
    all_named: bool | None = None
    all_named_exactly: bool | None = None
    extra: int | None = None
    oracle_ratio: float | None = None
    expected: tuple[str, ...] = ()
    probability: float | None = None
    name_right: bool | None = None
    wall_s: float | None = None
    intervals: list[Interval] = field(default_factory=list)


def score_case(
    case: str, truth: dict[str, Any], verdict: dict[str, Any], tracks: dict[str, dict[str, np.ndarray]]
) -> CaseScore:
    """Score one case.

    Args:
        case: Its name.
        truth: Sealed entry.
        verdict: ``exit_code``, ``wall_s`` and ``gap`` (the tool's JSON or None).
        tracks: Per role the columns of its CSV, for regimes stated as ranges of q and dq, and the order of joints.
    """
    gap = verdict.get("gap") or {}
    answered = _answered(verdict, gap)
    effects = truth["effects"]
    right = answered in truth["expected"]
    entries = _entries(gap) if answered == "physics_missing" else []
    names = _names(entries, gap, answered)
    missing = bool(effects) and truth["group"] in ("single", "masked", "pairs", "triples", "unknown")
    scored = missing and "physics_missing" in truth["expected"] and truth["group"] != "unknown"
    true_names = tuple(e["name"] for e in effects)
    off = truth.get("parameters_off") or []
    probability = _probability(entries)
    right = right or (scored and answered == "parameter_off" and bool(names) and names[0] in true_names)
    return CaseScore(
        case=case,
        group=truth["group"],
        variant=truth["variant"],
        strength=min((e["target"] for e in effects), default=None) if missing else None,
        clear=all(e["clear"] for e in effects),
        answered=answered,
        right_verdict=right,
        truth_names=true_names,
        named=names,
        top1=names[:1] != () and names[0] in true_names if scored else None,
        top1_or_class=_any_alike(names[:1], effects) if scored else None,
        in_set=bool(_first_set(names, entries, gap) & set(true_names)) if scored else None,
        set_size=len(_first_set(names, entries, gap)) if scored and names else None,
        joint_right=_joint_right(gap, entries, effects) if missing else None,
        iou=_iou(gap, entries, effects, tracks) if missing else None,
        false_alarm=_false_alarm(answered, names) if truth["group"] == "clean" else None,
        wrong_name=answered == "physics_missing" and bool(names) if truth["group"] == "unknown" else None,
        all_named=_all_named(names, effects) if scored and len(effects) > 1 else None,
        all_named_exactly=set(true_names) <= set(names) if scored and len(effects) > 1 else None,
        extra=_extra(names, effects, off) if scored else None,
        oracle_ratio=_oracle_ratio(truth, gap, tracks) if missing else None,
        expected=tuple(truth["expected"]),
        probability=probability,
        name_right=_name_right(names[0], true_names if scored else (), off)
        if probability is not None
        else None,
        wall_s=gap.get("wall_s", verdict.get("wall_s")),
        intervals=intervals(effects, entries) if scored else [],
    )


def _answered(verdict: dict[str, Any], gap: dict[str, Any]) -> str:
    if verdict.get("exit_code") == 4:
        return "refused"
    return str(gap.get("verdict", "none"))


def _entries(gap: dict[str, Any]) -> list[dict[str, Any]]:
    """Named effects, most probable first."""
    return sorted(gap.get("effects") or [], key=lambda e: -float(e.get("probability") or 0.0))


def _names(entries: list[dict[str, Any]], gap: dict[str, Any], answered: str) -> tuple[str, ...]:
    """Catalogue names given, best first; entries of the parameter list count for the four that may be there."""
    names = [str(e.get("name")) for e in entries]
    if answered in ("parameter_off", "physics_missing"):
        for entry in gap.get("parameters_off") or []:
            for name, words in EITHER_LIST.items():
                if entry.get("name") in words and name not in names:
                    names.append(name)
    return tuple(names)


def _alike(name: str, effect: dict[str, Any]) -> bool:
    return name == effect["name"] or name in effect["same_as"]


def _any_alike(names: tuple[str, ...], effects: list[dict[str, Any]]) -> bool:
    return any(_alike(n, e) for n in names for e in effects)


def _first_set(names: tuple[str, ...], entries: list[dict[str, Any]], gap: dict[str, Any]) -> set[str]:
    """The first name and what else it could be, wherever it stands: among the effects or the parameters."""
    if not names:
        return set()
    words = EITHER_LIST.get(names[0], ())
    first = entries[:1] or [p for p in gap.get("parameters_off") or [] if p.get("name") in words][:1]
    return {names[0], *(str(n) for e in first for n in e.get("could_also_be") or [])}


def _joint_right(gap: dict[str, Any], entries: list[dict[str, Any]], effects: list[dict[str, Any]]) -> bool:
    places = [e.get("joint") for e in entries[:1]] or [w.get("joint") for w in (gap.get("where") or [])[:1]]
    return bool(places) and places[0] in {e["joint"] for e in effects}


def _false_alarm(answered: str, names: tuple[str, ...]) -> bool:
    """Physics invented; the four names that may stand under either list are a wrong parameter, not physics."""
    if answered == "unknown":
        return True
    return answered == "physics_missing" and not (names and set(names) <= set(EITHER_LIST))


def _all_named(names: tuple[str, ...], effects: list[dict[str, Any]]) -> bool:
    return all(any(_alike(n, e) for n in names) for e in effects)


def _extra(names: tuple[str, ...], effects: list[dict[str, Any]], off: list[dict[str, Any]]) -> int:
    return sum(not any(_alike(n, e) for e in effects) and not _stands_for(n, off) for n in names)


def _name_right(name: str, askable: tuple[str, ...], off: list[dict[str, Any]]) -> bool:
    return name in askable or _stands_for(name, off)


def _stands_for(name: str, off: list[dict[str, Any]]) -> bool:
    """Whether a name is that of a value which is wrong in the model file: right under either list."""
    return any(entry["name"] in VALUES_OF.get(name, ()) for entry in off)


def _probability(entries: list[dict[str, Any]]) -> float | None:
    stated = entries[0].get("probability") if entries else None
    return None if stated is None else float(stated)


def _oracle_ratio(
    truth: dict[str, Any], gap: dict[str, Any], tracks: dict[str, dict[str, np.ndarray]]
) -> float | None:
    """(before − after) / (before − oracle) on the held-out recording, of the joint that was off most before.

    The oracle is the true machine under its control law, so a prediction without one does not compare.

    Returns:
        None where nothing was predicted in closed loop, or there is too little to gain.
    """
    fit = gap.get("fit") or {}
    columns = next(iter(tracks.values()), {})
    joints = [column[2:] for column in columns if column.startswith("q.")]
    oracles = truth["holdout"]["per_joint_oracle"]
    stated = fit.get("per_joint") or ({joints[0]: fit} if len(joints) == 1 else {})
    if not fit.get("closed_loop", True) or len(oracles) != len(joints):
        return None
    found = []
    for joint, oracle in zip(joints, oracles, strict=True):
        before, after = (stated.get(joint, {}).get(f"holdout_{when}") for when in ("before", "after"))
        if before is not None and after is not None:
            found.append((before, after, oracle))
    before, after, oracle = max(found, default=(0.0, 0.0, 0.0))
    return float((before - after) / (before - oracle)) if before > 0.0 and before >= 1.5 * oracle else None


# -- when and where -------------------------------------------------------------------------------------


def _iou(
    gap: dict[str, Any],
    entries: list[dict[str, Any]],
    effects: list[dict[str, Any]],
    tracks: dict[str, dict[str, np.ndarray]],
) -> float | None:
    """Overlap of stated and true time, best over the true effects; 0 when nothing is stated."""
    values = [v for e in effects if (v := _iou_of(gap, e, tracks)) is not None]
    return max(values) if values else None


def _iou_of(
    gap: dict[str, Any], effect: dict[str, Any], tracks: dict[str, dict[str, np.ndarray]]
) -> float | None:
    regime, joint = effect["regime"], effect["joint"]
    track = tracks.get(regime["recording"])
    if track is None or not regime["t"]:
        return None
    true = _in_intervals(track["t"], regime["t"])
    stated = np.zeros_like(true)
    for where in gap.get("where") or []:
        if where.get("joint") == joint and where.get("regime"):
            stated |= _stated(where["regime"], track, joint)
    union = np.count_nonzero(true | stated)
    return float(np.count_nonzero(true & stated) / union) if union else None


def _in_intervals(t: np.ndarray, intervals_: list[list[float]]) -> np.ndarray:
    inside = np.zeros(t.size, bool)
    for begin, end in intervals_:
        inside |= (t >= begin) & (t <= end)
    return inside


def _stated(regime: dict[str, Any], track: dict[str, np.ndarray], joint: str) -> np.ndarray:
    """Rows a stated regime covers: its time intervals if it has any, else its box in q and dq."""
    if regime.get("t"):
        return _in_intervals(track["t"], regime["t"])
    inside = np.ones(track["t"].size, bool)
    for name in ("q", "dq"):
        box = regime.get(name)
        if box and f"{name}.{joint}" in track:
            inside &= (track[f"{name}.{joint}"] >= box[0]) & (track[f"{name}.{joint}"] <= box[1])
    return inside


# -- parameters -----------------------------------------------------------------------------------------


def intervals(effects: list[dict[str, Any]], entries: list[dict[str, Any]]) -> list[Interval]:
    """Every stated 90 % interval whose parameter has a true counterpart; see ``score_parameters``."""
    from s2r_conceal.score_parameters import true_values

    found = []
    for entry in entries:
        effect = next((e for e in effects if e["name"] == entry.get("name")), None)
        if effect is None:
            continue
        true = true_values(effect)
        for name, stated in (entry.get("parameters") or {}).items():
            bounds = stated.get("interval90")
            if name in true and bounds and stated.get("identifiable", True):
                value = true[name]
                error = abs(float(stated["value"]) - value) / max(abs(value), 1e-12)
                inside = bool(bounds[0] <= value <= bounds[1])
                found.append(Interval(effect["name"], name, inside, error))
    return found
