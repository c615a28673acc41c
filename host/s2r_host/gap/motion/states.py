"""Hidden states driven by the recorded motion, integrated for many shapes at once."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from s2r_host.gap.motion.session import Session

# Phase of the fastest contact per step. Many shapes share the steps of the fastest and so are finer than they need be.
TOGETHER_STEP, ALONE_STEP = 0.35, 0.25
TINY = 1e-9  # 1/s, 1/s²: where a linear motion changes its form


def bristle(s: Session, joint: int, width: np.ndarray, power: int = 1, beta: float = 1.0) -> np.ndarray:
    """Rate-independent bristle state in [-1, 1]: dz = dq/width (1 - |z|^n (β sgn(z dq) + 1 - β)).

    Dahl's solid friction model (1968) for n = 1 and β = 1, else a Bouc-Wen loop (Wen 1976); with β = 1/2 it turns back
    along a straight line. Integrated along position increments, so that it does not depend on the sampling rate.

    Args:
        s: Session with motion.
        joint: Joint index.
        width: Characteristic displacements [rad or m], shape (shapes,).
        power: Exponent n.
        beta: β, from 1/2 to 1.

    Returns:
        State, shape (time, shapes).
    """
    key = ("bristle", joint, power, round(beta, 9), tuple(np.round(width, 12)))
    stored = s.cache.get(key)
    if stored is not None:
        return stored
    step = np.diff(s.q[:, joint], prepend=s.q[0, joint])
    # Exact and linear in z for a given direction: a prefix scan instead of a loop.
    if power == 1 and beta == 1.0:
        keep = np.exp(-np.abs(step)[:, None] / width)
        out = linear_recursion(keep, np.sign(step)[:, None] * (1.0 - keep))
    else:
        out = _loop(step, width, power, beta)
    s.cache[key] = out
    return out


def stop_operator(s: Session, joint: int, reach: float) -> np.ndarray:
    """Elasto-plastic slip in [-1, 1]: follows the motion, held where |z| would exceed one, shape (time,).

    The stop operator (Visintin, Differential Models of Hysteresis, 1994, chapter III) of half travel ``reach``.
    """
    key = ("stop", joint, round(reach, 12))
    if key not in s.cache:
        z, out = 0.0, np.empty(len(s.t))
        for i, step in enumerate((np.diff(s.q[:, joint], prepend=s.q[0, joint]) / reach).tolist()):
            z = min(1.0, max(-1.0, z + step))
            out[i] = z
        s.cache[key] = out
    return s.cache[key]


def linear_recursion(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """z[i] = a[i] z[i-1] + b[i] with z[-1] = 0, by doubling, along the first axis."""
    a, z = a.copy(), b.copy()
    shift = 1
    while shift < len(z):
        z[shift:] += a[shift:] * z[:-shift].copy()
        a[shift:] *= a[:-shift].copy()
        shift *= 2
    return z


def _loop(step: np.ndarray, width: np.ndarray, power: int, beta: float) -> np.ndarray:
    return np.stack([_loop_of_one(step, float(w), power, beta) for w in width], axis=1)


def _loop_of_one(step: np.ndarray, width: float, power: int, beta: float) -> np.ndarray:
    """One shape at a time, in plain numbers: an array of one element costs ten times as much per step."""
    z, limit, back, out = 0.0, 0.2 * width, 2.0 * beta - 1.0, []
    for dq in step.tolist():
        parts = 1 if abs(dq) < limit else min(20, int(abs(dq) / limit) + 1)
        x = dq / parts / width
        for _ in range(parts):
            grow = 1.0 - abs(z) ** power if z * dq > 0.0 else 1.0 + back * abs(z) ** power
            z = max(min(z + x * grow, 1.0), -1.0)
        out.append(z)
    return np.array(out)


def deflection(
    s: Session,
    joint: int,
    inertia: np.ndarray,
    load: np.ndarray,
    slope: np.ndarray,
    k: np.ndarray,
    d: np.ndarray,
    gap: np.ndarray,
    bend: np.ndarray | None = None,
) -> np.ndarray:
    """Transmitted effort of a link that hangs on a motor whose motion was recorded.

    Link minus motor angle δ obeys M δ̈ = T - L with T = -k dz(δ) - d δ̇ in contact; dz is the dead zone of half
    width ``gap``. L is the load the link would put on a rigid transmission, plus its change with δ: gravity pulls where
    the link is.

    Args:
        s: Session.
        joint: Joint index.
        inertia: Link inertia, shape (time, shapes).
        load: Rigid load of the link, shape (time, shapes).
        slope: Change of that load with the link's position, shape (time,).
        k, d, gap: Stiffness, damping, half width, shape (shapes,).
        bend: Change of ``slope`` with the link's position, shape (time,); only used for one shape alone.

    Returns:
        T, shape (time, shapes).
    """
    if load.shape[1] == 1:
        bend = np.zeros_like(slope) if bend is None else bend
        return _deflection_of_one(
            s, inertia[:, 0], load[:, 0], slope, bend, float(k[0]), float(d[0]), float(gap[0])
        )[:, None]
    n, shapes = load.shape
    lightest = np.min(
        inertia, axis=0
    )  # along an arm's motion the inertia varies tenfold, the damping does not
    fastest = float(max(np.max(np.sqrt(k / lightest)), np.max(d / lightest)))
    parts = max(1, int(np.ceil(fastest * s.dt / TOGETHER_STEP)))
    h = s.dt / parts
    delta = -np.sign(load[0]) * gap - load[0] / k
    rate = np.zeros(shapes)
    out = np.empty((n, shapes))
    for i in range(n):
        per_mass, pull, turn = h / inertia[i], load[i], slope[i]
        for _ in range(parts):
            over = delta - np.minimum(np.maximum(delta, -gap), gap)
            effort = -k * over - d * rate * (over != 0.0)
            rate = rate + (effort - pull - turn * delta) * per_mass
            delta = delta + h * rate
        over = delta - np.minimum(np.maximum(delta, -gap), gap)
        out[i] = -k * over - d * rate * (over != 0.0)
    return out


def _deflection_of_one(
    s: Session, inertia: np.ndarray, load: np.ndarray, slope: np.ndarray, bend: np.ndarray, k: float, d: float,
    gap: float,
) -> np.ndarray:  # fmt: skip
    """The same for one shape, in plain numbers: a tenth of the cost of arrays of one element, shape (time,)."""
    if gap == 0.0:
        return _hanging_link(s.dt, inertia, load, slope, bend, k, d)
    lightest = float(np.min(inertia))
    parts = max(1, int(np.ceil(max(float(np.sqrt(k / lightest)), d / lightest) * s.dt / ALONE_STEP)))
    h = s.dt / parts
    delta, rate, out = -float(np.sign(load[0])) * gap - float(load[0]) / k, 0.0, []
    rows = ((h / inertia).tolist(), load.tolist(), slope.tolist(), (0.5 * bend).tolist())
    for per_mass, pull, turn, half in zip(*rows, strict=True):
        for _ in range(parts):
            over = delta - gap if delta > gap else delta + gap if delta < -gap else 0.0
            effort = -k * over - d * rate if over else 0.0
            rate += (effort - pull - (turn + half * delta) * delta) * per_mass
            delta += h * rate
        over = delta - gap if delta > gap else delta + gap if delta < -gap else 0.0
        out.append(-k * over - d * rate if over else 0.0)
    return np.array(out)


def _hanging_link(
    dt: float, inertia: np.ndarray, load: np.ndarray, slope: np.ndarray, bend: np.ndarray, k: float, d: float
) -> np.ndarray:
    """The same without a gap: each row in one step, however stiff and damped the spring is, shape (time,).

    Between two rows the equation is linear, M δ̈ + d δ̇ + (k + slope) δ = -L, up to the small ``bend``, which is taken at
    the middle of the step: its exact solution needs no steps shorter than a row (exponential integrator; Hochbruck and
    Ostermann, Acta Numerica 19, 2010).
    """
    half, stiffness = 0.5 * d / inertia, (k + slope) / inertia
    stiffness = np.where(np.abs(stiffness) < TINY, TINY, stiffness)
    root = np.sqrt(half**2 - stiffness + 0j)
    root = np.where(np.abs(root) < TINY, TINY, root)
    slow, fast = np.exp((root - half) * dt), np.exp((-root - half) * dt)
    even, odd = (0.5 * (slow + fast)).real, (0.5 * (slow - fast) / root).real
    stays = even + half * odd
    rows = (
        stays,
        odd,
        -stiffness * odd,
        even - half * odd,
        (1.0 - stays) / stiffness / inertia,
        odd / inertia,
    )
    delta, rate, out = -float(load[0]) / k, 0.0, []
    columns = (x.tolist() for x in (*rows, load, 0.5 * bend))
    for aa, ab, ba, bb, shift, push, pull, more in zip(*columns, strict=True):
        middle = delta + 0.5 * dt * rate
        effort = pull + more * middle * middle
        delta, rate = aa * delta + ab * rate - shift * effort, ba * delta + bb * rate - push * effort
        out.append(-k * delta - d * rate)
    return np.array(out)


def filtered(num: list[float], den: list[float], x: np.ndarray, dt: float) -> np.ndarray:
    """Continuous transfer function of up to second order applied to a signal that starts at rest.

    Tustin's substitution s = 2/dt (1 - z)/(1 + z), z the delay by one sample.
    """
    k = 2.0 / dt
    b, a = _tustin(num, k), _tustin(den, k)
    return np.asarray(lfilter(b / a[0], a / a[0], x))


def _tustin(polynomial: list[float], k: float) -> np.ndarray:
    c2, c1, c0 = [0.0] * (3 - len(polynomial)) + polynomial
    return np.array([c2 * k * k + c1 * k + c0, 2.0 * (c0 - c2 * k * k), c2 * k * k - c1 * k + c0])


def delayed(x: np.ndarray, delay: float, dt: float) -> np.ndarray:
    """x(t - delay) by linear interpolation, ends held; negative delays look ahead."""
    grid = np.arange(len(x)) * dt
    return np.interp(grid - delay, grid, x)
