"""A batch: refusals of bad lists, resuming, and the summary. The tool itself is replaced by a stub."""

import errno
import json
from dataclasses import replace
from pathlib import Path

import pytest

from s2r_host.gap import batch
from s2r_host.gap.batch import Job, read_jobs, run_batch, run_job, since_when
from s2r_host.gap.cli import _batch, batch_code, run_gap
from s2r_host.gap.config import read_config
from s2r_host.gap.errors import GapRecordingError, GapUsageError
from s2r_host.gap.output.answer import forget_answer, write_answer
from s2r_protocol.cli.conditions import keep_to
from s2r_protocol.cli.root import main
from s2r_protocol.exits import S2RError, UsageError


def _list(tmp_path, text):
    path = tmp_path / "jobs.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_jobs_are_read_with_paths_beside_the_file(tmp_path):
    jobs = read_jobs(_list(tmp_path, "- {name: a, model: m.xml, fit: r.csv, robot: r1, date: 2026-01-02}"))
    assert jobs == [Job("a", tmp_path / "m.xml", (tmp_path / "r.csv",), robot="r1", date="2026-01-02")]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{}", "write a list of jobs"),
        ("- {name: a, model: m.xml}", "needs name, model and fit"),
        ("- {name: a, model: m.xml, fit: r.csv, colour: red}", "allowed keys"),
        ("- {name: ../a, model: m.xml, fit: r.csv}", "cannot be the name of a folder"),
        ("- {name: summary.html, model: m.xml, fit: r.csv}", "cannot be the name of a folder"),
        ("- {name: a, model: m, fit: r}\n- {name: a, model: m, fit: r}", "two jobs are called 'a'"),
    ],
)
def test_a_bad_list_is_refused_with_the_reason(tmp_path, text, said):
    with pytest.raises(GapUsageError, match=said):
        read_jobs(_list(tmp_path, text))


def test_a_list_or_configuration_that_is_not_there_is_refused_with_the_next_step(tmp_path):
    with pytest.raises(
        GapUsageError, match=r"batch '.*no.yaml': No such file or directory; correct the path"
    ):
        read_jobs(tmp_path / "no.yaml")
    with pytest.raises(
        GapUsageError, match=r"config '.*no.yaml': No such file or directory; .* leave --config out"
    ):
        read_config(tmp_path / "no.yaml")
    with pytest.raises(GapUsageError, match="is no YAML"):
        read_config(_list(tmp_path, "skip: [cogging"))
    with pytest.raises(GapUsageError, match="is no YAML: month must be"):
        read_jobs(_list(tmp_path, "- {name: a, model: m.xml, fit: r.csv, date: 2026-28-11}"))


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("skip: backlash", ("backlash",)),
        ("skip: [backlash, payload]", ("backlash", "payload")),
        ("skip:", ()),
        ("", ()),
    ],
)
def test_effects_to_skip_are_a_name_or_a_list(tmp_path, text, names):
    assert read_config(_list(tmp_path, text)).skip == names


@pytest.mark.parametrize("seconds", ["-1", ".nan"])
def test_seconds_of_a_calibration_that_cannot_be_are_refused(tmp_path, seconds):
    with pytest.raises(GapUsageError, match=r"calibrate_s = .*; it is a number of seconds"):
        read_config(_list(tmp_path, f"calibrate_s: {seconds}"))


A = Job("a", Path("m"), ())


def _answer(folder, verdict, effects=(), to=A):
    """As a job that was run with seed 0 leaves it."""
    folder.mkdir(parents=True, exist_ok=True)
    keep_to(batch._question(to, 0), folder / "gap.json", begun=False)
    body = {"verdict": verdict, "effects": list(effects), "parameters_off": [], "wall_s": 1.0}
    (folder / "gap.json").write_text(json.dumps(body), encoding="utf-8")


COGGING = {"name": "cogging", "joint": "j1", "probability": 0.9}


def test_the_summary_tells_why_data_cannot_tell(tmp_path):
    folder = tmp_path / "a"
    _answer(folder, "insufficient")
    told = json.loads((folder / "gap.json").read_text()) | {"notes": ["cannot tell: joint 'j' rests", "more"]}
    (folder / "gap.json").write_text(json.dumps(told), encoding="utf-8")
    run_batch([Job("a", tmp_path / "m", ())], tmp_path, 1, 0)
    page = (tmp_path / "summary.html").read_text(encoding="utf-8")
    assert "insufficient<td>cannot tell: joint &#x27;j&#x27; rests" in page
    assert "<meta name=viewport" in page


def test_finished_jobs_are_not_run_again_and_the_summary_says_since_when(tmp_path, monkeypatch):
    jobs = [Job(n, tmp_path / "m", (), robot="r1", date=d) for n, d in (("a", "2026-02"), ("b", "2026-01"))]
    _answer(tmp_path / "out" / "a", "physics_missing", [COGGING], jobs[0])
    _answer(tmp_path / "out" / "b", "nothing_missing", to=jobs[1])
    monkeypatch.setattr(batch, "run_job", lambda *_: pytest.fail("a finished job was run again"))
    told = []
    rows = run_batch(jobs, tmp_path / "out", 1, 0, told.append)
    assert told == [2]
    assert [r["verdict"] for r in rows] == ["physics_missing", "nothing_missing"]
    since = {"robot": "r1", "place": "j1", "kind": "effect", "name": "cogging", "since": "2026-02", "runs": 1}
    assert since_when(rows) == [since]
    assert "2026-02" in (tmp_path / "out" / "summary.html").read_text(encoding="utf-8")


@pytest.fixture
def job(tmp_path):
    """A job whose files are there."""
    for name in ("m.xml", "r.csv", "r.yaml", "held.csv", "gap.yaml"):
        (tmp_path / name).write_text(name)
    return Job(
        "a", tmp_path / "m.xml", (tmp_path / "r.csv",), (tmp_path / "held.csv",), config=tmp_path / "gap.yaml"
    )


@pytest.fixture
def runs(tmp_path, monkeypatch):
    """The names of the jobs that were run; each finds nothing missing."""
    begun = []

    def tool(model, fit, holdout, repeat, config, out, seed, quiet):
        begun.append(out.name)
        (out / "gap.json").write_text(
            json.dumps({"verdict": "nothing_missing", "effects": [], "parameters_off": [], "wall_s": 1.0})
        )

    monkeypatch.setattr("s2r_host.gap.cli.run_gap", tool)
    monkeypatch.setattr(batch, "each_done", lambda work, jobs, workers, lost: [work(*job) for job in jobs])
    return begun


@pytest.mark.parametrize("changed", ["m.xml", "r.csv", "r.yaml", "held.csv", "gap.yaml"])
@pytest.mark.parametrize("how", ["other", "gone"])
def test_an_answer_to_other_files_is_not_taken_for_the_jobs(tmp_path, runs, job, changed, how):
    run_batch([job], tmp_path / "out", 1, 0)
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*.*")}
    (tmp_path / changed).unlink() if how == "gone" else (tmp_path / changed).write_text("other")
    told = {"m.xml": "model", "r.csv": "fit", "r.yaml": "fit", "held.csv": "holdout", "gap.yaml": "config"}[
        changed
    ]
    with pytest.raises(
        UsageError, match=rf"a/gap\.json holds results with {told} .*{changed}.*another --out"
    ):
        run_batch([job], tmp_path / "out", 1, 0)
    assert runs == ["a"]
    assert {path: path.read_bytes() for path in (tmp_path / "out").rglob("*.*")} == before


def test_an_answer_with_another_seed_or_of_unknown_files_is_not_taken(tmp_path, runs, job):
    run_batch([job], tmp_path / "out", 1, 0)
    with pytest.raises(UsageError, match="holds results with --seed 0, not 7"):
        run_batch([job], tmp_path / "out", 1, 7)
    (tmp_path / "out/a/gap.conditions.json").unlink()
    with pytest.raises(UsageError, match=r"no gap\.conditions\.json that says what they were made with"):
        run_batch([job], tmp_path / "out", 1, 0)


def test_the_same_files_elsewhere_have_their_answer_and_new_labels(tmp_path, runs, job):
    """As where a batch was moved, or its inputs were copied anew."""
    run_batch([job], tmp_path / "out", 1, 0)
    (tmp_path / "moved").mkdir()
    for name in ("m.xml", "r.csv", "r.yaml", "held.csv", "gap.yaml"):
        (tmp_path / name).rename(tmp_path / "moved" / name)
    moved = {
        role: tuple(tmp_path / "moved" / p.name for p in getattr(job, role)) for role in ("fit", "holdout")
    }
    there = replace(
        job,
        model=tmp_path / "moved/m.xml",
        config=tmp_path / "moved/gap.yaml",
        robot="r2",
        date="2026-02",
        **moved,
    )
    (row,) = run_batch([there], tmp_path / "out", 1, 0)
    assert runs == ["a"]
    assert (row["robot"], row["date"], row["verdict"]) == ("r2", "2026-02", "nothing_missing")


def test_a_job_that_was_refused_may_be_mended(tmp_path, runs, job):
    folder = tmp_path / "out/a"
    folder.mkdir(parents=True)
    keep_to(batch._question(job, 0), folder / "gap.json", begun=False)
    batch._leave(folder / "refused.json", "no such column", 4)
    (tmp_path / "r.csv").write_text("mended")
    for _ in range(2):
        (row,) = run_batch([job], tmp_path / "out", 1, 0)
        assert row["verdict"] == "nothing_missing"
    assert runs == ["a"]


def test_numbers_that_are_off_are_told_with_since_when():
    load = {"name": "payload_mass", "place": "hand"}
    rows = [
        {
            "name": n,
            "robot": "r1",
            "date": d,
            "verdict": "parameter_off",
            "effects": [],
            "parameters_off": off,
        }
        for n, d, off in (("a", "2026-03", [load]), ("b", "2026-01", []), ("c", "2026-02", [load, load]))
    ]
    (entry,) = since_when(rows)
    since = {"place": "hand", "kind": "number", "name": "payload_mass", "since": "2026-02", "runs": 2}
    assert entry == {"robot": "r1"} | since
    assert "<td>hand<td>payload_mass (a number that is off)<td>2026-02<td>2" in batch._page(rows)


def test_a_batch_on_ray_hands_out_what_any_worker_can_find(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    handed = []

    def cluster(work, calls, workers, address, lost):
        handed.append((work, workers, address, lost))
        for call in calls:
            handed.append(call)
            yield call, lost(*call)

    monkeypatch.setattr(batch, "on_ray", cluster)
    told = []
    jobs = [Job("a", Path("m.xml"), (Path("r.csv"),), repeat=(Path("again.csv"),), config=Path("gap.yaml"))]
    (row,) = run_batch(jobs, Path("out"), 2, 0, told.append, ray="local")
    (_, workers, address, _), (job, folder, _) = handed
    assert (workers, address) == (2, "local")
    assert folder == tmp_path / "out/a"
    files = [job.model, *job.fit, *job.repeat, job.config]
    assert files == [tmp_path / n for n in ("m.xml", "r.csv", "again.csv", "gap.yaml")]
    assert row["verdict"] == "failed"
    assert told == [0, 1]


def test_ray_goes_with_a_batch(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["gap", "--model", "m.xml", "--fit", "r.csv", "--ray", "local", "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert "--ray goes with --batch" in capsys.readouterr().err


def test_the_summary_names_parameters_beside_effects_and_links_any_folder():
    row = {
        "name": "50% #2", "robot": "r1", "date": "", "verdict": "physics_missing", "effects": [COGGING],
        "parameters_off": [{"name": "armature", "place": "j1"}], "report": True,
    }  # fmt: skip
    line = batch._line(row)
    assert "href='50%25%20%232/report.html'" in line
    assert "cogging on j1 (0.90), armature of j1" in line


def test_an_interrupted_batch_says_how_far_it_is_and_how_to_go_on(tmp_path, monkeypatch, capsys):
    path = _list(tmp_path, "- {name: a, model: m.xml, fit: r.csv}\n- {name: b, model: m.xml, fit: r.csv}")
    _answer(tmp_path / "out" / "a", "nothing_missing", to=read_jobs(path)[0])

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(batch, "each_done", interrupted)
    with pytest.raises(KeyboardInterrupt):
        _batch(path, tmp_path / "out", 1, False, 0)
    said = capsys.readouterr().err
    assert "runs: 1 of 2" in said
    assert "1 of 2 runs have an answer; the same command goes on from there" in said


@pytest.mark.parametrize(
    ("error", "file", "code"),
    [(GapRecordingError("fit.csv: no"), "refused.json", 4), (ZeroDivisionError("x"), "failed.json", 1)],
)
def test_a_refusal_and_a_bug_leave_their_reason(tmp_path, monkeypatch, error, file, code):
    def tool(*_, **__):
        raise error

    monkeypatch.setattr("s2r_host.gap.cli.run_gap", tool)
    run_job(Job("a", tmp_path / "m", ()), tmp_path / "a", 0)
    left = json.loads((tmp_path / "a" / file).read_text(encoding="utf-8"))
    assert left["exit_code"] == code
    assert str(error) in left["reason"]


@pytest.mark.parametrize("left", ["failed.json", "refused.json"])
def test_a_job_that_failed_or_was_refused_is_tried_again(tmp_path, monkeypatch, left):
    folder = tmp_path / "a"
    folder.mkdir()
    (folder / left).write_text("{}", encoding="utf-8")
    assert not batch.answered(folder)
    monkeypatch.setattr("s2r_host.gap.cli.run_gap", lambda *_, **__: None)
    run_job(Job("a", tmp_path / "m", ()), folder, 0)
    assert not (folder / left).exists()


def test_a_job_whose_process_is_killed_has_failed_and_the_others_go_on(tmp_path, monkeypatch):
    monkeypatch.setattr(batch, "each_done", lambda work, jobs, workers, lost: [lost(*job) for job in jobs])
    (row,) = run_batch([Job("a", tmp_path / "m", ())], tmp_path / "out", 1, 0)
    assert row["verdict"] == "failed"
    assert "its process was killed" in row["reason"]


def test_a_full_disk_leaves_the_pages_of_before_whole(tmp_path, monkeypatch):
    run_batch([], tmp_path, seed=0, workers=1, told=lambda done: None)
    batch._leave(tmp_path / "a/refused.json", "before", 4)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*")}
    write = Path.write_text

    def half(path, text, **options):
        write(path, text[: len(text) // 2], **options)
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr(Path, "write_text", half)
    for again in (
        lambda: run_batch([], tmp_path, seed=0, workers=1, told=lambda done: None),
        lambda: batch._leave(tmp_path / "a/refused.json", "another", 4),
    ):
        with pytest.raises(OSError, match="No space left"):
            again()
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.*")} == before


def test_an_answer_of_somebody_else_is_none(tmp_path):
    for content in ('{"width_m": 3}', '{"verdict": "unk', "[]"):
        (tmp_path / "gap.json").write_text(content, encoding="utf-8")
        assert not batch.answered(tmp_path)
        run_job(Job("a", tmp_path / "m", (tmp_path / "r.csv",)), tmp_path, 0)
        assert "not written by this command" in batch._row(Job("a", tmp_path, ()), tmp_path)["reason"]


def test_a_file_in_the_place_of_a_folder_is_refused_before_anything_runs(tmp_path):
    (tmp_path / "a").write_text("", encoding="utf-8")
    with pytest.raises(GapUsageError, match="holds a file 'a', and a job is called so"):
        run_batch([Job("a", tmp_path / "m", ())], tmp_path, 1, 0)


def test_a_name_that_yaml_takes_for_something_else_is_refused(tmp_path):
    path = tmp_path / "jobs.yaml"
    path.write_text("- {name: no, model: m.xml, fit: a.csv}\n", encoding="utf-8")
    with pytest.raises(GapUsageError, match="name of job 1 is read as False; write it in quotes"):
        batch.read_jobs(path)


def test_what_is_left_of_an_older_answer_goes(tmp_path):
    for name in ("patch.py", "next_experiment.csv", "gap.json", "notes.txt"):
        (tmp_path / name).write_text("", encoding="utf-8")
    forget_answer(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["gap.json.part", "notes.txt"]


def refusal(folder, fit):
    """What a run into a folder says before it reads anything."""
    with pytest.raises(UsageError) as ended:
        run_gap(folder / "m.xml", [fit], [], [], None, folder, seed=0, quiet=True)
    return str(ended.value)


def test_what_is_no_earlier_answer_is_not_replaced(tmp_path):
    (tmp_path / "report.html").write_text("mine", encoding="utf-8")
    assert "holds report.html, not written by this command" in refusal(tmp_path, tmp_path / "fit.csv")
    (tmp_path / "gap.json").write_text('{"width_m": 3}', encoding="utf-8")
    assert "holds gap.json, report.html, not written" in refusal(tmp_path, tmp_path / "fit.csv")
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(("own", "content"), [("gap.json", '{"verdict": "found"}'), ("gap.json.part", "")])
def test_an_earlier_answer_whole_or_broken_off_is_made_again(tmp_path, own, content):
    (tmp_path / "report.html").write_text("old", encoding="utf-8")
    (tmp_path / own).write_text(content, encoding="utf-8")
    with pytest.raises(S2RError) as ended:
        run_gap(tmp_path / "m.xml", [tmp_path / "fit.csv"], [], [], None, tmp_path, seed=0, quiet=True)
    assert "m.xml" in str(ended.value)  # past the folder: there is no such model


def test_an_answer_does_not_replace_what_it_is_made_from(tmp_path):
    (tmp_path / "gap.json").write_text('{"verdict": "found"}', encoding="utf-8")
    fit = tmp_path / "next_experiment.csv"
    fit.write_text("", encoding="utf-8")
    assert f"would replace {fit}, which it is made from" in refusal(tmp_path, fit)


def test_the_answer_is_written_whole_and_last(tmp_path):
    folder = tmp_path / "a"
    folder.mkdir()
    (folder / "report.html").write_text("", encoding="utf-8")
    (folder / "gap.json.part").write_text("{", encoding="utf-8")
    assert not batch.answered(folder)
    write_answer({"verdict": "unknown"}, folder)
    assert batch.answered(folder)
    assert not (folder / "gap.json.part").exists()
    assert json.loads((folder / "gap.json").read_text(encoding="utf-8")) == {"verdict": "unknown"}


@pytest.mark.parametrize(
    ("verdicts", "code"),
    [
        ({"nothing_missing", "insufficient"}, 0),
        ({"nothing_missing", "refused"}, 4),
        ({"refused", "physics_missing"}, 7),
        ({"parameter_off"}, 7),
        ({"failed", "physics_missing"}, 1),
    ],
)
def test_a_batch_ends_with_the_worst_of_its_runs(verdicts, code):
    assert batch_code(verdicts) == code


def test_a_full_disk_ends_a_batch_as_it_ends_a_run(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("s2r_host.gap.cli.run_gap", full)
    monkeypatch.setattr(batch, "each_done", lambda work, jobs, workers, lost: [work(*job) for job in jobs])
    with pytest.raises(OSError, match="No space left"):
        run_batch([Job("a", tmp_path / "m", ())], tmp_path / "out", 1, 0)
    assert not list((tmp_path / "out").rglob("failed.json"))
