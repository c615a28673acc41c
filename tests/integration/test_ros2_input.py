"""Two peers that share no code with us move and watch the arm over rmw_zenoh's keys.

One packs with rosbags and publishes on a key written out by hand; the other unpacks with mcap-ros2-support. Neither
uses a name or a byte of the project's own ROS 2 modules.
"""

from __future__ import annotations

import json
import re
import time
from types import SimpleNamespace

import numpy as np
import pytest
import zenoh

rosbags = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed")
mcap_ros2 = pytest.importorskip("mcap_ros2._dynamic", reason="mcap-ros2-support is not installed")
pytest.importorskip("s2r_executor._native", reason="the native core is not built")

from s2r_protocol.arms import load_arm  # noqa: E402
from s2r_protocol.cli.peers import free_port, peer, stand_in_cell  # noqa: E402

ARM = load_arm("xmate3pro")
DOMAIN = 3
INPUT = (
    "3/lab/xmate3pro/joint_trajectory/trajectory_msgs::msg::dds_::JointTrajectory_/"
    "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e"
)
LOG = (
    "3/lab/xmate3pro/trajectory_log/rcl_interfaces::msg::dds_::Log_/"
    "RIHS01_e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac"
)
STATES = (
    "0/lab/xmate3pro/joint_states/sensor_msgs::msg::dds_::JointState_/"
    "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
)
STORE = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)


def session(*endpoints):
    config = zenoh.Config()
    for key, value in (
        ("mode", "peer"),
        ("connect/endpoints", list(endpoints)),
        ("listen/endpoints", []),
        ("scouting/multicast/enabled", False),
    ):
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def until(condition, what):
    deadline = time.monotonic() + 300
    while not (found := condition()):
        assert time.monotonic() < deadline, what()
        time.sleep(0.02)
    return found


@pytest.fixture(scope="module")
def peers(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ros2")
    input_at = f"tcp/127.0.0.1:{free_port()}"
    with stand_in_cell(folder, ("--seed", "3"), pace=1.0) as cell:
        options = (
            "--executor",
            cell.executor,
            "--listen",
            input_at,
            "--domain",
            str(DOMAIN),
            "--enable-drives",
        )
        with (
            peer("ros2", ("ros2", *options), folder),
            session(input_at) as node,
            session(input_at, cell.executor) as watcher,
        ):
            logs, q = [], []
            decode_log, decode_state = (
                decoder("rcl_interfaces/msg/Log"),
                decoder("sensor_msgs/msg/JointState"),
            )
            subscribers = [
                watcher.declare_subscriber(LOG, lambda s: logs.append(decode_log(s.payload.to_bytes()).msg)),
                watcher.declare_subscriber(
                    STATES, lambda s: q.append(decode_state(s.payload.to_bytes()).position)
                ),
            ]
            publisher = node.declare_publisher(INPUT)
            until(lambda: publisher.matching_status.matching and q, lambda: "nobody subscribes")
            yield SimpleNamespace(publisher=publisher, watcher=watcher, logs=logs, q=q, input_at=input_at)
            for subscriber in subscribers:
                subscriber.undeclare()


def decoder(name):
    """mcap-ros2-support's own parser and reader, fed with rosbags' text of the definition."""
    text, _ = STORE.generate_msgdef(name, ros_version=2)
    return mcap_ros2.generate_dynamic(name, text)[name]


def trajectory(points, names=ARM.joint_names):
    t = STORE.types
    time_type, duration = t["builtin_interfaces/msg/Time"], t["builtin_interfaces/msg/Duration"]
    none = np.zeros(0)
    packed = [
        t["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=np.asarray(q, float), velocities=none, accelerations=none, effort=none,
            time_from_start=duration(sec=int(at), nanosec=round(at % 1 * 1e9)),
        )
        for at, q in points
    ]  # fmt: skip
    header = t["std_msgs/msg/Header"](stamp=time_type(sec=0, nanosec=0), frame_id="test")
    body = t["trajectory_msgs/msg/JointTrajectory"](header=header, joint_names=list(names), points=packed)
    return bytes(STORE.serialize_cdr(body, "trajectory_msgs/msg/JointTrajectory"))


def sent(peers, wire, answer):
    """Publish and wait for a line of the log that begins like ``answer``."""
    seen = len(peers.logs)
    peers.publisher.put(wire)
    return until(
        lambda: next((text for text in peers.logs[seen:] if text.startswith(answer)), None),
        lambda: f"no {answer!r} in {peers.logs}",
    )


def test_a_trajectory_of_another_maker_moves_the_arm_where_it_says(peers):
    goal = np.array(peers.q[-1]) + 0.1
    sent(peers, trajectory([(0.5, goal - 0.05), (1.0, goal)]), "done")
    seen = len(peers.q)
    until(lambda: len(peers.q) > seen + 1, lambda: "no more joint states")
    np.testing.assert_allclose(peers.q[-1], goal, atol=5e-3)


def test_what_admission_refuses_does_not_move_and_says_why(peers):
    before = np.array(peers.q[-1])
    said = sent(peers, trajectory([(0.05, before + 1.0)]), "not carried out")
    assert re.search(r"\(POSITION\): joint 'joint4' .* is outside \[-2.0944, 2.0944\] rad", said), said
    assert "joint names do not match" in sent(peers, trajectory([(1, [0.0])], ["elbow"]), "not carried out")
    assert "not a trajectory_msgs" in sent(peers, b"\x00\x01\x00\x00\x01", "refused")
    np.testing.assert_allclose(peers.q[-1], before, atol=5e-3)


def test_an_empty_trajectory_stops_the_motion_and_the_next_one_goes(peers):
    start = np.array(peers.q[-1])
    sent(peers, trajectory([(25.0, start + 0.3), (50.0, start), (75.0, start + 0.3)]), "accepted")
    assert "being carried out" in sent(peers, trajectory([(1.0, start)]), "refused")
    sent(peers, trajectory([]), "stop accepted")
    until(lambda: "not carried out" in peers.logs[-1], lambda: peers.logs)
    assert "STOP_REQUESTED" in peers.logs[-1]
    sent(peers, trajectory([(2.0, start)]), "done")


def test_ros2_topic_list_would_show_the_relay(peers):
    tokens = [
        str(r.ok.key_expr) for r in peers.watcher.liveliness().get("@ros2_lv/3/**", timeout=10.0) if r.ok
    ]
    kinds = {(parts[5], parts[8]) for parts in (token.split("/") for token in tokens)}
    assert kinds == {
        ("NN", "s2r_trajectory_input"),
        ("MS", "s2r_trajectory_input"),
        ("MP", "s2r_trajectory_input"),
    }
    assert any(
        re.search(r"/MS/.*/%lab%xmate3pro%joint_trajectory/trajectory_msgs::", token) for token in tokens
    )
