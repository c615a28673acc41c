"""Hidden states against closed forms, and a load along its arm against the load put there."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from s2r_host._native import hysteresis_loop
from s2r_host.gap.effects.base import Context
from s2r_host.gap.effects.joint_elasticity import EFFECT as ELASTICITY
from s2r_host.gap.effects.joint_elasticity import mean_inertia
from s2r_host.gap.effects.payload import EFFECT, add_mass, arm
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.states import bristle
from s2r_host.gap.rig import write_model


def test_a_loop_of_power_two_follows_the_hyperbolic_tangent():
    """On a rise from rest dz/dq = (1 - z²)/w; turned back, dz/dq = 1/w until z changes sign."""
    q = np.concatenate([np.linspace(0.0, 0.3, 4000), np.linspace(0.3, 0.0, 4000)[1:]])[:, None]
    width = np.array([0.1, 0.25])
    z = bristle(SimpleNamespace(q=q, cache={}), 0, width, 2, 0.5)  # pyright: ignore[reportArgumentType]
    assert z.shape == (7999, 2)
    assert z[3999] == pytest.approx(np.tanh(0.3 / width), abs=1e-4)
    top, back = np.tanh(0.3 / width), q[3999, 0] - q[4500, 0]
    assert z[4500] == pytest.approx(top - back / width, abs=1e-4)


def test_dahls_loop_is_the_one_of_power_one_that_turns_back_as_it_comes():
    q = (0.3 * np.sin(np.linspace(0.0, 12.0, 6000)))[:, None]
    dahl, nearly = (
        bristle(SimpleNamespace(q=q, cache={}), 0, np.array([0.1]), 1, beta)  # pyright: ignore[reportArgumentType]
        for beta in (1.0, 1.0 - 1e-6)
    )
    assert nearly == pytest.approx(dahl, abs=2e-3)


def test_a_load_at_any_reach_is_the_quadratic_through_three(tmp_path):
    model = RigidModel(write_model(tmp_path / "model.xml"))
    rng = np.random.default_rng(3)
    q, v, a = (rng.normal(size=(20, 1)) for _ in range(3))
    s = SimpleNamespace(q=q, v=v, a=a, load=model.inverse(q, v, a), cache={})
    body = model.jointed_bodies()[-1]
    heavier = model.variant(lambda m: add_mass(m, body, 0.3, 1.37 * arm(model, body)))
    direct = (model.inverse(q, v, a, heavier) - s.load) / 0.3
    ctx = Context(model, [])
    found = EFFECT.columns(ctx, s, 0, {"body": body, "reach": 1.37}).linear[0]  # pyright: ignore[reportArgumentType]
    assert np.max(np.abs(direct)) > 0.1
    assert found == pytest.approx(direct, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("hz", [2.0, 9.0])
def test_a_soft_spring_is_wound_up_by_gravity_where_the_link_hangs(tmp_path, hz):
    """Against the equations of motor and link integrated to nine digits."""
    model = RigidModel(write_model(tmp_path / "model.xml", armature=0.02))
    t, zeta = np.arange(0.0, 6.0, 0.004), 0.05

    def motion(x):
        q = 0.8 * np.sin(1.1 * x) + 0.15 * np.sin(3.7 * x)
        v = 0.88 * np.cos(1.1 * x) + 0.555 * np.cos(3.7 * x)
        return q, v, -0.968 * np.sin(1.1 * x) - 2.0535 * np.sin(3.7 * x)

    q, v, a = (x[:, None] for x in motion(t))
    load, mass = model.inverse(q, v, a), model.mass_diagonal(q)
    s = SimpleNamespace(t=t, dt=0.004, q=q, v=v, a=a, load=load, mass=mass, cache={})
    ctx = Context(model, [s])  # pyright: ignore[reportArgumentType]
    J, armature = mean_inertia(ctx, 0), float(model.model.dof_armature[0])
    link, w = J - armature, 2.0 * np.pi * hz
    found = ELASTICITY.columns(ctx, s, 0, {"f": hz, "zeta": zeta, "motor": armature / J}).fixed  # pyright: ignore[reportArgumentType]
    assert found is not None
    own = load[:, 0] - float(model.model.dof_damping[0]) * v[:, 0] - armature * a[:, 0]
    k, d = link * w**2, 2.0 * zeta * w * link

    def weight(angle):
        zero = np.zeros((1, 1))
        return float(model.inverse(np.full((1, 1), angle), zero, zero)[0, 0])

    def slopes(x, y):
        pull = np.interp(x, t, own) + weight(motion(x)[0] + y[0]) - weight(motion(x)[0])
        return [y[1], (-k * y[0] - d * y[1] - pull) / link]

    true = solve_ivp(slopes, (0.0, t[-1]), [-own[0] / k, 0.0], t_eval=t, rtol=1e-7, atol=1e-9).y
    left = found - (-k * true[0] - d * true[1] - own)
    assert np.std(true[0]) > (0.05 if hz < 5.0 else 0.002)
    assert np.sqrt(np.mean(left[250:] ** 2)) < 0.05 * np.std(found)


@pytest.mark.parametrize("wrong", [{"width": 0.0}, {"power": 0.5}])
def test_a_loop_without_width_or_of_no_power_is_refused(wrong):
    with pytest.raises(ValueError, match="width must be positive, power one or more"):
        hysteresis_loop(np.zeros(3), **({"width": 0.1, "power": 2, "beta": 0.5} | wrong))
