"""Position servos that log a commanded speed they do not use, and side files with a slip of the pen."""

import numpy as np
import pytest
import yaml

from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.motion.checks import check_joints
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.servo_law import with_speeds_used
from s2r_host.gap.recordings.files import read_recording
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.rig import write_model

T = np.arange(0.0, 8.0, 0.004)
KP, KD = 80.0, 3.0


def served(kind="position_servo", *, uses_speed=False, effort=True):
    q_cmd, dq_cmd = np.sin(2.0 * T), 2.0 * np.cos(2.0 * T)
    q, dq = np.sin(2.0 * (T - 0.02)), 2.0 * np.cos(2.0 * (T - 0.02))
    tau = (
        KP * (q_cmd - q)
        + KD * (dq_cmd * uses_speed - dq)
        + 0.03 * np.random.default_rng(1).normal(size=len(T))
    )
    channels = {
        kind_: {"elbow": x} for kind_, x in (("q", q), ("dq", dq), ("q_cmd", q_cmd), ("dq_cmd", dq_cmd))
    }
    if effort:
        channels["tau"] = {"elbow": tau}
    law = Controller(kind, {"elbow": KP}, {"elbow": KD})
    return Recording("r", T, channels, law, "measured", "q_cmd", "a", "", ())


def test_a_servo_that_damps_the_measured_speed_alone_is_recognised():
    rec, notes = with_speeds_used(served())
    assert rec.get("dq_cmd", "elbow") is None
    assert notes == ["r: the servo of 'elbow' does not use its commanded speed"]
    assert rec.get("q_cmd", "elbow") is not None


@pytest.mark.parametrize(
    "rec", [served(uses_speed=True), served("pd"), served(effort=False)], ids=["uses it", "pd", "no effort"]
)
def test_a_commanded_speed_stays_where_it_counts_or_nothing_tells(rec):
    kept, notes = with_speeds_used(rec)
    assert kept is rec
    assert notes == []


def side_file(folder, side):
    path = folder / "rec.csv"
    rows = np.stack([T, np.sin(T), np.cos(T)], axis=1)
    np.savetxt(path, rows, delimiter=",", header="t,q.elbow,tau.elbow", comments="")
    path.with_suffix(".yaml").write_text(yaml.safe_dump(side), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("side", "message"),
    [
        ({"controler": {"type": "pd"}}, "rec.yaml: key 'controler' is not known; is 'controller' meant?"),
        (
            {"controller": {"type": "pd", "kP": {"elbow": 2.0}}},
            "controller: key 'kP' is not known; is 'kp' meant?",
        ),
    ],
)
def test_a_misspelt_key_is_refused(tmp_path, side, message):
    with pytest.raises(GapRecordingError) as refused:
        read_recording(side_file(tmp_path, side))
    assert message in str(refused.value)


def test_a_key_that_is_like_no_other_is_only_said(tmp_path):
    rec = read_recording(side_file(tmp_path, {"operator": "Ada"}))
    assert any("operator" in warning for warning in rec.warnings)


def test_gains_of_a_joint_that_the_model_lacks_are_refused(tmp_path):
    model = RigidModel(write_model(tmp_path / "model.xml"))
    rec = read_recording(side_file(tmp_path, {"controller": {"type": "pd", "kp": {"wrist": 2.0}}}))
    with pytest.raises(GapRecordingError, match=r"controller.kp names 'wrist'.*elbow.*joint_names"):
        check_joints(model, rec)
