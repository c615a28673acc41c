"""Rests at one end of the way that hold more than friction does: something acts there."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session, make_session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.friction_seen import pulled_rests, stiction, trust
from s2r_host.gap.regression.problem import build_problem

DT, MASS_kg, FRICTION_N, STOP_N = 0.01, 5.0, 2.0, 9.0
WAY_m = (0.02, 0.39, 0.03, 0.37, 0.02, 0.40, 0.05, 0.38, 0.03)
RAIL = f"""<mujoco><worldbody><body name="drawer">
  <joint name="rail" type="slide" axis="1 0 0" frictionloss="{FRICTION_N}"/>
  <inertial pos="0 0 0" mass="{MASS_kg}" diaginertia=".1 .1 .1"/></body></worldbody></mujoco>"""


def drawer(folder: Path, held_N: dict[bool, tuple[float, float]]) -> tuple[RigidModel, Session]:
    """A drawer pushed to and fro with rests of 0.8 s; what holds at the rests near the upper end (True) and others."""
    (folder / "rail.xml").write_text(RAIL, encoding="utf-8")
    rng, way, held = np.random.default_rng(2), [], []
    for a, b in itertools.pairwise(WAY_m):
        share = np.linspace(0.0, 1.0, 150)
        way += [a + (b - a) * (3.0 * share**2 - 2.0 * share**3), np.full(80, b)]
        held += [np.zeros(150), np.full(80, rng.uniform(*held_N[b > 0.2]))]
    q, rest = np.concatenate(way), np.concatenate(held)
    v = np.gradient(q, DT)
    tau = (
        MASS_kg * np.gradient(v, DT)
        + FRICTION_N * np.sign(np.round(v, 9))
        + rest
        + 0.1 * rng.normal(size=len(q))
    )
    t = DT * np.arange(len(q))
    rec = Recording(
        "r",
        t,
        {"q": {"rail": q}, "tau": {"rail": tau}},
        Controller("none"),
        "measured",
        "effort",
        "a",
        "",
        (),
    )
    model = RigidModel(folder / "rail.xml")
    return model, make_session(model, rec, 0)


def test_a_stop_that_is_pressed_against_is_seen_in_the_rests_at_that_end(tmp_path):
    model, s = drawer(tmp_path, {True: (0.8 * STOP_N, STOP_N), False: (-1.5, 1.5)})
    pulled = pulled_rests(s, 0)
    assert pulled.any()
    assert s.q[pulled, 0].min() > 0.3
    assert stiction(s, 0)[0] < 1.5 * FRICTION_N  # what the other rests hold
    (block,) = build_problem(model, [s], [], []).blocks
    weight = trust(model, block, 0.3, guessed=True)
    there, elsewhere = (
        pulled[block.picks],
        (np.abs(s.v[:, 0]) < 1e-9)[block.picks] & (s.q[block.picks, 0] < 0.1),
    )
    assert np.median(weight[there]) > 1.4 * np.median(weight[elsewhere])


@pytest.mark.parametrize(
    "held_N",
    [
        {
            True: (0.8 * STOP_N, STOP_N),
            False: (-STOP_N, -0.8 * STOP_N),
        },  # sticks hard wherever it comes to rest
        {True: (-1.5, 1.5), False: (-1.5, 1.5)},
        {True: (-STOP_N, STOP_N), False: (-1.0, 1.0)},
    ],
    ids=["either way", "friction", "both ways at one end"],
)
def test_friction_that_holds_at_rest_pulls_at_nothing(tmp_path, held_N):
    _, s = drawer(tmp_path, held_N)
    assert not pulled_rests(s, 0).any()
