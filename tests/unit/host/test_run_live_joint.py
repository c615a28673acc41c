"""When a frame was taken, in the time of the plan that played, and what becomes of a feed that gets no more of them."""

import time
import zlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.errors import PeerUnreachableError
from s2r_host.motion.arm_model import ArmModel
from s2r_host.perception.errors import BadViewError
from s2r_host.perception.motion import JointMotion
from s2r_host.run import live_joint
from s2r_host.run.live_joint import LiveJoint, PlanMoment, moment_of_frame
from s2r_protocol.arms import load_arm


def moments(*rows, done=False):
    return [PlanMoment(stamp, seq, t, done, np.zeros(7)) for stamp, seq, t in rows]


def test_a_stamp_of_this_clock_tells_the_moment():
    asked = moments((100, 3, 1.0), (200, 3, 1.2), (300, 3, 1.4))
    found = moment_of_frame(250, asked)
    assert found is not None
    assert (found.seq, found.t) == (3, 1.2)


def test_a_stamp_of_another_clock_tells_it_only_while_little_happens():
    assert moment_of_frame(7, moments((100, 3, 1.0), (300, 3, 1.4))) is None
    short = moment_of_frame(7, moments((100, 3, 1.0), (120, 3, 1.02)))
    assert short is not None
    assert short.t == 1.02
    resting = moment_of_frame(7, moments((100, 3, 2.0), (900, 3, 2.0), done=True))
    assert resting is not None


def test_a_frame_during_which_another_plan_took_over_tells_nothing():
    assert moment_of_frame(150, moments((100, 3, 1.0), (200, 4, 0.1))) is None


class Camera:
    """Sends one frame, then nothing but trouble."""

    def __init__(self, trouble):
        self.trouble, self.sent, self.go_on = trouble, 0, False

    def capture(self, _name):
        self.sent += 1
        if self.sent == 1:
            return SimpleNamespace(stamp_ns=time.monotonic_ns(), frame=None)
        while not self.go_on:
            time.sleep(0.001)
        raise self.trouble


def seen_by(camera, estimate: Any = None) -> tuple[Any, Any, Any]:
    """Just enough of a session, a belief and a view."""
    plan = SimpleNamespace(plan_seq=3, plan_t=1.0, plan_done=False)
    session = SimpleNamespace(
        camera=camera, settings=SimpleNamespace(camera_name="front"), arm=ArmModel(load_arm("xmate3pro")),
        link=SimpleNamespace(state=lambda: plan, joints=lambda: SimpleNamespace(q=np.zeros(7))),
    )  # fmt: skip
    belief = SimpleNamespace(
        estimate=estimate, model=SimpleNamespace(range=(0.0, 0.3)), template=SimpleNamespace(reach_m=1.0)
    )
    return session, belief, SimpleNamespace(capture=SimpleNamespace(frame=None), arm_mask=None)


@pytest.mark.parametrize(
    ("trouble", "said"),
    [
        (PeerUnreachableError("no camera answered"), "no camera answered"),
        (zlib.error("Error -3 while decompressing data"), "error: Error -3 while decompressing data"),
        (ValueError("cannot reshape array"), "ValueError: cannot reshape array"),
        (BadViewError("ignore has shape (4, 4)"), "ignore has shape (4, 4)"),
    ],
    ids=["silent", "damaged", "another size", "another mask"],
)
@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_whatever_ends_the_feed_is_told_and_nothing_is_seen_from_then_on(monkeypatch, trouble, said):
    state = SimpleNamespace(value=0.1, interval90=(0.09, 0.11))
    tracker: Any = SimpleNamespace(update=lambda *_: state)
    monkeypatch.setattr(live_joint.JointTracker, "of", lambda *_: tracker)
    monkeypatch.setattr(live_joint, "robot_mask", lambda *_: None)
    camera = Camera(trouble)
    with LiveJoint(*seen_by(camera), 0.1) as feed:
        until_s = time.monotonic() + 5.0
        while feed.latest() is None and time.monotonic() < until_s:
            time.sleep(0.001)
        assert feed.latest() is not None
        camera.go_on = True
        feed.join(5.0)
        assert feed.problem == said
        assert feed.latest() is None


def test_a_part_with_too_little_surface_is_not_followed_and_the_camera_is_left_alone():
    points, some = np.zeros((60, 3)), np.arange(60) < 20
    surface: Any = SimpleNamespace(points=points, normals=points, normal_ok=some)
    estimate: Any = SimpleNamespace(
        motion=JointMotion("prismatic", np.array([1.0, 0, 0]), np.zeros(3), 0.1), delta=0.1,
        view_before=surface, view_after=surface, parts=SimpleNamespace(before=some, after=some),
    )  # fmt: skip
    camera = Camera(PeerUnreachableError("no camera answered"))
    with LiveJoint(*seen_by(camera, estimate), 0.1) as feed:
        assert not feed.known
        assert feed.problem == "the part has 40 points with a surface, tracking needs 50 or more"
        assert not feed.is_alive()
        assert feed.latest() is None
    assert camera.sent == 0


def test_a_part_that_is_not_found_before_it_moves_is_not_followed(monkeypatch):
    tracker: Any = SimpleNamespace(update=lambda *_: SimpleNamespace(value=None, interval90=None))
    monkeypatch.setattr(live_joint.JointTracker, "of", lambda *_: tracker)
    with LiveJoint(*seen_by(Camera(ValueError())), 0.1) as feed:
        assert not feed.known
        assert not feed.is_alive()
        assert not feed.problem
