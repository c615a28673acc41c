"""How a manipulation leaves the part: where geometry has it, unless it went on by itself."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.motion.arm_model import ArmModel
from s2r_host.run.belief import Belief
from s2r_host.run.contact import touch_at
from s2r_host.run.end import end_of
from s2r_host.run.task import FAUCET

YIELDS = 0.02


def _end(arm: ArmModel, belief: Belief, final: float, positive: bool) -> Any:
    """Of a motion to home whose replay left the lever at ``final``."""
    q = np.tile(arm.arm.q_home, (3, 1))
    played = SimpleNamespace(q_meas=q, final=final, s=np.array([0.0, 0.5 * final, final]))
    delivery: Any = SimpleNamespace(replay=played, trajectory=SimpleNamespace(q=q))
    request: Any = SimpleNamespace(
        object_mjcf=belief.growing, s_initial=0.0, s_target=1.0 if positive else -1.0
    )
    return end_of(arm, belief, request, delivery, YIELDS, FAUCET)


@pytest.mark.parametrize("positive", [True, False])
def test_a_lever_pushed_to_the_end_stays_where_it_touches_the_fingertip(arm, lever_at_tip, positive):
    belief = lever_at_tip
    touched = touch_at(belief.growing, arm, arm.arm.q_home, 0.25 if positive else -0.25, positive, 0.2)
    assert touched is not None
    behind = touched.s - (0.03 if positive else -0.03)  # where a model that gave way left it
    end = _end(arm, belief, behind, positive)
    assert end.touching
    assert end.geom == "part_lever"
    assert behind + end.yields == pytest.approx(touched.s, abs=1e-3)
    x, y, _ = end.p_pushed - belief.template.motion.origin
    assert abs(x) == pytest.approx(0.005, abs=1e-3)  # a side of the lever, as it is at joint value 0
    assert 0.08 < y < 0.14


def test_a_lever_that_went_on_by_itself_stays_where_the_replay_has_it(arm, lever_at_tip):
    end = _end(arm, lever_at_tip, 0.6, positive=True)
    assert not end.touching
    assert not end.at_edge
    assert end.yields == YIELDS


def test_a_lever_that_was_left_where_it_was_cut_back_was_pushed_at_an_edge(arm, lever_at_tip):
    p = _end(arm, lever_at_tip, 0.6, positive=True).p_pushed
    outward = np.array([0.0, 1.0, 0.0])
    short = replace(lever_at_tip, within=((outward, float(outward @ p) + 0.001),))
    end = _end(arm, short, 0.6, positive=True)
    assert not end.touching
    assert end.at_edge
