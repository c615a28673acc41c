"""The accuracy campaign: random but repeatable trials inside the joints' limits, and figures that count failures."""

import itertools
import json
import math
import sys
import warnings
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from s2r_protocol.exits import UsageError
from s2r_sim import batch
from s2r_sim.errors import ResultsTakenError, WorkerLostError
from s2r_sim.paper import trial as trial_module
from s2r_sim.paper.ablations import ablations, uncorrected
from s2r_sim.paper.calls import calls_of, commit, noted
from s2r_sim.paper.cli import paper
from s2r_sim.paper.cli_ablations import ablations as ablation_command
from s2r_sim.paper.distribution import shares_below
from s2r_sim.paper.own_page import check_page
from s2r_sim.paper.page import write_page
from s2r_sim.paper.projection import projection
from s2r_sim.paper.score import failed_stage, score_trial
from s2r_sim.paper.summary import causes, interval, merit, wilson
from s2r_sim.paper.trial import amount_to_ask_for, run_trial
from s2r_sim.paper.trials import KINDS, draw_simple_trial, draw_trial
from s2r_sim.score import true_joint
from s2r_sim.sealed import host_seed
from s2r_sim.truth import CONTACT_COLUMNS

PUSH = {"drawer": (-0.045, 0.0), "laptop": (-math.radians(25), math.radians(25))}
PUSH["faucet"] = PUSH["laptop"]


@pytest.mark.parametrize("kind", KINDS)
def test_every_trial_stays_within_the_limits_wherever_the_push_leaves_the_part(kind):
    for number in range(60):
        trial = draw_trial(kind, number)
        for push in PUSH[kind]:
            s = trial.world.object.q_start + push
            assert 0.0 < s < trial.world.object.q_max
            assert 0.0 < s + trial.change < trial.world.object.q_max, (kind, number)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_what_is_asked_stays_within_the_limits_wherever_any_push_leaves_the_part(kind, sense):
    turned = 0
    for number in range(40):
        trial = draw_trial(kind, number)
        q_max = trial.world.object.q_max
        for s in np.linspace(0.02, 0.98, 9) * q_max:
            change = trial.asked(s, sense)
            assert 0.0 < s + sense * change < q_max, (kind, number, s)
            fits = 0.06 * q_max < s + sense * trial.change < 0.94 * q_max
            assert change == trial.change or not fits
            turned += change != trial.change
    assert 0 < turned < 40 * 9


@pytest.mark.parametrize("kind", KINDS)
def test_both_directions_are_asked_for_and_the_same_number_is_the_same_trial(kind):
    signs = {math.copysign(1.0, draw_trial(kind, number).change) for number in range(20)}
    assert signs == {1.0, -1.0}
    assert draw_trial(kind, 3, salt="a") == draw_trial(kind, 3, salt="a")
    assert draw_trial(kind, 3, salt="a").world != draw_trial(kind, 4, salt="a").world


def pushed(trial, s, along=1.0):
    """``run.json`` before the host asks: by it the pushes took the part to ``s``, on an axis ``along`` the true one."""
    axis = (along * true_joint(trial.world)[1]).tolist()
    origin = along * (s - trial.world.object.q_start)
    return {"joint": {"axis_direction": axis}, "s_origin": origin, "s_first": 0.0}


@pytest.mark.parametrize("along", [1.0, -1.0])
def test_the_amount_asked_for_goes_by_what_the_host_says_of_its_pushes(along):
    trial = draw_trial("faucet", 5350)
    q_max = trial.world.object.q_max
    for share in (0.05, 0.5, 0.95):
        change = amount_to_ask_for(trial, pushed(trial, share * q_max, along))
        assert change == pytest.approx(trial.asked(share * q_max, along))
    near_the_end = amount_to_ask_for(trial, pushed(trial, 0.95 * q_max, along))
    assert along * near_the_end < 0.0


def test_what_pushes_moved_before_the_one_that_told_the_joint_counts_as_well():
    """Two pushes of 20 degrees, seen without an error; the joint is told from the view between them."""
    told = 0
    for number, push in itertools.product(range(60), np.radians([20.0, -20.0])):
        trial = draw_trial("faucet", number)
        s = trial.world.object.q_start + 2 * push
        if not 0.0 < s < trial.world.object.q_max:
            continue
        run = pushed(trial, s) | {"s_origin": push, "s_first": -push}
        assert amount_to_ask_for(trial, run) == pytest.approx(trial.asked(s, 1.0))
        told += 1
    assert told > 50


def test_where_the_host_says_nothing_of_its_pushes_the_amount_is_as_drawn():
    trial = draw_trial("faucet", 5350)
    near_the_end = pushed(trial, 0.95 * trial.world.object.q_max)
    assert amount_to_ask_for(trial, near_the_end | {"s_first": None}) == trial.change


HOST = """
import json, pathlib, sys
run = pathlib.Path(sys.argv[1])
run.mkdir()
(run / "run.json").write_text(json.dumps({"joint": None}))
there = sorted(path.name for path in run.parent.rglob("*"))
(run / "run.json").write_text(json.dumps({"joint": None, "there": there, "told": float(input())}))
"""


def test_world_and_truth_are_out_of_the_trials_folder_until_its_processes_have_ended(tmp_path, monkeypatch):
    running = {}

    @contextmanager
    def cell(folder, world, pace, stand_in, executor):
        running.update(world=world[1], truth=stand_in[1], folder=folder)
        assert world[1].exists()
        stand_in[1].write_text("of the stand-in")
        yield SimpleNamespace(executor="e", camera="c")
        assert not (folder / "world.json").exists()

    def scored(trial, folder, change):
        assert (folder / "truth.csv").read_text() == "of the stand-in"
        assert (folder / "world.json").read_text() == trial.world.to_json()
        return {"exit": 0, "change": change, **json.loads((folder / "run/run.json").read_text())}

    def host(*arguments):
        running["told"] = [str(word) for word in arguments]
        return [sys.executable, "-c", HOST, str(arguments[arguments.index("--out") + 1])]

    monkeypatch.setattr(trial_module, "stand_in_cell", cell)
    monkeypatch.setattr(trial_module, "s2r_command", host)
    monkeypatch.setattr(trial_module, "score_trial", scored)
    row = run_trial(tmp_path, (), 0.0, "xmate3pro", "drawer", 5350, 1)
    assert row["told"] == draw_trial("drawer", 5350).change
    assert row["there"] == ["host.log", "run", "run.json"]
    assert not [word for word in running["told"] if "5350" in word]
    assert running["told"][running["told"].index("--seed") + 1] == str(host_seed(5350))
    for hidden in (running["world"], running["truth"]):
        assert running["folder"] not in hidden.parents
        assert not hidden.exists()


def test_trials_hide_effects_that_no_belief_has():
    for kind in KINDS:
        assert any(not draw_trial(kind, number).world.effects.none for number in range(3))


@pytest.mark.parametrize("kind", KINDS)
def test_what_gives_way_is_drawn_apart_and_leaves_the_rest_of_a_trial_as_it_is(kind):
    for number in range(4):
        simple, trial = draw_simple_trial(kind, number, "a"), draw_trial(kind, number, "a")
        assert _rigid(trial.world) == simple.world
        assert (trial.kind, trial.number, trial.change) == (simple.kind, simple.number, simple.change)
        assert draw_trial(kind, number, "a") == trial


def _rigid(world):
    gives = {name: None for name in ("bend", "slop") if hasattr(world.object, name)}
    arm = world.arm.model_copy(update={"gears": None})
    return world.model_copy(update={"object": world.object.model_copy(update=gives), "arm": arm})


@pytest.mark.parametrize(("kind", "name"), [("laptop", "bend"), ("drawer", "slop")])
def test_every_concealed_lid_bends_every_drawer_has_clearance_and_no_two_alike(kind, name):
    drawn = [getattr(draw_trial(kind, number).world.object, name) for number in range(4)]
    assert None not in drawn
    assert len(set(drawn)) == 4


def test_every_concealed_arm_has_gears_of_its_own_as_stiff_as_its_joints_are_strong():
    gears = [draw_trial("faucet", number).world.arm.gears for number in range(4)]
    assert len(set(gears)) == 4
    for one in gears:
        assert all(1e4 < k < 3.2e4 for k in one.stiffness_Nm_rad[:4])
        assert all(3e3 < k < 1e4 for k in one.stiffness_Nm_rad[4:])


def _row(kind, number, change, delta, stage=None):
    return {
        "kind": kind, "number": number, "change": change, "delta": delta, "delta_first": delta, "stage": stage,
        "reason": "why | so", "pushes": 1, "manipulations": 0 if delta is None else 1, "axis_error_rad": 0.01,
        "axis_offset_m": 0.002, "push_error": -0.001,
    }  # fmt: skip


def write_trial(folder, trial, s, run):
    """Files of a trial that has ended, its true joint values one row each, a tick apart; ``run`` adds to run.json."""
    trial.world.save(folder / "world.json")
    header = ",".join(["t_s", "master_tick", "object", "joint1", *CONTACT_COLUMNS])
    lines = [f"{0.01 * k:.2f},{k},{value:.9g},0,0,0,0,0" for k, value in enumerate(s)]
    (folder / "truth.csv").write_text("\n".join([header, *lines]) + "\n")
    (folder / "run").mkdir()
    usual = {
        "exit": {"code": 4, "reason": "no joint"}, "attempts": [], "stages": [], "views": [], "wall_s": 1.0,
        "delta": None, "joint_by_push": None, "joint": None, "push_seen_from": None, "world_commitment": None,
    }  # fmt: skip
    (folder / "run/run.json").write_text(json.dumps(usual | run))


@pytest.mark.parametrize(("published", "holds"), [("own", True), (None, True), ("another's", False)])
def test_a_seal_holds_where_the_host_was_told_the_hash_of_the_world_that_was_drawn(
    tmp_path, published, holds
):
    trial = draw_trial("laptop", 5350)
    told = trial.world.commitment if published == "own" else published
    write_trial(tmp_path, trial, [1.0, 1.1], {"world_commitment": told})
    assert score_trial(trial, tmp_path, 0.3)["commitment_holds"] is holds


def test_a_world_that_was_exchanged_breaks_its_seal_and_the_page_tells(tmp_path):
    write_trial(tmp_path, draw_trial("laptop", 5350, salt="another"), [1.0, 1.1], {})
    row = score_trial(draw_trial("laptop", 5350), tmp_path, 0.3)
    assert row["commitment_holds"] is False
    rows = [{**_row("laptop", n, 0.3, 0.01), "commitment_holds": n > 0} for n in range(3)]
    write_page(rows, tmp_path / "results.md", "s2r bench paper", attempts=3)
    assert "2 of 3 seals hold" in (tmp_path / "results.md").read_text()


ROWS = [
    _row("drawer", 0, 0.10, 0.005),
    _row("drawer", 1, -0.10, 0.02),
    _row("drawer", 2, 0.10, -0.045),
    _row("drawer", 3, 0.10, 0.2),
    _row("drawer", 4, 0.10, None, "plan"),
]


def test_a_trial_without_a_manipulation_is_a_miss_but_has_no_error():
    m = merit(ROWS, "drawer")
    assert (m.n, m.done, m.below) == (5, 4, (1, 2, 3))
    assert m.delta == pytest.approx((0.005 + 0.02 + 0.045 + 0.2) / 4)
    assert m.delta_r == pytest.approx((0.05 + 0.2 + 0.45 + 2.0) / 4)
    assert causes(ROWS, "drawer").failures == {"plan": 1}


def test_the_interval_of_a_share_holds_the_share():
    for k in range(11):
        low, high = wilson(k, 10)
        assert low <= k / 10 <= high
    assert wilson(0, 0) == (0.0, 1.0)


def test_the_projection_is_the_measured_means_times_the_numbers_and_absent_without_costs():
    assert projection(ROWS) == []
    costed = [{**row, "cpu_s": 64.0, "stored_bytes": 2e7, "moving_s": 30.0, "wall_s": 70.0} for row in ROWS]
    text = "\n".join(projection(costed))
    assert "1,778 core hours, that is 1.2 machines of 64 cores for a day, and 2.0 TB" in text
    assert "busy for 100 s at most" in text
    assert "864,000 trials a day: 2.8 h" in text


def test_ablations_compare_shared_trials_and_count_failures_as_misses():
    worse = [
        {**row, "delta_first": None if row["number"] == 1 else 3 * (row["delta"] or 0.1)} for row in ROWS[:3]
    ]
    text = "\n".join(ablations(ROWS, ["drawer", "faucet"], {"without torque": worse}))
    # First: 5, 20, 45 % against 15, 100 (no manipulation), 135 %.
    assert "| without torque | drawer | 3 | 1 → 0 | 2 → 1 | 23.3 → 83.3 % | 20.0 → 100.0 % | +60.0 %" in text
    assert "+80.0 %" in text
    assert "| without torque | drawer | 3 | 1 → 1 | 2 → 2 |" in text  # last: the same
    assert "faucet" not in text


def test_several_kinds_are_told_together_too_and_what_correcting_is_worth():
    rows = [{**row, "kind": kind} for kind in ("drawer", "laptop") for row in ROWS]
    first = [{**row, "delta_first": 0.09} for row in rows]
    pairs = uncorrected(first, KINDS, "plain")
    assert {one.label for one in pairs} == {"without correction (plain)"}
    assert [(one.kind, len(one.ours)) for one in pairs] == [("drawer", 5), ("laptop", 5), ("all", 10)]
    assert pairs[0].differences("delta") == pytest.approx([0.85, 0.7, 0.45, -1.1, -0.1])
    assert not pairs[0].differences("delta_first").any()


def test_the_interval_of_differences_holds_them_and_is_narrow_for_equal_ones():
    middle, low, high = interval(np.array([-1.0, 0.0, 1.0, 2.0]), "mean")
    assert low < middle == 0.5 < high
    assert interval(np.full(5, 0.2), "median") == pytest.approx((0.2, 0.2, 0.2))


def test_the_page_of_ablations_has_tables_picture_remarks_and_every_trial(tmp_path):
    for name, rows in (("base", ROWS), ("other", [{**row, "delta_first": 0.09} for row in ROWS])):
        (tmp_path / name).mkdir()
        lines = [json.dumps({"job": [row["kind"], row["number"], 5], "result": row}) for row in rows]
        (tmp_path / name / "results.jsonl").write_text("\n".join(lines))
    remarks = tmp_path / "remarks.md"
    remarks.write_text("## What it says\n")
    page, pair = tmp_path / "page" / "ablations.md", f"no eyes={tmp_path / 'base'},{tmp_path / 'other'}"
    result = CliRunner().invoke(
        ablation_command, ["--pair", pair, "--page", str(page), "--remarks", str(remarks)]
    )
    assert result.exit_code == 0, result.output
    text = page.read_text()
    assert "## What it says" in text
    assert "| no eyes | drawer | 5 |" in text
    assert "| without correction (base) | drawer | 5 |" in text
    assert "| no eyes | drawer | 4 | –, – | +90.0 %, – |" in text
    assert page.with_name("ablations.png").stat().st_size > 5000


@pytest.mark.parametrize("taken", ["page.md", "page.png"])
def test_a_page_replaces_none_but_an_earlier_one_of_its_command_and_its_picture(tmp_path, taken):
    write_campaign(tmp_path / "base", 3)
    options = ["--out", str(tmp_path / "base"), "--page-only", "--page", str(tmp_path / "page.md")]
    (tmp_path / taken).write_text("# Results\n\nmy own\n")
    refused = CliRunner().invoke(paper, options)
    assert isinstance(refused.exception, UsageError)
    assert f"{taken} exists and would be replaced, and no page of 's2r bench paper' is there" in str(
        refused.exception
    )
    assert (tmp_path / taken).read_text() == "# Results\n\nmy own\n"
    (tmp_path / taken).unlink()
    for _ in range(2):
        assert CliRunner().invoke(paper, options).exit_code == 0


@pytest.mark.parametrize(
    ("name", "command"),
    [("results", "paper"), ("ablations", "ablations"), ("physics-left-out", "missing")],
)
def test_the_pages_of_this_project_are_made_again_in_their_places(name, command):
    check_page(Path(__file__).parents[3] / "docs" / f"{name}.md", f"s2r bench {command}")


def test_a_place_for_a_page_that_cannot_be_is_told_before_the_work(tmp_path, monkeypatch):
    monkeypatch.setattr(batch, "run_jobs", lambda *_, **__: pytest.fail("hours of work"))
    (tmp_path / "file").write_text("")
    page = tmp_path / "file" / "page.md"
    refused = CliRunner().invoke(paper, ["--out", str(tmp_path / "new"), "--page", str(page)])
    assert isinstance(refused.exception, UsageError)
    assert "its folder cannot be made" in str(refused.exception)


@pytest.mark.parametrize(
    ("pair", "complaint"),
    [("x=/nowhere,/nowhere", "give LABEL=BASE,DIR"), ("x=/nowhere", "give LABEL=BASE,DIR")],
)
def test_campaigns_that_are_not_there_cannot_be_compared(tmp_path, pair, complaint):
    result = CliRunner().invoke(ablation_command, ["--pair", pair, "--page", str(tmp_path / "p.md")])
    assert complaint in str(result.exception)


def test_campaigns_to_compare_with_must_be_there(tmp_path):
    result = CliRunner().invoke(paper, ["--out", str(tmp_path), "--page-only", "--compare", "x=/nowhere"])
    assert "give LABEL=DIR with a results.jsonl" in str(result.exception)


def write_campaign(folder, *attempts):
    """The same trials, run with each of these numbers of manipulations at most."""
    folder.mkdir()
    jobs = [([row["kind"], row["number"], count], row) for count in attempts for row in ROWS]
    lines = [json.dumps({"job": job, "result": row}) for job, row in jobs]
    (folder / "results.jsonl").write_text("\n".join(lines) + "\n")


def test_a_campaign_that_shares_no_trial_is_refused_before_anything_is_run_or_written(tmp_path, monkeypatch):
    write_campaign(tmp_path / "base", 3)
    write_campaign(tmp_path / "other", 3)
    monkeypatch.setattr(batch, "run_jobs", lambda *_, **__: pytest.fail("hours of work"))
    compared = ["--compare", f"x={tmp_path / 'other'}", "--kinds", "drawer"]
    alone = CliRunner().invoke(paper, ["--out", str(tmp_path / "new"), "--first", "50", *compared])
    (tmp_path / "other" / "results.jsonl").write_text(
        json.dumps({"job": ["drawer", 77, 3], "result": _row("drawer", 77, 0.1, 0.0)}) + "\n"
    )
    page = CliRunner().invoke(paper, ["--out", str(tmp_path / "base"), "--page-only", *compared])
    for refused in (alone, page):
        assert isinstance(refused.exception, UsageError)
        assert "--compare 'x': that campaign shares no trial with this one" in str(refused.exception)
    assert not (tmp_path / "base" / "results.png").exists()


@pytest.mark.parametrize("there", ["base", "other", "compare"])
def test_a_campaign_of_several_numbers_of_manipulations_is_not_compared(tmp_path, there):
    for name in ("base", "other", "compare"):
        write_campaign(tmp_path / name, *((1, 3) if name == there else (3,)))
    pair = f"x={tmp_path / 'base'},{tmp_path / 'other'}"
    compared = CliRunner().invoke(ablation_command, ["--pair", pair, "--page", str(tmp_path / "p.md")])
    options = ["--out", str(tmp_path / "base"), "--page-only", "--compare", f"x={tmp_path / 'compare'}"]
    result = CliRunner().invoke(paper, options) if there == "compare" else compared
    assert isinstance(result.exception, UsageError)
    assert f"{there}/results.jsonl holds trials with 1 and 3 attempts" in str(result.exception)
    assert "move the lines of one number" in str(result.exception)
    assert (compared.exit_code == 0) == (there == "compare")


def test_a_campaign_of_one_manipulation_each_is_compared_with_one_of_three(tmp_path):
    write_campaign(tmp_path / "base", 3)
    write_campaign(tmp_path / "other", 1)
    pair = f"x={tmp_path / 'base'},{tmp_path / 'other'}"
    result = CliRunner().invoke(ablation_command, ["--pair", pair, "--page", str(tmp_path / "p.md")])
    assert result.exit_code == 0, result.output
    options = ["--out", str(tmp_path / "base"), "--page-only", "--compare", f"x={tmp_path / 'other'}"]
    assert CliRunner().invoke(paper, options).exit_code == 0


@pytest.mark.parametrize(("attempts", "counted"), [(1, 5), (3, 2)])
def test_a_page_from_results_alone_holds_trials_of_one_number_of_manipulations(tmp_path, attempts, counted):
    """A campaign of one manipulation each, and the same trials begun anew with up to three."""
    jobs = [(row, 1) for row in ROWS] + [(row, 3) for row in ROWS[:2]]
    lines = [json.dumps({"job": [row["kind"], row["number"], count], "result": row}) for row, count in jobs]
    (tmp_path / "results.jsonl").write_text("\n".join(lines) + "\n")
    options = ["--out", str(tmp_path), "--page-only", "--attempts", str(attempts), "--json"]
    result = CliRunner().invoke(paper, options)
    assert result.exit_code == 0, result.output
    assert [merit["n"] for merit in json.loads(result.stdout)["last"]] == [counted, 0, 0]


def test_a_page_from_results_alone_tells_no_other_options_than_they_were_made_with(tmp_path):
    (row,) = [row for row in ROWS if row["kind"] == "drawer"][:1]
    line = json.dumps({"job": [row["kind"], row["number"], 3], "result": row})
    (tmp_path / "results.jsonl").write_text(line + "\n")
    made_with = {"--run-options": "--reactive", "--pace": 1.0, "--arm": "xmate3pro"}
    (tmp_path / "results.conditions.json").write_text(json.dumps(made_with))
    options = ["--out", str(tmp_path), "--page-only"]
    refused = CliRunner().invoke(paper, options)
    assert isinstance(refused.exception, UsageError)
    assert "holds results with --run-options '--reactive', not ''" in str(refused.exception)
    assert not (tmp_path / "results.md").exists()
    told = CliRunner().invoke(paper, [*options, "--run-options", "--reactive", "--pace", "1"])
    assert told.exit_code == 0, told.output
    assert "--run-options '--reactive' --pace 1 --out DIR" in (tmp_path / "results.md").read_text()


def test_causes_are_told_of_the_last_manipulation_alone(tmp_path):
    write_campaign(tmp_path / "base", 3)
    told = CliRunner().invoke(paper, ["--out", str(tmp_path / "base"), "--page-only", "--json"])
    said = json.loads(told.stdout)
    assert said["last"][0]["failures"] == {"plan": 1}
    assert said["last"][0]["misses"] == {"not told": 3, "plan": 1}
    assert not {"failures", "misses"} & said["first"][0].keys()


def test_the_page_has_every_trial_the_failures_and_a_picture(tmp_path):
    write_page(ROWS, tmp_path / "results.md", "s2r bench paper --trials 5", attempts=3)
    text = (tmp_path / "results.md").read_text()
    assert "| drawer | 5 | 4 | 1 (20 %" in text
    assert "| drawer | plan | 1 |" in text
    assert "why / so" in text
    assert "paper (real arm)" in text
    assert (tmp_path / "results.png").stat().st_size > 5000


def test_the_distribution_counts_trials_without_a_manipulation_in_its_shares():
    errors, below = shares_below(ROWS, "delta")
    assert errors == pytest.approx([5.0, 20.0, 45.0, 200.0])
    assert below == pytest.approx([20.0, 40.0, 60.0, 80.0])
    assert [len(part) for part in shares_below(ROWS[4:], "delta")] == [0, 0]


def test_two_pages_in_one_folder_have_two_pictures(tmp_path):
    for name in ("first try", "second"):
        write_page(ROWS, tmp_path / f"{name}.md", "s2r bench paper", attempts=3)
    assert "](first%20try.png)" in (tmp_path / "first try.md").read_text()
    assert sorted(p.name for p in tmp_path.glob("*.png")) == ["first try.png", "second.png"]


def test_a_page_without_a_trial_warns_of_nothing(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_page([], tmp_path / "results.md", "s2r bench paper", 3, "", {})


def test_options_that_s2r_run_refuses_end_the_campaign_and_are_no_result(tmp_path):
    results = tmp_path / "results.jsonl"
    outcome = CliRunner().invoke(
        paper, ["--kinds", "drawer", "--trials", "1", "--run-options", "--swiftly", "--out", str(tmp_path)]
    )
    assert isinstance(outcome.exception, UsageError)
    assert "correct --run-options" in str(outcome.exception)
    assert "--swiftly" in str(outcome.exception)
    assert results.read_text() == ""


@pytest.mark.parametrize(
    ("stages", "code", "named"),
    [
        ([("plan 1", False), ("measure 1", False)], 0, None),
        ([("plan 1", False), ("plan 2", True)], 7, None),
        ([("first push 2: proposals", True)], 4, "first push not reachable"),
        ([("estimate joint", True), ("estimate joint 3", True)], 4, "estimate joint"),
        ([("look A", False)], 5, "between stages"),
    ],
)
def test_the_stage_that_ended_a_run_is_named(stages, code, named):
    run = {"stages": [{"name": name, "failed": failed} for name, failed in stages], "exit": {"code": code}}
    assert failed_stage(run) == named


def test_effects_survive_the_world_file():
    world = draw_trial("faucet", 1).world
    again = type(world).model_validate_json(world.to_json())
    assert again.effects == world.effects
    assert json.loads(world.to_json())["effects"]["detent_pitch"] == world.effects.detent_pitch


def test_friction_is_highest_at_rest_and_detents_pull_to_their_notch():
    effects = draw_trial("faucet", 2).world.effects
    assert effects.friction(1.0, 0.0, 0.0) > effects.friction(1.0, 0.0, 10 * effects.stiction_speed)
    quarter = 0.25 * effects.detent_pitch
    assert effects.detent_force(quarter) <= 0.0 <= effects.detent_force(-quarter)
    assert np.isclose(effects.detent_force(effects.detent_pitch), 0.0, atol=1e-9)


def joined(folder, kind, numbers, attempts=3, **conditions):
    """A folder of results with the conditions they were made with, as a campaign leaves it."""
    folder.mkdir()
    made_with = {"--run-options": "", "--pace": 0.0, "--arm": "xmate3pro"} | conditions
    (folder / "results.conditions.json").write_text(json.dumps(made_with))
    costs = {"wall_s": 1800.0, "cpu_s": 3600.0, "stored_bytes": 10, "moving_s": 1.0}
    results, rows = folder / "results.jsonl", [_row(kind, number, 0.3, 0.01) | costs for number in numbers]
    lines = [json.dumps({"job": [kind, row["number"], attempts], "result": row}) for row in rows]
    with noted(results, f"s2r bench paper --kinds {kind} --out DIR", jobs=2):
        results.write_text("\n".join(lines) + "\n")
    return folder


def page_of(*folders, options=()):
    words = ["--page-only", "--out", str(folders[0]), *options]
    words += [word for folder in folders[1:] for word in ("--also", str(folder))]
    result = CliRunner().invoke(paper, words)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return (folders[0] / "results.md").read_text()


def test_a_page_of_several_campaigns_names_the_command_and_the_commit_of_each_and_what_all_of_them_take(
    tmp_path,
):
    lids = joined(tmp_path / "lids", "laptop", range(876, 880))
    levers = joined(tmp_path / "levers", "faucet", range(2298, 2300))
    text = page_of(lids, levers)
    code = commit() or "not known"  # outside of git
    assert f"- `s2r bench paper --kinds laptop --out DIR`, commit {code}: 4 trials, 2 at a time" in text
    assert f"- `s2r bench paper --kinds faucet --out DIR`, commit {code}: 2 trials, 2 at a time" in text
    assert "6 manipulations." in text
    assert "| laptop | 879 |" in text
    assert "| faucet | 2299 |" in text
    assert "3.00 h of wall time and 6.00 h of processor time" in text
    assert "two at a time on 2 cores they take 3.00 h" in text
    assert (
        "`s2r bench paper --page-only --kinds drawer,laptop,faucet --attempts 3 --out DIR --also DIR`" in text
    )


def test_a_campaign_that_was_continued_is_one_line_and_what_nobody_noted_is_told(tmp_path):
    folder = joined(tmp_path / "lids", "laptop", range(2))
    (tmp_path / "lids/results.calls.jsonl").unlink()
    results = folder / "results.jsonl"
    for number in (2, 3):
        with noted(results, "s2r bench paper --kinds laptop --out DIR", jobs=2), results.open("a") as file:
            file.write(json.dumps({"job": ["laptop", number, 3], "result": _row("laptop", number, 0.3, 0.0)}))
            file.write("\n")
    text = page_of(folder)
    assert (
        f"`s2r bench paper --kinds laptop --out DIR`, commit {commit() or 'not known'}: 2 trials in 2 calls"
        in text
    )
    assert "- 2 trials (laptop 0 to 3): their command was not noted" in text


def adding(results, error):
    """A call that adds a trial and ends with an error."""
    with noted(results, "the command", jobs=2):
        results.write_text(json.dumps({"job": ["drawer", 7, 3], "result": ROWS[0]}) + "\n")
        raise error


@pytest.mark.parametrize(
    ("error", "calls"),
    [
        (KeyboardInterrupt(), 1),
        (WorkerLostError("out of memory"), 1),
        (UsageError("s2r run refused its options"), 1),
        (ResultsTakenError("another process added them"), 0),
    ],
)
def test_what_a_call_added_is_noted_however_it_ended(tmp_path, error, calls):
    results = tmp_path / "results.jsonl"
    with pytest.raises(type(error)):
        adding(results, error)
    lines = calls_of(results).read_text().splitlines() if calls_of(results).exists() else []
    assert [json.loads(line)["added"] for line in lines] == [[["drawer", 7, 3]]] * calls


def test_a_call_that_added_nothing_is_not_noted(tmp_path):
    results = tmp_path / "results.jsonl"
    with noted(results, "nothing to do", jobs=1):
        pass
    assert not calls_of(results).exists()


def test_campaigns_that_share_a_trial_or_were_run_otherwise_are_not_joined(tmp_path):
    one, same = (joined(tmp_path / name, "laptop", [1, 2]) for name in ("one", "same"))
    reactive = joined(tmp_path / "reactive", "faucet", [1], **{"--run-options": "--reactive"})
    with pytest.raises(UsageError, match=r"laptop 1 is in .*one as well and would count twice"):
        page_of(one, same)
    with pytest.raises(UsageError, match="holds results with --run-options '--reactive'"):
        page_of(one, reactive)
    result = CliRunner().invoke(paper, ["--out", str(one), "--also", str(same)])
    assert "give --page-only, too" in str(result.exception)
