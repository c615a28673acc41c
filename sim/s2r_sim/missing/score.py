"""What a run came to, from the sealed truth, and whether the gap tool gave the hidden effect its name."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from s2r_sim.errors import RunFileError
from s2r_sim.missing.cases import HIDDEN, LEARNING
from s2r_sim.paper.trials import Trial
from s2r_sim.score import Truth, read_truth, sense
from s2r_sim.world import load_world

Row = dict[str, Any]
SAME = 1e-6
LEAST_MOTIONS = len(LEARNING)  # of an answer that counts
NOT_ASKED = {
    "drawer: rail play": "the joint's effort has nothing of it, and a rail that is let go is back in its middle when"
    " the camera looks",
}
"""Cases whose effect no recording or look of the host has in it, with the reason; their names are counted apart."""


@dataclass(frozen=True)
class Manipulation:
    """One manipulation as it really was.

    Attributes:
        target: Its number.
        plan: Number of the executor's plan that pushed the part.
        s_from, s_to, s_target: True joint [m or rad].
    """

    target: int
    plan: int
    s_from: float
    s_to: float
    s_target: float

    @property
    def asked(self) -> float:
        """Change asked for [m or rad]."""
        return self.s_target - self.s_from

    @property
    def delta(self) -> float:
        """What is left of it [m or rad]."""
        return self.s_target - self.s_to


def score_run(trial: Trial, folder: Path, shares: Sequence[float]) -> Row:
    """The row of one run whose processes have ended.

    ``moves`` has one entry per target that was manipulated towards: the number of the target, true δ [m or rad] and
    δ_r. ``answers`` has what the gap tool said, in order, ``lost_motion`` all that was learnt of it.

    Raises:
        TruthFileError, WorldFileError, FileNotFoundError: A file is missing or damaged.
        RunFileError: As :func:`manipulations`.
    """
    truth = read_truth(folder / "truth.csv")
    run = json.loads((folder / "run/run.json").read_text())
    return {
        "exit": run["exit"]["code"],
        "reason": run["exit"]["reason"],
        "wall_s": run["wall_s"],
        "moves": [
            {"target": one.target, "delta": one.delta, "delta_r": one.delta / one.asked}
            for one in manipulations(trial, folder, run, truth, shares)
        ],
        "answers": [told(lesson) | {"carried": lesson["carried"]} for lesson in run["physics"]],
        "lost_motion": _total_lost(run["lost_motion"]),
        "hidden": trial.world.effects.model_dump(),
        "commitment_holds": load_world(folder / "world.json").commitment == trial.world.commitment,
    }


def manipulations(
    trial: Trial, folder: Path, run: dict[str, Any], truth: Truth, shares: Sequence[float]
) -> list[Manipulation]:
    """What a run did towards its targets, in order.

    Raises:
        RunFileError: The run has a target that it was not given, or not in this order.
    """
    attempts = [entry for entry in run["attempts"] if entry["tick_start"] is not None]
    at_ticks = [truth.s_at_tick(entry["tick_start"]) for entry in attempts]
    # A run may end before it has manipulated anything.
    left_at = [*at_ticks[1:], float(truth.s[-1])] if attempts else []
    found, at = [], 0
    for entry, s_from, s_to in zip(attempts, at_ticks, left_at, strict=True):
        asked = entry["s_target"] - attempts[0]["s_initial"]
        at = _which(asked, shares, trial.change, at, folder / "run/run.json")
        target = at_ticks[0] + sense(trial.world, run) * asked
        found.append(Manipulation(at, entry["plan_seqs"][0], s_from, s_to, target))
        at += 1
    return found


def _which(asked: float, shares: Sequence[float], change: float, first: int, file: Path) -> int:
    """Number of the target that was asked for [m or rad], from ``first`` on.

    Raises:
        RunFileError: None of them is.
    """
    for k in range(first, len(shares)):
        if abs(shares[k] * change - asked) < SAME:
            return k
    given = ", ".join(f"{share * change:+.6f}" for share in shares[first:]) or "none"
    raise RunFileError(
        f"{file} has a manipulation towards {asked:+.6f} from where the first began; the targets it was given and has "
        f"not come to before are {given}: is it the run of another trial, or were its joint values shifted?"
    )


def _total_lost(lessons: Sequence[Row]) -> dict[str, float]:
    """All of the lost motion that was learnt, by surface and direction [m or rad]."""
    total: dict[str, float] = {}
    for lesson in lessons:
        for what, lost in lesson["surfaces"].items():
            total[what] = total.get(what, 0.0) + lost
    return total


def told(answer: Row) -> Row:
    """What counts of the gap tool's answer: verdict, effects (name, what else it could be, probability), numbers, and
    after how many motions it was given."""
    return {
        "verdict": answer["verdict"],
        "effects": [[e["name"], e["could_also_be"], e["probability"]] for e in answer["effects"]],
        "parameters_off": [entry["name"] for entry in answer["parameters_off"]],
        "after": answer["after_manipulations"],
    }


def answer_of(label: str, answers: Sequence[Row]) -> Row | None:
    """The answer that counts of those of a run, in order: the first that is not open; the first where all are."""
    return next((one for one in answers if named(label, one) is not None), answers[0] if answers else None)


def named(label: str, answer: Row) -> bool | None:
    """Whether an answer names what is hidden, whatever it names beside.

    None: it is open. The tool said that the data cannot tell, or it had fewer motions than learning takes.
    """
    # Results of earlier code do not say after how many.
    if answer["verdict"] in ("insufficient", "refused") or answer.get("after", LEAST_MOTIONS) < LEAST_MOTIONS:
        return None
    names = HIDDEN[label].names
    if not names:
        return answer["verdict"] in ("nothing_missing", "parameter_off")
    return any(_names_it(effect, names) for effect in answer["effects"])


def named_alone(label: str, answer: Row) -> bool:
    """Whether an answer names what is hidden and no effect besides."""
    names = HIDDEN[label].names
    return named(label, answer) is True and all(_names_it(effect, names) for effect in answer["effects"])


def _names_it(effect: Sequence[Any], names: Sequence[str]) -> bool:
    name, also, _ = effect
    return name in names or bool(set(also) & set(names))


def relative(row: Row, later: bool) -> np.ndarray:
    """|δ_r| of a run's first three targets, or of those after."""
    first = len(LEARNING)
    return np.array([abs(m["delta_r"]) for m in row.get("moves", []) if (m["target"] >= first) == later])


def paired(learnt: Row, plain: Row) -> np.ndarray:
    """|δ_r| with what was learnt minus without, of the later targets that both runs have."""
    one, other = ({m["target"]: abs(m["delta_r"]) for m in row.get("moves", [])} for row in (learnt, plain))
    return np.array([one[k] - other[k] for k in sorted(set(one) & set(other)) if k >= len(LEARNING)])
