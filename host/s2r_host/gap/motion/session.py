"""One recording on the work grid: filtered motion, effort, load, and what each step costs in noise."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import welch

from s2r_host.gap.motion.filters import zero_phase
from s2r_host.gap.motion.lost_rows import bridged
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.ties import led
from s2r_host.gap.recordings.leading_position import lead_of_position
from s2r_host.gap.recordings.recording import Recording, resolution

MAX_RATE_HZ = 500.0
JITTER = 0.02  # of the step between rows: a log of 500 rows per second whose stamps jitter is no faster one
# Share of the work grid's rate above which lines of faster logs are filtered out, and the order of that filter.
ALIAS_SHARE, ALIAS_ORDER = 0.45, 8
HUM = 30.0  # times the median of the power there, from which on something is a line
MOTION_CUT_HZ = 50.0
COMPARE_CUT_HZ = 30.0
LEAST_MOTION_CUT_HZ = 8.0
NOISY_SPEED = 0.08
LINE_SHARE = 0.6
LINE_MARGIN = 1.5
WRENCH_AXES = ("fx", "fy", "fz", "mx", "my", "mz")
FREE_SHARE = 0.02  # of the load: less effort than that drives nothing


Motion = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Position, velocity, acceleration, shape (time,) each."""


@dataclass(eq=False)
class Session:
    """Signals of one recording, resampled to an even grid, in the joint order of the model.

    Attributes:
        rec: The recording it was made from.
        t: Time [s], shape (time,); ``dt`` its step.
        q, v, a: Filtered position, velocity, acceleration, shape (time, joint).
        u: Effort that acts, of drive and recorded wrenches (NaN columns where absent); ``has_u`` tells which joints
            have one, ``has_drive`` which have one of their drive.
        pushed: The part of it that comes from recorded wrenches, shape (time, joint).
        load: Effort the nominal model needs for this motion, dry friction left out, shape (time, joint).
        mass: Diagonal of the inertia matrix, shape (time, joint).
        v_eps: Speed over which dry friction turns round [rad/s or m/s], shape (joint,); first the noise of the speed.
        v_noise: Noise of the speed [rad/s or m/s], shape (joint,).
        q_lsb: Resolution of the position [rad or m], shape (joint,).
        lead: How early dry friction turns round before the joint does [s], shape (joint,); see ``friction_edge.py``.
        by_speed: Velocity and acceleration come from the logged speed, not from the position, shape (joint,).
        cut: Upper end of the band in which efforts are compared [Hz], shape (joint,).
        motion_cut: Cut of the filter behind position and its derivatives [Hz], shape (joint,).
        index: Number of the recording, or of the stretch of one, in the order of the command line.
        cache: States already integrated, keyed by whoever made them.
    """

    rec: Recording
    index: int
    t: np.ndarray
    dt: float
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    u: np.ndarray
    pushed: np.ndarray
    has_u: np.ndarray
    has_drive: np.ndarray
    load: np.ndarray
    mass: np.ndarray
    v_eps: np.ndarray
    v_noise: np.ndarray
    q_lsb: np.ndarray
    q_raw: np.ndarray
    cut: np.ndarray
    motion_cut: np.ndarray
    lead: np.ndarray
    by_speed: np.ndarray
    cache: dict = field(default_factory=dict)

    def sign(self, joint: int) -> np.ndarray:
        """Direction in which dry friction is overcome, in [-1, 1], smooth inside the velocity noise, shape (time,)."""
        return np.tanh(self.slip(joint) / self.v_eps[joint])

    def slip(self, joint: int) -> np.ndarray:
        """Speed that decides the direction of dry friction [rad/s or m/s], shape (time,)."""
        return self.v[:, joint] + self.lead[joint] * self.a[:, joint]

    def drive(self, joint: int) -> np.ndarray:
        """Effort of the drive alone as recorded [N·m or N], shape (time,): that which a control law asks for."""
        return self.u[:, joint] - self.pushed[:, joint]

    def driven(self, joint: int) -> bool:
        """Does an effort act at all? Where a joint swings freely, what is left over is its load, to the last digit."""
        return bool(np.std(self.u[:, joint]) > FREE_SHARE * np.std(self.load[:, joint]))

    def channel(self, kind: str, joint: str) -> np.ndarray | None:
        """A recorded channel on the work grid, or None."""
        raw = self.rec.get(kind, joint)
        return None if raw is None else np.interp(self.t, self.rec.t, raw)


def lowpass(x: np.ndarray, cut_hz: float, dt: float, order: int = 2, before_hz: float = np.inf) -> np.ndarray:
    """Zero-phase Butterworth low-pass along the first axis; unchanged when the cut is above 0.45 of the rate.

    ``before_hz`` is the cut of a second filter applied in the same pass.
    """
    cuts = tuple(c for c in (before_hz, cut_hz) if c * dt < 0.45)
    if not cuts or len(x) < 30:
        return np.asarray(x, dtype=float)
    return zero_phase(x, cuts, dt, order)


def make_session(model: RigidModel, rec: Recording, index: int) -> Session:
    """Bring a recording to the work grid and evaluate the nominal model along it."""
    t, dt = work_grid(rec)
    full, doubt = bridged(model, rec)
    rec = replace(rec, effort_doubt=doubt) if doubt else rec
    n, nv = len(t), len(model.joints)
    q, v, a, u = (np.zeros((n, nv)) for _ in range(4))
    q_raw = np.zeros((n, nv))
    u[:] = np.nan
    v_eps, q_lsb, by_speed = np.full(nv, 1e-3), np.zeros(nv), np.zeros(nv, dtype=bool)
    cut = np.full(nv, min(COMPARE_CUT_HZ, rec.band_hz))
    motion_cut = np.full(nv, min(MOTION_CUT_HZ, 4.0 / 3.0 * rec.band_hz))
    for i, joint in enumerate(model.joints):
        raw = rec.get("q", joint)
        if raw is None:
            q[:, i] = q_raw[:, i] = model.model.qpos0[i]
            continue
        q_raw[:, i] = np.interp(t, rec.t, raw)
        q_lsb[i] = resolution(rec.as_read.channels["q"][joint])
        effort = rec.get("tau", joint)
        if effort is not None:
            u[:, i] = on_grid(full, full.channels["tau"][joint], t, dt)
            line = line_hz(effort, rec.dt) if rec.rows is None else 0.0
            cut[i] = max(cut[i], min(LINE_MARGIN * line, rec.band_hz, 0.4 / dt))
            motion_cut[i] = max(motion_cut[i], cut[i])
        least = LEAST_MOTION_CUT_HZ if cut[i] <= COMPARE_CUT_HZ else float(cut[i])
        (q[:, i], v[:, i], a[:, i]), by_speed[i], motion_cut[i] = _quiet_motion(
            full, joint, t, dt, float(motion_cut[i]), least
        )
        cut[i] = min(cut[i], motion_cut[i])
        v_eps[i] = _speed_noise(v[:, i], dt, float(motion_cut[i]))
    for tie in reversed(model.ties):
        if rec.get("q", model.joints[tie.follower]) is None:
            own = slice(None), tie.leader
            q[:, tie.follower], v[:, tie.follower], a[:, tie.follower] = tie.moves(q[own], v[own], a[own])
            q_raw[:, tie.follower] = tie.position(q_raw[own])
            v_eps[tie.follower] = max(np.median(np.abs(tie.slope(q[own]))) * v_eps[tie.leader], 1e-6)
    if rec.effort == "commanded":
        u = np.clip(u, *model.effort_limits())  # what the model says the drive can do is no news
    has_drive = np.asarray(np.isfinite(u).all(0))
    pushed, touched = _pushed(model, rec, t, q)
    u[:, touched] = np.nan_to_num(u[:, touched]) + pushed[:, touched]
    for tie in model.ties:  # what drives or pushes a follower drives its leader
        if np.isfinite(u[:, tie.follower]).all():
            passed = tie.slope(q[:, tie.leader]) * u[:, tie.follower]
            u[:, tie.leader] = np.nan_to_num(u[:, tie.leader]) + passed
            pushed[:, tie.leader] += passed
            u[:, tie.follower] = np.nan
    return Session(
        rec=rec, index=index, t=t, dt=dt, q=q, v=v, a=a, u=u, pushed=pushed,
        has_u=np.asarray(np.isfinite(u).all(0)), has_drive=has_drive,
        load=model.inverse(q, v, a), mass=model.mass_diagonal(q), v_eps=v_eps, v_noise=v_eps.copy(),
        q_lsb=q_lsb, q_raw=q_raw, cut=cut, motion_cut=motion_cut, lead=np.zeros(nv), by_speed=by_speed,
    )  # fmt: skip


def work_grid(rec: Recording) -> tuple[np.ndarray, float]:
    """Even times at which a recording is compared [s], at most some 500 per second, and their step."""
    dt = rec.dt if rec.step_s is None else rec.step_s
    if rec.step_s is None and 1.0 / dt > MAX_RATE_HZ:
        dt *= np.ceil(1.0 / (dt * MAX_RATE_HZ) - JITTER)
    t = np.arange(0.0, rec.t[-1] + 0.5 * dt, dt)
    return t[t <= rec.t[-1] + 1e-9], float(dt)


def on_grid(rec: Recording, x: np.ndarray, t: np.ndarray, dt: float) -> np.ndarray:
    """A recorded signal at the times of the work grid, shape (time,).

    A hum above the band of the grid is filtered out of a faster log first: sampled as it is, one of 492 Hz would come
    back as 8 Hz, in the middle of the motion. Noise comes back as noise.
    """
    if dt < 1.5 * rec.dt:
        return np.interp(t, rec.t, x)
    fine_t = np.arange(0.0, rec.t[-1] + 1e-9, rec.dt)
    fine = np.interp(fine_t, rec.t, x)
    top = ALIAS_SHARE / dt
    return np.interp(t, fine_t, lowpass(fine, top, rec.dt, ALIAS_ORDER) if _hums(fine, rec.dt, top) else fine)


def _hums(x: np.ndarray, dt: float, above_hz: float) -> bool:
    """Does a line stand out of the noise of a signal above a frequency?"""
    f, power = welch(x, 1.0 / dt, nperseg=min(1024, max(8, len(x) // 4)))
    high = power[f > above_hz]
    return high.size > 0 and float(high.max()) > HUM * float(np.median(high))


def line_hz(effort: np.ndarray, dt: float) -> float:
    """Highest line of an effort that lives above the usual band, 0 when it does not [Hz].

    Cogging of a fast motor puts most of the effort into a few narrow lines; noise spreads.
    """
    f, power = welch(effort, 1.0 / dt, nperseg=min(1024, len(effort) // 4))
    above = f > COMPARE_CUT_HZ
    if not power.any() or power[above].sum() < LINE_SHARE * power.sum():
        return 0.0
    order = np.argsort(-power * above)[: max(3, len(f) // 40)]
    if power[order].sum() < LINE_SHARE * power.sum():
        return 0.0
    strong = order[power[order] > 0.05 * power[order[0]]]
    return float(f[strong].max())


def _quiet_motion(
    rec: Recording, joint: str, t: np.ndarray, dt: float, cut: float, least: float
) -> tuple[Motion, bool, float]:
    """Motion at the highest cut whose velocity noise stays a small part of the top speed.

    Returns:
        The motion, whether it comes from the logged speed, and the cut [Hz].
    """
    simulated = lead_of_position(rec, joint) > 0.0
    motion, by_speed = _motion(rec, joint, t, cut, simulated=simulated)
    while cut > least and _speed_noise(motion[1], dt, cut) > NOISY_SPEED * _top(motion[1]):
        cut = max(0.7 * cut, least)
        motion, by_speed = _motion(rec, joint, t, cut, simulated=simulated)
    return motion, by_speed, cut


def _top(v: np.ndarray) -> float:
    return float(np.percentile(np.abs(v), 99)) if v.size else 1.0


def _motion(rec: Recording, joint: str, t: np.ndarray, cut: float, *, simulated: bool) -> tuple[Motion, bool]:
    """Position, velocity, acceleration from the quieter of two routes: q alone, or q with the logged dq (True).

    The logged dq of a ``simulated`` recording is exact.
    """
    raw, logged = rec.get("q", joint), rec.get("dq", joint)
    assert raw is not None
    fine_dt = rec.dt
    fine_t = np.arange(0.0, rec.t[-1] + 1e-9, fine_dt)
    q = lowpass(_resample(rec.t, raw, fine_t), cut, fine_dt)
    routes = [(q, *_derivatives(q, fine_t))]
    if logged is not None:
        dq = lowpass(_resample(rec.t, logged, fine_t), cut, fine_dt)
        ddq = CubicSpline(fine_t, dq)(fine_t, 1)
        routes.append((q, dq, ddq))
    noise = [np.std(r[2] - lowpass(r[2], 0.5 * cut, fine_dt)) for r in routes]
    # The logged velocity has to be clearly quieter: a filtered one carries a lag that nobody declared.
    by_speed = len(routes) == 2 and (noise[1] < 0.7 * noise[0] or simulated or 1.0 / fine_dt < 100.0)
    q, dq, ddq = (np.asarray(np.interp(t, fine_t, x)) for x in routes[int(by_speed)])
    return (q, dq, ddq), bool(by_speed)


def _resample(t_from: np.ndarray, x: np.ndarray, t_to: np.ndarray) -> np.ndarray:
    even = len(t_from) == len(t_to) and float(np.max(np.abs(t_from - t_to))) < 1e-3 * (t_to[1] - t_to[0])
    if even:
        return x
    return np.interp(t_to, t_from, x) if len(t_from) > 4000 else CubicSpline(t_from, x)(t_to)


def _derivatives(q: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    spline = CubicSpline(t, q)
    return spline(t, 1), spline(t, 2)


def _speed_noise(v: np.ndarray, dt: float, cut: float) -> float:
    """Twice the velocity left above the motion, never under 0.2 % of the top speed."""
    fast = v - lowpass(v, 0.6 * cut, dt)
    top = float(np.max(np.abs(v))) if v.size else 1.0
    return max(2.0 * float(np.median(np.abs(fast))) * 1.48, 2e-3 * top, 1e-6)


def nominal_friction(model: RigidModel, s: Session) -> np.ndarray:
    """Dry friction the nominal model holds, as required effort, shape (time, joint)."""
    loss = model.model.dof_frictionloss
    own = np.stack([loss[j] * s.sign(j) for j in range(len(model.joints))], axis=1)
    return led(model.ties, s.q, own)


def _pushed(model: RigidModel, rec: Recording, t: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What recorded external wrenches do to each joint, shape (time, joint), and which joints have any of it.

    A wrench acts at the origin of its body and is given in the world frame.
    """
    efforts = wrench_efforts(model, rec, t, q)
    if efforts is None:
        return np.zeros_like(q), np.zeros(q.shape[1], dtype=bool)
    touched = np.max(np.abs(efforts), axis=0) > 1e-12
    return np.where(touched, efforts, 0.0), touched


def wrench_bodies(model: RigidModel, rec: Recording, t: np.ndarray) -> dict[int, np.ndarray]:
    """Recorded wrenches at the times ``t`` by body index: (fx, fy, fz, mx, my, mz), shape (time, 6)."""
    table = rec.channels.get("wrench", {})
    found: dict[int, np.ndarray] = {}
    dt = float(t[1] - t[0])
    for body in range(model.model.nbody):
        name = model.body_name(body)
        parts = [table.get(f"{name}.{axis}") for axis in WRENCH_AXES]
        if any(p is not None for p in parts):
            zero = np.zeros(len(t))
            found[body] = np.stack([zero if p is None else on_grid(rec, p, t, dt) for p in parts], axis=1)
    return found


def wrench_efforts(model: RigidModel, rec: Recording, t: np.ndarray, q: np.ndarray) -> np.ndarray | None:
    """Joint efforts of all recorded wrenches, shape (time, joint), or None when there are none."""
    wrenches = wrench_bodies(model, rec, t)
    if not wrenches:
        return None
    m = model.model
    d = mujoco.MjData(m)
    out = np.zeros((len(t), m.nv))
    jacp, jacr = np.zeros((3, m.nv)), np.zeros((3, m.nv))
    for i in range(len(t)):
        d.qpos[:] = q[i]
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        for body, w in wrenches.items():
            mujoco.mj_jacBody(m, d, jacp, jacr, body)
            out[i] += jacp.T @ w[i, :3] + jacr.T @ w[i, 3:]
    return out


@dataclass(frozen=True, eq=False)
class WrenchParts:
    """What wrenches on a joint's part do to it.

    Attributes:
        along: Effort along the joint [N·m or N], shape (time,).
        across: Size of the force that its bearing takes [N], shape (time,).
        racking: Size of the moment that its bearing takes, of a pull beside the centre [N·m], shape (time,).
    """

    along: np.ndarray
    across: np.ndarray
    racking: np.ndarray


def wrench_parts(model: RigidModel, s: Session, joint: int) -> WrenchParts | None:
    """Wrenches on what a joint moves, taken apart; None without any."""
    key = ("wrench", joint)
    if key not in s.cache:
        moved = set(model.subtree_bodies(model.joints[joint]))
        bodies = {b: w for b, w in wrench_bodies(model, s.rec, s.t).items() if b in moved}
        efforts = wrench_efforts(model, s.rec, s.t, s.q) if bodies else None
        s.cache[key] = None if efforts is None else _parts(model, s, joint, efforts[:, joint], bodies)
    return s.cache[key]


def _parts(
    model: RigidModel, s: Session, joint: int, along: np.ndarray, bodies: dict[int, np.ndarray]
) -> WrenchParts:
    """The bearing of a slide takes every moment, that of a hinge every force, and the rest what is not along it."""
    total = np.sum(list(bodies.values()), axis=0)
    force, moment = (np.linalg.norm(total[:, part], axis=1) for part in (slice(3), slice(3, 6)))
    beside = force if model.unit(model.joints[joint]) == "m" else moment
    beside[:] = np.sqrt(np.maximum(beside**2 - along**2, 0.0))
    return WrenchParts(along, force, moment)
