"""What the answer adds beside the verdict: two baselines and the next experiment."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from s2r_host.gap.config import GapConfig
from s2r_host.gap.output.baselines import BASELINES, not_fitted, refitted_parameters, residual_network
from s2r_host.gap.output.next_experiment import propose
from s2r_host.gap.pipeline import Analysis
from s2r_host.gap.simulation.forward import Errors, evaluate
from s2r_host.gap.simulation.replay import build_twin


def add_extras(a: Analysis, config: GapConfig, seed: int, folder: Path, log: Callable[[str], None]) -> None:
    """Fill ``baselines`` and ``next_experiment`` of an analysis in place."""
    if a.verdict == "insufficient" or a.problem is None or a.search is None or a.decision is None:
        # The first note says what the recordings lack: effort, length or motion.
        a.next_experiment = {"separates": [], "trajectory": None, "why": a.notes[0]}
        a.baselines |= {name: not_fitted("the recordings cannot tell") for name in BASELINES}
        return
    if config.baselines and config.simulate:
        log("baselines")
        joints = list(a.problem.joints)
        window = config.open_loop_window_s
        refit = refitted_parameters(a.problem, a.search)
        a.baselines["sysid"] = _held(evaluate(refit, a.fit, a.hold, joints, window), joints)
        a.baselines["sysid"]["how"] = (
            "the model's own parameters, least squares on the effort, no new physics"
        )
        net = residual_network(a.problem, np.random.default_rng(seed))
        twin = build_twin(a.model, a.problem.ctx, [], generic=net)
        a.baselines["residual_network"] = _held(evaluate(twin, a.fit, a.hold, joints, window), joints)
    if config.next_experiment and a.verdict in ("physics_missing", "unknown"):
        log("next experiment")
        a.next_experiment |= propose(a, a.decision, folder)


def _held(e: Errors, joints: list[int]) -> dict:
    def rms(x: np.ndarray) -> float:
        return float(np.sqrt(np.mean(x[joints] ** 2)))

    closed = bool(np.isfinite(e.held).any())
    return {"holdout": rms(e.held if closed else e.open_held), "open_loop_holdout": rms(e.open_held)}
