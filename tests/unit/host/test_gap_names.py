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


@pytest.mark.parametrize(
    ("units", "said"),
    [
        ({"q": "deg"}, r"'q.rail' is declared in deg, and 'rail' slides"),
        ({"q": "mm"}, r"'q.elbow' is declared in mm, and 'elbow' turns"),
        ({"q_cmd.rail": "rev"}, r"'q_cmd.rail' is declared in rev, and 'rail' slides"),
        ({"tau": "Nm"}, r"'tau.rail' is declared in Nm, and 'rail' slides"),
        ({"tau.elbow": "kN"}, r"'tau.elbow' is declared in kN, and 'elbow' turns"),
        ({"tau_ff.elbow": "N"}, r"'tau_ff.elbow' is declared in N, and 'elbow' turns"),
    ],
)
def test_a_unit_of_another_kind_of_joint_is_refused(model, tmp_path, units, said):
    more = {"q_cmd.rail": 0.1 * np.sin(T), "tau.elbow": T, "tau.rail": T, "tau_ff.elbow": T}
    with pytest.raises(GapRecordingError, match=said):
        checked(model, tmp_path, {"units": units}, **more)


def test_hinges_and_slides_each_have_their_unit(model, tmp_path):
    units = {"q": "deg", "q.rail": "mm", "tau": "Ncm", "tau.rail": "kN"}
    rec = checked(model, tmp_path, {"units": units}, **{"tau.elbow": T, "tau.rail": T})
    assert rec.channels["q"]["elbow"] == pytest.approx(np.radians(np.sin(T)))
    assert rec.channels["q"]["rail"] == pytest.approx(1e-4 * np.sin(T))
    assert rec.channels["tau"]["elbow"] == pytest.approx(1e-2 * T)
    assert rec.channels["tau"]["rail"] == pytest.approx(1e3 * T)


@pytest.mark.parametrize("units", [{"q": "rad"}, {"q.elbow": "rad"}])
def test_what_turns_on_and_on_is_believed_once_its_unit_is_declared(model, tmp_path, units):
    wheel = {"q.elbow": 125.0 * T + 0.5 * np.sin(3.0 * T)}
    with pytest.raises(GapRecordingError, match=r"'q.elbow' spans 24\d.* of what turns on and on, 'rad'"):
        checked(model, tmp_path, {}, **wheel)
    assert checked(model, tmp_path, {"units": {"q.rail": "m"} | units}, **wheel).joints == ("elbow", "rail")


@pytest.mark.parametrize("name", ["j1", "elbow"])
def test_a_unit_counts_under_either_name_of_a_joint(tmp_path, name):
    path = tmp_path / "rec.csv"
    path.write_text("\n".join(["t,q.j1", *(f"{t},{1e3 * t}" for t in T)]), encoding="utf-8")
    side = {"joint_names": {"j1": "elbow"}, "units": {f"q.{name}": "mrad"}}
    path.with_suffix(".yaml").write_text(yaml.safe_dump(side), encoding="utf-8")
    assert read_recording(path).channels["q"]["elbow"] == pytest.approx(T)


def test_a_unit_of_no_column_is_told(model, tmp_path):
    said = checked(model, tmp_path, {"units": {"q.elbw": "deg", "temp": "C"}}).warnings
    assert "side file: units of q.elbw are of no column and convert nothing" in said
