"""90 % intervals of stated parameters: noise, what the shapes of an effect trade off, what its equation leaves out.

The coefficients of an effect are fitted at fixed shapes (widths, edges, speeds), and each shape is searched on its own.
But a shape and a coefficient pull against each other, as do two shapes, so the interval of each comes from the
curvature of the evidence over all shapes together (Laplace's approximation; MacKay, Information Theory, Inference, and
Learning Algorithms, 2003, chapter 27), carried to the coefficients by how they follow the shapes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from s2r_host.gap.effects.base import Value
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Solution, Term
from s2r_host.gap.search.search import Search

MODEL_ERROR = 0.012  # relative error of a value beyond its noise: what the equations of an effect leave out
Z90 = 1.645
LEAST_DROP = 0.2  # log odds that tell one shape from the next
LEAST_CURVATURE = 0.05  # of a direction of shapes, against what each shape has alone


@dataclass(frozen=True)
class Spread:
    """How uncertain the shapes of one term are, and what that does to its coefficients.

    Attributes:
        keys: Shape parameters; ``flat`` those that the data do not fix.
        covariance: Of the shapes, shape (keys, keys).
        slopes: Change of the coefficients with each shape, shape (coefficients, keys).
    """

    keys: tuple[str, ...]
    covariance: np.ndarray
    slopes: np.ndarray
    flat: frozenset[str]


def parameter_table(problem: Problem, search: Search, solution: Solution, i: int) -> dict[str, dict]:
    """Values with 90 % intervals; a flat profile makes a parameter unidentifiable."""
    term = solution.terms[i]
    effect = search.effects[term.effect]
    values = effect.parameters(problem.ctx, term.joint, dict(term.shape), solution.theta[i])
    others = [t for k, t in enumerate(solution.terms) if k != i]
    spread = shape_spread(search, term, others, solution.noise)
    table = {}
    for name, value in values.items():
        deviation, identifiable = _deviation(solution, i, spread, value)
        error = effect.model_error.get(name, MODEL_ERROR)
        half = Z90 * float(np.linalg.norm([deviation, error * value.value, value.error]))
        identifiable = identifiable and error < 0.5
        table[name] = {
            "value": float(value.value),
            "unit": value.unit,
            "interval90": [float(value.value - half), float(value.value + half)],
            "identifiable": bool(identifiable),
        }
    return table


def _deviation(solution: Solution, i: int, spread: Spread, value: Value) -> tuple[float, bool]:
    if value.gradient:
        g = np.array(value.gradient)
        along = g @ spread.slopes
        variance = float(g @ solution.covariance[i] @ g + along @ spread.covariance @ along)
        deviation = float(np.sqrt(max(variance, 0.0)))
        return deviation, deviation < 0.5 * abs(value.value) + 1e-12
    if value.shape_key is None or value.shape_key not in spread.keys:
        return 0.0, True
    k = spread.keys.index(value.shape_key)
    return float(np.sqrt(spread.covariance[k, k])) * abs(value.scale), value.shape_key not in spread.flat


def shape_spread(search: Search, term: Term, others: list[Term], noise: float) -> Spread:
    """Joint curvature of the evidence over the shapes of a term beside the other terms."""
    fit = ~search.problem.held
    base = search.marginal(others, fit, noise)
    shape = dict(term.shape)
    steps = search.effects[term.effect].refine(search.problem.ctx, term.joint)
    keys = tuple(k for k in steps if k in shape)
    x0 = np.array([shape[k] for k in keys])

    def at(x: np.ndarray) -> tuple[float, np.ndarray]:
        moved = shape | {k: float(v) for k, v in zip(keys, x, strict=True)}
        w, prior = search.weigh(base, fit, Term(term.effect, term.joint, tuple(sorted(moved.items()))))
        return w.log_evidence(noise, prior), w.theta

    top, theta = at(x0)
    deviations, flat = np.zeros(len(keys)), set()
    for k, (key, unit) in enumerate(zip(keys, np.eye(len(keys)), strict=True)):
        law, step = steps[key]
        scale = abs(x0[k]) if law == "log" else 1.0
        deviations[k], is_flat = curvature(
            lambda h, u=unit: at(x0 + h * u)[0], top, step, scale, law, abs(x0[k])
        )
        if is_flat:
            flat.add(key)
    firm = [k for k, key in enumerate(keys) if key not in flat and deviations[k] > 0]
    covariance = np.diag(deviations**2)
    slopes = np.zeros((len(theta), len(keys)))
    if not firm:
        return Spread(keys, covariance, slopes, frozenset(flat))
    moves = np.diag(deviations)
    sides = {(k, sign): at(x0 + sign * moves[k]) for k in firm for sign in (1.0, -1.0)}
    bends = np.eye(len(firm))
    for a, k in enumerate(firm):
        slopes[:, k] = (sides[k, 1.0][1] - sides[k, -1.0][1]) / (2.0 * deviations[k])
        for b in range(a):
            m = firm[b]
            both = at(x0 + moves[k] + moves[m])[0] + at(x0 - moves[k] - moves[m])[0]
            alone = sum(sides[n, sign][0] for n in (k, m) for sign in (1.0, -1.0))
            bends[a, b] = bends[b, a] = -0.5 * (both - alone + 2.0 * top)
    values, vectors = np.linalg.eigh(np.clip(bends, -1.0, 1.0))
    inverse = (vectors / np.maximum(values, LEAST_CURVATURE)) @ vectors.T
    covariance[np.ix_(firm, firm)] = inverse * np.outer(deviations[firm], deviations[firm])
    return Spread(keys, covariance, slopes, frozenset(flat))


def curvature(
    value: Callable[[float], float], top: float, step: float, scale: float, law: str, size: float
) -> tuple[float, bool]:
    """Standard deviation of one shape from the profile of the evidence; second: is it flat?

    Args:
        value: Log evidence at a distance from the optimum, where it is ``top``.
        step: First step, ``scale`` its unit; ``law`` is ``log`` for shapes that cannot change sign.
        size: The shape itself.
    """
    h = step * scale
    for _ in range(12):
        drop = top - 0.5 * (value(h) + value(-h))
        if abs(drop) < 1e-9:  # finer than the grid of the hidden state: the grid is the resolution
            return float(2.0 * h / np.sqrt(2.0 * 3.0)), False
        if LEAST_DROP < drop < 3.0:
            return h / np.sqrt(2.0 * drop), h > 0.5 * size
        h = h * 0.5 if drop >= 3.0 else h * 1.6
        if h > 0.9 * scale and law == "log":
            return h, True
    # Evidence that jumps (impacts are chaotic) never falls by a middling amount: the jump is the resolution.
    drop = max(top - 0.5 * (value(h) + value(-h)), LEAST_DROP)
    return float(h / np.sqrt(2.0 * drop)), h > 0.5 * size
