"""The report says nothing twice."""

from s2r_host.gap.report import _per_joint, _rejected


def test_what_is_named_is_not_among_the_rejected():
    row = {"name": "clock_skew", "joint": "joint1", "why": "no evidence", "holdout_gain": 0.0}
    answer = {
        "effects": [{"name": "clock_skew", "joint": "joint1"}],
        "rejected": [row, {**row, "joint": "joint2"}],
    }
    assert "clock_skew on joint2<" in _rejected(answer)


def test_rows_of_the_joints_are_told_from_the_row_of_the_whole():
    errors = {"open_loop_holdout_before": 0.2, "open_loop_holdout_after": None}
    table = _per_joint({"fit": {"per_joint": {"joint1": errors, "joint2": errors}}})
    assert "of each joint, held out" in table
    assert "<th>position, held out" not in table
