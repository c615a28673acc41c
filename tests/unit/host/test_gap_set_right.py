"""What late stamps took of the gap is remembered when the joints behind a compliant gear are compared as well."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.gap import pipeline
from s2r_host.gap.config import GapConfig


def test_late_stamps_count_beside_a_compliant_gear(monkeypatch):
    session: Any = SimpleNamespace(lead=np.zeros(1), v_eps=np.zeros(1))
    late = SimpleNamespace(name="clock_skew", joint=0, shape={"lag": 0.01}, of_effort=False)
    geared = SimpleNamespace(joint=0, finding=SimpleNamespace(name="joint_elasticity"))

    def problem(size, law, contradictions):
        context = SimpleNamespace(control_lag={})
        return SimpleNamespace(
            raw=np.full(9, size),
            law=law,
            contradictions=contradictions,
            set_right=0.0,
            joints=[],
            ctx=context,
        )

    # As recorded, with the stamps set right, at the links.
    built = iter([problem(1.0, [late], []), problem(0.1, [], [geared]), problem(0.05, [], [])])
    monkeypatch.setattr(pipeline, "build_problem", lambda *_, **__: next(built))
    for name in ("aligned", "links_alone"):
        monkeypatch.setattr(pipeline, name, lambda _, sessions, __: sessions)
    for name in ("find_edges", "fill_residuals"):
        monkeypatch.setattr(pipeline, name, lambda *_: None)
    a: Any = SimpleNamespace(model=None, fit=[session], hold=[], repeats=[])
    assert pipeline._stated(a, GapConfig()).set_right == pytest.approx(0.99)
