"""Patches of models written in degrees, and of bodies and joints without names."""

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from s2r_host.gap.effects.backlash import EFFECT as BACKLASH
from s2r_host.gap.effects.base import Context
from s2r_host.gap.effects.spring_return import EFFECT as SPRING
from s2r_host.gap.effects.spring_return import add_spring
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.output.answer import write_model
from s2r_host.gap.simulation.replay import build_twin

MODEL = """<mujoco><compiler angle="{angle}"/><worldbody><body>
  <joint name="door" stiffness="{old}" springref="{rest}" armature=".01"/><geom size=".1" pos=".3 0 0"/>
  <body pos=".6 0 0"><joint type="slide" armature=".01"/><geom size=".1"/></body></body></worldbody></mujoco>"""


@pytest.fixture(params=["degree", "radian"])
def model(request, tmp_path):
    rest = 10.0 if request.param == "degree" else np.deg2rad(10.0)
    path = tmp_path / "door.xml"
    path.write_text(MODEL.format(angle=request.param, old=1.0, rest=rest), encoding="utf-8")
    return RigidModel(path)


def test_a_spring_rests_where_it_was_found_to(model):
    spec = model.spec.copy()
    add_spring(Context(model, []), spec, 0, 3.0, -0.5)
    patched = spec.compile()
    assert patched.jnt_stiffness[0] == pytest.approx(4.0)
    assert patched.qpos_spring[0] == pytest.approx((1.0 * np.deg2rad(10.0) + 3.0 * -0.5) / 4.0)


@pytest.mark.parametrize("c", [1.5, -0.4])
def test_a_steady_pull_is_told_and_patched_as_one(model, c):
    """A closing weight pulls alike everywhere: of a spring its stiffness is nothing and its pull all there is."""
    swing: Any = SimpleNamespace(q=np.array([[-0.5, 0.0], [0.7, 0.0]]))
    ctx, spec, theta = Context(model, [swing]), model.spec.copy(), np.array([0.0, c])
    told = SPRING.parameters(ctx, 0, {}, theta)
    assert (told["stiffness"].value, told["pull"].value) == (0.0, -c)
    assert "rest" not in told
    assert SPRING.patch(ctx, spec, 0, {}, theta)
    plain, patched = model.model, spec.compile()
    for q in (-0.5, 0.7):
        pulls = []
        for m in (plain, patched):
            data = mujoco.MjData(m)
            data.qpos[0] = q
            mujoco.mj_forward(m, data)
            pulls.append(float(data.qfrc_passive[0]))
        assert pulls[1] - pulls[0] == pytest.approx(-c, rel=2e-4)


def test_a_gap_is_as_wide_as_it_was_found_to_be(model):
    resting: Any = SimpleNamespace(mass=np.ones((1, 2)))
    ctx, spec = Context(model, [resting]), model.spec.copy()
    for joint, half in ((0, 0.02), (1, 0.003)):
        assert BACKLASH.patch(ctx, spec, joint, {"w": half, "motor": 0.5}, np.zeros(0))
    patched = spec.compile()
    for name, half in (("door_gap_flex", 0.02), (f"{model.joints[1]}_gap_flex", 0.003)):
        assert patched.joint(name).range == pytest.approx([-half, half])


def test_what_has_no_name_gets_one_that_is_free(tmp_path):
    path = tmp_path / "m.xml"
    path.write_text(
        '<mujoco><worldbody><body name="body2"><joint/><geom size=".1"/><body pos=".3 0 0"><joint axis="0 1 0"/>'
        '<geom size=".1"/></body></body></worldbody></mujoco>',
        encoding="utf-8",
    )
    model = RigidModel(path)
    assert model.joints == ("joint0", "joint1")
    names = [model.body_name(body) for body in (1, 2)]
    assert len(set(names)) == 2
    assert all(model.spec.copy().body(name) is not None for name in names)
    assert isinstance(model.spec.copy().compile(), mujoco.MjModel)


@pytest.mark.parametrize("moments", [(1.0, 1.0, 2.0 - 1e-8), (1.0, 1.0 - 5e-7, 1e-6)], ids=["disc", "rod"])
def test_a_patched_model_of_a_flat_or_thin_part_loads(tmp_path, moments):
    for size in np.random.default_rng(5).uniform(0.01, 0.3, 20):
        path = tmp_path / "flat.xml"
        x, y, z = size * np.array(moments)
        inertial = f'pos="0 0 .02" mass="4" fullinertia="{x:.12g} {y:.12g} {z:.12g} 0 0 0"'
        path.write_text(
            f'<mujoco><worldbody><body name="table"><joint/><inertial {inertial}/></body></worldbody></mujoco>',
            encoding="utf-8",
        )
        model = RigidModel(path)
        write_model(build_twin(model, Context(model, []), []), tmp_path)
        patched = mujoco.MjModel.from_xml_path(str(tmp_path / "model_patched.xml"))
        assert np.sort(patched.body_inertia[1]) == pytest.approx(
            np.sort([x, y, z]), rel=5e-5, abs=3e-5 * size
        )
