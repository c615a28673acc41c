"""A dry run plans from where the arm stands, and says where that is when it cannot."""

from types import SimpleNamespace

import numpy as np
import pytest

from s2r_host.errors import NoMotionError
from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.obstacles import table_obstacle
from s2r_host.run.dry_run import DryRunError, planned_where_it_stands, stay
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import ExitCode

ARM = ArmModel(load_arm("xmate3pro"))
OFF = np.array([0.0, 0.2, 0.0, -0.1, 0.0, 0.0, 0.0])


def session_at(q, dry_run=True):
    return SimpleNamespace(
        arm=ARM, settings=SimpleNamespace(dry_run=dry_run), status=lambda: SimpleNamespace(q_ref=q)
    )


def refuse(session):
    with planned_where_it_stands(session):
        raise NoMotionError("no way")


def test_a_refusal_off_home_names_the_joint_that_is_farthest_off():
    home = ARM.arm.q_home
    with pytest.raises(DryRunError) as refused:
        refuse(session_at(home + OFF))
    assert refused.value.exit_code == ExitCode.REFUSED
    text = str(refused.value)
    assert text.startswith("no way. A dry run looks and plans from where the arm stands")
    assert f"joint 'joint2' (index 1) is at {home[1] + 0.2:.3f} rad, home is {home[1]:.3f} rad" in text


@pytest.mark.parametrize(("q", "dry_run"), [(ARM.arm.q_home, True), (ARM.arm.q_home + OFF, False)])
def test_a_refusal_at_home_or_of_a_run_that_moves_stays_as_it_is(q, dry_run):
    with pytest.raises(NoMotionError, match=r"^no way$"):
        refuse(session_at(q, dry_run))


def test_an_arm_in_the_air_stays_and_one_in_touch_is_no_place_to_plan_from():
    assert "joint 'joint2' (index 1)" in stay(session_at(ARM.arm.q_home + OFF), [table_obstacle()])
    below = ARM.arm.q_home + np.array([0.0, 1.2, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(NoMotionError, match="the arm begins in touch"):
        stay(session_at(below), [table_obstacle()])
