"""A soft end stop and a part that rings behind the joint: named among what they are confused with, with their numbers.

The recordings come from the equation of motion turned round, not from the regressors of the catalogue.
"""

import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.effects import catalogue
from s2r_host.gap.pipeline import analyse
from s2r_host.gap.rig import GRAVITY, INERTIA, LENGTH, MASS, write_model

DT, FINE, NOISE = 0.002, 10, 0.004
J = MASS * LENGTH**2 + INERTIA
FRICTION = {"coulomb_friction", "viscous_friction", "stribeck"}
STOP = {"position": 0.6, "stiffness": 8.0, "damping": 4.0}
PART = {"inertia_share": 0.3, "frequency": 5.0, "damping_ratio": 0.03}


def swinging(t):
    """To and fro, into the stop at 0.6 rad."""
    return 0.15 + 0.6 * np.sin(1.9 * t) + 0.2 * np.sin(4.7 * t + 1.0)


def point_to_point(t):
    """Short strokes with abrupt ends, a second apart."""
    q = np.zeros_like(t)
    for k in range(int(t[-1])):
        x = np.clip((t - k - 0.1) / 0.25, 0.0, 1.0)
        q += (0.7 if k % 2 else -0.5) * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return q


def pushes_back(q, v, a):
    x = np.maximum(0.0, q - STOP["position"])
    return STOP["stiffness"] * x + STOP["damping"] * x * v


def rings(q, v, a):
    """The part's own motion, step by step."""
    w, h = 2.0 * np.pi * PART["frequency"], DT / FINE
    eta = rate = 0.0
    reaction = np.zeros_like(a)
    for i, pull in enumerate(a):
        acceleration = -pull - 2.0 * PART["damping_ratio"] * w * rate - w * w * eta
        rate += h * acceleration
        eta += h * rate
        reaction[i] = PART["inertia_share"] * J * acceleration
    return reaction


def recorded(folder, name, motion, extra, seed):
    t = np.arange(0.0, 9.0, DT / FINE)
    q = motion(t)
    v = np.gradient(q, t)
    a = np.gradient(v, t)
    tau = J * a + 0.08 * v + MASS * GRAVITY * LENGTH * np.sin(q) + extra(q, v, a)
    noise = np.random.default_rng(seed).normal(size=len(t)) * NOISE
    path = folder / f"{name}.csv"
    rows = np.stack([t, q, v, tau + noise], axis=1)[::FINE]
    np.savetxt(path, rows, delimiter=",", header="t,q.elbow,dq.elbow,tau.elbow", comments="", fmt="%.7g")
    path.with_suffix(".yaml").write_text(f"effort: measured\ninput: effort\nsession: {name}\n")
    return path


@pytest.mark.parametrize(
    ("name", "motion", "extra", "known", "share"),
    [
        ("soft_end_stop", swinging, pushes_back, STOP, 0.1),
        ("flexible_part", point_to_point, rings, PART, 0.15),
    ],
)
def test_it_is_named_with_its_numbers(tmp_path, name, motion, extra, known, share):
    model = write_model(tmp_path / "model.xml")
    fit, again = (recorded(tmp_path, x, motion, extra, seed) for seed, x in enumerate(("fit", "again")))
    rivals = {name, *catalogue()[name].confusable, *FRICTION}
    config = GapConfig(skip=tuple(sorted(set(catalogue()) - rivals)), simulate=False, baselines=False)
    found = analyse(model, [fit], [], [again], config, lambda _: None)
    assert found.decision is not None
    assert [e.name for e in found.decision.effects] == [name]
    values = found.decision.effects[0].parameters
    sure = [key for key in known if values[key]["identifiable"]]
    assert len(sure) >= 2
    for key in sure:
        assert values[key]["value"] == pytest.approx(known[key], rel=share), key
