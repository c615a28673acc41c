"""Two things to beat: the user's own parameters refitted, and a small network that learns the residual."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from s2r_host.gap.effects.base import StepState
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.rows import compare
from s2r_host.gap.search.search import Search
from s2r_host.gap.simulation.replay import Twin, build_twin

BASELINES = ("sysid", "residual_network")
LOOSE = 30.0
HIDDEN = 24
STEPS = 1500


def not_fitted(why: str) -> dict:
    """The entry of a baseline that there is none of."""
    return {"holdout": None, "open_loop_holdout": None, "how": f"not fitted: {why}"}


def refitted_parameters(problem: Problem, search: Search) -> Twin:
    """The nominal model with its base parameters fitted freely, and no new physics."""
    before = search.looseness
    search.looseness = LOOSE
    solution = search.finish([], [], [])
    search.looseness = before
    return build_twin(problem.ctx.model, problem.ctx, [], problem.moved(solution.base))


def residual_network(problem: Problem, rng: np.random.Generator) -> Callable[[StepState], np.ndarray]:
    """One hidden layer per joint, (q, dq, sign dq, load) to residual effort, trained with Adam.

    Args:
        problem: Residual and sessions; only fit rows are used, the last fifth of them stops the training.
        rng: Source of the initial weights and batches.
    """
    nets = {j: _train(*_data(problem, j), rng) for j in problem.joints}
    eps = {j: max(float(s.v_eps[j]) for s in problem.ctx.sessions) for j in problem.joints}
    nv = len(problem.ctx.model.joints)

    def correction(state: StepState) -> np.ndarray:
        out = np.zeros(nv)
        for j, net in nets.items():
            x = np.array([state.q[j], state.v[j], np.tanh(state.v[j] / eps[j]), state.load[j]])
            out[j] = float(net(x[None])[0])
        return out

    return correction


def _data(problem: Problem, j: int) -> tuple[np.ndarray, np.ndarray]:
    X, y = [], []
    for block in problem.blocks:
        if block.joint == j:
            s = block.session
            F = np.stack([s.q[:, j], s.v[:, j], s.sign(j), s.load[:, j]], axis=1)
            X.append(compare(F, s, j, True)[block.picks][~block.held])
            y.append(problem.raw[block.rows][~block.held])
    return np.concatenate(X), np.concatenate(y)


def _train(X: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    mean, scale = X.mean(0), X.std(0) + 1e-9
    size = float(y.std()) + 1e-12
    Z, target = (X - mean) / scale, y / size
    cut = int(0.8 * len(Z))
    W = [
        rng.normal(size=(Z.shape[1], HIDDEN)) / 2.0,
        np.zeros(HIDDEN),
        rng.normal(size=HIDDEN) / HIDDEN,
        np.zeros(1),
    ]
    m, v = [np.zeros_like(w) for w in W], [np.zeros_like(w) for w in W]
    best, best_loss = [w.copy() for w in W], np.inf
    for step in range(1, STEPS + 1):
        pick = rng.integers(0, max(cut, 1), size=min(256, cut))
        h = np.tanh(Z[pick] @ W[0] + W[1])
        error = h @ W[2] + W[3] - target[pick]
        back = (error[:, None] * W[2]) * (1.0 - h**2)
        grads = [Z[pick].T @ back, back.sum(0), h.T @ error, np.array([error.sum()])]
        for k, g in enumerate(grads):
            g = g / len(pick) + 1e-5 * W[k]
            m[k] = 0.9 * m[k] + 0.1 * g
            v[k] = 0.999 * v[k] + 0.001 * g**2
            W[k] = W[k] - 0.01 * (m[k] / (1 - 0.9**step)) / (np.sqrt(v[k] / (1 - 0.999**step)) + 1e-8)
        if step % 50 == 0:
            loss = float(np.mean((np.tanh(Z[cut:] @ W[0] + W[1]) @ W[2] + W[3] - target[cut:]) ** 2))
            if loss < best_loss:
                best, best_loss = [w.copy() for w in W], loss
    low, high = Z.min(0), Z.max(0)

    def net(x: np.ndarray) -> np.ndarray:
        z = np.clip((x - mean) / scale, low, high)
        return size * (np.tanh(z @ best[0] + best[1]) @ best[2] + best[3])

    return net
