"""Hidden states against closed forms, and a load along its arm against the load put there."""

from types import SimpleNamespace

import numpy as np
import pytest

from s2r_host.gap.effects.base import Context
from s2r_host.gap.effects.payload import EFFECT, add_mass, arm
from s2r_host.gap.model import RigidModel
from s2r_host.gap.rig import write_model
from s2r_host.gap.states import bristle, deflection


def test_a_loop_of_power_two_follows_the_hyperbolic_tangent():
    """On a rise from rest dz/dq = (1 - z²)/w; turned back, dz/dq = 1/w until z changes sign."""
    q = np.concatenate([np.linspace(0.0, 0.3, 4000), np.linspace(0.3, 0.0, 4000)[1:]])[:, None]
    width = np.array([0.1, 0.25])
    z = bristle(SimpleNamespace(q=q, cache={}), 0, width, 2)  # pyright: ignore[reportArgumentType]
    assert z.shape == (7999, 2)
    assert z[3999] == pytest.approx(np.tanh(0.3 / width), abs=1e-4)
    top, back = np.tanh(0.3 / width), q[3999, 0] - q[4500, 0]
    assert z[4500] == pytest.approx(top - back / width, abs=1e-4)


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


def test_one_shape_alone_is_integrated_as_among_others():
    """A loose link whose load turns over twice: in plain numbers and in arrays, at steps that need no halving."""
    t = np.arange(0.0, 2.0, 0.002)
    session, slope = SimpleNamespace(dt=0.002), 0.5 * np.cos(t)
    inertia, load = np.full((len(t), 1), 0.1), (2.0 * np.sin(4.0 * t))[:, None]
    k, d, gap = np.array([500.0]), np.array([0.5]), np.array([0.003])
    alone = deflection(session, 0, inertia, load, slope, k, d, gap)  # pyright: ignore[reportArgumentType]
    inertia, load = np.repeat(inertia, 2, axis=1), np.repeat(load, 2, axis=1)
    k, d, gap = np.repeat(k, 2), np.repeat(d, 2), np.repeat(gap, 2)
    among = deflection(session, 0, inertia, load, slope, k, d, gap)  # pyright: ignore[reportArgumentType]
    assert alone.shape == (len(t), 1)
    assert np.any(alone == 0.0)  # free while the gap is crossed
    assert np.max(np.abs(alone)) > 1.5
    assert alone == pytest.approx(among[:, :1], abs=1e-9)
