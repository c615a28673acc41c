"""The effort residual of all recordings as one whitened regression, split into fit and held-out rows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.signal import welch

from s2r_host.gap.effects.base import Columns, Context, count_reversals
from s2r_host.gap.evidence import Whitener, fit_whitener
from s2r_host.gap.kinematics import Contradiction, contradiction
from s2r_host.gap.law import LawFinding, check_law
from s2r_host.gap.model import RigidModel
from s2r_host.gap.nuisance import BaseParameter, base_parameters
from s2r_host.gap.session import Session, lowpass, nominal_friction
from s2r_host.gap.states import stop_operator

HOLDOUT_SHARE = 0.3
SIGNAL_TO_NOISE = 20.0
SIGNAL_TO_GUESS = 3.0  # against a leftover, which is noise and model error together
LEAST_CUT_HZ = 2.5
EDGE_SHARE = 0.5
STICK_DOUBT = 0.5
SLOW_LOG_S = 0.01
BETWEEN_SHARE = 0.25
DRIFT_SHARE = 0.15
GENERIC_FOLDS = 8
GENERIC_BINS = 40
STROKE_PARTS = 6
LOOP_SHARES = (0.003, 0.01, 0.03, 0.1, 0.3)


@dataclass
class Block:
    """Rows of one joint in one recording."""

    session: Session
    joint: int
    rows: slice
    picks: np.ndarray
    held: np.ndarray


@dataclass
class Drift:
    """Friction of a held-out session that was not among the fitted ones, as nuisance: dry and viscous change.

    Attributes:
        block: Rows it belongs to.
        columns: Whitened direction of motion (and speed, where there is viscous friction), shape (rows, k).
        raw: Direction of motion in effort units, shape (rows,).
        level: Friction the fitted sessions show: dry [N·m or N], viscous [N·m·s/rad or N·s/m], shape (k,).
    """

    block: Block
    columns: np.ndarray
    raw: np.ndarray
    level: np.ndarray

    def estimate(
        self, left: np.ndarray, noise: float, found: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Changes the whitened leftover of this block asks for, their covariance, levels and columns.

        Args:
            left: Whitened leftover, shape (rows of the problem,).
            noise: Variance of a whitened row.
            found: Whitened friction that effects of the catalogue add, shape (rows of the problem,): it drifts too.

        Returns:
            (k,), (k, k), (k,) and (rows, k); the level of what was found is one.
        """
        columns, level = self.columns, self.level
        if found is not None and np.any(found[self.block.rows]):
            columns = np.concatenate([columns, found[self.block.rows][:, None]], axis=1)
            level = np.append(level, 1.0)
        power, pull = columns.T @ columns / noise, columns.T @ left[self.block.rows] / noise

        def solved(width: float) -> tuple[np.ndarray, np.ndarray]:
            covariance = np.linalg.inv(power + np.diag((width * level) ** -2.0))
            return covariance @ pull, covariance

        change, covariance = solved(DRIFT_SHARE)
        for _ in range(2):  # a prior as wide as what it is asked to allow
            change, covariance = solved(max(DRIFT_SHARE, 2.0 * abs(float(change[0])) / float(level[0])))
        return change, covariance, level, columns


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
        weight: Trust in each row: less where dry friction may stick and the sign of motion is a guess.
        effort: Filtered effort rows, same layout, whitened.
        drift: Friction changes of new held-out sessions; ``law`` where the declared control law does not hold;
            ``contradictions`` where position and speed of a joint do not agree; ``twin`` the second runs.
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
    drift: list[Drift] = field(default_factory=list)
    law: list[LawFinding] = field(default_factory=list)
    contradictions: list[Contradiction] = field(default_factory=list)
    twin: Twin | None = None
    cache: dict = field(default_factory=dict)

    def whiten(self, per_session: dict[int, np.ndarray], joint: int) -> np.ndarray:
        """Filter, decimate, whiten and stack a regressor.

        Args:
            per_session: Session number -> array (time,) on ``joint`` or (time, joint).
            joint: The joint a one-dimensional array belongs to.
        """
        out = np.zeros(len(self.y))
        for block in self.blocks:
            x = per_session.get(block.session.index)
            if x is None:
                continue
            if x.ndim == 1:
                if block.joint != joint:
                    continue
            else:
                x = x[:, block.joint]
            rows = compare(x, block.session, block.joint, True)[block.picks]
            out[block.rows] = self.whiteners[block.joint](rows)
        return out * self.weight

    def rms(self, rows: np.ndarray, block: Block, mask: np.ndarray) -> float:
        """Root mean square of effort rows of a block where ``mask`` holds, each row as trusted as its weight."""
        weight = self.weight[block.rows][mask] ** 2
        return float(np.sqrt(weight @ rows[block.rows][mask] ** 2 / max(float(weight.sum()), 1e-12)))

    def columns(self, per_session: dict[int, Columns], joint: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Whitened matrix (rows, k) and fixed column of an effect evaluated on every session."""
        first = next(iter(per_session.values()))
        matrix = np.stack(
            [self.whiten({k: c.linear[i] for k, c in per_session.items()}, joint) for i in range(len(first.linear))],
            axis=1,
        ) if first.linear else np.zeros((len(self.y), 0))  # fmt: skip
        fixed = None
        if first.fixed is not None:
            fixed = self.whiten({k: c.fixed for k, c in per_session.items() if c.fixed is not None}, joint)
        return matrix, fixed


def compare(x: np.ndarray, s: Session, joint: int, nonlinear: bool) -> np.ndarray:
    """Bring a signal to the comparison band; what was not made from filtered motion passes both filters."""
    return lowpass(
        x, float(s.cut[joint]), s.dt, before_hz=float(s.motion_cut[joint]) if nonlinear else np.inf
    )


def residual(model: RigidModel, s: Session, joint: int) -> np.ndarray:
    """Filtered effort minus what the nominal model needs, shape (time,)."""
    rigid = compare(s.load[:, joint], s, joint, False)
    friction = compare(nominal_friction(model, s)[:, joint], s, joint, True)
    return compare(s.u[:, joint], s, joint, True) - rigid - friction


def build_problem(
    model: RigidModel, fit: list[Session], hold: list[Session], repeats: list[Session]
) -> Problem:
    """Assemble the regression.

    Args:
        model: The nominal model.
        fit: Sessions that may be fitted.
        hold: Sessions that may only be predicted; when empty the last 30 % of each fit session is held.
        repeats: Second runs of a motion among ``fit``: they set the noise floor.
    """
    ctx = Context(model, fit)
    sessions = fit + hold
    joints = [j for j in range(len(model.joints)) if any(s.has_u[j] for s in sessions)]
    blocks, raw = _blocks(model, sessions, hold, joints)
    noise, source = _noise(model, joints, fit, repeats, blocks, raw)
    for j in joints:
        cut = _band(j, fit, blocks, noise[j], SIGNAL_TO_NOISE if source == "repeat" else SIGNAL_TO_GUESS)
        for s in sessions + repeats:
            s.cut[j] = min(cut, float(s.cut[j]))
    blocks, raw = _blocks(model, sessions, hold, joints)
    noise, source = _noise(model, joints, fit, repeats, blocks, raw)
    start = blocks[-1].rows.stop if blocks else 0
    held = [b.held for b in blocks]
    whiteners, floor = {}, {}
    for j in joints:
        scale = max(float(np.std(s.u[:, j])) for s in sessions if s.has_u[j])
        whiteners[j] = fit_whitener(noise[j], 1e-4 * scale)
        floor[j] = max(float(np.sqrt(np.mean(np.concatenate(noise[j]) ** 2))), 1e-4 * scale)
    problem = Problem(
        ctx, joints, blocks, whiteners, np.zeros(start), np.concatenate(raw), np.zeros(start),
        np.concatenate(held), base_parameters(model), np.zeros((start, 0)), np.zeros(0), floor, source,
        np.concatenate([_trust(model, b, floor[b.joint]) for b in blocks]),
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
    problem.floor_doubt = max((_doubt(noise[j]) for j in joints), default=1.0)
    if source == "repeat":
        problem.twin = _second_runs(model, problem, fit, repeats)
    problem.law = [f for j in joints if (f := check_law(model, fit, hold, j)) is not None]
    problem.contradictions = [c for j in joints if (c := contradiction(model, fit, j)) is not None]
    return problem


def _second_runs(
    model: RigidModel, problem: Problem, fit: list[Session], repeats: list[Session]
) -> Twin | None:
    """The rows of second runs, with the base parameters and the noise model of the first ones."""
    blocks, raw = _blocks(model, repeats, [], problem.joints)
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
        problem.floor_source, np.concatenate([_trust(model, b, problem.floor[b.joint]) for b in blocks]),
    )  # fmt: skip
    for block, values in zip(blocks, raw, strict=True):
        twin.y[block.rows] = twin.whiteners[block.joint](values)
    twin.y *= twin.weight
    for k, parameter in enumerate(problem.base):
        twin.B[:, k] = _base_column(twin, parameter)
    return Twin(twin, pairs)


def _blocks(
    model: RigidModel, sessions: list[Session], hold: list[Session], joints: list[int]
) -> tuple[list[Block], list[np.ndarray]]:
    blocks: list[Block] = []
    raw: list[np.ndarray] = []
    start = 0
    for s in sessions:
        for j in joints:
            if not s.has_u[j]:
                continue
            picks = _picks(s, j)
            rows = slice(start, start + len(picks))
            start += len(picks)
            held = np.full(len(picks), s in hold)
            if not hold:
                held = picks >= (1.0 - HOLDOUT_SHARE) * len(s.t)
            blocks.append(Block(s, j, rows, picks, held))
            raw.append(residual(model, s, j)[picks])
    return blocks, raw


def _band(j: int, fit: list[Session], blocks: list[Block], noise: list[np.ndarray], least: float) -> float:
    """Highest frequency at which the effort still stands well above the noise [Hz].

    Beyond it a regressor is made of noise, and whatever filters that noise would look like physics: the
    direct method of closed-loop identification is biased there (Janot et al., IDIM-IV, 2014).
    """
    power_u: np.ndarray | None = None
    power_n: np.ndarray | None = None
    block = next(b for b in blocks if b.joint == j)
    s = block.session
    rate = 1.0 / (s.dt * float(block.picks[1] - block.picks[0]))
    length = min(256, len(block.picks) // 3)
    f = np.zeros(0)
    for b in blocks:
        if b.joint == j and b.session in fit:
            f, p = welch(compare(b.session.u[:, j], b.session, j, True)[b.picks], rate, nperseg=length)
            power_u = p if power_u is None else power_u + p
    for x in noise:
        _, p = welch(x, rate, nperseg=min(length, len(x)))
        if len(p) == len(f):
            power_n = p if power_n is None else power_n + p
    if power_u is None or power_n is None:
        return float(s.cut[j])
    power_n = np.maximum(power_n / len(noise), 1e-30)
    strong = np.flatnonzero((power_u / power_n > least) & (f <= s.cut[j]))
    highest = float(f[strong[-1]]) if strong.size else 0.0
    return float(np.clip(1.5 * highest, LEAST_CUT_HZ, s.cut[j]))


def _picks(s: Session, joint: int) -> np.ndarray:
    step = max(1, int(1.0 / (2.4 * float(s.cut[joint]) * s.dt)))
    # Filters ring at the ends of a record for about a period of their cut.
    margin = max(3, min(int(max(0.15, 1.5 / float(s.cut[joint])) / s.dt), len(s.t) // 8))
    return np.arange(margin, len(s.t) - margin, step)


def _fill_drift(problem: Problem, fit: list[Session], hold: list[Session]) -> None:
    known = {s.rec.session for s in fit}
    for block in problem.blocks:
        s, j = block.session, block.joint
        if s not in hold or s.rec.session in known:
            continue
        levels = [friction_levels(problem.ctx.model, x, j) for x in fit if x.has_u[j]]
        if not levels:
            continue
        dry, viscous = np.mean(levels, axis=0)
        parts = [(dry, s.sign(j)), (viscous, s.v[:, j])]
        if dry <= 0:
            continue
        kept = [(level, compare(x, s, j, True)[block.picks]) for level, x in parts if level > 0]
        weight = problem.weight[block.rows]
        columns = np.stack([problem.whiteners[j](rows) * weight for _, rows in kept], axis=1)
        problem.drift.append(Drift(block, columns, kept[0][1], np.array([level for level, _ in kept])))


def _fill_base(problem: Problem, sessions: list[Session]) -> None:
    columns, prior, kept = [], [], []
    limit = 1e-4 * float(np.sqrt(np.mean(problem.effort**2)))
    for parameter in problem.base:
        whitened = _base_column(problem, parameter)
        deviation = parameter.prior
        if parameter.name == "effort_offset":
            j = problem.ctx.model.index(parameter.place)
            if j not in problem.joints:
                continue
            tops = [float(np.std(s.u[:, j])) for s in sessions if s.has_u[j]]
            deviation = max(0.003 * max(tops), 0.3 * problem.floor[j])
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


def _noise(
    model: RigidModel, joints: list[int], fit: list[Session], repeats: list[Session],
    blocks: list[Block], raw: list[np.ndarray],
) -> tuple[dict[int, list[np.ndarray]], str]:  # fmt: skip
    """Noise samples per joint: half the difference of two runs, or what a rich generic model leaves over."""
    noise: dict[int, list[np.ndarray]] = {j: [] for j in joints}
    for twin in repeats:
        partner = find_partner(twin, fit)
        if partner is None:
            continue
        n = min(len(twin.t), len(partner.t))
        for j in joints:
            picks = _picks(partner, j)
            picks = picks[picks < n - 3]
            if twin.has_u[j] and partner.has_u[j]:
                difference = residual(model, partner, j)[:n] - residual(model, twin, j)[:n]
                noise[j].append(difference[picks] / np.sqrt(2.0))
    source = "repeat" if all(noise[j] for j in joints) and joints else "estimated"
    for j in joints:
        if not noise[j]:
            for block, values in zip(blocks, raw, strict=True):
                if block.joint == j:
                    noise[j].append(generic_leftover(block.session, j, values, block.picks))
    return noise, source


def find_partner(twin: Session, fit: list[Session]) -> Session | None:
    """The fit session that shows the same motion, or None."""
    best, best_rms = None, np.inf
    for s in fit:
        if abs(s.dt - twin.dt) > 1e-6 or abs(len(s.t) - len(twin.t)) > 0.1 * len(s.t):
            continue
        n = min(len(s.t), len(twin.t))
        rms = float(np.sqrt(np.mean((s.q[:n] - twin.q[:n]) ** 2)))
        if rms < best_rms:
            best, best_rms = s, rms
    if best is None or best_rms > 0.1 * max(float(np.max(np.std(best.q, axis=0))), 1e-9):
        return None
    return best


def generic_leftover(s: Session, j: int, values: np.ndarray, picks: np.ndarray) -> np.ndarray:
    """What a generic local correction cannot predict on stretches it was not fitted to, shape (rows,).

    Never more than the residual itself: then nothing was predictable, and all of it counts as noise.
    """
    X = generic_basis(s, j, picks)
    X = X / (np.sqrt(np.mean(X**2, axis=0)) + 1e-12)
    # A single stroke passes every place once: only short stretches leave their surroundings to learn from.
    parts = GENERIC_FOLDS if count_reversals(s, j) >= 2 else GENERIC_FOLDS * STROKE_PARTS
    fold = np.arange(len(X)) * parts // max(len(X), 1) % GENERIC_FOLDS
    best = values - np.mean(values)
    for ridge in (1e-4, 1e-2, 1e-1):
        left = np.empty_like(values)
        for k in range(GENERIC_FOLDS):
            train = fold != k
            A = X[train].T @ X[train] + ridge * train.sum() * np.eye(X.shape[1])
            left[~train] = values[~train] - X[~train] @ np.linalg.solve(A, X[train].T @ values[train])
        if np.mean(left**2) < np.mean(best**2):
            best = left
    return best


def generic_basis(s: Session, j: int, picks: np.ndarray) -> np.ndarray:
    """Position bins per direction, speed shapes, acceleration, load and its derivatives, shape (rows, k)."""
    q, v, a = s.q[:, j], s.v[:, j], s.a[:, j]
    sign, top = s.sign(j), np.max(np.abs(v)) + 1e-12
    edges = np.linspace(q.min(), q.max() + 1e-12, int(np.clip(len(picks) // 20, 12, GENERIC_BINS)))
    width = edges[1] - edges[0] + 1e-12
    columns = [np.ones_like(q), v, np.abs(v), v * np.abs(v), a, s.load[:, j], np.abs(s.load[:, j]) * sign]
    columns += [sign * np.exp(-((v / (share * top)) ** 2)) for share in (0.02, 0.1, 0.3)]
    # Late or lagging drives leave derivatives of the load. The effort itself is no column: with the load it spans
    # the residual exactly, and any floor would come out.
    late = np.gradient(s.load[:, j], s.dt)
    columns += [late, np.gradient(late, s.dt)]
    columns += [s.load[:, i] for i in range(s.q.shape[1]) if i != j]
    columns += loops(s, j)
    for centre in edges:
        hat = np.maximum(0.0, 1.0 - np.abs(q - centre) / width)
        columns += [hat, hat * sign]
    return np.stack([compare(c, s, j, True)[picks] for c in columns], axis=1)


def loops(s: Session, j: int) -> list[np.ndarray]:
    """Stop operators of several widths and their cubes: any loop at reversals, a dead zone included.

    Prandtl and Ishlinskii's superposition of them approximates rate-independent loops.
    """
    found = []
    for width in float(np.ptp(s.q[:, j])) * np.array(LOOP_SHARES):
        if width > 2.0 * s.q_lsb[j]:
            z = stop_operator(s, j, float(width))
            found += [z, z**3]
    return found


def dry_level(s: Session, j: int) -> float:
    """Size of the friction step in a recording, by plain regression [N·m or N]."""
    return abs(float(_friction_fit(s, j)[0]))


def friction_levels(model: RigidModel, s: Session, j: int) -> tuple[float, float]:
    """Dry [N·m or N] and viscous [N·m·s/rad or N·s/m] friction of a recording, the model's own included."""
    fitted = _friction_fit(s, j)
    return abs(float(fitted[0])), max(0.0, float(fitted[1]) + float(model.model.dof_damping[j]))


def _friction_fit(s: Session, j: int) -> np.ndarray:
    key = ("friction", j, float(s.cut[j]), float(s.v_eps[j]))
    if key not in s.cache:
        r = compare(s.u[:, j], s, j, True) - compare(s.load[:, j], s, j, False)
        columns = [s.sign(j), s.v[:, j], s.a[:, j], s.load[:, j], np.ones(len(s.t))]
        X = np.stack([compare(c, s, j, True) for c in columns], axis=1)
        s.cache[key] = np.linalg.lstsq(X, r, rcond=None)[0]
    return s.cache[key]


def _trust(model: RigidModel, block: Block, floor: float) -> np.ndarray:
    """Weight of the rows of a block, shape (rows,), in (0, 1].

    At rest dry friction balances whatever is there, up to its break-away level: such rows say little.
    """
    s, j = block.session, block.joint
    still = compare(stillness(s, j), s, j, True)[block.picks]
    doubt = STICK_DOUBT * max(stiction(s, j)) * np.clip(still, 0.0, 1.0) / max(floor, 1e-12)
    between = np.clip(compare(_between_rows(model, s, j), s, j, True)[block.picks], 0.0, None) / max(
        floor, 1e-12
    )
    return 1.0 / np.sqrt(1.0 + doubt**2 + between**2)


def _between_rows(model: RigidModel, s: Session, j: int) -> np.ndarray:
    """What a slow log cannot say about the effort between its rows [N·m or N], shape (time,).

    Linear interpolation errs by an eighth of the second difference; motion rebuilt from such rows errs alike. Zero
    for logs fast enough for the loops they record.
    """
    raw = s.rec.get("tau", model.joints[j])
    if s.rec.dt < SLOW_LOG_S or raw is None or len(raw) < 3:
        return np.zeros(len(s.t))
    bend = np.abs(np.diff(raw, 2))
    bend = (
        np.pad(np.maximum(bend[1:], bend[:-1]), (2, 1), mode="edge")
        if len(bend) > 1
        else np.full(len(raw), bend[0])
    )
    return np.interp(s.t, s.rec.t, BETWEEN_SHARE * bend)


def stillness(s: Session, j: int) -> np.ndarray:
    """One where a joint may stick, zero where it clearly moves, shape (time,)."""
    return 1.0 - np.tanh(s.v[:, j] / (2.0 * s.v_eps[j])) ** 2


def stiction(s: Session, j: int) -> tuple[float, float]:
    """Effort that friction was seen to hold at rest (95th percentile), and dry friction in motion [N·m or N]."""
    moving = dry_level(s, j)
    r = compare(s.u[:, j], s, j, True) - compare(s.load[:, j], s, j, False)
    rest = compare(stillness(s, j), s, j, True) > 0.9
    return (float(np.percentile(np.abs(r[rest]), 95)) if rest.sum() > 20 else 0.0), moving


def _doubt(samples: list[np.ndarray]) -> float:
    """One and a half standard deviations of an rms of correlated samples, as a factor above one."""
    effective = 0.0
    for x in samples:
        rho = float(np.clip(np.mean(x[1:] * x[:-1]) / max(float(np.mean(x**2)), 1e-30), 0.0, 0.99))
        effective += len(x) * (1.0 - rho) / (1.0 + rho)
    return 1.0 + 1.5 / np.sqrt(2.0 * max(effective, 2.0))
