"""When a frame was taken, in the time of the plan that played."""

import numpy as np

from s2r_host.run.live_joint import PlanMoment, moment_of_frame


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
