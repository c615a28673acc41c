"""Which recorded plans lead from where the arm stands to the start of the plan that is replayed."""

import numpy as np
import pytest

from s2r_host.recording import JointTrack
from s2r_host.replay.sources import Replayable
from s2r_host.replay.way import JOINED_RAD, missing_of, recorded_way
from s2r_host.trajectory import Trajectory

HOME, BEFORE, PUSHED, AWAY = (np.full(7, value) for value in (0.0, 0.3, 0.4, 0.9))


def plan(number, start, end, ran=True):
    t = np.array([0.0, 1.0])
    rest = np.zeros((2, 7))
    trajectory = Trajectory(t, np.array([start, end]), rest, rest)
    track = JointTrack(np.array([0, 1]), trajectory.q, rest, np.zeros(2)) if ran else None
    return Replayable(number, f"plan {number}", trajectory, track)


@pytest.fixture
def plans():
    return [
        plan(1, HOME, BEFORE),
        plan(2, BEFORE, PUSHED),
        plan(3, PUSHED, BEFORE),
        plan(4, BEFORE, HOME),
        plan(5, HOME, AWAY),
    ]


def numbers(way):
    return [one.number for one in way]


def test_a_push_is_reached_by_its_own_approach(plans):
    assert numbers(recorded_way(plans, plans[1], HOME)) == [1]


def test_no_way_is_needed_where_the_arm_stands_at_the_start(plans):
    assert recorded_way(plans, plans[4], HOME) == []


def test_the_shortest_way_is_taken_not_the_whole_recording(plans):
    assert numbers(recorded_way(plans, plans[3], PUSHED)) == [3]


def test_a_retreat_is_reached_through_the_push_it_follows(plans):
    assert numbers(recorded_way(plans, plans[2], HOME)) == [1, 2]


def test_an_arm_that_stands_elsewhere_gets_no_recorded_way(plans):
    assert recorded_way(plans, plans[1], HOME + 2 * JOINED_RAD) == []


def test_a_gap_in_the_recording_ends_the_way(plans):
    broken = [plan(1, HOME, AWAY), *plans[1:]]
    assert recorded_way(broken, broken[1], HOME) == []


def test_a_plan_that_never_ran_leads_nowhere(plans):
    refused = [plan(1, HOME, BEFORE, ran=False), *plans[1:]]
    assert recorded_way(refused, refused[1], HOME) == []


def test_a_world_as_found_gets_everything_that_was_recorded_before(plans):
    assert numbers(recorded_way(plans, plans[4], HOME, whole=True)) == [1, 2, 3, 4]
    assert numbers(recorded_way(plans, plans[1], HOME, whole=True)) == [1]
    assert recorded_way(plans, plans[0], HOME, whole=True) == []


def test_what_a_broken_row_leaves_out_is_told(plans):
    whole = recorded_way(plans, plans[3], HOME, whole=True)
    assert missing_of(plans, plans[3], whole) == ()
    stopped = [plans[0], plan(2, BEFORE, AWAY), *plans[2:]]
    way = recorded_way(stopped, stopped[3], HOME, whole=True)
    assert numbers(missing_of(stopped, stopped[3], way)) == [1, 2, 3]
    assert missing_of([plan(1, HOME, AWAY, ran=False), *plans[1:]], plans[1], ()) == ()
