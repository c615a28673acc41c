"""What the answer adds beside the verdict: baselines and the next experiment."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from s2r_host.gap.config import GapConfig
from s2r_host.gap.output.baselines import BASELINES, not_fitted, refitted_parameters, residual_network
from s2r_host.gap.output.next_experiment import propose
from s2r_host.gap.pipeline import Analysis, floor_json
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.search.search import Search
from s2r_host.gap.simulation.forward import Errors, evaluate
from s2r_host.gap.simulation.replay import Twin, build_twin

NETWORK_MARGIN = 0.1
PREDICTIONS = ("sysid", "refitted_parameters", "residual_network")


def add_extras(a: Analysis, config: GapConfig, seed: int, folder: Path, log: Callable[[str], None]) -> None:
    """Fill ``baselines`` and ``next_experiment`` of an analysis in place."""
    if a.verdict == "insufficient" or a.problem is None or a.search is None or a.decision is None:
        # The first note says what the recordings lack: effort, length or motion.
        a.next_experiment = {"separates": [], "trajectory": None, "why": a.notes[0]}
        a.baselines |= {name: not_fitted("the recordings cannot tell") for name in BASELINES}
        return
    if config.baselines and config.simulate:
        log("baselines")
        a.baselines |= _baselines(a, a.problem, a.search, config.open_loop_window_s, seed)
        if a.baselines["residual_network"].get("named_within_10_percent") is False:
            a.notes.append(
                "the small residual network predicts held-out motion by more than 10 % better than what is named: the "
                "names do not explain all that can be learned"
            )
    if config.next_experiment and a.verdict in ("physics_missing", "unknown", "parameter_off"):
        log("next experiment")
        a.next_experiment |= propose(a, a.decision, folder)


def _baselines(a: Analysis, problem: Problem, search: Search, window_s: float, seed: int) -> dict[str, dict]:
    """Three predictions of the held-out motion that name nothing, and whether what is named is near the network's."""
    from s2r_host.gap.output.sysid import identify  # loads plotting libraries

    assert a.after is not None
    joints = list(problem.joints)
    named = _held(a.after, joints)["holdout"]
    if not np.isfinite(named):  # an effort or a law is missing, and so it is for any other model
        return dict.fromkeys(PREDICTIONS, not_fitted("no forward simulation of these recordings is possible"))

    def predicted(twin: Twin) -> dict:
        return _held(evaluate(twin, a.fit, a.hold, joints, window_s), joints)

    found = identify(problem, a.fit, bool(a.hold))
    if isinstance(found, str):
        sysid = not_fitted(found)
    else:
        sysid = predicted(build_twin(a.model, problem.ctx, [], found.moved)) | found.as_json()
    refitted = predicted(refitted_parameters(problem, search))
    refitted["how"] = "the model's own parameters, least squares on the effort by this tool, no new physics"
    net = residual_network(problem, np.random.default_rng(seed))
    network = predicted(build_twin(a.model, problem.ctx, [], learned=net))
    network["how"] = "one hidden layer per joint, position, speed, direction and load to residual effort"
    network["named_within_10_percent"] = near_network(named, network["holdout"], floor_json(a)["q_rmse"])
    return dict(zip(PREDICTIONS, (sysid, refitted, network), strict=True))


def near_network(named: float, network: float, floor: float) -> bool:
    """Is a held-out error at most a tenth above the residual network's, or above the noise of a position?"""
    return named <= (1.0 + NETWORK_MARGIN) * max(network, floor)


def _held(e: Errors, joints: list[int]) -> dict:
    def rms(x: np.ndarray) -> float:
        return float(np.sqrt(np.mean(x[joints] ** 2)))

    closed = bool(np.isfinite(e.held).any())
    return {"holdout": rms(e.held if closed else e.open_held), "open_loop_holdout": rms(e.open_held)}
