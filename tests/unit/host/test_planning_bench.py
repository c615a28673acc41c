"""The planner's benchmark: sides, peers, numbers."""

import json
import sys
from dataclasses import replace
from types import ModuleType

import matplotlib.pyplot as plt
import mujoco
import numpy as np
import pytest
from click.testing import CliRunner

from s2r_host.cli_bench import planning
from s2r_host.planning import PlanSettings, Stage
from s2r_host.planning.bench import runner
from s2r_host.planning.bench.curve import draw_curve
from s2r_host.planning.bench.judo_peer import JudoSettings, judo_sampler
from s2r_host.planning.bench.mesh_twin import write_decomposed, write_in_pieces
from s2r_host.planning.bench.planners import all_planners, planner_named
from s2r_host.planning.bench.runner import Conditions, jobs, read, run
from s2r_host.planning.bench.summary import ratios, summary
from s2r_host.planning.bench.tasks import draw_task
from s2r_protocol.exits import NotReadyError, UsageError


def row(planner: str, placement: int, cpu_s: float, *, planned: bool = True) -> dict:
    return {
        "planner": planner, "task": "drawer_open", "placement": placement, "seed": 0, "planned": planned,
        "delivered": planned, "verified": planned, "cpu_s": cpu_s, "wall_s": 2.0 * cpu_s, "cpu_all_s": cpu_s,
        "steps": 10, "env_steps": 1000, "replays": [0.1, -0.29, 0.31] if planned else [],
    }  # fmt: skip


def test_cpu_per_success_counts_what_failures_took():
    (line,) = summary([row("a", 0, 1.0), row("a", 1, 3.0, planned=False)])
    assert line["cpu_per_success_s"] == pytest.approx(4.0)
    assert (line["planned"], line["plans"]) == (1, 2)
    assert line["planned_90"] == pytest.approx((0.121, 0.879), abs=1e-3)  # Wilson 1927
    assert (line["replays_good"], line["replays"]) == (2, 3)


def test_no_success_has_no_cost_per_success():
    (line,) = summary([row("a", 0, 1.0, planned=False)])
    assert line["cpu_per_success_s"] is None
    assert line["cpu_per_success_90"] is None


def test_a_ratio_uses_only_the_tasks_that_both_sides_did():
    rows = [row("a", k, 1.0) for k in range(8)] + [row("b", k, 3.0) for k in range(4)]
    (ratio,) = ratios(rows, "a")
    assert ratio["jobs"] == 4
    assert ratio["ratio"] == pytest.approx(3.0)
    assert ratio["low"] == pytest.approx(3.0)


def test_planners_of_which_one_holds_nothing_have_no_ratio(tmp_path, monkeypatch):
    """NaN would be no JSON."""
    rows = [row("a", k, 1.0) for k in range(3)] + [row("b", k, 1.0, planned=False) for k in range(3)]
    monkeypatch.setattr(runner, "run", lambda todo, results, conditions, tell: rows)
    words = ["--planners", "ours,paper", "--tasks", "drawer_far", "--out", str(tmp_path)]
    assert ratios(rows, "a") == [{"planner": "b", "jobs": 3, "ratio": None, "low": None, "high": None}]
    monkeypatch.setattr("s2r_host.planning.bench.summary.ratios", lambda rows, reference: ratios(rows, "a"))
    ended = CliRunner().invoke(planning, [*words, "--json"])
    assert json.loads(ended.stdout, parse_constant=pytest.fail)["ratios"][0]["ratio"] is None
    ended = CliRunner().invoke(planning, words)
    assert "CPU per held success, b over ours: one of the two holds none of 3 tasks" in ended.stdout


def test_a_name_with_a_number_is_one_stage_with_so_many_samples():
    planner = planner_named("ours@24")
    assert [stage.population for stage in planner.settings.cascade] == [24]
    assert len(planner_named("ours").settings.cascade) > 1


@pytest.mark.parametrize("name", ["nobody", "ours@many", "ours@"])
def test_an_unknown_planner_is_refused_with_those_there_are(name):
    with pytest.raises(UsageError, match="there are ours"):
        planner_named(name)


def test_peers_get_no_help_of_ours():
    peers = {n: p for n, p in all_planners().items() if n.split("_")[0] in ("judo", "paper")}
    assert len(peers) >= 4
    for name, peer in peers.items():
        assert peer.settings.proposal_speeds == (), name
        assert len(peer.settings.cascade) == 1, name
        assert peer.settings.lead_in == name.endswith("_led"), name
        assert peer.places_free != name.endswith("_led"), name


def test_without_judo_its_planner_says_what_to_install_before_anything_is_planned(monkeypatch):
    monkeypatch.setitem(sys.modules, "judo.optimizers.cem", None)
    with pytest.raises(NotReadyError, match=r"pip install --no-deps judo-rai==0\.0\.6"):
        planner_named("judo_led@30")
    with pytest.raises(NotReadyError, match=r"pip install --no-deps judo-rai==0\.0\.6"):
        judo_sampler(JudoSettings())(PlanSettings(), Stage(), 7, np.random.default_rng(0))


class FakeConfig:
    def __init__(self, **values) -> None:
        self.__dict__.update(values)


class FakeCem:
    """What the adapter calls of Judo's class."""

    def __init__(self, config, nu) -> None:
        self.config, self.shape = config, (config.num_rollouts, config.num_nodes, nu)

    def sample_control_knots(self, nominal):
        return nominal + np.linspace(-2.0, 2.0, self.shape[0])[:, None, None] * np.ones(self.shape[1:])

    def update_nominal_knots(self, knots, rewards):
        return knots[int(np.argmax(rewards))]


@pytest.fixture
def fake_judo(monkeypatch):
    module = ModuleType("judo.optimizers.cem")
    module.__dict__.update(CrossEntropyMethod=FakeCem, CrossEntropyMethodConfig=FakeConfig)
    monkeypatch.setitem(sys.modules, "judo", ModuleType("judo"))
    monkeypatch.setitem(sys.modules, "judo.optimizers", ModuleType("judo.optimizers"))
    monkeypatch.setitem(sys.modules, "judo.optimizers.cem", module)


def test_judo_s_knots_become_bounded_increments_and_its_nominal_is_executed(fake_judo):
    del fake_judo
    settings = PlanSettings()
    sampler = judo_sampler(JudoSettings(nodes=3))(settings, Stage(population=9), 7, np.random.default_rng(0))
    sampler.begin()
    samples = sampler.sample(np.zeros((2, 10, 7)))
    assert samples.shape == (9, settings.icem.horizon, 7)
    assert np.abs(samples).max() == pytest.approx(settings.action_max_rad)
    sampler.update(samples, np.arange(9.0))
    best, values = sampler.ranked()
    assert best.shape == (1, settings.icem.horizon, 7)
    assert values[0] == 8.0
    assert best[0] == pytest.approx(samples[8])
    sampler.forget()
    assert not sampler.ranked()[0].any()


def test_a_run_is_continued_and_its_numbers_stay(tmp_path):
    todo = list(jobs(["ours"], ["drawer_open"], 1, 1))
    conditions = Conditions(collection=0, threads=1, replays=2)
    told = []
    first = run(todo, tmp_path / "results.jsonl", conditions, told.append)
    again = run(todo, tmp_path / "results.jsonl", conditions, told.append)
    assert told == ["ours/drawer_open/0/0"]
    assert first[0]["verified"]
    assert len(first[0]["replays"]) == 2
    assert again[0]["cpu_s"] == first[0]["cpu_s"]
    assert len(read(tmp_path / "results.jsonl")) == 1


@pytest.mark.parametrize(
    "other", [{"collection": 1}, {"threads": 2}, {"replays": 3}, {"tool": "t_shape"}, {"doubt": "built"}]
)
def test_results_of_other_conditions_are_not_returned_for_these(tmp_path, other):
    results, given = tmp_path / "results.jsonl", Conditions(collection=0, threads=1)
    todo = list(jobs(["ours"], ["drawer_open"], 1, 1))
    run([], results, given, str)
    results.write_text(json.dumps({"key": todo[0].key}) + "\n")
    assert run(todo, results, given, str) == [{"key": todo[0].key}]
    (name,) = other
    with pytest.raises(
        UsageError, match=f"results with --{name} .*, not {other[name]!r}: give another --out"
    ):
        run(todo, results, replace(given, **other), str)


def test_results_of_which_nobody_knows_the_conditions_are_not_continued(tmp_path):
    results = tmp_path / "results.jsonl"
    todo = list(jobs(["ours"], ["drawer_open"], 1, 1))
    results.write_text(json.dumps({"key": todo[0].key}) + "\n")
    with pytest.raises(UsageError, match=r"no results\.conditions\.json .* give another --out"):
        run(todo, results, Conditions(collection=0, threads=1), str)


@pytest.mark.parametrize("words", ["--arm nope", "--tool nope", "--curve {}/nowhere/curve.png"])
def test_a_call_that_is_refused_leaves_nothing_in_its_folder(tmp_path, words):
    words = [
        *words.format(tmp_path).split(),
        "--planners",
        "ours",
        "--tasks",
        "drawer_open",
        "--placements",
        "1",
    ]
    ended = CliRunner().invoke(planning, [*words, "--out", str(tmp_path / "out")])
    assert isinstance(ended.exception, UsageError)
    assert not (tmp_path / "out").exists()


def test_a_plan_that_is_given_up_counts_with_what_it_took(tmp_path):
    todo = list(jobs(["ours"], ["drawer_open"], 1, 1))
    conditions = Conditions(collection=0, threads=1, plan_only=True, patience_s=1e-6)
    (given_up,) = run(todo, tmp_path / "results.jsonl", conditions, lambda _: None)
    assert not given_up["planned"]
    assert "no plan within the time limit" in given_up["reason"]
    assert given_up["cpu_s"] > 0.0


def test_the_curve_is_a_picture_with_a_point_per_population(tmp_path):
    rows = [row(f"a@{n}", k, 0.01 * n, planned=n > 20) for n in (10, 20, 40) for k in range(3)]
    draw_curve(rows, tmp_path / "curve.png")
    assert (tmp_path / "curve.png").read_bytes()[:4] == b"\x89PNG"


def test_settings_of_the_sides_differ_from_ours_only_where_they_say():
    ours = all_planners()["ours"].settings
    assert all_planners()["ensemble3"].settings == replace(ours, ensemble=3)


def test_a_mesh_twin_has_the_object_s_shape_in_convex_pieces(tmp_path):
    path = draw_task("drawer_open", 0, 0).write(tmp_path)
    twin = write_in_pieces(path, 4)
    boxes, meshes = (mujoco.MjModel.from_xml_path(str(p)) for p in (path, twin))
    assert meshes.ngeom == 4 * boxes.ngeom
    assert set(meshes.geom_type.tolist()) == {int(mujoco.mjtGeom.mjGEOM_MESH)}
    assert meshes.body_mass == pytest.approx(boxes.body_mass, rel=1e-4)
    data = [mujoco.MjData(model) for model in (boxes, meshes)]
    hits = []
    for model, state in zip((boxes, meshes), data, strict=True):
        mujoco.mj_forward(model, state)
        geom = np.zeros(1, dtype=np.int32)
        towards = np.array([1.0, 0.0, 0.0])
        hits.append(mujoco.mj_ray(model, state, np.array([0.0, 0.02, 0.12]), towards, None, 1, -1, geom))
    assert hits[0] > 0.0
    assert hits[1] == pytest.approx(hits[0], abs=1e-5)


def test_a_decomposed_twin_is_what_coacd_makes_of_each_body_with_the_object_s_own_inertia(tmp_path):
    path = draw_task("faucet_left", 0, 0).write(tmp_path)
    boxes, meshes = (mujoco.MjModel.from_xml_path(str(p)) for p in (path, write_decomposed(path)))
    assert set(meshes.geom_type.tolist()) == {int(mujoco.mjtGeom.mjGEOM_MESH)}
    part = mujoco.mj_name2id(meshes, mujoco.mjtObj.mjOBJ_BODY, "object_part")
    assert meshes.body_mass[part] == pytest.approx(boxes.body_mass[part])
    assert meshes.body_inertia[part] == pytest.approx(boxes.body_inertia[part])
    reach = np.concatenate([_corners_of(meshes, geom) for geom in np.flatnonzero(meshes.geom_bodyid == part)])
    (box,) = np.flatnonzero(boxes.geom_bodyid == part)
    assert np.ptp(reach, axis=0) == pytest.approx(2 * boxes.geom_size[box], abs=0.004)


def _corners_of(model, geom):
    """Vertices of a mesh in the frame of its body."""
    R, mesh = np.zeros(9), model.geom_dataid[geom]
    mujoco.mju_quat2Mat(R, model.geom_quat[geom])
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    return model.mesh_vert[first : first + count] @ R.reshape(3, 3).T + model.geom_pos[geom]


def test_boxes_are_cut_or_decomposed_and_not_both(tmp_path):
    ended = CliRunner().invoke(planning, ["--pieces", "2", "--coacd", "--out", str(tmp_path)])
    assert "exclude each other" in str(ended.exception)


def test_every_option_of_the_command_reaches_the_runs(tmp_path, monkeypatch):
    seen = {}
    monkeypatch.setattr(
        runner, "run", lambda todo, results, conditions, tell: seen.update(c=conditions) or []
    )
    words = (
        "--collection 7 --threads 1 --replays 3 --pieces 4 --arm ARM --tool t_shape --plan-only --patience 9"
    )
    ended = CliRunner().invoke(planning, [*words.split(), "--tasks", "drawer_far", "--out", str(tmp_path)])
    assert ended.exit_code == 0, ended.output
    assert seen["c"] == runner.Conditions(7, 1, 3, 3, True, 9.0, "ARM", "t_shape", 4)


def test_a_drawer_out_of_reach_is_planned_with_the_tool_alone(tmp_path):
    for tool, held in (("", False), ("t_shape", True)):
        conditions = runner.Conditions(0, 1, plan_only=True, tool=tool)
        rows = runner.run(
            [runner.Job("ours", "drawer_far", 0, 0)], tmp_path / f"{tool}.jsonl", conditions, str
        )
        assert rows[0]["planned"] is held


@pytest.mark.parametrize(("planner", "said"), [("ours", ""), ("ours@64", "numbers at the points")])
def test_the_curves_legend_speaks_of_numbers_only_where_some_stand(tmp_path, monkeypatch, planner, said):
    monkeypatch.setattr(plt, "close", lambda figure: None)
    draw_curve([row(planner, 0, 1.0)], tmp_path / "curve.png")
    legend = plt.gca().get_legend()
    monkeypatch.undo()
    plt.close()
    assert legend is not None
    assert legend.get_title().get_text().startswith(said)
    assert bool(legend.get_title().get_text()) == bool(said)
