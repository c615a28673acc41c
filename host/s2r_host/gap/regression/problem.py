"""The effort residual of all recordings as one whitened regression, split into fit and held-out rows."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np

from s2r_host.gap.effects.base import Columns, Context
from s2r_host.gap.motion.kinematics import Contradiction, contradiction, parted_ties
from s2r_host.gap.motion.law import LawFinding, check_law, stamps_agree
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session
from s2r_host.gap.regression.drift import Drift
from s2r_host.gap.regression.evidence import Whitener, fit_whitener
from s2r_host.gap.regression.floor import (
    LEAST_ROWS,
    floor_level,
    noise_samples,
    rms,
    rms_doubt,
    without_rests,
)
from s2r_host.gap.regression.friction_seen import TRUSTED, dry_level, friction_levels, trust
from s2r_host.gap.regression.nuisance import COMPARISON, BaseParameter, base_parameters, recording_gains
from s2r_host.gap.regression.rows import Block, band, compare, least_cut, make_blocks
from s2r_host.gap.regression.second_run import find_partner
from s2r_host.gap.regression.unrepeated import Wander, wandering

EDGE_SHARE = 0.5
EQUATIONS = 2e-3  # of the effort: steps of an integration and filters err so much where nothing else does
TIMING_KNOWN = 0.3  # of the usual doubt, where the control law shows when its effort was logged


@dataclass(frozen=True)
class Twin:
    """Second runs of fitted motions, seen through the same filters: what comes back in both is no noise.

    Attributes:
        problem: Rows of the second runs alone.
        pairs: Block of the fitted run and block of its second run.
    """

    problem: Problem
    pairs: list[tuple[Block, Block]]


@dataclass
class Problem:
    """Residual, nuisance and noise model.

    Attributes:
        ctx: Model and sessions.
        joints: Joints with an effort channel, as indices.
        blocks: Row ranges in stacking order.
        y: Whitened residual, shape (rows,).
        raw: The same rows, filtered but not whitened [N·m or N].
        held: Mask of held-out rows, shape (rows,).
        base: Base parameters; ``B`` their whitened columns, ``prior`` their deviations.
        floor: Noise per joint in ``raw`` units (rms), keyed by joint index.
        floor_doubt: Factor by which the floor may be too low, from the effective number of its samples.
        alike: Share of the floor's power, per joint, that two runs of one motion have in common: steps of an encoder.
        trust: Trust in each row, at most one: less where dry friction may stick and the sign of motion is a guess.
        weight: What whitened rows are multiplied with, trust included; an arm's joints are levelled by it, too.
        effort: Filtered effort rows, same layout, whitened.
        drift: Friction changes of new held-out sessions; ``law`` where the declared control law does not hold;
            ``contradictions`` where position and speed of a joint do not agree; ``twin`` the second runs;
            ``wanders`` slow forces that no second run repeats.
        set_right: Share of the residual effort's power that went with the lateness of stamps that the law tells.
    """

    ctx: Context
    joints: list[int]
    blocks: list[Block]
    whiteners: dict[int, Whitener]
    y: np.ndarray
    raw: np.ndarray
    effort: np.ndarray
    held: np.ndarray
    base: list[BaseParameter]
    B: np.ndarray
    prior: np.ndarray
    floor: dict[int, float]
    floor_source: str
    weight: np.ndarray
    floor_doubt: float = 1.0
    alike: dict[int, float] = field(default_factory=dict)
    drift: list[Drift] = field(default_factory=list)
    law: list[LawFinding] = field(default_factory=list)
    set_right: float = 0.0
    contradictions: list[Contradiction] = field(default_factory=list)
    twin: Twin | None = None
    wanders: list[Wander] = field(default_factory=list)
    cache: dict = field(default_factory=dict)
    trust: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.trust = self.weight.copy()

    def prior_at(self, looseness: float | np.ndarray) -> np.ndarray:
        """Prior deviations of the base parameters with the machine's numbers trusted more or less, (parameters,).

        How far efforts are off in comparison (timing, a recording's scale) has nothing to do with that trust.

        Args:
            looseness: Factor on the prior deviations, alike or one by one.
        """
        machine = np.array([p.name not in COMPARISON for p in self.base], dtype=bool)
        return self.prior * np.where(machine, looseness, 1.0)

    def moved(self, coefficients: np.ndarray) -> list[tuple[BaseParameter, float]]:
        """Base parameters of the machine with their coefficients; what is of the comparison alone is left out.

        Args:
            coefficients: Of ``base``, shape (parameters,).
        """
        pairs = zip(self.base, coefficients, strict=True)
        return [(p, float(x)) for p, x in pairs if p.name not in COMPARISON]

    def whiten(
        self, per_session: dict[int, np.ndarray], joint: int, smooth: dict[int, np.ndarray] | None = None
    ) -> np.ndarray:
        """Filter, decimate, whiten and stack a regressor.

        Args:
            per_session: Session number -> array (time,) on ``joint`` or (time, joint).
            joint: The joint a one-dimensional array belongs to.
            smooth: The part of it that was made from filtered motion alone (``Columns.smooth``), same shapes.
        """
        out = np.zeros(len(self.y))
        for block in self.blocks:
            x = per_session.get(block.session.index)
            if x is None:
                continue
            part = None if smooth is None else smooth[block.session.index]
            rest = None if part is x else x if part is None else x - part
            if x.ndim == 1 and block.joint != joint:
                continue
            rows = np.zeros(len(x))
            for made, nonlinear in ((part, False), (rest, True)):
                if made is not None:
                    own = made if made.ndim == 1 else made[:, block.joint]
                    rows = rows + compare(own, block.session, block.joint, nonlinear)
            out[block.rows] = self.whiteners[block.joint](rows[block.picks])
        return out * self.weight

    def rms(self, rows: np.ndarray, block: Block, mask: np.ndarray) -> float:
        """Root mean square of effort rows of a block where ``mask`` holds, each row as trusted as its weight.

        Under a guessed floor rows in which the joint may stick count only where there are no others, and then by what
        they are doubted.
        """
        if self.floor_source != "repeat":
            trusted = mask & (self.trust[block.rows] ** 2 >= TRUSTED)
            if trusted.sum() < LEAST_ROWS:
                return float(np.sqrt(np.mean((self.trust[block.rows] * rows[block.rows])[mask] ** 2)))
            mask = trusted
        trust = self.trust[block.rows][mask]  # a doubted row may be off by its floor over its trust
        return float(
            np.sqrt(trust**2 @ (trust * rows[block.rows][mask]) ** 2 / max(float(trust @ trust), 1e-12))
        )

    def columns(self, per_session: dict[int, Columns], joint: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Whitened matrix (rows, k) and fixed column of an effect evaluated on every session."""
        first = next(iter(per_session.values()))
        matrix = np.stack(
            [
                self.whiten(
                    {k: c.linear[i] for k, c in per_session.items()},
                    joint,
                    {k: c.smooth[i] for k, c in per_session.items()} if first.smooth else None,
                )
                for i in range(len(first.linear))
            ],
            axis=1,
        ) if first.linear else np.zeros((len(self.y), 0))  # fmt: skip
        fixed = None
        if first.fixed is not None:
            fixed = self.whiten({k: c.fixed for k, c in per_session.items() if c.fixed is not None}, joint)
        return matrix, fixed


def build_problem(
    model: RigidModel,
    fit: list[Session],
    hold: list[Session],
    repeats: list[Session],
    *,
    bounded: bool = False,
    skip: Collection[str] = (),
) -> Problem:
    """Assemble the regression.

    Args:
        model: The nominal model.
        fit: Sessions that may be fitted.
        hold: Sessions that may only be predicted; when empty 30 % of each fit session are held.
        repeats: Second runs of a motion among ``fit``: they set the noise floor.
        bounded: Without second runs, the channels' own noise bounds the floor.
        skip: What the control law is not asked for.
    """
    ctx = Context(model, fit)
    sessions = fit + hold
    joints = [j for j in range(len(model.joints)) if any(s.has_u[j] for s in sessions)]
    blocks, raw = make_blocks(model, sessions, hold, joints)
    joints = [j for j in joints if any(b.joint == j and b.session in fit for b in blocks)]
    noise = noise_samples(model, joints, fit, repeats, blocks, raw)
    guessed = noise.source != "repeat"
    for j in joints:
        of_joint = [b for b in blocks if b.joint == j]
        heard = without_rests(of_joint, noise.size[j]) if guessed else noise.size[j]
        cut = band(model, j, fit, blocks, heard, guessed=guessed)
        for s in sessions + repeats:
            s.cut[j] = min(max(cut, least_cut(s)), float(s.cut[j]))
    _one_band(fit, repeats)
    blocks, raw = make_blocks(model, sessions, hold, joints)
    noise = noise_samples(model, joints, fit, repeats, blocks, raw)
    start = blocks[-1].rows.stop if blocks else 0
    held = [b.held for b in blocks]
    whiteners, floor, alike = {}, {}, {}
    for j in joints:
        scale = max(_moved_effort(s, j) for s in sessions if s.has_u[j])
        least = max(EQUATIONS * scale, 1e-12)
        whitener = fit_whitener(noise.course[j], least)
        own = max(rms(noise.course[j]), least)
        level = floor_level(model, sessions, blocks, noise.size[j], j, guessed=guessed, bounded=bounded)
        floor[j] = max(level, least)
        alike[j] = max(0.0, 1.0 - (rms(noise.size[j]) / max(level, 1e-12)) ** 2)
        whiteners[j] = replace(whitener, scale=whitener.scale * floor[j] / own)
    problem = Problem(
        ctx, joints, blocks, whiteners, np.zeros(start), np.concatenate(raw), np.zeros(start),
        np.concatenate(held), [*base_parameters(model), *recording_gains(model, sessions)], np.zeros((start, 0)),
        np.zeros(0), floor, noise.source,
        np.concatenate([trust(model, b, floor[b.joint], guessed=guessed) for b in blocks]),
    )  # fmt: skip
    for block, values in zip(blocks, raw, strict=True):
        w = whiteners[block.joint]
        problem.y[block.rows] = w(values)
        problem.effort[block.rows] = w(
            compare(block.session.u[:, block.joint], block.session, block.joint, True)[block.picks]
        )
    problem.y *= problem.weight
    problem.effort *= problem.weight
    _fill_base(problem, sessions)
    _fill_drift(problem, fit, hold)
    problem.floor_doubt = max((rms_doubt(noise.size[j]) for j in joints), default=1.0)
    if not guessed:
        problem.alike = alike
        problem.twin = _second_runs(model, problem, fit, repeats)
        problem.wanders = [w for j in joints if (w := wandering(model, j, fit, repeats)) is not None]
    problem.law = [f for j in joints if (f := check_law(model, fit, hold, j, skip)) is not None]
    problem.contradictions = [c for j in joints if (c := contradiction(model, fit, j)) is not None]
    problem.contradictions += [c for c in parted_ties(model, fit) if c.joint in joints]
    return problem


def _one_band(fit: list[Session], repeats: list[Session]) -> None:
    """Compare second runs and what they repeat in one band, that of the narrowest: they are held together by rows."""
    pairs = [(first, again) for again in repeats if (first := find_partner(again, fit)) is not None]
    for first, again in pairs:
        first.cut[:] = np.minimum(first.cut, again.cut)
    for first, again in pairs:
        again.cut[:] = first.cut


def _moved_effort(s: Session, j: int) -> float:
    """Spread of the effort that an equation has to balance: where none drives a joint, that of its inertia."""
    return float(np.std(s.u[:, j] if s.driven(j) else s.mass[:, j] * s.a[:, j]))


def _second_runs(
    model: RigidModel, problem: Problem, fit: list[Session], repeats: list[Session]
) -> Twin | None:
    """The rows of second runs, with the base parameters and the noise model of the first ones."""
    blocks, raw = make_blocks(model, repeats, [], problem.joints)
    pairs = []
    for block in blocks:
        partner = find_partner(block.session, fit)
        first = [b for b in problem.blocks if b.session is partner and b.joint == block.joint]
        pairs += [(b, block) for b in first]
    if not pairs:
        return None
    rows = blocks[-1].rows.stop
    twin = Problem(
        problem.ctx, problem.joints, blocks, problem.whiteners, np.zeros(rows), np.concatenate(raw), np.zeros(rows),
        np.zeros(rows, dtype=bool), problem.base, np.zeros((rows, len(problem.base))), problem.prior, problem.floor,
        problem.floor_source, np.concatenate([trust(model, b, problem.floor[b.joint]) for b in blocks]),
    )  # fmt: skip
    for block, values in zip(blocks, raw, strict=True):
        twin.y[block.rows] = twin.whiteners[block.joint](values)
    twin.y *= twin.weight
    for k, parameter in enumerate(problem.base):
        twin.B[:, k] = _base_column(twin, parameter)
    return Twin(twin, pairs)


def _fill_drift(problem: Problem, fit: list[Session], hold: list[Session]) -> None:
    known = {s.rec.session for s in fit}
    new: dict[tuple[str, int], list[Block]] = {}
    for block in problem.blocks:
        if block.session in hold and block.session.rec.session not in known:
            new.setdefault((block.session.rec.session, block.joint), []).append(block)
    for (_, j), blocks in new.items():
        levels = [friction_levels(problem.ctx.model, x, j) for x in fit if x.has_u[j]]
        if not levels:
            continue
        dry, viscous = np.mean(levels, axis=0)
        if dry <= 0:
            continue
        level = np.array([dry, viscous] if viscous > 0 else [dry])
        columns = np.concatenate([_friction_columns(problem, b)[:, : len(level)] for b in blocks])
        problem.drift.append(Drift(blocks, columns, level))


def _friction_columns(problem: Problem, block: Block) -> np.ndarray:
    """Whitened direction and speed of the motion in a block, shape (rows, 2)."""
    s, j, weight = block.session, block.joint, problem.weight[block.rows]
    parts = (compare(x, s, j, True)[block.picks] for x in (s.sign(j), s.v[:, j]))
    return np.stack([problem.whiteners[j](rows) * weight for rows in parts], axis=1)


def _fill_base(problem: Problem, sessions: list[Session]) -> None:
    columns, prior, kept = [], [], []
    limit = 1e-4 * float(np.sqrt(np.mean(problem.effort**2)))
    for parameter in problem.base:
        whitened = _base_column(problem, parameter)
        deviation = parameter.prior
        if parameter.name == "effort_offset":
            j = problem.ctx.model.index(parameter.place)
            if j not in problem.joints or all(s.rec.effort_sigma.get(parameter.place) for s in sessions):
                continue  # a declared accuracy says how far the zero may be off; what is beyond it acts on the joint
            tops = [float(np.std(s.u[:, j])) for s in sessions if s.has_u[j]]
            deviation = max(0.003 * max(tops), 0.3 * problem.floor[j])
        if parameter.name == "timing" and stamps_agree(
            problem.ctx.model, problem.ctx.sessions, problem.ctx.model.index(parameter.place)
        ):
            deviation *= TIMING_KNOWN
        if parameter.name == "armature" and not problem.ctx.accelerates(
            problem.ctx.model.index(parameter.place)
        ):
            continue
        if parameter.name == "edge":
            j = problem.ctx.model.index(parameter.place)
            if j not in problem.joints:
                continue
            deviation = EDGE_SHARE * max(dry_level(s, j) for s in sessions if s.has_u[j])
        if np.sqrt(np.mean(whitened**2)) * deviation < limit * 1e-2:
            continue
        columns.append(whitened)
        prior.append(deviation)
        kept.append(parameter)
    problem.base = kept
    problem.B = np.stack(columns, axis=1) if columns else np.zeros((len(problem.y), 0))
    problem.prior = np.array(prior)


def _base_column(problem: Problem, parameter: BaseParameter) -> np.ndarray:
    """Whitened regressor of a base parameter, shape (rows,)."""
    whitened = np.zeros(len(problem.y))
    for block in problem.blocks:
        x = parameter.column(block.session)[:, block.joint]
        nonlinear = parameter.name in ("frictionloss", "edge")
        rows = compare(x, block.session, block.joint, nonlinear)[block.picks]
        whitened[block.rows] = problem.whiteners[block.joint](rows) * problem.weight[block.rows]
    return whitened
