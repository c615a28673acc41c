"""Opening the sealed truth after a run, and what it says."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from s2r_sim.demo.goals import Goal
from s2r_sim.score import Truth, read_truth, sense
from s2r_sim.world import load_world


@dataclass(frozen=True)
class DemoVerdict:
    """The demo's result. Joint values [m or rad] as the demo's target is counted: 0 = as found, + = out or opening.

    Attributes:
        seed: Of the hidden world.
        exit_code: The host's.
        reason: The host's, one sentence.
        s_target: What was asked for last.
        s_initial_true: True value before the first planned manipulation towards it, None if none began.
        s_true: True value at the end.
        delta_first_true: True δ after the first planned manipulation towards it.
        delta_true: True δ at the end.
        delta_r_true: δ over the distance that was asked for.
        delta_measured: δ as the host measured it with the camera.
        deltas_true: True δ of every target that was manipulated towards, in order.
        others_moved: How far each other part that can move has moved in all; the part is the one that plans moved most.
        attempts: Planned manipulations carried out.
        wall_s: The host's wall time.
        commitment: Salted hash of the world, published by the stand-in before the run.
        commitment_holds: The world file still has that hash.
        report: The host's report.
    """

    seed: int
    exit_code: int
    reason: str
    s_target: float
    s_initial_true: float | None
    s_true: float
    delta_first_true: float | None
    delta_true: float
    delta_r_true: float | None
    delta_measured: float | None
    deltas_true: tuple[float, ...]
    others_moved: tuple[float, ...]
    attempts: int
    wall_s: float
    commitment: str
    commitment_holds: bool
    report: str

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def open_truth(seed: int, folder: Path, published: str) -> DemoVerdict:
    """Compare what the host believes with what really happened.

    Args:
        seed: Of the world.
        folder: The demo's folder, with ``world.json``, ``truth.csv`` and ``run/run.json``.
        published: The commitment the stand-in printed before the run.

    Raises:
        TruthFileError, WorldFileError: A file is missing or damaged.
    """
    run = json.loads((folder / "run/run.json").read_text())
    truth = _truth_of_part(folder, run)
    s_true = float(truth.s[-1])
    counted = float(run["s_origin"])  # the host's own joint may count from a later view
    target = float(run["s_target"]) - counted
    at = {a["number"]: truth.s_at_tick(a["tick_start"]) for a in run["attempts"]}
    goals = run["goals"]
    # No motion was made for a last target at which the part was already, or that had no plan.
    moved = bool(goals) and goals[-1]["s_target"] == run["s_target"]
    begun = [at[number] for number in goals[-1]["attempts"]] if moved else []
    left_at = [*(at[goal["attempts"][0]] for goal in goals[1:]), s_true]
    after_first = (begun[1] if len(begun) > 1 else s_true) if begun else None
    return DemoVerdict(
        seed=seed,
        exit_code=int(run["exit"]["code"]),
        reason=run["exit"]["reason"],
        s_target=target,
        s_initial_true=begun[0] if begun else None,
        s_true=s_true,
        delta_first_true=None if after_first is None else target - after_first,
        delta_true=target - s_true,
        delta_r_true=(target - s_true) / (target - begun[0]) if begun else None,
        delta_measured=run["delta"],
        deltas_true=tuple(goal["s_target"] - counted - s for goal, s in zip(goals, left_at, strict=False)),
        others_moved=tuple((truth.others[-1] - truth.others[0]).tolist()),
        attempts=len(run["attempts"]),
        wall_s=float(run["wall_s"]),
        commitment=published,
        commitment_holds=load_world(folder / "world.json").commitment == published,
        report=str(folder / "run/report.html"),
    )


def _truth_of_part(folder: Path, run: dict[str, Any]) -> Truth:
    """The truth log of the part that planned motions moved most, or pushes where no motion was planned.

    Its joint value counts as the demo's target does: from as found, in the sense of the host's joint.
    """
    truth = read_truth(folder / "truth.csv")
    ticks = [attempt["tick_start"] for attempt in run["attempts"] if attempt["tick_start"] is not None]
    moved = truth.of_moved(ticks[0] if ticks else int(truth.master_tick[0]))
    way = sense(load_world(folder / "world.json"), run) if run["joint"] else 1.0
    return replace(moved, s=way * (moved.s - moved.s[0]))


def draw_truth(folder: Path, verdict: DemoVerdict, goal: Goal) -> Path:
    """Plot the true joint value over time with the target and what the camera said; returns the picture's path."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    run = json.loads((folder / "run/run.json").read_text())
    truth = _truth_of_part(folder, run)
    unit = goal.targets.unit
    figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
    axes.plot(truth.t, unit.factor * truth.s, color="#20639b", label="truth, opened after the run")
    counted = float(run["s_origin"])
    targets = [aimed["s_target"] - counted for aimed in run["goals"]] or [verdict.s_target]
    for k, target in enumerate(targets):
        label = "target" if k == 0 else None
        axes.axhline(unit.factor * target, color="#3caea3", linestyle="--", label=label)
    ticks = [attempt["tick_start"] for attempt in run["attempts"][1:]]
    times = [float(truth.t[truth.row_at_tick(tick)]) for tick in ticks] + [float(truth.t[-1])]
    for k, (t, attempt) in enumerate(zip(times, run["attempts"], strict=False)):
        label = "measured by the camera" if k == 0 else None
        axes.plot(t, unit.factor * (attempt["s_final"] - counted), "o", color="#ed553b", label=label)
    axes.set(xlabel="simulated time [s]", ylabel=f"{goal.name}, from as found [{unit.name}]")
    axes.set_title(f"hidden {goal.name} {verdict.seed}: true δ = {unit.show(verdict.delta_true)}")
    axes.grid(alpha=0.3)
    axes.legend()
    path = folder / "truth.png"
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path
