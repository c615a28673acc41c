"""Names and units in a recording that the model contradicts are refused; nothing is left out without a word."""

import numpy as np
import pytest
import yaml

from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.motion.checks import check_joints
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.recordings.files import read_recording

T = np.arange(0, 2, 0.01)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """An arm's joint and a drawer."""
    path = tmp_path_factory.mktemp("model") / "model.xml"
    path.write_text(
        '<mujoco><worldbody><body name="arm"><joint name="elbow"/><geom size=".1"/></body><body name="drawer">'
        '<joint name="rail" type="slide"/><geom size=".1"/></body></worldbody></mujoco>',
        encoding="utf-8",
    )
    return RigidModel(path)


def checked(model, folder, side, **more):
    columns = {"t": T, "q.elbow": np.sin(T), "q.rail": 0.1 * np.sin(T)} | more
    path = folder / "rec.csv"
    rows = [",".join(columns), *(",".join(map(str, row)) for row in zip(*columns.values(), strict=True))]
    path.write_text("\n".join(rows), encoding="utf-8")
    path.with_suffix(".yaml").write_text(yaml.safe_dump(side), encoding="utf-8")
    rec = read_recording(path)
    check_joints(model, rec)
    return rec


@pytest.mark.parametrize("column", ["hand.fx", "arm.x", "arm.torque", "fx"])
def test_a_wrench_that_acts_nowhere_is_refused(model, tmp_path, column):
    with pytest.raises(
        GapRecordingError, match=rf"'wrench.{column}' is on no body of the model \(world, arm, drawer\)"
    ):
        checked(model, tmp_path, {}, **{f"wrench.{column}": T})


def test_a_wrench_on_a_body_passes(model, tmp_path):
    assert checked(model, tmp_path, {}, **{"wrench.arm.mz": T}).channels["wrench"]["arm.mz"] == pytest.approx(
        T
    )


@pytest.mark.parametrize("key", ["effort_sigma", "effort_gain_sigma", "position_sigma"])
def test_an_accuracy_of_an_unknown_joint_is_refused(model, tmp_path, key):
    with pytest.raises(
        GapRecordingError, match=rf"{key} names 'elbw', a joint the model does not have \(elbow, rail\)"
    ):
        checked(model, tmp_path, {key: {"elbw": 0.1}})
