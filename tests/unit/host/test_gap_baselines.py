"""Baselines of recordings that no model can be rolled out along."""

import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.output.answer import make_answer
from s2r_host.gap.output.extras import add_extras
from s2r_host.gap.pipeline import analyse

DT, DURATION_S, NOISE = 0.004, 10.0, 0.01
ARM = """<mujoco><worldbody><body name="upper"><joint name="elbow" axis="0 1 0" damping=".1"/>
<inertial mass="1" pos="0 0 -.2" diaginertia=".02 .02 .002"/><body name="hand" pos="0 0 -.4">
<joint name="wrist" axis="1 0 0" damping=".01"/><inertial mass=".001" pos="0 0 -.01" diaginertia="1e-6 1e-6 1e-6"/>
</body></body></worldbody></mujoco>"""


@pytest.fixture(scope="module")
def half_recorded(tmp_path_factory):
    """An arm of which one joint was recorded, without a law; dry friction is missing there."""
    folder = tmp_path_factory.mktemp("half")
    path = folder / "model.xml"
    path.write_text(ARM, encoding="utf-8")
    model = RigidModel(path)
    made = [recorded(model, folder / f"{k}.csv", k, phase) for k, phase in enumerate((0.0, 0.0, 1.3))]
    a = analyse(path, [made[0]], [made[2]], [made[1]], GapConfig(report=False), lambda _: None)
    add_extras(a, GapConfig(report=False), 0, folder, lambda _: None)
    return a


def recorded(model, path, seed, phase):
    t = np.arange(0.0, DURATION_S, DT)
    q, v, a = np.zeros((3, len(t), 2))
    for size, w in ((0.6, 1.9), (0.2, 7.3)):
        q[:, 0] += size * np.sin(w * t + phase)
        v[:, 0] += size * w * np.cos(w * t + phase)
        a[:, 0] -= size * w**2 * np.sin(w * t + phase)
    tau = model.inverse(q, v, a)[:, 0] + 0.25 * np.tanh(v[:, 0] / 0.004)
    tau += NOISE * np.random.default_rng(seed).normal(size=len(t))
    columns = np.stack([t, q[:, 0], v[:, 0], tau], axis=1)
    np.savetxt(path, columns, delimiter=",", header="t,q.elbow,dq.elbow,tau.elbow", comments="")
    return path


def test_what_cannot_be_simulated_is_not_held_against_a_network(half_recorded):
    answer = make_answer(half_recorded, 0)
    assert answer["effects"][0]["name"] == "coulomb_friction"
    assert answer["fit"]["holdout_after"] is None
    assert not any("residual network" in note for note in answer["notes"])
    for found in answer["baselines"].values():
        assert found["holdout"] is found["open_loop_holdout"] is None
        assert found["how"] == "not fitted: no forward simulation of these recordings is possible"
        assert "named_within_10_percent" not in found
