"""Configuration: unknown keys and impossible values are refused by name."""

from __future__ import annotations

import pytest

from s2r_executor import core_process
from s2r_executor.config import ConfigError, load_config, parse_override
from s2r_executor.core_process import core_settings
from s2r_protocol.arms import load_arm


def test_defaults_are_strict_on_hardware_and_relaxed_on_the_stand_in():
    assert load_config(overrides={"bus": "can:can0"}).effective_host_timeout_s == 0.05
    assert load_config(overrides={"bus": "unix:/tmp/x"}).effective_host_timeout_s == 0.5
    lockstep = load_config(overrides={"bus": "unix:/tmp/x", "clock": "lockstep"})
    assert lockstep.effective_host_timeout_s == lockstep.effective_front_end_timeout_s == 5.0
    assert load_config(overrides={"bus": "can:can0"}).effective_front_end_timeout_s == 0.1
    assert load_config(overrides={"host_timeout_s": 0.2}).effective_host_timeout_s == 0.2


def test_a_core_that_a_signal_ends_has_the_time_that_the_longest_stop_takes():
    config = load_config(overrides={"admission.stop_duration_max_s": 10.0})
    assert core_settings(config, load_arm("xmate3pro"))["quit_timeout_s"] > config.longest_stop_s > 20.0


def test_the_core_gets_the_cpu_that_is_configured_or_the_first_isolated_one(monkeypatch):
    def cpu(overrides):
        return core_settings(load_config(overrides=overrides), load_arm("xmate3pro"))["cpu"]

    monkeypatch.setattr(core_process, "first_isolated", lambda: 3)
    assert (cpu({}), cpu({"core.cpu": 1}), cpu({"core.cpu": 0})) == (3, 1, 0)
    monkeypatch.setattr(core_process, "first_isolated", lambda: None)
    assert cpu({}) == -1


def test_packing_chooses_the_tick():
    assert load_config(overrides={"packing": "fd"}).tick_ns == 1_000_000
    assert load_config(overrides={"packing": "classic"}).tick_ns == 4_000_000


def test_the_period_of_one_packing_leaves_the_other_as_it_is():
    one = {"core.tick_ns.fd": 2_000_000}
    assert load_config(overrides=one).tick_ns == 2_000_000
    assert load_config(overrides={**one, "packing": "classic"}).tick_ns == 4_000_000
    assert load_config(overrides={"core": {"tick_ns": {"classic": 8_000_000}}}).tick_ns == 1_000_000
    with pytest.raises(
        ConfigError, match=r"core\.tick_ns\.fdd: there is no such key; did you mean core\.tick_ns\.fd"
    ):
        load_config(overrides={"core.tick_ns.fdd": 1})


@pytest.mark.parametrize("key", ["hots_timeout_s", "admission.torque_margn", "core.gate"])
def test_an_unknown_key_is_refused_by_name(key):
    with pytest.raises(ConfigError, match=key.replace(".", r"\.")):
        load_config(overrides={key: 1})


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("host_timeout_s", 0.01),
        ("host_timeout_s", float("nan")),
        ("admission.start_tolerance_rad", -1.0),
        ("admission.torque_margin", 1.0),
        ("core.gate_margin", 1.5),
        ("packing", "usb"),
    ],
)
def test_a_value_out_of_range_is_refused_by_key(key, value):
    with pytest.raises(ConfigError, match=key.replace(".", r"\.")):
        load_config(overrides={key: value})


@pytest.mark.parametrize(
    ("lower", "upper", "said"),
    [
        ([0.9, 0.0, 0.5], [0.3, 0.1, 1.0], r"in x, lower_m = 0\.9 is above upper_m = 0\.3"),
        ([0.3, 0.0, 1.0], [0.9, 0.1, 0.5], r"in z, lower_m = 1 is above upper_m = 0\.5"),
        ([0.3, float("nan"), 0.5], [0.9, 0.1, 1.0], r"keep_out\.0\.lower_m\.1 = nan: it should be a finite"),
        ([0.3, 0.0, 0.5], [0.9, 0.1, float("inf")], r"keep_out\.0\.upper_m\.2 = inf: it should be a finite"),
    ],
)
def test_a_keep_out_box_that_holds_nothing_is_refused(lower, upper, said):
    zone = {"name": "wall", "lower_m": lower, "upper_m": upper}
    with pytest.raises(
        ConfigError, match=rf"(?s)admission\.{'' if 'keep' in said else 'keep_out.0.*'}{said}"
    ):
        load_config(overrides={"admission.keep_out": [zone]})


def test_a_keep_out_wall_without_thickness_is_one():
    zone = {"name": "wall", "lower_m": [0.3, 0.0, 0.5], "upper_m": [0.9, 0.0, 1.0]}
    assert load_config(overrides={"admission.keep_out": [zone]}).admission.keep_out[0].name == "wall"


@pytest.mark.parametrize("height", [float("nan"), float("inf")])
def test_a_table_that_is_nowhere_is_refused(height):
    with pytest.raises(ConfigError, match=r"admission\.table_z_m"):
        load_config(overrides={"admission.table_z_m": height})


def test_file_and_overrides_combine_and_the_override_wins(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("cell: cell2\nadmission:\n  torque_margin: 0.3\n  table_z_m: null\n")
    config = load_config(path, dict([parse_override("admission.torque_margin=0.2")]))
    assert (config.cell, config.admission.torque_margin, config.admission.table_z_m) == ("cell2", 0.2, None)


@pytest.mark.parametrize("text", ["a: [", "- 1\n- 2\n"])
def test_an_unusable_file_is_refused(tmp_path, text):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"c\.yaml"):
        load_config(path)


@pytest.mark.parametrize("text", ["novalue", "=3", "a=[1"])
def test_an_override_without_key_or_value_is_refused(text):
    with pytest.raises(ConfigError, match="--set"):
        parse_override(text)


def test_an_override_below_a_plain_value_is_refused():
    with pytest.raises(ConfigError, match="'cell' is a value"):
        load_config(overrides={"cell": "a", "cell.x": 1})
