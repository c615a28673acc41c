"""A recording whose weight, inertia and friction all belong to another machine, and one with a heavy load."""

import numpy as np
import pytest

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.rig import MASS, write_model
from s2r_host.gap.search.search import Search
from s2r_host.gap.verdict.decide import decide
from s2r_host.gap.verdict.other_machine import all_numbers_elsewhere

DT, FRICTION, DAMPING, ARMATURE = 0.004, 0.2, 0.08, 0.02


def machine(folder, mass=MASS, friction=0.0, damping=DAMPING, armature=ARMATURE):
    return RigidModel(write_model(folder / f"{mass}-{friction}.xml", friction, damping, mass, armature))


def problem_of(folder, mass, friction, damping, armature, spring=0.0, stated=ARMATURE):
    """A machine with these numbers (and a spring [N·m/rad]) when the model has the usual ones."""
    model = machine(folder, friction=FRICTION, armature=stated)
    true = machine(folder, mass, 0.0, damping, armature)

    def recorded(index, phase):
        t = np.arange(0, 20, DT)
        q = 0.9 * np.sin(1.7 * t + phase) + 0.3 * np.sin(5.3 * t + 2.0 * phase)
        dq = np.gradient(q, DT)
        u = true.inverse(q[:, None], dq[:, None], np.gradient(dq, DT)[:, None])[:, 0] + friction * np.sign(dq)
        u = u + spring * (q - 2.0) + 0.1 * np.random.default_rng(index).normal(size=len(t))
        channels = {"q": {"elbow": q}, "dq": {"elbow": dq}, "tau": {"elbow": u}}
        rec = Recording(f"r{index}", t, channels, Controller("none"), "measured", "effort", "a", "", ())
        return make_session(model, rec, index)

    return build_problem(model, [recorded(0, 0.0)], [recorded(2, 1.0)], [recorded(1, 0.0)])


@pytest.mark.parametrize(
    ("numbers", "other"),
    [
        ((0.3 * MASS, 2.5 * FRICTION, 2.0 * DAMPING, 2.0 * ARMATURE), True),
        ((2.5 * MASS, FRICTION, DAMPING, ARMATURE), False),
        ((MASS, FRICTION, DAMPING, ARMATURE, 2.0), False),
    ],
    ids=["another machine", "a heavy load", "a strong spring"],
)
def test_weight_inertia_and_friction_all_far_off_are_another_machine(tmp_path, numbers, other):
    problem = problem_of(tmp_path, *numbers)
    assert (all_numbers_elsewhere(problem, Search(problem)) is not None) == other


def test_a_motor_s_inertia_stated_far_too_large_is_no_body_with_inertia_below_zero(tmp_path):
    """One joint accelerates both alike, but the body has less inertia than what is too much of the motor's."""
    problem = problem_of(tmp_path, MASS, FRICTION, DAMPING, ARMATURE, stated=3.0 * ARMATURE)
    decision = decide(problem, Search(problem))
    assert decision.verdict == "parameter_off"
    (off,) = decision.parameters_off
    assert off["name"] == "armature"
    assert off["to"] == pytest.approx(ARMATURE, abs=0.1 * ARMATURE)
