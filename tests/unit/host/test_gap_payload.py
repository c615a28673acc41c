"""A load that was found weighs as much in the patched model as it was said to, and in its file, too."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.effects.payload import EFFECT, add_mass
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.pipeline import analyse

ARM = """<mujoco><worldbody><body name="link"><joint name="joint" axis="0 1 0"/>
  <geom size="0.05" pos="0.3 0 0"/></body></worldbody></mujoco>"""


def _held(model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return float(data.qfrc_bias[0])


def test_a_patched_load_hangs_at_its_place_in_memory_and_in_the_file():
    bare, spec = mujoco.MjModel.from_xml_string(ARM), mujoco.MjSpec.from_string(ARM)
    context = SimpleNamespace(model=SimpleNamespace(body_name=lambda body: "link", model=bare))
    assert EFFECT.patch(context, spec, 0, {"body": 1, "reach": 1.0}, np.array([2.0]))  # pyright: ignore[reportArgumentType]
    loaded = spec.compile()
    weight = -2.0 * 9.81 * 0.3
    assert _held(loaded) - _held(bare) == pytest.approx(weight, rel=1e-6)
    assert _held(mujoco.MjModel.from_xml_string(spec.to_xml())) - _held(bare) == pytest.approx(
        weight, rel=1e-4
    )


def test_a_load_beside_that_of_an_earlier_patch_has_a_name_of_its_own():
    bare, spec = mujoco.MjModel.from_xml_string(ARM), mujoco.MjSpec.from_string(ARM)
    context = SimpleNamespace(model=SimpleNamespace(body_name=lambda body: "link", model=bare))
    for _ in range(2):
        assert EFFECT.patch(context, spec, 0, {"body": 1, "reach": 1.0}, np.array([2.0]))  # pyright: ignore[reportArgumentType]
    assert _held(spec.compile()) - _held(bare) == pytest.approx(-4.0 * 9.81 * 0.3, rel=1e-6)


WRIST = """<mujoco><worldbody>
<body name="upper"><joint name="shoulder" axis="0 0 1" damping="3" frictionloss="2" armature="0.4"/>
<inertial mass="4" pos="0 0 0.1" diaginertia="0.03 0.03 0.02"/>
<body name="fore" pos="0 0 0.3"><joint name="elbow" axis="0 1 0" damping="3" frictionloss="2" armature="0.4"/>
<inertial mass="2" pos="0 0 0.15" diaginertia="0.02 0.02 0.005"/>
<body name="palm" pos="0 0 0.35"><joint name="wrist" axis="1 0 0" damping="0.5" frictionloss="0.4" armature="0.1"/>
<inertial mass="0.7" pos="0.01 0.05 0" diaginertia="0.002 0.002 0.002"/></body></body></body>
</worldbody></mujoco>"""
HELD, PLACE = 1.2, np.array([0.02, 0.06, 0.12])


@pytest.fixture(scope="module")
def wrist(tmp_path_factory):
    path = tmp_path_factory.mktemp("wrist") / "model.xml"
    path.write_text(WRIST)
    return RigidModel(path)


def smooth(rng, joints, seconds=12.0, dt=0.004):
    t = np.arange(0.0, seconds, dt)
    f, phase = rng.uniform(0.1, 0.9, (joints, 4, 1)), rng.uniform(0.0, 2.0 * np.pi, (joints, 4, 1))
    w, wave = 2.0 * np.pi * f, 2.0 * np.pi * f * t + phase
    return t, *(0.3 * np.sum(x, axis=1).T for x in (np.sin(wave), w * np.cos(wave), -(w**2) * np.sin(wave)))


def test_a_load_beside_its_line_is_exact_at_its_place_and_right_nearby(wrist):
    _, q, v, a = smooth(np.random.default_rng(3), 3, seconds=2.0)
    s = SimpleNamespace(q=q, v=v, a=a, load=wrist.inverse(q, v, a), cache={})
    ctx = SimpleNamespace(model=wrist)
    body = int(wrist.model.body("palm").id)
    there = 2.0 * wrist.model.body_ipos[body]
    shape = {"body": float(body), "x": there[0], "y": there[1], "z": there[2]}
    columns = EFFECT.columns(ctx, s, -1, shape).linear  # pyright: ignore[reportArgumentType]
    for off in (np.zeros(3), np.array([0.004, -0.003, 0.005])):
        place = there + off
        loaded = wrist.variant(lambda m, p=place: add_mass(m, body, 1.0, p))
        true = wrist.inverse(q, v, a, loaded) - s.load
        said = columns[0] + sum(x * d for x, d in zip(columns[1:], off, strict=True))
        assert np.max(np.abs(said - true)) < 1e-9 + 2e-3 * np.max(np.abs(true)) * np.linalg.norm(off) / 0.007


def recorded(folder, model, name, motion, seed):
    t, q, v, a = smooth(np.random.default_rng(motion), 3)
    rng = np.random.default_rng(seed)
    body = int(model.model.body("palm").id)
    loaded = model.variant(lambda m: add_mass(m, body, HELD, PLACE))
    effort = model.inverse(q, v, a, loaded) + model.model.dof_frictionloss * np.tanh(v / 0.001)
    columns = {"t": t}
    for j, joint in enumerate(model.joints):
        columns |= {
            f"q.{joint}": q[:, j] + 1e-5 * rng.standard_normal(len(t)),
            f"dq.{joint}": v[:, j] + 1e-3 * rng.standard_normal(len(t)),
            f"tau.{joint}": effort[:, j] + (0.1, 0.1, 0.03)[j] * rng.standard_normal(len(t)),
        }
    path = folder / f"{name}.csv"
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.8g")
    path.with_suffix(".yaml").write_text("effort: measured\nsession: one\n")
    return path


def test_a_load_that_hangs_aside_is_one_number_and_not_many(wrist, tmp_path):
    """Along the line to the palm's centre of mass it explained little, and numbers of all links took its place."""
    names = (("fit", 1, 3), ("held", 2, 4), ("again", 1, 5))
    files = [recorded(tmp_path, wrist, *name) for name in names]
    quick = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)
    found = analyse(wrist.path, files[:1], files[1:2], files[2:], quick, lambda _: None)
    assert found.decision is not None
    (load,) = found.decision.parameters_off
    assert (load["name"], load["body"]) == ("payload_mass", "palm")
    assert load["interval90"][0] < HELD < load["interval90"][1]
    assert found.twin is not None
    (extra,) = [b for b in found.twin.spec.bodies if b.name.startswith("gap_payload")]
    assert np.linalg.norm(extra.pos - PLACE) < 0.02
