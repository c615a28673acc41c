"""Physics left out: sealed objects with one effect each, figures per effect, a page of them."""

import json
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from click.testing import CliRunner
from mcap.writer import Writer

from s2r_protocol.exits import ExitCode
from s2r_protocol.ros2.cdr import pack
from s2r_sim.errors import RunFileError, UnstableError
from s2r_sim.missing.cases import HIDDEN, LATER, LEARNING, draw_case
from s2r_sim.missing.cli import missing
from s2r_sim.missing.page import compared, interval_over_objects, likened, own_shifts, summaries, write_page
from s2r_sim.missing.play import force_of, no_effect, played
from s2r_sim.missing.score import answer_of, named, named_alone, paired, relative, score_run, told
from s2r_sim.missing.shift import largest, shifts
from s2r_sim.missing.trial import run_case
from s2r_sim.objects.effects import JointEffects
from s2r_sim.paper.trials import Trial
from s2r_sim.physics import build_world
from s2r_sim.score import true_joint
from s2r_sim.sealed import host_seed
from s2r_sim.truth import CONTACT_COLUMNS
from s2r_sim.world import load_world

GAUGE = {"drawer": 0.3, "laptop": 0.1, "faucet": 0.1}  # what the arm feels, N or N·m


BESIDE_THE_JOINT = ("drawer: rail play", "drawer: slop", "laptop: flexible lid")


@pytest.mark.parametrize("label", HIDDEN)
def test_every_case_hides_one_effect_that_the_arm_can_feel_and_leaves_the_part_room(label):
    for number in range(3):
        trial = draw_case(label, number)
        effects, thing = trial.world.effects, trial.world.object
        coulomb = thing.coulomb_N if thing.kind == "drawer" else thing.coulomb
        sizes = [coulomb * effects.stiction, 0.5 * coulomb * effects.profile, effects.detent, effects.pull]
        hidden = [size for size in sizes if size > 0.0]
        if HIDDEN[label].names and label not in BESIDE_THE_JOINT:
            assert len(hidden) == 1
            assert hidden[0] > 2.0 * GAUGE[thing.kind]
        else:
            assert not hidden
        assert effects.pull < coulomb  # the part stays where it is let go
        for push in (-0.045, 0.0) if thing.kind == "drawer" else (-0.43, 0.43):
            for share in (*LEARNING, *LATER):
                assert 0.0 < thing.q_start + push + share * trial.change < thing.q_max


def test_the_same_number_is_the_same_object_and_another_one_is_not():
    label = "drawer: stiction"
    assert draw_case(label, 0, "salt") == draw_case(label, 0, "salt")
    assert draw_case(label, 0, "salt").world != draw_case(label, 1, "salt").world
    assert draw_case(label, 0).world.commitment != draw_case(label, 0).world.commitment  # the salt is fresh


EXPECTED = {
    "drawer: nothing": (22326, 0.10395),
    "drawer: friction profile": (21328, -0.116042),
    "drawer: stiction": (24327, -0.126982),
    "drawer: closing spring below friction": (20326, -0.144001),
    "drawer: rail play": (23326, 0.149787),
    "laptop: nothing": (29326, -0.466923),
    "laptop: friction profile": (28326, 0.590016),
    "faucet: nothing": (26327, 0.389917),
    "faucet: detent": (25327, 0.495739),
    "faucet: stiction": (27327, -0.429757),
    "drawer: slop": (30326, 0.114405),
    "laptop: flexible lid": (31327, 0.505291),
}


def test_cases_keep_their_objects_whatever_cases_are_added():
    """Numbers of trials and wanted changes as they were before cases had places of their own."""
    drawn = {label: (trial.number, trial.change) for label in HIDDEN for trial in [draw_case(label, 158)]}
    assert len({hidden.place for hidden in HIDDEN.values()}) == len(HIDDEN)
    assert drawn == EXPECTED


@pytest.mark.parametrize(("label", "name"), [("drawer: slop", "slop"), ("laptop: flexible lid", "bend")])
def test_what_gives_way_is_hidden_in_its_own_case_only(label, name):
    assert label in HIDDEN
    for other in HIDDEN:
        spec = draw_case(other, 0).world.object
        assert (getattr(spec, name, None) is not None) == (other == label)
        assert draw_case(other, 0).world.arm.gears is None


def write_run(folder, trial, *targets):
    """Files of a run that went towards these changes, one after the other."""
    trial.world.save(folder / "world.json")
    header = ",".join(["t_s", "master_tick", "object", *CONTACT_COLUMNS])
    (folder / "truth.csv").write_text(f"{header}\n0.0,0,0.5,0,0,0,0\n0.1,100,0.6,0,0,0,0\n")
    (folder / "run").mkdir()
    run = {
        "attempts": [
            {"tick_start": 50 * k, "plan_seqs": [7, 8], "s_initial": 0.2, "s_target": 0.2 + change}
            for k, change in enumerate(targets)
        ],
        "physics": [],
        "lost_motion": [],
        "wall_s": 1.0,
        "exit": {"code": 4, "reason": "no joint"},
    }
    (folder / "run/run.json").write_text(json.dumps(run))


def test_a_run_that_ended_before_its_first_manipulation_is_a_row_without_moves(tmp_path):
    trial = draw_case("faucet: nothing", 0)
    write_run(tmp_path, trial)
    row = score_run(trial, tmp_path, (*LEARNING, *LATER))
    assert row["moves"] == []
    assert row["exit"] == 4
    assert row["commitment_holds"]


def test_a_run_with_a_target_that_it_was_not_given_is_told_by_file_and_numbers(tmp_path):
    trial = draw_case("faucet: nothing", 0)
    write_run(tmp_path, trial, 9.0)
    with pytest.raises(
        RunFileError, match=r"run\.json has a manipulation towards \+9\.000000 .* another trial"
    ):
        score_run(trial, tmp_path, (*LEARNING, *LATER))


def test_the_world_is_out_of_the_runs_folder_while_the_host_is_at_work(tmp_path, monkeypatch):
    seen = []

    @contextmanager
    def cell(folder, world, stand_in):
        assert folder not in world[1].parents
        assert folder not in stand_in[1].parents
        yield SimpleNamespace(executor="e", camera="c")
        seen.extend(path.name for path in folder.rglob("*"))

    monkeypatch.setattr("s2r_sim.missing.trial.stand_in_cell", cell)
    told = []
    monkeypatch.setattr("s2r_sim.missing.trial.s2r_command", lambda *words: told.extend(words) or ["true"])
    run_case(tmp_path, "faucet: nothing", 0, "learnt", 1)
    assert seen == ["host.log"]
    assert told[told.index("--seed") + 1] == str(host_seed(draw_case("faucet: nothing", 0).number))
    assert not [word for word in told if "nothing" in str(word)]  # what the case hides is its folder's name
    (world,) = tmp_path.rglob("world.json")
    assert load_world(world) == draw_case("faucet: nothing", 0, load_world(world).salt).world


def test_one_run_that_cannot_be_scored_is_a_row_of_the_campaign(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "s2r_sim.missing.trial._play", lambda trial, folder, *_: write_run(folder, trial, 9.0)
    )
    row = run_case(tmp_path, "faucet: nothing", 0, "learnt", 1)
    assert row["exit"] == ExitCode.BUG
    assert row["reason"].startswith("RunFileError: ")


def _answer(verdict, *names, numbers=(), also=()):
    effects = [[name, list(also), 0.9] for name in names]
    return {
        "verdict": verdict, "effects": effects, "parameters_off": list(numbers), "carried": list(names),
    }  # fmt: skip


def test_a_name_counts_as_sealed_a_set_that_holds_it_does_and_no_answer_is_open():
    assert named("drawer: stiction", _answer("physics_missing", "stribeck"))
    assert named("drawer: stiction", _answer("physics_missing", "presliding", also=("stribeck",)))
    assert named("drawer: stiction", _answer("physics_missing", "cogging")) is False
    assert named("drawer: stiction", _answer("nothing_missing")) is False
    assert named("drawer: stiction", _answer("insufficient")) is None
    assert named("drawer: nothing", _answer("parameter_off", numbers=("frictionloss",)))
    assert named("drawer: nothing", _answer("physics_missing", "stribeck")) is False


def test_a_wrong_name_beside_the_right_one_is_counted_apart():
    both = _answer("physics_missing", "stribeck", "cogging")
    assert named("drawer: stiction", both)
    assert not named_alone("drawer: stiction", both)
    assert named_alone("drawer: stiction", _answer("physics_missing", "stribeck", numbers=("frictionloss",)))
    assert not named_alone("drawer: stiction", _answer("physics_missing", "cogging"))
    assert named_alone("drawer: nothing", _answer("nothing_missing"))


def test_an_answer_of_fewer_than_three_motions_is_open_and_the_next_takes_its_place():
    early = _answer("unknown") | {"after": 1}
    later = _answer("physics_missing", "stribeck") | {"after": 4}
    assert named("drawer: stiction", early) is None
    assert answer_of("drawer: stiction", [early, later]) is later
    assert answer_of("drawer: stiction", [_answer("insufficient"), later]) is later
    assert answer_of("drawer: stiction", [later, _answer("nothing_missing")]) is later
    assert answer_of("drawer: stiction", [_answer("unknown") | {"after": 3}, later])["verdict"] == "unknown"
    assert answer_of("drawer: stiction", [early]) is early
    assert answer_of("drawer: stiction", []) is None
    lesson = {"verdict": "unknown", "effects": [], "parameters_off": [], "after_manipulations": 2}
    assert told(lesson)["after"] == 2


def test_what_no_look_or_effort_has_in_it_is_not_asked_for(tmp_path):
    play = [
        _row("drawer: rail play", arm, (0.05, -0.05, 0.05, 0.01, -0.02)) for arm in ("as it is", "learnt")
    ]
    write_page([*ROWS, *play], tmp_path / "page.md", "the command")
    text = (tmp_path / "page.md").read_text()
    assert "| named as sealed in 90 % |  | 1 of 1 answers, 100 % | 2 |" in text
    assert "| named as sealed in 90 %, no wrong name beside |  | 1 of 1 answers, 100 % | 2 |" in text
    assert "- **drawer: rail play**: the joint's effort has nothing of it" in text
    assert "Named 0 times of 1; said: physics missing: stribeck" in text


def test_a_rail_that_is_let_go_is_back_in_its_middle(arm):
    """Pushed 80 mm beside its middle it turns by half a degree: no look at rest has that in it."""
    world = draw_case("drawer: rail play", 0).world
    assert world.object.play_rad > np.radians(0.6)
    model = build_world(arm, world)
    data, v = mujoco.MjData(model), [model.joint(name).dofadr[0] for name in arm.joint_names]
    data.joint("object_joint").qpos[0] = world.object.q_start
    turned = []
    for k in range(1200):
        data.qfrc_applied[v] = data.qfrc_bias[v]  # the arm stays aside
        data.body("object_part").xfrc_applied[:] = [8.0, 0, 0, 0, 0, 0.8] if k < 200 else 0.0
        mujoco.mj_step(model, data)
        turned.append(float(data.joint("object_play_yaw").qpos[0]))
    assert np.abs(turned).max() > np.radians(0.4)
    assert abs(turned[-1]) < np.radians(0.02)
    assert abs(data.joint("object_play_y").qpos[0]) < 2e-5


def _row(label, arm, shares, number=0):
    moves = [{"target": k, "delta": 0.1 * s, "delta_r": s} for k, s in enumerate(shares)]
    answers = [_answer("physics_missing", "stribeck")] if arm == "learnt" else []
    return {
        "case": label, "number": number, "arm": arm, "change": 0.1, "exit": 7, "reason": "a | b", "moves": moves,
        "answers": answers, "lost_motion": {"part_front, growing": 0.002} if answers else {},
    }  # fmt: skip


ROWS = [
    _row("drawer: stiction", "as it is", (0.05, -0.05, 0.05, 0.04, -0.06)),
    _row("drawer: stiction", "learnt", (0.05, -0.05, 0.05, 0.01, -0.02)),
    {
        "case": "laptop: nothing",
        "number": 0,
        "arm": "learnt",
        "change": 0.5,
        "exit": 4,
        "reason": "no | plan",
    },
]


def test_only_later_targets_count_and_they_are_paired():
    assert relative(ROWS[1], later=False).tolist() == [0.05, 0.05, 0.05]
    assert relative(ROWS[1], later=True).tolist() == [0.01, 0.02]
    assert paired(ROWS[1], ROWS[0]) == pytest.approx([-0.03, -0.04])


def test_summaries_hold_runs_that_came_to_nothing(tmp_path):
    stiction, laptop = summaries(ROWS)
    assert stiction.first == pytest.approx(0.05)
    assert stiction.plain == pytest.approx(0.05)
    assert stiction.learnt == pytest.approx(0.015)
    assert (stiction.right, stiction.wrong, stiction.open) == (1, 0, 0)
    assert (laptop.objects, laptop.learnt, laptop.right) == (1, None, 0)
    write_page(ROWS, tmp_path / "page.md", "the command")
    text = (tmp_path / "page.md").read_text()
    assert "| drawer: stiction | – | 1 | 5.0 % | 5.0 % | 1.5 % | 3.3 × | 3.3 × |" in text
    assert "no / plan" in text
    assert (tmp_path / "page.png").stat().st_size > 5000


def test_objects_without_a_control_count_for_names_and_not_for_errors(tmp_path):
    alone = _row("drawer: stiction", "learnt", (0.5, 0.5, 0.5, 0.9, 0.9), number=30)
    assert compared([*ROWS, alone]) == ROWS[:2]
    assert compared([alone]) == [alone]
    stiction = summaries([*ROWS, alone])[0]
    assert (stiction.objects, stiction.learnt, stiction.right) == (1, pytest.approx(0.015), 2)
    write_page([*ROWS, alone], tmp_path / "page.md", "the command")
    assert "| **all** |  | 1 | 5.0 % | 5.0 % | 1.5 % |" in (tmp_path / "page.md").read_text()


def test_a_run_that_ended_early_is_compared_by_the_targets_it_reached(tmp_path):
    """The hard ones are those it did not get to; the other run's must not count against it alone."""
    early = [
        _row("faucet: stiction", "as it is", (0.02,) * 3 + (0.01, 0.01, 0.2, 0.2, 0.2)),
        _row("faucet: stiction", "learnt", (0.02,) * 3 + (0.01, 0.01)),
        _row("faucet: detent", "as it is", (0.3,)),
        _row("faucet: detent", "learnt", (0.3,)),
    ]
    detent, stiction = summaries(early)
    assert (stiction.plain, stiction.learnt) == (pytest.approx(0.01), pytest.approx(0.01))
    assert (detent.objects, detent.plain, detent.learnt) == (0, None, None)
    write_page(early, tmp_path / "page.md", "the command")
    assert "| **all** |  | 1 | 2.0 % | 1.0 % | 1.0 % |" in (tmp_path / "page.md").read_text()


def test_what_the_gap_tool_adds_is_told_from_objects_run_all_three_ways(tmp_path):
    third = _row("drawer: stiction", "lost motion alone", (0.05, -0.05, 0.05, 0.02, -0.03))
    other = _row("drawer: stiction", "lost motion alone", (0.05, -0.05, 0.05, 0.9, 0.9), number=7)
    assert compared([*ROWS, third, other]) == ROWS[:2]
    write_page([*ROWS, third, other], tmp_path / "page.md", "the command")
    text = (tmp_path / "page.md").read_text()
    assert "| all | 1 | 5.0 % | 2.5 % | 1.5 % |" in text
    assert "| drawer: stiction | 7 | – | lost motion |" in text
    write_page(ROWS, tmp_path / "page.md", "the command")
    assert "lost motion alone" not in (tmp_path / "page.md").read_text()


SHIFTS = [
    {"case": "heavy drawer out", "effect": "stiction + 100 %", "shift_r": 0.004},
    {"case": "light drawer in", "effect": "stiction + 100 %", "shift_r": -0.012},
    {"case": "heavy drawer out", "effect": "profile 1 to 3", "shift_r": 0.009},
    {"case": "lever +", "effect": "profile 1 to 3", "shift_r": 0.5},
]


def test_a_case_is_likened_to_the_bench_as_before():
    assert likened("drawer: stiction", SHIFTS) is True
    assert likened("drawer: friction profile", SHIFTS) is False
    assert likened("drawer: nothing", SHIFTS) is None
    assert likened("faucet: stiction", SHIFTS) is None


def test_what_matters_is_told_object_by_object_by_its_own_shift_and_not_by_the_results(tmp_path):
    weak = [
        _row("drawer: stiction", arm, (0.5, 0.5, 0.5, 0.9, 0.9), number=1) for arm in ("as it is", "learnt")
    ]
    rows = [ROWS[0] | {"shift_r": 0.02}, ROWS[1], weak[0] | {"shift_r": 0.004}, weak[1]]
    assert own_shifts(rows) == {("drawer: stiction", 0): 0.02, ("drawer: stiction", 1): 0.004}
    write_page(rows, tmp_path / "page.md", "the command", shifts=SHIFTS)
    text = (tmp_path / "page.md").read_text()
    assert "| drawer: stiction | 1 of 2 (1.2 %) | 2 |" in text
    assert "| **what matters** |  | 1 | 5.0 % | 5.0 % | 1.5 % |" in text
    assert "| **what does not** |  | 1 | 50.0 % | 90.0 % | 90.0 % |" in text
    assert "| **what matters, as likened before** |  | 2 |" in text
    assert "| **what does not, as likened before** |" not in text
    assert "| of what matters, the median falls to half | 5.0 % | 1.5 % | 1 |" in text
    assert "| the same, as it was told before: likened to a row of the bench |" in text
    assert "| drawer: stiction | 1 | 0.4 % | yes |" in text
    assert "| named as sealed in 90 % |  | 2 of 2 answers, 100 % | 2 |" in text


def test_an_effect_is_played_in_a_model_and_leaves_it_as_it_was(tmp_path, monkeypatch):
    model = mujoco.MjModel.from_xml_string(SLED)
    data, robot = mujoco.MjData(model), np.array([True, False])
    targets = np.linspace(0.0, 0.2, 400)[:, None]

    def end(force):
        mujoco.mj_resetData(model, data)
        return played(
            model, data, "sled", robot, targets, lambda data, row: data.ctrl.__setitem__(0, row[0]), force
        )

    plain = end(no_effect)
    assert 0.19 < plain < 0.25  # pushed to the end, and let go
    assert end(force_of(JointEffects(profile=2.0))) < plain - 1e-4  # held earlier once it is let go
    assert end(lambda s, v, dry: (-3.0 * dry, dry)) < 0.1  # pulled back, past where the arm was
    monkeypatch.chdir(tmp_path)  # MuJoCo leaves its own log
    with pytest.raises(UnstableError, match="became unstable"):
        end(lambda s, v, dry: (1e13, dry))
    assert model.dof_frictionloss[model.joint("sled").dofadr[0]] == 1.0
    assert model.geom_contype.tolist() == [1, 1]


SLED = """
<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody>
  <body name="finger"><joint name="finger" type="slide" axis="1 0 0" damping="1"/><geom size="0.02" mass="1"/></body>
  <body name="sled" pos="0.05 0 0"><joint name="sled" type="slide" axis="1 0 0" frictionloss="1"/>
    <geom type="box" size="0.02 0.05 0.05" mass="0.5"/></body></worldbody>
  <actuator><position joint="finger" kp="5000" kv="200"/></actuator></mujoco>
"""


def pushing(arm, world, depth_m):
    """Arm joints (rows, 7), one row per millisecond, that push a drawer's front inwards."""
    model = build_world(arm, world)
    data, found = mujoco.MjData(model), []
    data.joint("object_joint").qpos[0] = world.object.q_start
    mujoco.mj_forward(model, data)
    part = data.body("object_part")
    out, front = part.xmat.reshape(3, 3)[:, 0].copy(), part.xpos.copy()
    z = -np.cos(0.35) * out - np.sin(0.35) * np.array([0.0, 0.0, 1.0])
    y = np.cross(z, np.cross(out, z))
    y /= np.linalg.norm(y)
    R = np.column_stack([np.cross(y, z), y, z])
    columns = [model.joint(name).dofadr[0] for name in arm.joint_names]
    q, J = np.array(arm.q_home), np.zeros((6, model.nv))
    begin = (
        front
        + (world.object.front_thickness_m + 0.03) * out
        + np.array([0.0, 0.0, 0.3 * world.object.height_m])
    )
    for k, way in enumerate(np.linspace(0.0, 0.03 + depth_m, 40)):
        for _ in range(300 if k == 0 else 30):
            data.qpos[:7] = q
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            tip = data.site("tool_tip")
            mujoco.mj_jacSite(model, data, J[:3], J[3:], tip.id)
            turn = R @ tip.xmat.reshape(3, 3).T
            skew = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
            error = np.concatenate([begin - way * out - tip.xpos, skew])
            A = J[:, columns]
            q = q + np.clip(A.T @ np.linalg.solve(A @ A.T + 1e-4 * np.eye(6), error), -0.1, 0.1)
        assert np.linalg.norm(error) < 2e-3
        found.append(q)
    x = np.linspace(0.0, 1.0, 1200)
    return np.array([np.interp(x, np.linspace(0.0, 1.0, 40), joint) for joint in np.array(found).T]).T


def test_an_objects_own_effect_is_played_with_and_without(arm, tmp_path):
    drawn = draw_case("drawer: closing spring below friction", 0)
    effects = JointEffects(
        pull=2.0 * drawn.world.object.coulomb_N
    )  # it closes the drawer once that is let go
    world = drawn.world.model_copy(update={"effects": effects})
    trial, s = Trial(drawn.kind, 0, world, -0.05), world.object.q_start
    write_run(tmp_path, trial, -0.05)
    run = json.loads((tmp_path / "run/run.json").read_text())
    (tmp_path / "run/run.json").write_text(
        json.dumps(run | {"joint": {"axis_direction": true_joint(world)[1].tolist()}})
    )
    header = ",".join(["t_s", "master_tick", "object", *CONTACT_COLUMNS])

    def left_at(s_to):
        (tmp_path / "truth.csv").write_text(f"{header}\n0.0,0,{s},0,0,0,0\n0.1,100,{s_to},0,0,0,0\n")

    left_at(s - 0.05)
    with pytest.raises(RunFileError, match="has 0 recordings of plan 7, not one"):
        shifts(trial, tmp_path, LEARNING)
    write_recording(tmp_path, arm, pushing(arm, world, 0.05))
    (share,) = shifts(trial, tmp_path, LEARNING)
    assert 0.3 < share < (s - 0.05) / 0.05  # on towards closed, of 50 mm asked for
    (weak,) = shifts(
        Trial(drawn.kind, 0, drawn.world, -0.05), tmp_path, LEARNING
    )  # a pull that friction holds
    assert 0.0 < weak < 0.5 * share  # it coasts on a little
    assert largest([0.01, -0.03]) == 0.03
    left_at(s - 0.01)  # stopped on the way: says nothing
    assert shifts(trial, tmp_path, LEARNING) == []
    assert largest([]) is None
    play = draw_case("drawer: rail play", 0)
    assert shifts(play, tmp_path, LEARNING) is None  # not along the joint
    assert largest(None) is None


def write_recording(folder, arm, q):
    """Set-points (n, 7) as the executor records a plan's, one per millisecond."""
    (folder / "recordings").mkdir()
    name, dq = "sensor_msgs/msg/JointState", np.gradient(q, 1e-3, axis=0)
    with (folder / "recordings/plan-1-7.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name, "ros2msg", b"")
        told, meant = (
            writer.register_channel(f"/a/joint_{what}", "cdr", schema) for what in ("states", "commands")
        )
        for k, row in enumerate(q):
            values = {"name": arm.joint_names, "position": row, "velocity": dq[k]}
            writer.add_message(meant, k, pack(name, values), k)
            writer.add_message(told, k, pack(name, values | {"position": 0.0 * row}), k)
        writer.finish()


def test_every_case_is_likened_to_an_effect_that_the_bench_has():
    bench = (Path(__file__).parents[2] / "bench/bench_left_out.py").read_text()
    for hidden in HIDDEN.values():
        assert hidden.like is None or f'"{hidden.like}": ' in bench, hidden.label


def test_targets_of_one_object_are_no_independent_ones():
    """Four objects that differ by far more than their targets do: the interval is that of four values."""
    values = [np.full(10, middle) + np.linspace(-0.001, 0.001, 10) for middle in (-0.05, -0.01, 0.01, 0.05)]
    interval = interval_over_objects(values)
    assert interval is not None
    low, high = interval
    assert low < -0.03
    assert high > 0.03
    assert interval_over_objects(values[:1]) is None
    assert interval_over_objects([*values[:1], np.zeros(0)]) is None


def test_the_page_is_written_from_results_alone_and_unknown_cases_are_refused(tmp_path):
    jobs = [[row["case"], row["number"], row["arm"]] for row in ROWS]
    lines = [json.dumps({"job": [*job, 10], "result": row}) for job, row in zip(jobs, ROWS, strict=True)]
    other = json.dumps(
        {"job": ["faucet: nothing", 0, "learnt", 2], "result": ROWS[2] | {"case": "faucet: nothing"}}
    )
    (tmp_path / "results.jsonl").write_text(
        "\n".join([*lines, other]) + "\n"
    )  # the last had two targets, not ten
    done = CliRunner().invoke(missing, ["--out", str(tmp_path), "--page-only", "--json"])
    assert done.exit_code == 0, done.output
    assert [one["case"] for one in json.loads(done.stdout)] == ["drawer: stiction", "laptop: nothing"]
    refused = CliRunner().invoke(missing, ["--out", str(tmp_path), "--cases", "door: magic"])
    assert "unknown case 'door: magic'" in str(refused.exception or refused.output)
    one = summaries(ROWS)[0]
    assert one.difference is not None
    assert one.difference_90 is None  # one object says nothing of the next
