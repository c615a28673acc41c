"""Joints that the model ties to others are moved by the leader's drive, which feels what they need."""

import mujoco
import numpy as np
import pytest

from s2r_host.gap.config import GapConfig
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.pipeline import analyse

MJCF = """<mujoco><option timestep="0.0005"/><worldbody>
<body name="bridge"><joint name="bridge" type="slide" axis="1 0 0" armature="3" damping="25" frictionloss="4"/>
<inertial mass="5.5" pos="0 0 0" diaginertia="0.1 0.1 0.1"/></body>
<body name="drawer"><joint name="drawer" type="slide" axis="1 0 0" damping="6" frictionloss="3" ref="{ref}"/>
<inertial mass="3.1" pos="0 0 0" diaginertia="0.1 0.1 0.1"/></body></worldbody>
<equality><joint joint1="drawer" joint2="bridge" polycoef="0 {slope} 0 0 0" solref="0.001 1"/></equality></mujoco>"""
URDF = """<robot name="gripper"><link name="palm"/>{links}
<joint name="left" type="prismatic"><parent link="palm"/><child link="l"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="9" velocity="1"/></joint>
<joint name="right" type="prismatic"><parent link="palm"/><child link="r"/><axis xyz="0 -1 0"/>
<limit lower="-1" upper="1" effort="9" velocity="1"/><mimic joint="left" multiplier="{slope}" offset="0.1"/></joint>
</robot>"""
LINK = """<link name="{}"><inertial><mass value="{}"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>
</inertial></link>"""
SECONDS, DT = 16.0, 0.004
QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)


def test_the_leader_carries_what_a_mimic_joint_needs(tmp_path):
    path = tmp_path / "model.urdf"
    path.write_text(URDF.format(links=LINK.format("l", 2.0) + LINK.format("r", 3.0), slope=2.0))
    model = RigidModel(path)
    (tie,) = model.ties
    assert (model.joints[tie.follower], model.joints[tie.leader]) == ("right", "left")
    t = np.linspace(0.0, 1.0, 5)
    q, v, a = tie.moves(0.2 * t, 0.2 + 0.0 * t, 0.3 + 0.0 * t)
    assert q == pytest.approx(0.1 + 0.4 * t)
    assert v == pytest.approx(0.4)
    assert a == pytest.approx(0.6)
    column = np.zeros((5, 2))
    asked = column.copy()
    asked[:, tie.leader], asked[:, tie.follower] = 0.3, a
    needed = model.inverse(column, column, asked)[:, tie.leader]
    assert needed == pytest.approx(
        (2.0 + 2.0**2 * 3.0) * 0.3
    )  # inertia of the follower counts by the slope's square
    assert model.mass_diagonal(column)[:, tie.leader] == pytest.approx(2.0 + 2.0**2 * 3.0)


def test_a_follower_of_a_follower(tmp_path):
    path = tmp_path / "model.xml"
    bodies = "".join(
        f'<body name="{n}"><joint name="{n}" type="slide" axis="1 0 0"/><inertial mass="{m}" pos="0 0 0" '
        'diaginertia="1 1 1"/></body>'
        for n, m in (("a", 1.0), ("b", 2.0), ("c", 3.0))
    )
    ties = '<joint joint1="b" joint2="a" polycoef="0 2 0 0 0"/><joint joint1="c" joint2="b" polycoef="0 3 0 0 0"/>'
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody><equality>{ties}</equality></mujoco>")
    model = RigidModel(path)
    still = np.zeros((1, 3))
    needed = model.inverse(still, still, np.array([[1.0, 2.0, 6.0]]))
    assert needed[0, 0] == pytest.approx(1.0 + 2.0 * 4.0 + 3.0 * 36.0)
    assert model.mass_diagonal(still)[0, 0] == pytest.approx(1.0 + 2.0 * 4.0 + 3.0 * 36.0)


def recorded(folder, model, name, seed, slope, *, follower="recorded", slips=0.0):
    """What the bridge's drive needs for a smooth motion of both, by hand; the drawer's column, if any, may slip."""
    rng = np.random.default_rng(seed)
    f, phase = rng.uniform(0.1, 1.0, 4), rng.uniform(0.0, 2.0 * np.pi, 4)
    t = np.arange(0.0, SECONDS, DT)
    wave, w = 2.0 * np.pi * np.outer(f, t) + phase[:, None], 2.0 * np.pi * f[:, None]
    q, v, a = (0.06 * np.sum(x, axis=0) for x in (np.sin(wave), w * np.cos(wave), -(w**2) * np.sin(wave)))
    way = slope * v
    effort = 8.5 * a + 25.0 * v + 4.0 * np.tanh(v / 0.001)
    effort += slope * (3.1 * slope * a + 6.0 * way + 3.0 * np.tanh(way / 0.001))
    columns = {
        "t": t,
        "q.bridge": q,
        "dq.bridge": v,
        "tau.bridge": effort + 0.3 * rng.standard_normal(len(t)),
    }
    if follower == "recorded":
        slid = slips * np.cumsum(np.abs(a) > 1.5 * np.std(a)) * DT
        columns |= {"q.drawer": slope * q + slid, "dq.drawer": way}
    for kind, level in (("q", 1e-5), ("dq", 5e-4)):
        for c in columns:
            if c.startswith(f"{kind}."):
                columns[c] = columns[c] + level * rng.standard_normal(len(t))
    path = folder / f"{name}.csv"
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.8g")
    path.with_suffix(".yaml").write_text("effort: measured\nsession: one\n")
    return path


def asked(folder, slope, **how):
    path = folder / "model.xml"
    path.write_text(MJCF.format(slope=slope, ref=0.0))
    model = RigidModel(path)
    files = [recorded(folder, model, name, seed, slope, **how) for name, seed in (("fit", 1), ("held", 2))]
    return analyse(path, files[:1], files[1:], [], QUICK, lambda _: None)


@pytest.mark.parametrize("follower", ["recorded", "left out"])
def test_what_is_tied_is_no_missing_physics(tmp_path, follower):
    """It was a coupling of motors: an inertia and a damping of the drawer's own size."""
    found = asked(tmp_path, -0.7, follower=follower)
    assert found.verdict == "nothing_missing"
    if follower == "left out":
        assert any("taken to follow 'bridge'" in note for note in found.notes)


def test_a_tie_that_slips_is_said(tmp_path):
    found = asked(tmp_path, 1.0, slips=0.02)
    assert found.verdict == "unknown"
    assert [p.joint for p in found.places] == ["bridge"]
    assert "ties 'drawer' to 'bridge'" in found.places[0].words


def test_a_wrench_on_what_is_tied_stands_for_the_tie(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(MJCF.format(slope=1.0, ref=0.0))
    model = RigidModel(path)
    file = recorded(tmp_path, model, "fit", 1, 1.0)
    rows = file.read_text().splitlines()
    pulls = np.loadtxt(file, delimiter=",", skiprows=1)[:, 4:]
    pull = 6.0 * pulls[:, 1] + 3.0 * np.tanh(pulls[:, 1] / 0.001) + 3.1 * np.gradient(pulls[:, 1], DT)
    rows = [f"{rows[0]},wrench.drawer.fx", *(f"{r},{p:.6g}" for r, p in zip(rows[1:], pull, strict=True))]
    file.write_text("\n".join(rows) + "\n")
    found = analyse(path, [file], [], [], QUICK, lambda _: None)
    assert found.model.ties == ()
    assert any("pulled by a recorded wrench" in note for note in found.notes)


def test_the_sum_is_what_mujoco_needs_with_the_tie_as_a_constraint(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(
        MJCF.format(slope=-1.5, ref=0.2).replace('frictionloss="4"', "").replace('frictionloss="3"', "")
    )
    model = RigidModel(path)
    (tie,) = model.ties
    m = model.model
    d = mujoco.MjData(m)
    lead = m.joint("bridge").dofadr[0]
    rows = []
    for i in range(3000):
        d.qfrc_applied[lead] = 20.0 * np.sin(0.004 * i)
        mujoco.mj_step(m, d)
        rows.append((d.qpos.copy(), d.qvel.copy(), d.qacc.copy(), d.qfrc_applied[lead]))
    q, v, a, u = (np.stack(x) for x in zip(*rows[500:], strict=True))
    assert np.max(np.abs(q[:, tie.follower] - tie.position(q[:, tie.leader]))) < 1e-3
    assert model.inverse(q, v, a)[:, lead] == pytest.approx(u, abs=0.05 * float(np.std(u)))
