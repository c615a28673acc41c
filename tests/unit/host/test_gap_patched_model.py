"""The patched model in stock MuJoCo moves as the simulation that the answer reports."""

import importlib.util
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import Context
from s2r_host.gap.motion.flat_bodies import thickened
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import make_session
from s2r_host.gap.output.answer import write_model
from s2r_host.gap.pipeline import patched_twin
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.regression.nuisance import body_parameters
from s2r_host.gap.regression.problem import build_problem
from s2r_host.gap.simulation.replay import Live, build_twin, run

STEP_S, ROWS = 0.00025, slice(100, 600)
JOINTS: tuple[str, ...] = ("left arm/shoulder", "left arm/elbow")
MODEL = f"""<mujoco><option timestep="{STEP_S}" integrator="implicitfast"/><worldbody><body name="upper">
<joint name="{JOINTS[0]}" axis="0 1 0" damping=".2" frictionloss=".05" armature=".1"/>
<inertial mass="1" pos="0 0 -.2" diaginertia=".02 .02 .002"/><body name="arm" pos="0 0 -.4">
<joint name="{JOINTS[1]}" axis="0 1 0" damping=".2" frictionloss=".05" armature=".1"/>
<inertial mass="1" pos="0 0 -.2" diaginertia=".02 .02 .002"/></body></body></worldbody></mujoco>"""
# No force of the simulation: what the record shows of sensors and stamps, and friction of another session.
BESIDE = ("clock_skew", "session_friction", "encoder_offset", "encoder_eccentricity")


@pytest.fixture(scope="module")
def ctx(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(MODEL, encoding="utf-8")
    model = RigidModel(path)
    t = np.arange(0, 6, 0.002)
    q = [0.4 * np.sin(2.1 * t), 0.5 * np.sin(1.3 * t + 0.4)]
    u = [1.5 * np.sin(2.1 * t), 1.0 * np.cos(3 * t)]
    channels: dict[str, dict[str, np.ndarray]] = {
        kind: dict(zip(JOINTS, x, strict=True)) for kind, x in (("q", q), ("tau", u))
    }
    channels["wrench"] = {"arm.fx": 2 * np.sin(7 * t), "arm.my": 0.3 * np.sin(4 * t)}
    rec = Recording("r", t, channels, Controller(), "commanded", "effort", "s", "", ())
    return Context(model, [make_session(model, rec, 0)], control_lag={0: (0.0, 0.01), 1: (0.0, 0.01)})


def stock(folder, start, at_link):
    """What encoders see of the patched model under the recorded efforts, with its callback where there is one."""
    model = mujoco.MjModel.from_xml_path(str(folder / "model_patched.xml"))
    off = None
    if (folder / "patch.py").exists():
        spec = importlib.util.spec_from_file_location("patch", folder / "patch.py")
        assert spec is not None
        assert spec.loader is not None
        patch: Any = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(patch)
        assert patch.TERMS
        off = patch.install(model)
    try:
        return _moved(model, start, at_link)
    finally:
        if off is not None:
            off()


def _moved(model, s, at_link):
    data = mujoco.MjData(model)
    adr = [int(model.jnt_qposadr[model.joint(j).id]) for j in JOINTS]
    dof = [int(model.jnt_dofadr[model.joint(j).id]) for j in JOINTS]
    data.qpos[adr], data.qvel[dof] = s.q[ROWS.start], s.v[ROWS.start]
    data.time = s.t[ROWS.start]
    found = []
    for i in range(ROWS.start, ROWS.stop):
        found.append(data.qpos[adr].copy())
        for joint in at_link:  # the notes of an answer say so
            found[-1][joint] += data.joint(f"{JOINTS[joint]}_gap_flex").qpos[0]
        data.qfrc_applied[dof] = s.u[i] - s.pushed[i]
        # Moments about the bodies' own axes that push the joints as the recorded wrench did.
        data.body("arm").xfrc_applied[4] = s.pushed[i, 1]
        data.body("upper").xfrc_applied[4] = s.pushed[i, 0] - s.pushed[i, 1]
        for _ in range(round(s.dt / STEP_S)):
            mujoco.mj_step(model, data)
    return np.array(found)


def live(ctx, name):
    """An effect of middling size on the second joint, or on the whole model; some act on one joint's own shape."""
    effect = catalogue()[name]
    joint = -1 if effect.scope == "model" else 1
    if not effect.applies(ctx, joint):
        pytest.skip(f"{name} cannot act here")
    shapes = effect.shapes(ctx, joint)
    for shape in dict.fromkeys([0, len(shapes) // 2, len(shapes) - 1]):
        columns = effect.columns(ctx, ctx.sessions[0], joint, shapes[shape])
        yield Live(name, joint, dict(shapes[shape]), np.full(len(columns.linear), 0.05))


@pytest.mark.parametrize("name", sorted(set(catalogue()) - set(BESIDE)))
def test_it_moves_as_the_simulation_of_the_answer(ctx, name, tmp_path):
    for shape, term in enumerate(live(ctx, name)):
        twin = build_twin(ctx.model, ctx, [term])
        wanted = run(twin, ctx.sessions[0], ROWS.start, ROWS.stop, closed=False).q
        plain = run(build_twin(ctx.model, ctx, []), ctx.sessions[0], ROWS.start, ROWS.stop, closed=False).q
        # A folder each: compiled modules are known by path, size and whole second.
        folder = tmp_path / str(shape)
        folder.mkdir()
        write_model(twin, folder)
        off_by = np.max(np.abs(stock(folder, ctx.sessions[0], twin.at_link) - wanted))
        assert off_by < 1e-4 + 0.05 * np.max(np.abs(wanted - plain)), (name, term.shape)


NUMBERS = (
    'damping=".2" frictionloss=".3" armature=".02" limited="true" range="-172 172" stiffness=".5" springref="20" '
    'margin=".01" solreflimit=".03 1" solreffriction=".03 1" actuatorfrclimited="true" actuatorfrcrange="-9 9"'
)
TOLD = """<mujoco><option timestep="{step}" integrator="implicitfast"/><default>{defaults}</default><worldbody>
<body name="link" {childclass}><joint name="{joint}" axis="0 1 0" {own}/>
<inertial mass="1" pos="0 0 -.2" diaginertia=".02 .02 .002"/></body></worldbody></mujoco>"""


def told(where, folder):
    """Context of one joint whose numbers stand on it, in the main default class, or in one of its body."""
    numbers = f"<joint {NUMBERS}/>"
    path = folder / f"{where}.xml"
    path.write_text(
        TOLD.format(
            step=STEP_S,
            joint="hinge",
            own=NUMBERS if where == "joint" else "",
            defaults={"main": numbers, "class": f"<default class='arm'>{numbers}</default>"}.get(where, ""),
            childclass='childclass="arm"' if where == "class" else "",
        ),
        encoding="utf-8",
    )
    model, t = RigidModel(path), np.arange(0, 6, 0.002)
    channels = {"q": {"hinge": 0.5 * np.sin(1.3 * t)}, "tau": {"hinge": np.cos(3 * t)}}
    rec = Recording("r", t, channels, Controller(), "commanded", "effort", "s", "", ())
    return Context(model, [make_session(model, rec, 0)])


@pytest.mark.parametrize("where", ["main", "class"])
@pytest.mark.parametrize("name", ["joint_elasticity", "backlash"])
def test_the_joint_behind_a_gear_takes_nothing_from_the_defaults_of_the_model(name, where, tmp_path):
    def patched(x):
        ctx = told(x, tmp_path)
        twin = build_twin(ctx.model, ctx, [Live(name, 0, catalogue()[name].shapes(ctx, 0)[-1], np.zeros(0))])
        folder = tmp_path / f"patched {x}"
        folder.mkdir()
        write_model(twin, folder)
        return twin.model, mujoco.MjModel.from_xml_path(str(folder / "model_patched.xml"))

    arrays = (
        "dof_frictionloss", "dof_armature", "dof_damping", "dof_solref", "dof_solimp", "jnt_stiffness", "jnt_limited",
        "jnt_range", "jnt_margin", "jnt_solref", "jnt_solimp", "jnt_actfrclimited", "qpos0", "qpos_spring",
    )  # fmt: skip
    for found, wanted in zip(patched(where), patched("joint"), strict=True):
        assert wanted.nv == 2
        assert wanted.dof_frictionloss[1] == 0.0
        for array in arrays:
            assert getattr(found, array) == pytest.approx(getattr(wanted, array), rel=1e-4), array


FLAT_PLATE = """<mujoco><worldbody><body name="plate"><joint name="hinge" axis="0 0 1"/>
<inertial mass="5.2" pos=".16 0 0" diaginertia=".03 .06 .09"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("name", ["mass", "inertia"])
def test_a_flat_body_of_another_size_is_still_a_body(name):
    """Of a plate one moment of inertia is the sum of the others; MuJoCo refuses it where rounding makes it more."""
    spec = mujoco.MjSpec.from_string(FLAT_PLATE)
    model: Any = SimpleNamespace(model=spec.compile(), body_name=lambda body: "plate")
    parameter = next(p for p in body_parameters(model, 1) if p.name == name)
    for change in np.linspace(-0.3, 0.3, 61):
        copied = spec.copy()
        parameter.write(copied, float(change))
        moments = copied.compile().body_inertia[1]
        assert moments == pytest.approx(np.array([0.03, 0.06, 0.09]) * (1.0 + change), rel=1e-7)


@pytest.mark.parametrize("moments", [(0.03, 0.06, 0.09), (0.02, 0.02, 0.0), (0.1, 0.2, 0.1)])
def test_a_flat_or_thin_body_is_thickened_in_its_smallest_moments_alone(moments):
    flat = np.array(moments)
    thick = thickened(flat, 1e-3)
    assert thick.sum() > 2.0 * thick.max()
    assert np.all((thick != flat) == (flat == flat.min()))
    assert thick == pytest.approx(flat, abs=1.001e-3 * flat.max())


@pytest.mark.parametrize("moments", [(0.05, 0.06, 0.09), (0.0, 0.0, 0.0)])
def test_another_body_keeps_its_moments(moments):
    assert np.array_equal(thickened(np.array(moments), 1e-3), moments)


def test_the_correction_of_what_has_no_name_moves_the_stock_model_as_the_simulation(ctx, tmp_path):
    model, t = ctx.model, np.arange(0, 12, 0.002)
    w, shift = np.array([1.7, 2.9]), np.array([0.0, 0.4])
    q = 0.5 * np.sin(np.outer(t, w) + shift)
    v, a = 0.5 * w * np.cos(np.outer(t, w) + shift), -(w**2) * q
    u = model.inverse(q, v, a) + 0.05 * np.sign(v) + 0.4 * v * np.abs(q)
    channels = {"q": dict(zip(JOINTS, q.T, strict=True)), "tau": dict(zip(JOINTS, u.T, strict=True))}
    s = make_session(model, Recording("r", t, channels, Controller(), "commanded", "effort", "s", "", ()), 0)
    found: Any = SimpleNamespace(model=model, problem=build_problem(model, [s], [], []))
    solution: Any = None
    twin = patched_twin(found, solution, "unknown")
    assert {(t.effect, t.joint) for t in twin.live} == {("generic_correction", 0), ("generic_correction", 1)}
    wanted = run(twin, s, ROWS.start, ROWS.stop, closed=False).q
    plain = run(build_twin(model, twin.ctx, []), s, ROWS.start, ROWS.stop, closed=False).q
    recorded = s.q[ROWS]
    assert np.max(np.abs(wanted - recorded)) < 0.5 * np.max(np.abs(plain - recorded))
    write_model(twin, tmp_path)
    off_by = np.max(np.abs(stock(tmp_path, s, twin.at_link) - wanted))
    assert off_by < 1e-4 + 0.05 * np.max(np.abs(wanted - plain))


def test_what_has_a_stock_form_leaves_no_callback(ctx, tmp_path):
    twin = build_twin(ctx.model, ctx, [Live("coulomb_friction", 1, {}, np.array([0.2]))])
    twin.offset[:] = 0.01  # the zero of an effort channel is no part of the machine
    write_model(twin, tmp_path)
    assert not (tmp_path / "patch.py").exists()


def test_the_callback_leaves_other_models_alone(ctx, tmp_path):
    twin = build_twin(ctx.model, ctx, [Live("spring_return", 1, {}, np.array([0.5, 0.1]))])
    twin.live, twin.native = [Live("detent", 1, {"q0": 0.0, "w": 0.1}, np.array([0.5]))], []
    write_model(twin, tmp_path)
    model, other = (mujoco.MjModel.from_xml_path(str(tmp_path / "model_patched.xml")) for _ in range(2))
    spec = importlib.util.spec_from_file_location("patch", tmp_path / "patch.py")
    assert spec is not None
    assert spec.loader is not None
    patch: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(patch)
    alone = mujoco.MjData(other)
    alone.qpos[:] = 0.05
    mujoco.mj_forward(other, alone)
    before = alone.qfrc_passive.copy()
    off = patch.install(model)
    try:
        mujoco.mj_forward(other, alone)
    finally:
        off()
    assert alone.qfrc_passive == pytest.approx(before)
