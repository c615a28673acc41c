"""The drawer's state is measured to a fraction of a millimetre from made-up stereo depth."""

import numpy as np
import pytest

from s2r_host.errors import SceneError
from s2r_host.perception.estimate import estimate_joint
from s2r_host.perception.motion import JointMotion, rotation
from s2r_host.perception.synthetic import Box, laptop_pair, look_at, pair
from s2r_host.perception.view import DepthView
from s2r_host.run.measure import PartTemplate, measure_state, part_template

K = np.array([[460.0, 0, 320], [0, 460.0, 180], [0, 0, 1]])
SHAPE = (360, 640)


def views(seed, motion_m, opening=0.07):
    """A cabinet with a drawer seen from beside the arm, before and after a motion outwards."""
    rng = np.random.default_rng(seed)
    X_WO = np.eye(4)
    X_WO[:3, :3] = rotation(np.array([0, 0, 1.0]), np.pi + 0.1)
    X_WO[:3, 3] = [0.68, 0.02, 0.0]

    def box(low, high):
        low, high = np.array(low), np.array(high)
        X = np.eye(4)
        X[:3, 3] = (low + high) / 2
        return Box(X_WO @ X, high - low)

    table = np.eye(4)
    table[:3, 3] = [0.7, 0.0, -0.01]
    static = [
        Box(table, np.array([1.6, 1.6, 0.02])),
        box((-0.4, 0.15, 0), (0, 0.162, 0.25)),
        box((-0.4, -0.162, 0), (0, -0.15, 0.25)),
        box((-0.4, -0.15, 0.238), (0, 0.15, 0.25)),
        box((-0.4, -0.15, 0), (0, 0.15, 0.1)),
    ]
    s = opening
    part = [
        box((s, -0.16, 0.1), (s + 0.018, 0.16, 0.25)),
        box((s - 0.3, -0.13, 0.115), (s, -0.12, 0.22)),
        box((s - 0.3, 0.12, 0.115), (s, 0.13, 0.22)),
        box((s - 0.3, -0.13, 0.11), (s, 0.13, 0.118)),
        box((s + 0.055, -0.06, 0.195), (s + 0.066, 0.06, 0.206)),
    ]
    motion = JointMotion("prismatic", X_WO[:3, 3].copy(), X_WO[:3, 0].copy(), motion_m)
    X_WC = look_at(np.array([-0.04, -0.5, 0.6]), np.array([0.6, 0.0, 0.14]))
    return pair(static, part, motion, K, SHAPE, X_WC, rng)


@pytest.fixture(scope="module")
def template():
    before_after = views(0, -0.045)
    estimate = estimate_joint(before_after.before, before_after.after, joint_type="prismatic", seed=0)
    return part_template(estimate.reversed())


@pytest.mark.parametrize("s", [-0.045, 0.0, 0.1, 0.15, 0.2])
def test_state_is_measured_to_a_millimetre(template, s):
    measured = measure_state(template, DepthView(views(10, s).after))
    assert measured.s == pytest.approx(s, abs=1e-3)
    assert measured.sigma < 1e-3
    assert abs(measured.s - s) < 6 * measured.sigma + 3e-4


def test_expectation_does_not_pull_the_measurement(template):
    frame = views(11, 0.15).after
    free = measure_state(template, DepthView(frame))
    told = measure_state(template, DepthView(frame), s_expected=0.10)
    assert told.s == pytest.approx(free.s, abs=2e-5)


def test_ignored_pixels_do_not_count(template):
    frame = views(12, 0.15).after
    ignore = np.zeros(frame.depth_m.shape, bool)
    ignore[:, :300] = True
    measured = measure_state(template, DepthView(frame, ignore))
    assert measured.s == pytest.approx(0.15, abs=1.5e-3)


def test_a_hidden_part_is_refused_instead_of_guessed(template):
    frame = views(13, 0.15).after
    ignore = np.ones(frame.depth_m.shape, bool)
    ignore[:60] = False
    with pytest.raises(SceneError, match=r"not found|only"):
        measure_state(template, DepthView(frame, ignore))


@pytest.mark.parametrize("turn", [0.1, 0.22])
def test_a_lid_is_measured_to_half_a_degree(turn):
    """The same laptop and camera each time: only the turn differs."""
    known = laptop_pair(np.random.default_rng(3), turn_rad=0.35)
    estimate = estimate_joint(known.before, known.after, joint_type="revolute", seed=0)
    measured = measure_state(
        part_template(estimate),
        DepthView(laptop_pair(np.random.default_rng(3), turn).after),
        s_range=(-1.0, 1.0),
    )
    assert np.degrees(measured.s) == pytest.approx(np.degrees(turn), abs=0.5)
    assert np.degrees(measured.sigma) < 0.5


@pytest.mark.parametrize("turn", [-0.5, 0.55, 0.7, 0.85])
def test_a_lid_edge_on_or_from_its_other_side_is_measured_by_its_outline(turn):
    known = laptop_pair(np.random.default_rng(3), turn_rad=0.35)
    estimate = estimate_joint(known.before, known.after, joint_type="revolute", seed=0)
    template = part_template(estimate).with_back(0.006)
    frame = laptop_pair(np.random.default_rng(3), turn).after
    measured = measure_state(template, DepthView(frame), s_range=(turn - 0.4, turn + 0.4))
    assert np.degrees(measured.s) == pytest.approx(np.degrees(turn), abs=1.5)


def test_a_lid_that_is_nowhere_near_its_range_is_refused():
    known = laptop_pair(np.random.default_rng(3), turn_rad=0.35)
    estimate = estimate_joint(known.before, known.after, joint_type="revolute", seed=0)
    with pytest.raises(SceneError, match=r"only \d+%"):
        measure_state(part_template(estimate), DepthView(known.after), s_range=(-0.6, -0.5))


def test_the_back_of_a_plate_is_its_front_moved_and_turned_over():
    plate = PartTemplate(
        np.array([[0.1, 0.0, 0.2]]), np.array([[0.0, 0.0, 1.0]]),
        JointMotion("revolute", np.zeros(3), np.array([0.0, 1.0, 0.0]), 0.0),
    ).with_back(0.006)  # fmt: skip
    assert plate.p[1] == pytest.approx([0.1, 0.0, 0.194])
    assert plate.n[1] == pytest.approx([0.0, 0.0, -1.0])
