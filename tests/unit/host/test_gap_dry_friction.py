"""Dry friction that a model lacks is named as that alone: no other effect is the same equation in disguise."""

from s2r_host.gap.config import GapConfig
from s2r_host.gap.pipeline import analyse
from s2r_host.gap.rig import Drive, Secret, write_case

QUICK = GapConfig(simulate=False, baselines=False, report=False, next_experiment=False)


def test_dry_friction_is_as_good_as_certain_and_no_ripple(tmp_path):
    case = write_case(tmp_path, Secret(extra={"coulomb_friction": 0.25}), Drive(duration_s=10.0))
    a = analyse(case["model"], [case["fit"]], [case["holdout"]], [case["repeat"]], QUICK, lambda _: None)
    assert a.decision is not None
    (found,) = a.decision.effects
    assert found.name == "coulomb_friction"
    assert found.could_also_be == []
    assert found.probability > 0.9
