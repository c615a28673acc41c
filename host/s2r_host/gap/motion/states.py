"""Hidden states driven by the recorded motion, integrated for many shapes at once."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from s2r_host._native import held_slip, hysteresis_loop
from s2r_host.gap.motion.session import Session


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
        s.cache[key] = held_slip(np.diff(s.q[:, joint], prepend=s.q[0, joint]) / reach)
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
    step = np.ascontiguousarray(step)
    return np.stack([hysteresis_loop(step, width=float(w), power=power, beta=beta) for w in width], axis=1)


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
