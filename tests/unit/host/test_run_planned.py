"""How far the part is believed to go on with an arm that gets to where it is sent, before a motion has been timed."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.run.planned import YIELDS_M, YIELDS_SHARE, servos_yield

LEVER_M = 0.1


def yields(behind_m: float, s_target: float, lever_m: float = LEVER_M) -> float:
    """Of a plan from joint value 0 whose fingertip is sent so far ahead along +y, where the part goes as it grows."""
    session: Any = SimpleNamespace(arm=SimpleNamespace(tool_pose=pose))
    template = SimpleNamespace(velocity=lambda p: np.array([[0.0, lever_m, 0.0]]))
    belief: Any = SimpleNamespace(template=template)
    request: Any = SimpleNamespace(s_initial=0.0, s_target=s_target)
    reached, sent = np.zeros(3), np.array([0.003, behind_m, 0.0])
    result: Any = SimpleNamespace(q_cmd=[sent], q_meas=[reached])
    return servos_yield(session, belief, request, result)


def pose(p):
    X = np.eye(4)
    X[:3, 3] = p
    return X


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_part_goes_on_by_what_the_servos_lack_along_its_motion(sign):
    assert yields(sign * 0.001, sign * 0.5) == pytest.approx(sign * 0.01)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_servos_that_hold_a_part_back_do_not_let_it_come_back(sign):
    assert yields(-sign * 0.001, sign * 0.5) == 0.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_plan_that_ends_pressing_hard_is_believed_in_part(sign):
    assert yields(sign * 0.008, sign * 0.5) == pytest.approx(sign * YIELDS_M / LEVER_M)
    assert yields(sign * 0.008, sign * 0.05) == pytest.approx(sign * YIELDS_SHARE * 0.05)
    assert yields(sign * 0.008, sign * 0.5, lever_m=0.01) == pytest.approx(sign * YIELDS_SHARE * 0.5)
