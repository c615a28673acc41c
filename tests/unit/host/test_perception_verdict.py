"""When an estimate is an answer: known well enough, and surely of one family."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.perception.errors import AbstainError
from s2r_host.perception.intervals import Intervals
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.ranking import Explained
from s2r_host.perception.verdict import KNOWN_TO, LEAST_OF_VIEW, VAGUELY, judge, require_narrow
from s2r_protocol.targets import JointType

Z = np.array([0.0, 0.0, 1.0])
ALL_EXPLAINED = Explained(share=0.9, judged=1.0, before=0.9, after=0.9)


def motion(joint_type: JointType, delta: float) -> JointMotion:
    return JointMotion(joint_type, np.zeros(3), Z, delta)


def intervals(delta: float, share: float, axis_deg: float = 1.0) -> Intervals:
    """Intervals of a motion that is known to this share of it."""
    return Intervals(np.radians(axis_deg), 0.005, ((1.0 - share) * delta, (1.0 + share) * delta))


def test_a_turn_has_to_be_known_to_a_tenth_unless_less_will_do() -> None:
    turn = motion("revolute", 0.4)
    require_narrow(intervals(0.4, 0.09), turn, KNOWN_TO)
    with pytest.raises(AbstainError, match="the motion to 20 % only; push further"):
        require_narrow(intervals(0.4, 0.2), turn, KNOWN_TO)
    require_narrow(intervals(0.4, 0.2), turn, VAGUELY)
    with pytest.raises(AbstainError, match="60 % only"):
        require_narrow(intervals(0.4, 0.6), turn, VAGUELY)


def test_a_slide_known_worse_still_has_its_axis() -> None:
    require_narrow(intervals(0.1, 0.2), motion("prismatic", 0.1), KNOWN_TO)
    with pytest.raises(AbstainError, match="60 % only"):
        require_narrow(intervals(0.1, 0.6), motion("prismatic", 0.1), KNOWN_TO)


def test_an_axis_known_to_twenty_degrees_is_none() -> None:
    with pytest.raises(AbstainError, match="the axis is known to 20 degrees"):
        require_narrow(intervals(0.4, 0.05, axis_deg=20.0), motion("revolute", 0.4), VAGUELY)


def judged(
    best: JointType,
    other: JointType,
    apart: float,
    thin: bool,
    residual_m: float = 0.001,
    noise_m: float = 0.001,
    explained: Explained = ALL_EXPLAINED,
    points: int = 300,
) -> list[str]:
    """The verdict on a clear motion of 5 cm whose best other family costs so much more."""

    def hypothesis(family: JointType, cost: float) -> Any:
        refined = SimpleNamespace(residual_m=residual_m, plate_m=None)
        delta = 0.05 if family == "prismatic" else 0.5
        return SimpleNamespace(motion=motion(family, delta), cost=cost, evidence=0.2, refined=refined)

    ranked = [hypothesis(best, 0.3), hypothesis(other, 0.3 + apart)]
    p = np.random.default_rng(0).uniform(0.05, 0.15, (points, 3))
    scene: Any = SimpleNamespace(before=SimpleNamespace(points=p, sigma_m=np.full(len(p), noise_m)))
    parts: Any = SimpleNamespace(before=np.ones(len(p), dtype=bool))
    return judge(ranked, scene, parts, explained, thin)


def test_a_part_that_the_first_view_hardly_shows_is_told_as_that() -> None:
    assert not judged("prismatic", "revolute", 1.0, thin=False, points=100)
    with pytest.raises(AbstainError, match="the first view shows 99 points of the part, at least 100"):
        judged("prismatic", "revolute", 1.0, thin=False, points=99)
    unclear = replace(ALL_EXPLAINED, share=0.3)
    with pytest.raises(AbstainError, match=r"no single rigid motion explains the change: .* 30 %"):
        judged("prismatic", "revolute", 1.0, thin=False, points=99, explained=unclear)


@pytest.mark.parametrize(
    ("best", "other", "thin", "least"),
    [
        ("prismatic", "revolute", True, 0.06),
        ("prismatic", "revolute", False, 0.02),
        ("revolute", "prismatic", True, 0.02),
    ],
)
def test_a_lever_that_seems_to_slide_has_to_do_so_clearly(
    best: JointType, other: JointType, thin: bool, least: float
) -> None:
    assert judged(best, other, least + 0.005, thin) == []
    with pytest.raises(AbstainError, match=f"{best} and {other} explain the motion about equally well"):
        judged(best, other, least - 0.005, thin)


def test_the_residual_may_be_as_large_as_the_depth_is_noisy_at_that_distance() -> None:
    assert judged("revolute", "prismatic", 0.1, False, residual_m=0.0035, noise_m=0.004) == []
    with pytest.raises(AbstainError, match=r"residual of 3\.5 mm, limit 3\.0 mm at this distance"):
        judged("revolute", "prismatic", 0.1, False, residual_m=0.0035)
    with pytest.raises(AbstainError, match=r"limit 5\.0 mm"):
        judged("revolute", "prismatic", 0.1, False, residual_m=0.006, noise_m=0.004)


@pytest.mark.parametrize("view", ["first", "second"])
def test_what_moved_in_either_view_has_to_be_explained_in_part(view: str) -> None:
    def explained(share: float) -> Explained:
        name = "before" if view == "first" else "after"
        return replace(ALL_EXPLAINED, **{name: share})

    assert judged("prismatic", "revolute", 0.1, False, explained=explained(LEAST_OF_VIEW)) == []
    with pytest.raises(AbstainError, match=f"explains 14 % of what moved in the {view} view, at least 15 %"):
        judged("prismatic", "revolute", 0.1, False, explained=explained(0.14))
