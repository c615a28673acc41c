"""The drive seen through the control law: what was asked, recomputed from the record, against what was reported.

A measured effort is what arrived. Delay, lag and clip of the drive are then invisible in the plant's equation, but
the law says what was asked. A wrong controller gain and late position stamps show here too, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from s2r_host.gap.motion.align import law_parts, unlogged_speed
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import COMPARE_CUT_HZ, Session, lowpass
from s2r_host.gap.motion.states import filtered

TEMPER = 3.0
FINE_S = 0.002
SMALLEST_S, LARGEST_S = 5e-5, 0.06
MAX_MISFIT = 0.3
LEAST_MISFIT = 2e-6
LEAST_GAIN = 15.0
# Lag that the law has to exclude before stamps count as the same [s], by how much worse it fits there; misfit of a law
# that holds, as a share of the effort's power.
KNOWN_S, CLEARLY, HOLDS = 3e-4, 2.0, 1e-3
HOLDS_NOISY, SHIFTS_S = 0.05, (0.001, 0.002, 0.004, 0.008)  # the same for an effort with a sensor's noise
SMOOTHER_HZ = (5.0, 10.0, 20.0, 40.0)
LEAST_CHANGE = 0.012
Z90 = 1.645
PASSED, PASSES = 1.2, 0.01  # times a limit, in a share of the rows: what arrives there was not cut off at it
TOP = 0.98  # of the rows stay below what a drive reaches
MODEL_ERROR = 0.012  # relative error of a value beyond its noise
TICK_SHARE = (
    0.7  # of one period of the controller: when inside its tick a drive reports its effort is rarely said
)


# A drive that is read before it is written to reports the effort of the tick before: a delay of one period of the
# controller is what its order of reading makes, and a short lag fits the same record. Log and period agree that well.
OLD, TICK_DOUBT = ("actuator_delay", "bandwidth"), 0.1
EFFORT_CLOCK = "effort_clock"  # stamps of the effort that are late, or early, beside those of all else
PARTED, EDGE_S = 0.5, 0.2  # power left over by an effort that is moved to where it belongs; ends of a record
LATER = np.geomspace(SMALLEST_S, LARGEST_S, 18)
EARLIER = -LATER
BOTH_WAYS = np.concatenate([EARLIER[::-1], LATER])
BEHIND = LATER[LATER >= 2.0 * SMALLEST_S]  # of a drive


@dataclass(frozen=True)
class LawFinding:
    """What the control law says about one joint.

    Attributes:
        name: Catalogue name, or ``controller_gain``.
        joint: Joint index.
        gain: Log odds against 'the law holds as declared'.
        share: Share of the misfit of the law it removes on held-out recordings.
        parameters: As in the answer: value, unit, 90 % interval.
        shape: Shape for the forward simulation.
        rivals: Name -> log odds of everything else that was tried.
        of_effort: The stamps that are off are those of the effort; position and command have the same.
    """

    name: str
    joint: int
    gain: float
    share: float
    parameters: dict[str, dict]
    shape: dict[str, float] = field(default_factory=dict)
    rivals: dict[str, float] = field(default_factory=dict)
    of_effort: bool = False


@dataclass
class _Rows:
    """One recording of one joint: asked and reported effort on a fine grid, and how to compare them.

    ``unsure``: what the law would ask for otherwise if speeds that were not logged were taken a moment later.
    """

    s: Session
    joint: int
    held: bool
    u: np.ndarray
    asked: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    fine: np.ndarray
    late: Callable[[float], np.ndarray]
    unsure: list[np.ndarray]

    def compare(self, x: np.ndarray) -> np.ndarray:
        """Filter and decimate a signal of the work grid; of a slow log, only its own rows count."""
        if self.s.rec.rows is not None:
            return np.interp(self.s.rec.rows.t[1:-1], self.s.t, x)
        cut = min(COMPARE_CUT_HZ, self.s.rec.band_hz)
        step = max(1, int(1.0 / (2.4 * cut * self.s.dt)))
        margin = max(3, int(0.2 / self.s.dt))
        return lowpass(x, cut, self.s.dt)[margin:-margin:step]


def check_law(
    model: RigidModel, fit: list[Session], hold: list[Session], joint: int, skip: Collection[str] = ()
) -> LawFinding | None:
    """The best explanation for a law that does not hold, or None when it holds or is not known.

    What is in ``skip`` is not looked for, so that the next best is said in its place.
    """
    rows = [_rows(model, s, joint, s in hold) for s in fit + hold if s.has_u[joint]]
    usable = [r for r in rows if r is not None]
    if len(usable) != len(rows) or not usable:
        return None
    test = _Test(usable, model)
    if test.relative < 1.5 * LEAST_MISFIT:
        return None
    effort = model.effort_unit(model.joints[joint])
    found = [
        _gain(test, "kp"),
        _gain(test, "kd"),
        _shift(test, "clock_skew", lambda r, x: r.late(x), BOTH_WAYS),
    ]
    if usable[0].s.rec.effort == "measured":
        found += [
            _shift(test, "actuator_delay", _delayed, BEHIND),
            _shift(test, "bandwidth", _lagged, BEHIND),
            _shift(test, EFFORT_CLOCK, _delayed, EARLIER),
            _clip(test, effort),
        ]
    else:  # what was asked for can be delayed by stamps alone
        found.append(_shift(test, EFFORT_CLOCK, _delayed, BOTH_WAYS))
    tried = {f[1]: f for f in found}
    found = sorted((f for f in found if _in_catalogue(f[1]) not in skip), key=lambda f: -f[0])
    if not found:
        return None
    gain, name, share, parameters, shape = found[0]
    if name in OLD and moved_before(fit, joint, tried["actuator_delay"][4]["delay"]):
        if _in_catalogue(EFFORT_CLOCK) in skip:
            return None
        gain, name, share, parameters, shape = _as_clock(tried["actuator_delay"])
    if gain < LEAST_GAIN or share < 0.3 or test.relative * (1.0 - share) > MAX_MISFIT:
        return None
    if name == "clock_skew" and -_held_for(usable[0].s) < shape["lag"] < 0.0:
        return None
    rate = usable[0].s.rec.controller.rate_hz
    if name in OLD and gain < _smoother_speed(test) + LEAST_GAIN:
        return None
    if name in OLD and rate and next(iter(shape.values())) <= (1.0 + TICK_DOUBT) / rate:
        return None
    if name == "controller_gain" and all(
        abs(p["value"] - p["from"]) < LEAST_CHANGE * p["from"] for p in parameters.values()
    ):
        return None
    if name == EFFORT_CLOCK:
        if 0.0 < shape["lag"] < _held_for(usable[0].s):
            return None
        rivals = {f[1]: f[0] for f in found if f[1] not in (*OLD, "clock_skew", EFFORT_CLOCK)}
        return _late_effort(joint, gain, share, parameters, shape, rivals)
    rivals = {f[1]: f[0] for f in found[1:] if f[1] != EFFORT_CLOCK}
    return LawFinding(name, joint, gain, share, parameters, shape, rivals)


def _in_catalogue(name: str) -> str:
    return "clock_skew" if name == EFFORT_CLOCK else name


def moved_before(fit: list[Session], joint: int, delay: float) -> bool:
    """Had the joint moved as the effort made it move before that effort was stamped?

    A drive that answers late moves its joint late as well: effort and motion then belong together as they are. Stamps
    of the effort that are late by ``delay`` [s] part them: the model fits far better with the effort read later.
    """
    here, later = (
        sum(_plant_misfit(s, joint, shift) for s in fit if s.has_u[joint]) for shift in (0.0, delay)
    )
    return later < PARTED * here


def _plant_misfit(s: Session, joint: int, shift: float) -> float:
    """Sum of squares that load, inertia and friction of free size leave over of an effort read ``shift`` later."""
    later = np.interp(s.t + shift, s.t, s.u[:, joint])
    needed = [s.load[:, joint], s.a[:, joint], s.v[:, joint], s.sign(joint), np.ones(len(s.t))]
    edge = max(1, round(EDGE_S / s.dt))
    rows = lowpass(np.stack([later, *needed], axis=1), float(s.cut[joint]), s.dt)[edge:-edge]
    left = rows[:, 0] - rows[:, 1:] @ np.linalg.lstsq(rows[:, 1:], rows[:, 0], rcond=None)[0]
    return float(left @ left)


def _late_effort(
    joint: int,
    gain: float,
    share: float,
    parameters: dict[str, dict],
    shape: dict[str, float],
    rivals: dict[str, float],
) -> LawFinding:
    """Stamps of the effort that are late, as the lag of the position behind the effort that the catalogue knows."""
    said = parameters["lag"]
    low, high = said["interval90"]
    lag = said | {"value": -said["value"], "interval90": [-high, -low]}
    shape = {"lag": -shape["lag"]}
    return LawFinding("clock_skew", joint, gain, share, {"lag": lag}, shape, rivals, of_effort=True)


def _as_clock(delay: Found) -> Found:
    gain, _, share, parameters, shape = delay
    return gain, EFFORT_CLOCK, share, {"lag": parameters["delay"]}, {"lag": shape["delay"]}


def _held_for(s: Session) -> float:
    """How old an effort may be when it is logged beside a motion of now [s]: one period of the controller.

    Rows that are not taken on its ticks hold the effort of the last one. Without a declared rate, a row's distance.
    """
    rate = s.rec.controller.rate_hz
    return 1.0 / rate if rate else s.rec.as_read.dt


def stamps_agree(model: RigidModel, fit: list[Session], joint: int) -> bool:
    """Does the declared law, recomputed from position and speed, show that effort and motion share their stamps?

    Only for efforts as asked for: shifted by ``KNOWN_S`` either way the law misses them clearly more than in place.
    """
    test = _test_of(model, fit, joint, "commanded")
    return test is not None and test.relative < HOLDS and _excludes(test, KNOWN_S)


def stamps_within(model: RigidModel, fit: list[Session], joint: int) -> float | None:
    """Shift [s] between a reported effort and the motion that the declared law excludes; None where it excludes none.

    What a drive reports has passed its delay and lag. Where the law holds without any of them, stamps agree as well.
    """
    test = _test_of(model, fit, joint, "measured")
    if test is None or test.relative > HOLDS_NOISY:
        return None
    return next((x for x in SHIFTS_S if _excludes(test, x)), None)


def _test_of(model: RigidModel, fit: list[Session], joint: int, effort: str) -> _Test | None:
    own = [s for s in fit if s.has_u[joint]]
    rows = [_rows(model, s, joint, False) for s in own]
    usable = [r for r in rows if r is not None]
    if not usable or len(usable) < len(rows) or any(s.rec.effort != effort for s in own):
        return None
    return _Test(usable, model)


def _excludes(test: _Test, shift: float) -> bool:
    """Does the law miss the effort clearly more with the motion moved by so much either way?"""
    here = sum(m for m, _ in test.base)
    sides = [sum(m for m, _ in test.misfit(lambda r, x=x: r.late(x))) for x in (-shift, shift)]
    return min(sides) > CLEARLY * here


class _Test:
    """Misfit of the law with a change applied, nuisance (start of the integral) taken out."""

    def __init__(self, rows: list[_Rows], model: RigidModel) -> None:
        self.rows = rows
        self.joint_name = model.joints[rows[0].joint]
        unit = f"{model.effort_unit(self.joint_name)}/{model.unit(self.joint_name)}"
        self.gain_unit = {"kp": unit, "kd": f"{unit}·s"}
        self.y = [r.compare(r.u - r.asked) for r in rows]
        power = np.concatenate([r.compare(r.u) for r in rows])
        self.power = float(np.var(power)) + 1e-30
        self.base = self.misfit(lambda _: None)
        self.relative = sum(m for m, _ in self.base) / sum(n for _, n in self.base) / self.power

    def misfit(self, change: Callable[[_Rows], np.ndarray | None]) -> list[tuple[float, int]]:
        """Per recording: sum of squares and number of rows."""
        found = []
        for r, y in zip(self.rows, self.y, strict=True):
            moved = change(r)
            left = y if moved is None else y - r.compare(moved)
            nuisance = [np.ones(len(left)), np.linspace(-1, 1, len(left)), *(r.compare(x) for x in r.unsure)]
            X = np.stack(nuisance, axis=1)
            left = left - X @ np.linalg.lstsq(X, left, rcond=None)[0]
            found.append((float(left @ left) + LEAST_MISFIT * self.power * len(left), len(left)))
        return found

    def likelihood(self, misfit: list[tuple[float, int]]) -> float:
        """Log likelihood with the noise level read from the misfit itself."""
        total, n = sum(m for m, _ in misfit), sum(k for _, k in misfit)
        return -0.5 * n / TEMPER * float(np.log(total / n))

    def odds(self, misfit: list[tuple[float, int]], parameters: int) -> float:
        """Log odds against the law as declared, Bayesian information criterion."""
        n = sum(k for _, k in misfit) / TEMPER
        return self.likelihood(misfit) - self.likelihood(self.base) - 0.5 * parameters * float(np.log(n))

    def share(self, misfit: list[tuple[float, int]]) -> float:
        """Share of the misfit removed."""
        return 1.0 - sum(m for m, _ in misfit) / sum(m for m, _ in self.base)

    def interval(
        self, cost: Callable[[float], float], x: float, scale: float, more: float = 0.0
    ) -> list[float]:
        """90 % interval from the curvature of a negative log likelihood at its minimum.

        ``more`` is what the records do not say about the value, MODEL_ERROR what the equations leave out.
        """
        h = 0.02 * scale
        bend = (cost(x + h) - 2.0 * cost(x) + cost(x - h)) / h**2
        half = Z90 / np.sqrt(max(bend, 1e-12 / scale**2))
        half = float(np.sqrt(half**2 + (Z90 * MODEL_ERROR * scale) ** 2 + more**2))
        return [float(x - half), float(x + half)]


Found = tuple[float, str, float, dict[str, dict], dict[str, float]]


def _gain(test: _Test, which: str) -> Found:
    fit = [(r, y) for r, y in zip(test.rows, test.y, strict=True) if not r.held]
    columns = [r.compare(getattr(r, which)) for r, _ in fit]
    c, y = np.concatenate([x - x.mean() for x in columns]), np.concatenate([y - y.mean() for _, y in fit])
    x = float(c @ y / max(c @ c, 1e-30))
    misfit = test.misfit(lambda r: x * getattr(r, which))
    left = y - x * c
    half = Z90 * float(np.sqrt(TEMPER * (left @ left) / len(left) / max(c @ c, 1e-30)))
    first = test.rows[0]
    gains = first.s.rec.controller.kp if which == "kp" else first.s.rec.controller.kd
    nominal = gains.get(test.joint_name, 0.0)
    ends = [nominal * (1.0 + x - half), nominal * (1.0 + x + half)]
    table = {which: {"value": nominal * (1.0 + x), "from": nominal, "unit": test.gain_unit[which],
                     "interval90": ends, "identifiable": True}}  # fmt: skip
    return test.odds(misfit, 1), "controller_gain", test.share(misfit), table, {}


def _smoother_speed(test: _Test) -> float:
    """Log odds of a law whose drive damps a smoother speed than the one that was made of the positions; 0 if logged.

    Steps of an encoder, differentiated here, are noise that the drive may never have seen: a lag smooths them as well.
    """
    name = test.joint_name
    if any(r.s.rec.get("dq", name) is not None for r in test.rows):
        return 0.0

    def smoother(r: _Rows, cut_hz: float) -> np.ndarray:
        return lowpass(r.kd, cut_hz, r.s.dt) - r.kd

    return max(0.0, *(test.odds(test.misfit(lambda r, f=f: smoother(r, f)), 1) for f in SMOOTHER_HZ))


def _delayed(r: _Rows, delay: float) -> np.ndarray:
    return CubicSpline(r.s.t, r.asked)(np.clip(r.s.t - delay, 0.0, r.s.t[-1])) - r.asked


def _lagged(r: _Rows, time_constant: float) -> np.ndarray:
    asked = CubicSpline(r.s.t, r.asked)(r.fine)
    late = filtered([1.0], [time_constant, 1.0], asked - asked[0], float(r.fine[1])) + asked[0]
    return np.interp(r.s.t, r.fine, late) - r.asked


def _shift(test: _Test, name: str, change: Callable[[_Rows, float], np.ndarray], tried: np.ndarray) -> Found:
    def cost(x: float) -> float:
        return -test.likelihood(test.misfit(lambda r: change(r, x)))

    values = [cost(float(x)) for x in tried]
    best = float(tried[int(np.argmin(values))])
    around = sorted((0.6 * best, 1.6 * best))
    x = float(minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": 1e-6}).x)
    misfit = test.misfit(lambda r: change(r, x))
    key = {"actuator_delay": "delay", "bandwidth": "time_constant"}.get(name, "lag")
    rate = test.rows[0].s.rec.controller.rate_hz
    tick = TICK_SHARE / rate if rate and name in OLD else 0.0
    table = {
        key: {
            "value": x,
            "unit": "s",
            "interval90": test.interval(cost, x, abs(x), tick),
            "identifiable": True,
        }
    }
    # the effect of the catalogue calls its shape by another letter than the answer calls its parameter
    shape = {"T" if name == "bandwidth" else key: x}
    return test.odds(misfit, 1), name, test.share(misfit), table, shape


def _clip(test: _Test, unit: str) -> Found:
    asked = np.concatenate([np.abs(r.asked) for r in test.rows])
    # A drive that is at its limit for most of the time is asked for more than that by most rows: its own top tells.
    reached = float(np.quantile(np.concatenate([np.abs(r.u) for r in test.rows]), TOP))

    def change(r: _Rows, limit: float, v0: float) -> np.ndarray:
        bound = limit
        if v0 > 0:
            bound = limit * (1.0 - np.clip(np.sign(r.asked) * r.s.v[:, r.joint] / v0, 0.0, 1.0))
        return np.clip(r.asked, -bound, bound) - r.asked

    top = max(float(np.percentile(np.abs(r.s.v[:, r.joint]), 99.5)) for r in test.rows) + 1e-12
    best, best_cost = (float(asked.max()), 0.0), np.inf
    for v0 in (0.0, 3.0 * top, 5.0 * top, 8.0 * top):
        shares = (0.5, 0.7, 0.8, 0.87, 0.92, 0.95, 0.975, 0.99, 0.997)
        for limit in (reached, *(float(np.quantile(asked, q)) * (1.0 if v0 == 0.0 else 1.1) for q in shares)):
            value = -test.likelihood(test.misfit(lambda r: change(r, limit, v0)))  # noqa: B023
            if value < best_cost:
                best, best_cost = (limit, v0), value

    def cost(x: float) -> float:
        return -test.likelihood(test.misfit(lambda r: change(r, x, best[1])))

    limit = float(minimize_scalar(cost, bounds=(0.85 * best[0], 1.15 * best[0]), method="bounded").x)
    misfit = test.misfit(lambda r: change(r, limit, best[1]))
    table = {"limit": {"value": limit, "unit": unit, "interval90": test.interval(cost, limit, limit),
                       "identifiable": True}}  # fmt: skip
    arrived = np.concatenate([np.abs(r.s.rec.as_read.channels["tau"][test.joint_name]) for r in test.rows])
    passed = np.mean(arrived > PASSED * limit) > PASSES
    odds = -np.inf if passed else test.odds(misfit, 2)
    return odds, "saturation", test.share(misfit), table, {"limit": limit, "v0": best[1]}


def _rows(model: RigidModel, s: Session, joint: int, held: bool) -> _Rows | None:
    parts = law_parts(model, s, joint)
    if parts is None or not s.has_drive[joint]:
        return None
    asked = parts.total()

    def late(lag: float) -> np.ndarray:
        shifted = law_parts(model, s, joint, lag)
        assert shifted is not None
        return shifted.total() - asked

    fine = np.arange(0.0, float(s.t[-1]), min(FINE_S, s.dt))
    u = s.drive(joint) if s.rec.rows is None else asked + _off_at_rows(model, s, joint)
    return _Rows(s, joint, held, u, asked, parts.kp, parts.kd, fine, late, _unsure(model, s, joint))


def _unsure(model: RigidModel, s: Session, joint: int) -> list[np.ndarray]:
    """Changes of speeds that were not logged: whether a controller differentiates early or late is not known."""
    name, law = model.joints[joint], s.rec.controller
    found: list[np.ndarray] = []
    if not law.kd.get(name, 0.0):
        return found
    if s.rec.get("dq", name) is None:
        found.append(s.a[:, joint])
    command = s.channel("q_cmd", name)
    if command is not None and law.kind != "position_servo" and s.rec.get("dq_cmd", name) is None:
        found.append(np.gradient(np.gradient(command, s.dt), s.dt))
    return found


def _off_at_rows(model: RigidModel, s: Session, joint: int) -> np.ndarray:
    """Reported effort minus what the law asks for at the rows of a slow log, linear between, shape (time,).

    The law is evaluated on the row as read: position and speed carry the noise that the controller saw.
    """
    rec, name = s.rec.as_read, model.joints[joint]
    law = rec.controller
    asked = law.kp[name] * (rec.channels["q_cmd"][name] - rec.channels["q"][name])
    speed, command = rec.get("dq", name), rec.get("dq_cmd", name)
    if command is None:
        command = unlogged_speed(law.kind, rec.channels["q_cmd"][name], rec.t)
    if speed is not None:
        asked = asked + law.kd.get(name, 0.0) * (command - speed)
    ahead = rec.get("tau_ff", name)
    asked = asked if ahead is None else asked + ahead
    low, high = model.effort_limits()
    off = np.clip(rec.channels["tau"][name], low[joint], high[joint]) - np.clip(
        asked, low[joint], high[joint]
    )
    return np.interp(s.t, rec.t, off)
