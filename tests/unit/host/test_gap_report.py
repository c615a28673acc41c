"""The report says nothing twice."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from s2r_host.gap.output.answer import fit_json, make_answer, write_predictions
from s2r_host.gap.output.overlays import _motion, shown_block
from s2r_host.gap.output.report import _numbers, _parameters_off, _per_joint, _rejected, _verdict
from s2r_host.gap.pipeline import Analysis
from s2r_host.gap.regression.solution import Scored, Term
from s2r_host.gap.simulation.forward import Trace
from s2r_host.gap.verdict.decision import Decision
from s2r_host.gap.verdict.naming import Named, evidence_told


def test_what_is_named_is_not_among_the_rejected():
    row = {"name": "clock_skew", "joint": "joint1", "why": "no evidence", "holdout_gain": 0.0}
    named = Named(Term("clock_skew", 0), "clock_skew", "joint1", 0.9, [], "", {}, np.zeros(0))
    nothing = SimpleNamespace(raw_held=(0.0, 0.0))
    decision = Decision("physics_missing", nothing, [named], rejected=[row, {**row, "joint": "joint2"}])  # pyright: ignore[reportArgumentType]
    model = SimpleNamespace(joints=["joint1"], unit=lambda joint: "rad")
    analysis = Analysis(model, [], [], [], None, None, decision, [], None, None, None, "physics_missing")  # pyright: ignore[reportArgumentType]
    answer = make_answer(analysis, 0)
    assert [r["joint"] for r in answer["rejected"]] == ["joint2"]
    assert "clock_skew on joint2<" in _rejected(answer)


def test_the_evidence_says_which_misfit_its_share_is_of():
    """Not of the table of root mean square errors, which compares the model as given with all that is named."""
    detent, cogging = (
        Scored(Term(name, 0), 0.0, 30.0, share, np.zeros(0))
        for name, share in (("detent", 0.22), ("cogging", 0.1))
    )
    told = evidence_told(detent.term, [detent, cogging])
    assert told == (
        "removes 22% of the squared misfit in effort, on held-out motion, that shifted numbers and the other names "
        "leave; the next best, cogging, removes 10%"
    )
    assert evidence_told(detent.term, [detent]).endswith("the other names leave")


def test_a_cause_that_takes_nothing_of_the_held_out_misfit_is_told_by_its_evidence():
    instead = Scored(Term("detent", 0), 0.0, 30.0, 0.0, np.zeros(0))
    assert evidence_told(instead.term, [instead]).startswith("30 nats of evidence for this cause instead of")


def test_effects_that_were_not_tried_share_a_row_without_a_gain():
    """A gain of 0.0 % would say that they were tried and gained nothing."""
    why = "cannot act here with this model and these channels"
    rows = [
        ("joint_play", "a", why),
        ("joint_play", "b", why),
        ("contact_slip", "a", why),
        ("detent", "a", "no"),
    ]
    gains = dict.fromkeys(("joint_play", "contact_slip"), 0.0) | {"detent": -0.0002}
    answer = {
        "rejected": [{"name": n, "joint": j, "why": w, "holdout_gain": gains[n]} for n, j, w in rows],
    }
    table = _rejected(answer)
    assert "<tr><td>detent on a<td class=num>0.0%<td>no</tr>" in table
    assert f"<td>joint_play on a, b; contact_slip on a<td class=num>–<td>{why}</tr>" in table
    assert table.count("<tr>") == 3


def test_data_that_cannot_tell_are_told_with_the_reason_and_name_no_place_or_number():
    place = {"joint": "joint1", "share": 1.0, "regime": {"words": "throughout the motion"}}
    answer = {"verdict": "insufficient", "where": [place], "notes": ["no hold", "cannot tell: 'a<b' rests"]}
    assert "open'>The data cannot tell: &#x27;a&lt;b&#x27; rests.</div>" in _verdict(answer)
    number: Any = {"name": "frictionloss", "joint": "joint1", "from": 0.25, "to": 0.001, "unit": "N·m"}
    decision = Decision("insufficient", SimpleNamespace(raw_held=(0.0, 0.0)), [], parameters_off=[number])  # pyright: ignore[reportArgumentType]
    model = SimpleNamespace(joints=["joint1"], unit=lambda joint: "rad")
    analysis = Analysis(model, [], [], [], None, None, decision, [], None, None, None, "insufficient")  # pyright: ignore[reportArgumentType]
    assert make_answer(analysis, 0)["parameters_off"] == []


def test_the_verdict_tells_where_most_of_the_gap_is_not_what_was_named_first():
    shares = {"named first": 0.08, "a": 0.34, "b": 0.56, "c": 0.02}
    where = [{"joint": j, "share": s, "regime": {"words": f"words {j}"}} for j, s in shares.items()]
    told = _verdict({"verdict": "physics_missing", "where": where})
    assert "The gap lives on <b>b</b> (56%), words b; <b>a</b> (34%), words a.</div>" in told


def test_a_number_that_is_off_is_told_with_what_else_it_may_be():
    number = {"name": "gear", "joint": "a", "from": 1.0, "to": 1.25, "unit": "1", "interval90": [1.2, 1.3]}
    table = _parameters_off({"parameters_off": [number | {"could_also_be": ["payload"]}]})
    assert "gear of a<br><span class=muted>could also be: payload</span>" in table
    assert "<td class=num>1.25<td" in table


def test_rows_of_the_joints_are_told_from_the_row_of_the_whole():
    errors = {"open_loop_holdout_before": 0.2, "open_loop_holdout_after": None}
    table = _per_joint({"fit": {"per_joint": {"joint1": errors, "joint2": errors}}})
    assert "of each joint, held out" in table
    assert "<th>position, held out" not in table


def test_the_simulated_motion_is_shown_where_late_stamps_gave_its_recording_another_clock():
    """The rows belong to the aligned recording then, the simulation to the one as read."""
    t = np.arange(0.0, 2.0, 0.1)
    read, aligned = (SimpleNamespace(index=3, t=t, q=np.sin(t)[:, None]) for _ in range(2))
    trace = SimpleNamespace(session=read, start=0, closed=False, held=True, q=read.q + 0.1, u=read.q)
    model = SimpleNamespace(joints=["joint1"], unit=lambda joint: "rad")
    analysis = SimpleNamespace(model=model, before=SimpleNamespace(traces=[trace]), after=None, hold=[])
    block = SimpleNamespace(session=aligned, picks=np.arange(len(t)), held=np.ones(len(t), dtype=bool))
    motion, error = Figure().subplots(2, 1)
    _motion(analysis, 0, block, False, [motion, error])  # pyright: ignore[reportArgumentType]
    assert [line.get_label() for line in motion.lines] == ["before", "recorded"]
    assert np.allclose(error.lines[0].get_ydata(), 0.1)


@pytest.mark.parametrize(
    ("windows", "loops", "shown"),
    [
        ([1], [0, 1], (1, [True, False])),
        ([0, 1], [], (0, [False])),
        ([], [1], (1, [True])),
        ([], [], (0, [])),
    ],
)
def test_the_held_out_part_that_was_simulated_is_shown_rather_than_an_empty_frame(windows, loops, shown):
    """A stroke can be too short for an open-loop window."""
    sessions = [SimpleNamespace(index=k) for k in range(2)]
    blocks = [SimpleNamespace(session=s, joint=0, held=np.ones(3, dtype=bool)) for s in sessions]
    traces = [SimpleNamespace(session=sessions[k], closed=False, held=True) for k in windows]
    traces += [SimpleNamespace(session=sessions[k], closed=True, held=True) for k in loops]
    errors = SimpleNamespace(traces=traces)
    problem = SimpleNamespace(blocks=blocks)
    analysis: Any = SimpleNamespace(problem=problem, before=errors, after=None, hold=sessions)
    block, simulated = shown_block(analysis, 0)
    assert block is not None
    assert (block.session.index, simulated) == shown


def test_efforts_and_positions_have_units_of_their_own():
    errors = {f"{part}_{when}": 0.1 for part in ("train", "holdout") for when in ("before", "after")}
    floor = {"q_rmse": 1e-5, "tau_rmse": 0.02, "source": "repeat"}
    for unit, effort in (("rad", "N·m"), ("m", "N")):
        page = _numbers({"fit": {"unit": unit, **errors}, "baselines": {}, "floor": floor})
        assert f"position [{unit}], held out" in page
        assert f"effort [{effort}], held out" in page
        assert f"position 1e-05 {unit}, effort 0.02 {effort}." in page


def test_predictions_have_the_times_of_their_recording(tmp_path):
    import pyarrow.parquet as pq

    t, still = np.arange(0.0, 1.0, 0.01), np.zeros((100, 1))
    session: Any = SimpleNamespace(rec=SimpleNamespace(name="r", start_s=40.0), t=t, q_raw=still, u=still)
    trace = Trace(session, 10, True, False, still[10:60], still[10:60])
    errors: Any = SimpleNamespace(traces=[trace])
    answered: Any = SimpleNamespace(model=SimpleNamespace(joints=["a"]), hold=[session])
    write_predictions(errors, errors, answered, tmp_path / "predictions.parquet")
    assert pq.read_table(tmp_path / "predictions.parquet")["t"].to_pylist() == pytest.approx(40.0 + t[10:60])


def test_predictions_hold_the_held_out_end_alone(tmp_path):
    """Without a recording held out the closed loop runs along all of a fitted one, the open one at its end."""
    import pyarrow.parquet as pq

    t, x = np.arange(0.0, 1.0, 0.01), np.arange(100.0)[:, None]
    session: Any = SimpleNamespace(rec=SimpleNamespace(name="r", start_s=0.0), t=t, q_raw=x, u=x)
    traces = [
        Trace(session, 5, False, True, x[5:95], x[5:95]),
        Trace(session, 80, True, False, x[80:], x[80:]),
    ]
    errors: Any = SimpleNamespace(traces=traces)
    answered: Any = SimpleNamespace(model=SimpleNamespace(joints=["a"]), hold=[])
    write_predictions(errors, errors, answered, tmp_path / "predictions.parquet")
    table = pq.read_table(tmp_path / "predictions.parquet")
    assert table["q.a"].to_pylist() == [*range(70, 95), *range(80, 100)]
    assert table["q_before.a"].to_pylist() == table["tau_after.a"].to_pylist() == table["q.a"].to_pylist()


def test_the_zero_of_the_effort_that_predictions_were_made_with_is_told():
    """It is in no model: without it nobody could simulate what stands in predictions.parquet."""
    one = np.ones(1)
    errors = SimpleNamespace(train=one, held=one, open_train=one, open_held=one)
    model = SimpleNamespace(joints=["a"], unit=lambda _: "rad")
    twin = SimpleNamespace(offset=np.array([0.25]))
    a: Any = SimpleNamespace(model=model, before=errors, after=errors, problem=None, decision=None, twin=twin)
    assert fit_json(a)["per_joint"]["a"]["effort_offset"] == 0.25
