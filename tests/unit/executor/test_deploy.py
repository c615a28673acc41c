"""The systemd units and the example configuration are usable as they are shipped."""

import configparser
import shutil
import subprocess
from pathlib import Path

import pytest

from s2r_executor import one_master
from s2r_executor.config import load_config
from s2r_executor.core_process import core_settings
from s2r_protocol.arms import load_arm

DEPLOY = Path(__file__).parents[3] / "executor" / "deploy"


def unit(name):
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str
    parser.read(DEPLOY / name)
    return parser


def test_the_example_configuration_is_one():
    config = load_config(DEPLOY / "executor.yaml")
    assert (config.bus, config.clock, config.is_stand_in) == ("can:can0", "real", False)
    assert config.tls is not None


def test_the_executor_unit_grants_what_the_core_asks_for_and_no_more():
    service = unit("s2r-executor.service")["Service"]
    assert int(service["LimitRTPRIO"]) >= load_config(DEPLOY / "executor.yaml").core.realtime_priority
    assert service["LimitMEMLOCK"] == "infinity"
    assert service["CapabilityBoundingSet"] == "CAP_SYS_NICE CAP_IPC_LOCK"
    assert (service["Type"], service["KillSignal"]) == ("notify", "SIGINT")
    assert float(service["WatchdogSec"]) >= 1.0  # the front end reports every 0.1 s


def test_whatever_ends_the_service_ends_the_core_in_order():
    service = unit("s2r-executor.service")["Service"]
    # With "mixed" a crashed front end leaves nobody to signal, and systemd kills the core at once.
    assert service["KillMode"] == "control-group"
    assert (service["KillSignal"], service["WatchdogSignal"]) == ("SIGINT", "SIGINT")
    config = load_config(DEPLOY / "executor.yaml")
    core_takes_s = core_settings(config, load_arm(config.arm))["quit_timeout_s"]
    assert float(service["TimeoutAbortSec"]) > core_takes_s
    assert float(service["TimeoutStopSec"]) > core_takes_s


def test_the_service_and_whoever_starts_an_executor_by_hand_see_the_same_lock_of_the_bus():
    service = unit("s2r-executor.service")["Service"]
    assert service["ReadWritePaths"] == str(one_master._FOLDER)


def test_the_interface_comes_up_with_the_rates_the_core_assumes():
    start = unit("s2r-can@.service")["Service"]["ExecStart"]
    for said in ("bitrate 1000000", "dbitrate 5000000 fd on", "txqueuelen 128", "restart-ms 0"):
        assert said in start


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed here")
@pytest.mark.parametrize("name", ["s2r-executor.service", "s2r-can@.service"])
def test_systemd_understands_the_units(name, tmp_path):
    # Its programs are not installed here; everything else must be in order.
    text = (DEPLOY / name).read_text().replace("/opt/sim2real2/.venv/bin/s2r", "/bin/true")
    text = text.replace("/usr/sbin/ip", "/bin/true")
    path = tmp_path / name.replace("@.", "@can0.")
    path.write_text(text)
    (tmp_path / "s2r-can@can0.service").write_text(
        (DEPLOY / "s2r-can@.service").read_text().replace("/usr/sbin/ip", "/bin/true")
    )
    verified = subprocess.run(["systemd-analyze", "verify", "--man=no", path], capture_output=True, text=True)
    ours = [line for line in verified.stderr.splitlines() if "s2r" in line]
    assert not ours, verified.stderr
