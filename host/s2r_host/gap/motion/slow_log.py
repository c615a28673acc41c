"""What happened between the rows of a slow log, rebuilt from what its rows hold together.

A log of ten rows per second that holds position and speed says twice as much as one that holds either (Papoulis,
Generalized sampling expansion, IEEE Trans. Circuits and Systems 24(11), 1977): the motion between its rows is a
smoothing spline through both. The effort is a sample, not a mean, and swings between the rows as the loop makes it;
where the control law is declared, the law evaluated on the motion between the rows tells how. What is left of the
effort at the rows is interpolated. The filters of the tool then see means over time instead of samples, and forces
and momenta balance over every interval whatever happened inside it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from s2r_host.gap.motion.filters import zero_phase
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.motion_spline import STEP_NOISE, Motion, motion, smoothing_spline
from s2r_host.gap.recordings.recording import REBUILT_BAND, Recording, resolution

SLOW_S = 0.011  # slower logs are rebuilt
FINE_S = 0.005
LEAST_ROWS = 40
# What every second row leaves out of the balance of efforts, against what all of them do; where the loop is faster than
# the log, or unknown, twice as many rows help less.
SHRINK, SHRINK_BLIND = 4.0, 2.0


def filled(model: RigidModel, rec: Recording) -> Recording:
    """The recording with rows every few milliseconds, or itself when it is fast or holds no speed.

    Args:
        model: The nominal model.
        rec: A recording as read.
    """
    joints = [j for j in rec.joints if j in model.joints and rec.get("dq", j) is not None]
    if rec.dt <= SLOW_S or len(rec.t) < LEAST_ROWS or len(joints) < len(model.joints):
        return rec
    step = rec.dt / np.ceil(rec.dt / FINE_S - 1e-9)
    t = np.arange(0.0, float(rec.t[-1]) + 1e-9, step)
    every = np.arange(len(rec.t))
    odd = every[1:-1:2]
    whole, half = _rebuilt(model, rec, every, t), _rebuilt(model, rec, np.setdiff1d(every, odd), t)
    channels, doubt = whole.channels, {}
    for joint, guesses in whole.tau.items():
        rows = rec.channels["tau"][joint][odd]
        best = min(
            guesses, key=lambda k: float(np.mean((np.interp(rec.t[odd], t, half.tau[joint][k]) - rows) ** 2))
        )
        channels["tau"][joint] = guesses[best]
        apart = (guesses[best] - whole.load[joint]) - (half.tau[joint][best] - half.load[joint])
        power = zero_phase(zero_phase(apart, (REBUILT_BAND / rec.dt,), step) ** 2, (0.25 / rec.dt,), step)
        doubt[joint] = np.sqrt(np.maximum(power, 0.0)) / (SHRINK if best == "law" else SHRINK_BLIND)
    others = {
        kind: {name: np.interp(t, rec.t, x) for name, x in table.items()}
        for kind, table in rec.channels.items()
        if kind not in channels
    }
    return replace(rec, t=t, channels=others | channels, rows=rec, effort_doubt=doubt)


@dataclass(frozen=True)
class _Rebuilt:
    """Channels but efforts; efforts under every guide; effort the nominal model needs; by joint, shape (time,) each."""

    channels: dict[str, dict[str, np.ndarray]]
    tau: dict[str, dict[str, np.ndarray]]
    load: dict[str, np.ndarray]


def _rebuilt(model: RigidModel, rec: Recording, kept: np.ndarray, t: np.ndarray) -> _Rebuilt:
    """Channels at times ``t`` from some rows only."""
    rows = rec.t[kept]
    made: dict[str, dict[str, np.ndarray]] = {"q": {}, "dq": {}, "tau": {}}
    efforts: dict[str, dict[str, np.ndarray]] = {}
    here: dict[str, Motion] = {}
    there: dict[str, Motion] = {}
    for j in model.joints:
        curve = smoothing_spline(
            rows,
            rec.channels["q"][j][kept],
            rec.channels["dq"][j][kept],
            STEP_NOISE * resolution(rec.channels["q"][j]),
        )
        here[j], there[j] = motion(curve, rows), motion(curve, t)
        made["q"][j], made["dq"][j] = there[j].q, there[j].v
    load, load_at = _load(model, here), _load(model, there)
    commands = _commands(model, rec, kept, rows, t)
    for kind in ("q_cmd", "dq_cmd", "tau_ff"):
        made[kind] = {j: x for j, (_, x) in commands[kind].items()}
    for i, j in enumerate(model.joints):
        tau = rec.get("tau", j)
        if tau is None:
            continue
        guides = {"none": (np.zeros(len(rows)), np.zeros(len(t))), "load": (load[:, i], load_at[:, i])}
        law = rec.controller
        if law.kind in ("pd", "pid", "position_servo") and j in law.kp and j in commands["q_cmd"]:
            parts = []
            measured = ((rec.channels["q"][j][kept], rec.channels["dq"][j][kept]), (there[j].q, there[j].v))
            for k, (q, v) in enumerate(measured):
                dq_cmd = commands["dq_cmd" if law.kind == "position_servo" else "speed"].get(j)
                asked = law.kp[j] * (commands["q_cmd"][j][k] - q)
                asked = asked + law.kd.get(j, 0.0) * ((0.0 if dq_cmd is None else dq_cmd[k]) - v)
                ahead = commands["tau_ff"].get(j)
                parts.append(asked if ahead is None else asked + ahead[k])
            guides["law"] = (parts[0], parts[1])
        efforts[j] = {name: along + _between(rows, tau[kept] - at, t) for name, (at, along) in guides.items()}
    return _Rebuilt(made, efforts, {j: load_at[:, i] for i, j in enumerate(model.joints)})


def _commands(
    model: RigidModel, rec: Recording, kept: np.ndarray, rows: np.ndarray, t: np.ndarray
) -> dict[str, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """What the controller was told, at the rows and at ``t``; a feed-forward follows the model along the command.

    ``speed`` is how fast the command goes, logged or not.
    """
    found: dict[str, dict] = {"q_cmd": {}, "dq_cmd": {}, "tau_ff": {}, "speed": {}}
    here: dict[str, Motion] = {}
    there: dict[str, Motion] = {}
    for j in model.joints:
        q, dq = rec.get("q_cmd", j), rec.get("dq_cmd", j)
        if q is None:
            continue
        if dq is None:
            found["q_cmd"][j] = (q[kept], _between(rows, q[kept], t))
            found["speed"][j] = (_between(rows, q[kept], rows, 1), _between(rows, q[kept], t, 1))
            continue
        curve = smoothing_spline(rows, q[kept], dq[kept], 1e-7 * (float(np.ptp(q)) + 1e-9), exact=True)
        here[j], there[j] = motion(curve, rows), motion(curve, t)
        found["q_cmd"][j] = (q[kept], there[j].q)
        found["dq_cmd"][j] = found["speed"][j] = (dq[kept], there[j].v)
    known = len(here) == len(model.joints)
    at, along = (_load(model, here), _load(model, there)) if known else (None, None)
    for i, j in enumerate(model.joints):
        ahead = rec.get("tau_ff", j)
        if ahead is None:
            continue
        x = ahead[kept]
        if at is None or along is None or not np.any(x):
            found["tau_ff"][j] = (x, _between(rows, x, t))
            continue
        factor = float(at[:, i] @ x) / max(float(at[:, i] @ at[:, i]), 1e-30)
        found["tau_ff"][j] = (x, factor * along[:, i] + _between(rows, x - factor * at[:, i], t))
    return found


def _between(rows: np.ndarray, x: np.ndarray, t: np.ndarray, derivative: int = 0) -> np.ndarray:
    """A curve through the rows that does not swing over at steps, or its slope (Akima, J. ACM 17(4), 1970)."""
    curve = Akima1DInterpolator(rows, x, method="makima")
    return np.asarray(curve(np.clip(t, rows[0], rows[-1]), derivative))


def _load(model: RigidModel, motions: dict[str, Motion]) -> np.ndarray:
    """Effort the nominal model needs, shape (time, joint)."""
    q, v, a = (np.stack([getattr(motions[j], k) for j in model.joints], axis=1) for k in ("q", "v", "a"))
    return model.inverse(q, v, a)
