"""The whole way from files to an answer."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from s2r_host.gap.config import GapConfig
from s2r_host.gap.effects.base import Context
from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.motion.align import control_lag
from s2r_host.gap.motion.aligned import aligned, lags_of
from s2r_host.gap.motion.behind_gear import links_alone
from s2r_host.gap.motion.checks import check_efforts, check_gains, check_joints, check_units
from s2r_host.gap.motion.law import stamps_within
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.registration import registered
from s2r_host.gap.motion.servo_law import with_speeds_used
from s2r_host.gap.motion.session import Session, make_session, work_grid, wrench_bodies
from s2r_host.gap.motion.slow_log import filled
from s2r_host.gap.output.generic import fit_generic
from s2r_host.gap.recordings.files import read_recording
from s2r_host.gap.recordings.holes import stretches
from s2r_host.gap.recordings.names import distinct_names
from s2r_host.gap.regression.base_terms import PREFIX, BaseTerm
from s2r_host.gap.regression.friction_edge import find_edges
from s2r_host.gap.regression.problem import Problem, build_problem
from s2r_host.gap.regression.second_run import beside_first, find_partner, no_partner
from s2r_host.gap.regression.seeds import fill_residuals
from s2r_host.gap.regression.solution import Solution
from s2r_host.gap.search.search import Search
from s2r_host.gap.simulation.forward import Errors, evaluate
from s2r_host.gap.simulation.polish import drifts_freely, friction_change, polish
from s2r_host.gap.simulation.replay import Live, Twin, build_twin, has_loop, run
from s2r_host.gap.simulation.worsened import worsened
from s2r_host.gap.verdict import insufficient
from s2r_host.gap.verdict.decide import decide, restate, unnamed_force, unnamed_force_beside
from s2r_host.gap.verdict.decision import LEFTOVER_LIMIT, Decision, doubt
from s2r_host.gap.verdict.other_equations import BEHIND_THE_SENSOR
from s2r_host.gap.verdict.where import Place, acting, contradicted, locate, narrowed, somewhere, with_named

Log = Callable[[str], None]


LEAST_STEPS = 7  # of the work grid: three at each end are left out of every comparison
STAMPS_SHARE = 0.15  # one deviation, of a shift of the stamps that the law excludes clearly
UNTOUCHED = ("nothing_missing", "parameter_off")  # answers that a floor guessed too high gives as well
FINER = 0.95  # of the guessed floor: below it the channels' own noise is worth a second look
# The same on joints of which the first look has named an effect, maybe for what a better one explains.
MUCH_FINER = 0.25
FAR_ABOVE = 2.0  # times the leftover that is unknown above a measured floor


@dataclass
class Analysis:
    """Everything an answer and a report are made from."""

    model: RigidModel
    fit: list[Session]
    hold: list[Session]
    repeats: list[Session]
    problem: Problem | None
    search: Search | None
    decision: Decision | None
    places: list[Place]
    before: Errors | None
    after: Errors | None
    twin: Twin | None
    verdict: str
    notes: list[str] = field(default_factory=list)
    baselines: dict = field(default_factory=dict)
    next_experiment: dict = field(
        default_factory=lambda: {"separates": [], "trajectory": None, "why": ""}  # nothing is left to split
    )
    started: float = field(default_factory=time.monotonic)


def load_sessions(
    model: RigidModel, paths: list[Path], first: int, notes: list[str], names: dict[Path, str] | None = None
) -> list[Session]:
    """Read, check and resample recordings; their costs go to ``notes``.

    Args:
        model: The nominal model.
        paths: The recordings.
        first: Number of the first of them.
        notes: For people.
        names: What they are called, beside others; None: by their files.
    """
    sessions: list[Session] = []
    for path in paths:
        whole = read_recording(path, None if names is None else names[path])
        notes += check_joints(model, whole) + [f"{whole.name}: {w}" for w in whole.warnings]
        pieces, said = stretches(whole)
        notes += said
        for piece in pieces:
            rec, said = with_speeds_used(piece)
            notes += said
            steps = len(work_grid(rec)[0])
            if steps < LEAST_STEPS:
                short = f"{rec.name}: lasts {rec.t[-1]:.2g} s, {steps} steps of what is compared, and {LEAST_STEPS} are"
                if len(pieces) == 1:
                    raise GapRecordingError(f"{short} needed; is 't' in s? Record for several seconds")
                notes.append(f"{short} needed: it is left out")
                continue
            s = make_session(model, filled(model, rec), first + len(sessions))
            check_efforts(model, s)
            check_units(model, s)
            check_gains(model, s)
            sessions.append(s)
    return sessions


def _untie_what_is_pulled(model: RigidModel, paths: list[Path]) -> list[str]:
    """A recorded wrench on what a tied joint moves is what ties it: that joint is then one of its own."""
    if not model.ties:
        return []
    recorded = [read_recording(path) for path in paths]
    pulled = {body for rec in recorded for body in wrench_bodies(model, rec, rec.t)}
    free = [t for t in model.ties if pulled & set(model.subtree_bodies(model.joints[t.follower]))]
    model.ties = tuple(t for t in model.ties if t not in free)
    return [
        f"'{model.joints[t.follower]}' is pulled by a recorded wrench: that it is tied to '{model.joints[t.leader]}' "
        "in the model is not used"
        for t in free
    ]


def analyse(
    model_path: Path,
    fit_paths: list[Path],
    hold_paths: list[Path],
    repeat_paths: list[Path],
    config: GapConfig,
    log: Log,
) -> Analysis:
    """Run the tool.

    Raises:
        GapRecordingError: A recording was refused.
        GapModelError: The model was refused.
    """
    started = time.monotonic()
    model = RigidModel(model_path)
    notes = [*model.left_out, *model.inertia_replaced()]
    log(f"model {model.path.name}: joints {', '.join(model.joints)}")
    notes += _untie_what_is_pulled(model, [*fit_paths, *hold_paths, *repeat_paths])
    names = distinct_names([*fit_paths, *hold_paths, *repeat_paths])
    fit = load_sessions(model, fit_paths, 0, notes, names)
    hold = load_sessions(model, hold_paths, len(fit), notes, names)
    repeats = load_sessions(model, repeat_paths, len(fit) + len(hold), notes, names)
    placed = registered(model, fit + hold + repeats, notes)
    fit, hold, repeats = (
        placed[: len(fit)],
        placed[len(fit) : len(fit) + len(hold)],
        placed[len(fit) + len(hold) :],
    )
    notes += [why for twin in repeats if (why := no_partner(twin, fit)) is not None]
    repeats = [beside_first(model, twin, fit) for twin in repeats]
    if not hold:
        notes.append(
            "no held-out recording given: the last 30 % of each fit recording is held out, of each of several strokes "
            "three of ten stretches"
        )
    a = Analysis(model, fit, hold, repeats, None, None, None, [], None, None, None, "insufficient", notes)
    a.started = started
    reason = (
        insufficient.no_effort(model, fit)
        or insufficient.too_short(model, fit)
        or insufficient.at_rest(model, fit)
    )
    if reason:
        a.notes.insert(0, reason)
        _without_effort(a, log)
    else:
        _with_effort(a, config, log)
    return a


def _with_effort(a: Analysis, config: GapConfig, log: Log) -> None:
    sessions = a.fit + a.hold + a.repeats
    find_edges(sessions, a.model)
    log("residual efforts and noise floor")
    problem = _stated(a, config)
    log("search over the catalogue")
    search = Search(problem, frozenset(config.skip), log)
    decision = decide(problem, search, log)
    finer = _second_look(a, config, problem, decision, log) if problem.floor_source != "repeat" else None
    named = finer is not None and finer[2].verdict == "physics_missing"
    if finer is not None and named and not (decision.verdict in UNTOUCHED and unnamed_force_beside(*finer)):
        problem, search, decision = finer
    if decision.verdict in UNTOUCHED:
        unnamed_force(problem, search, decision)
    if decision.verdict in UNTOUCHED and finer is not None:
        problem, search, decision = finer
    a.problem, a.search, a.decision, a.verdict = problem, search, decision, decision.verdict
    a.places = _places(problem, search, decision)
    reason = insufficient.no_motion(a.model, a.fit, problem)
    if reason is None and decision.verdict in ("nothing_missing", "parameter_off"):
        reason = insufficient.poor_excitation(a.model, a.fit, problem)
    if reason is None and decision.verdict == "nothing_missing":
        reason = insufficient.passes_for_noise(problem)
    if reason:
        a.verdict = decision.verdict = "insufficient"
        a.notes.insert(0, reason)
    elif decision.verdict != "unknown" and (wide := insufficient.wide_guess(problem)):
        a.notes.append(wide)
    if (
        decision.verdict == "physics_missing"
        and not any(has_loop(a.model, s) for s in a.fit)
        and not any(search.effects[t.effect].simulated_by_mean for t in decision.solution.terms)
        and drifts_freely(problem)
    ):
        log("numbers refitted on the simulated motion")

        def miss(solution: Solution, s: Session, start: int, stop: int) -> np.ndarray:
            motion = run(patched_twin(a, solution, decision.verdict), s, start, stop, closed=False)
            return motion.q[:, 0] - s.q[start:stop, 0]

        decision.solution = polish(problem, search, decision.solution, a.hold, miss)
        restate(problem, search, decision)
    a.twin = patched_twin(a, decision.solution, decision.verdict)
    a.notes += [
        f"the encoder of '{a.model.joints[j]}' is behind its gear: in model_patched.xml the motor is that joint, and "
        "what the encoder sees is that joint and the one behind it together"
        for j in sorted(a.twin.at_link)
    ]
    if config.calibrate_s > 0:
        _calibrate(a, config.calibrate_s)
    if config.simulate:
        log("forward simulation before and after")
        nominal = build_twin(a.model, problem.ctx, [])
        joints = list(problem.joints)
        a.before = evaluate(nominal, a.fit, a.hold, joints, config.open_loop_window_s)
        a.after = evaluate(a.twin, a.fit, a.hold, joints, config.open_loop_window_s)
        _doubt_patch(a, nominal)


def _second_look(
    a: Analysis, config: GapConfig, problem: Problem, decision: Decision, log: Log
) -> tuple[Problem, Search, Decision] | None:
    """The same under a floor that the channels' own noise bounds, where that is worth it and tells more.

    A guessed floor holds what its generic correction does not follow. More is a name, or that nothing explains what is
    far above the bounded floor where the first look found no more than numbers.
    """
    finer = _stated(a, config, bounded=True)
    named = {e.joint for e in decision.effects}
    share = {j: MUCH_FINER if a.model.joints[j] in named else FINER for j in problem.joints}
    if all(finer.floor[j] >= share[j] * problem.floor[j] for j in problem.joints):
        return None
    log("search under the noise of the channels alone")
    search = Search(finer, frozenset(config.skip), log)
    found = decide(finer, search, log)
    far_above = found.leftover > FAR_ABOVE * LEFTOVER_LIMIT * doubt(finer)
    if found.verdict == "unknown" and far_above:
        return finer, search, found
    if found.verdict != "physics_missing":
        return None
    if decision.verdict == "physics_missing" and _held(found) > _held(decision):
        return None  # a finer floor is no reason to take names that predict the held-out effort worse
    return finer, search, found


def _held(decision: Decision) -> float:
    """Mean square of the held-out effort that an explanation leaves over [N²·m² or N²]."""
    return decision.solution.raw_held[1]


def _stated(a: Analysis, config: GapConfig, *, bounded: bool = False) -> Problem:
    """The regression with what law, kinematics and stamps say beforehand; ``bounded``: see ``build_problem``."""
    fit, hold, repeats = a.fit, a.hold, a.repeats
    assemble = partial(build_problem, a.model, bounded=bounded, skip=config.skip)
    problem = assemble(fit, hold, repeats)
    late = [f for f in problem.law if f.name == "clock_skew"]
    if late:
        fit, hold, repeats = (aligned(a.model, x, lags_of(late)) for x in (fit, hold, repeats))
        find_edges(fit + hold + repeats, a.model)
        for raw, moved in zip(a.fit + a.hold + a.repeats, fit + hold + repeats, strict=True):
            raw.lead[:], raw.v_eps[:] = moved.lead, moved.v_eps
        before, problem = problem, assemble(fit, hold, repeats)
        problem.law = late + [f for f in problem.law if f.name != "clock_skew"]
        problem.set_right = _set_right(before, problem)
    behind = [c.joint for c in problem.contradictions if c.finding is not None]
    if behind:
        links = [links_alone(a.model, x, behind) for x in (fit, hold, repeats)]
        find_edges(links[0] + links[1] + links[2], a.model)
        seen = problem.law, problem.contradictions, problem.set_right
        problem = assemble(*links)
        problem.law, problem.contradictions, problem.set_right = seen
    problem.contradictions = [
        replace(c, finding=None) if c.finding is not None and c.finding.name in config.skip else c
        for c in problem.contradictions
    ]
    if "session_friction" in config.skip:
        problem.drift.clear()
    fill_residuals(problem)
    for j in problem.joints:
        lag = control_lag(a.model, fit, j)
        if lag is not None:
            problem.ctx.control_lag[j] = lag
        within = None if any(f.joint == j for f in problem.law) else stamps_within(a.model, fit, j)
        if lag is None and within is not None:
            problem.ctx.control_lag[j] = (0.0, STAMPS_SHARE * within)
    for f in late:
        problem.ctx.control_lag[f.joint] = (0.0, 0.0005)
    return problem


def _set_right(before: Problem, after: Problem) -> float:
    """Share of the residual effort's power that went when late stamps were set right."""
    was, left = (float(np.mean(np.square(one.raw))) for one in (before, after))
    return 1.0 - left / max(was, 1e-30)


def _doubt_patch(a: Analysis, nominal: Twin) -> None:
    """Say so where the patched model predicts held-out motion worse.

    A generic correction is taken back then, and so are numbers beside which no effect was named: numbers that are off
    have to show in the motion.
    """
    assert a.decision is not None
    assert a.problem is not None
    assert a.before is not None
    assert a.after is not None
    found = worsened(a.before, a.after, list(a.problem.joints), _position_floor(a))
    if found is None:
        return
    j, was, now = found
    name = a.model.joints[j]
    said = f"the held-out motion of '{name}' worse than the nominal model ({was:.3g} to {now:.3g} {a.model.unit(name)})"
    if a.verdict == "unknown":
        a.notes.append(f"a generic correction predicts {said} and is left out of the patched model")
        a.twin, a.after = nominal, a.before
    elif a.verdict == "parameter_off":
        changed = ", ".join(p["name"] for p in a.decision.parameters_off)
        a.notes.append(f"{changed} explained effort, but would predict {said}: taken back")
        a.verdict = a.decision.verdict = "nothing_missing"
        a.decision.parameters_off, a.places = [], []
        a.twin, a.after = nominal, a.before
    else:
        a.notes.insert(
            0, f"the patched model predicts {said}: do not simulate with it, whatever its names are worth"
        )


def _places(problem: Problem, search: Search, decision: Decision) -> list[Place]:
    """Where the gap lives; what is named gives the regime in which it acts."""
    if decision.verdict == "nothing_missing":
        return []
    rows = problem.raw
    if len(problem.joints) > 1:  # a mass that is slightly wrong shows on all joints below it and is no place
        rows = search.finish([], [], []).unexplained
    places = with_named(problem, rows, locate(problem, rows), decision)
    if decision.contradictions:
        return [contradicted(problem, c) for c in decision.contradictions]
    if decision.touched is not None:
        return [contradicted(problem, decision.touched)]
    if decision.verdict == "unknown":
        return somewhere(problem, rows, places)
    if decision.verdict != "physics_missing":
        return places
    found = []
    for place in places:
        joint = problem.ctx.model.index(place.joint)
        acts = acting(search, decision, joint)
        found.append(place if acts is None else narrowed(place, acts[0], joint, acts[1]))
    return found


def _calibrate(a: Analysis, seconds: float) -> None:
    """Read one friction change per new held-out session from its first seconds; the notes announce it."""
    assert a.problem is not None
    assert a.search is not None
    assert a.decision is not None
    assert a.twin is not None
    solution = a.decision.solution
    for drift in a.problem.drift:
        s, j = drift.blocks[0].session, drift.blocks[0].joint
        change = friction_change(a.problem, a.search, solution, s, j, seconds)
        a.twin.friction_factor.setdefault(s.rec.session, np.ones(len(a.model.joints)))[j] = 1.0 + change
        a.notes.append(
            f"calibrated: friction of '{a.model.joints[j]}' in session '{s.rec.session}' changed by {change:+.2%}, "
            f"read from its first {seconds:g} s"
        )


def _without_effort(a: Analysis, log: Log) -> None:
    log("the effort cannot be compared: position only")
    ctx = Context(a.model, a.fit)
    nominal = build_twin(a.model, ctx, [])
    a.twin = nominal
    a.before = a.after = evaluate(nominal, a.fit, a.hold, list(range(len(a.model.joints))))


def patched_twin(a: Analysis, solution: Solution, verdict: str) -> Twin:
    """The model with what was found; for an unknown effect, with a generic local correction."""
    problem = a.problem
    assert problem is not None
    if verdict in ("nothing_missing", "insufficient"):
        return build_twin(a.model, problem.ctx, [])
    if verdict == "unknown":
        return build_twin(a.model, problem.ctx, fit_generic(problem))
    geared = {
        c.joint for c in problem.contradictions if c.finding is not None
    }  # their transmission is known better
    terms = [
        Live(t.effect, t.joint, dict(t.shape), th)
        for t, th in zip(solution.terms, solution.theta, strict=True)
        if t.joint not in geared or t.effect not in BEHIND_THE_SENSOR
    ]
    if a.decision is not None:
        terms += [Live(f.name, f.joint, f.shape, np.zeros(0)) for f in a.decision.law if not f.of_effort]
    base = [(p, x) for p, x in problem.moved(solution.base) if abs(x) * p.size > 0]
    assert a.search is not None
    for t in list(terms):
        effect = a.search.effects[t.effect]
        if t.effect.startswith(PREFIX) and isinstance(effect, BaseTerm):
            base += [(m, float(x)) for m, x in zip(effect.members, effect.moves(t.theta), strict=True)]
            terms.remove(t)
    merged: dict[int, tuple] = {}
    for p, x in base:
        old = merged.get(id(p), (p, 0.0))[1]
        merged[id(p)] = (p, old + x)
    return build_twin(a.model, problem.ctx, terms, list(merged.values()))


def floor_json(a: Analysis) -> dict:
    """Repeatability of position and effort, over all joints."""
    q = _position_floor(a)
    if a.problem is None:
        return {"q_rmse": q, "tau_rmse": 0.0, "source": "repeat" if a.repeats else "estimated"}
    tau = float(np.sqrt(np.mean([f**2 for f in a.problem.floor.values()])))
    return {"q_rmse": q, "tau_rmse": tau, "source": a.problem.floor_source}


def _position_floor(a: Analysis) -> float:
    values = []
    for twin in a.repeats:
        partner = find_partner(twin, a.fit)
        if partner is not None:
            n = min(len(twin.t), len(partner.t))
            values.append(float(np.mean((twin.q[:n] - partner.q[:n]) ** 2)) / 2.0)
    if values:
        return float(np.sqrt(np.mean(values)))
    return float(max((s.q_lsb.max() / np.sqrt(12.0) for s in a.fit), default=0.0))
