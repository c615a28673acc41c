"""Commissioning, canopen and python-can's own tools on the stand-in's bus, in both packings."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
import threading
import time
import tomllib
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import can
import canopen
import pytest
from click.testing import CliRunner

from s2r_executor import commission as module
from s2r_executor.cli import executor
from s2r_executor.commission import ForeignMasterError, commission
from s2r_executor.commission_record import (
    Commissioning,
    CommissioningError,
    check_record,
    read_identities,
    write_record,
)
from s2r_executor.config import load_config
from s2r_executor.sdo_client import CanLine, SdoAbortError, SdoClient, SdoTimeoutError
from s2r_protocol.arms import load_arm
from s2r_protocol.can import classic, fd, sdo
from s2r_protocol.can.frames import CanFrame, connect_unix
from s2r_protocol.can.python_can import StandInBus
from s2r_protocol.can.timing import BitRate
from s2r_protocol.exits import UnreachableError
from s2r_protocol.machine import Level
from s2r_sim.bus.bus import Bus
from s2r_sim.bus.classic_nodes import ClassicNodes
from s2r_sim.bus.fd_nodes import FdNodes
from s2r_sim.bus.hub import Hub
from s2r_sim.bus.object_dictionary import SdoServers
from s2r_sim.bus.wire import Wire
from s2r_sim.plant import Plant
from s2r_sim.world import draw_world

PACKINGS = ["fd", "classic"]


@pytest.fixture(scope="module")
def arm():
    return load_arm("xmate3pro")


@pytest.fixture
def stand_in(arm, tmp_path):
    """``with stand_in(packing) as bus``: the stand-in's bus and drives in lock-step, without a master."""

    @contextmanager
    def start(packing="fd"):
        plant = Plant(arm, draw_world(7, salt="test"))
        nodes = {"fd": FdNodes, "classic": ClassicNodes}[packing](plant.drives)
        bus = Bus(Hub(f"unix:{tmp_path}/bus.sock"), Wire(nodes.tick_ns, BitRate()), nodes, plant)
        bus.address = f"unix:{tmp_path}/bus.sock"
        bus.servers = SdoServers(plant.drives, arm, nodes.tick_ns)
        bus.responders.append(bus.servers.answer)
        thread = threading.Thread(target=bus.run_lockstep, args=(0.0,), daemon=True)
        thread.start()
        try:
            yield bus
        finally:
            bus.stop()
            thread.join(30.0)
            bus.hub.close()

    return start


def config_for(bus, packing="fd", **more):
    return load_config(overrides={"bus": bus.address, "packing": packing, "clock": "lockstep", **more})


def problems(found):
    return {f.topic: f for f in found.findings if f.level == Level.PROBLEM}


# -- canopen as the master, python-can's tools as listeners -------------------------------------------


@pytest.mark.parametrize("packing", PACKINGS)
def test_canopen_reads_the_drives_dictionaries(stand_in, packing):
    with stand_in(packing) as bus, StandInBus(bus.address) as line:
        network = canopen.Network(line)
        network.connect()
        try:
            node = network.add_node(3, canopen.ObjectDictionary())
            node.sdo.RESPONSE_TIMEOUT = 60.0
            assert node.sdo.upload(0x1000, 0) == bytes.fromhex("92010200")
            assert node.sdo.upload(0x1008, 0) == b"s2r stand-in drive, joint 3"  # four segments
            assert int.from_bytes(node.sdo.upload(0x1018, 4), "little") == 1003
            with pytest.raises(canopen.SdoAbortedError, match="0x06020000"):
                node.sdo.upload(0x5FFF, 0)
            with pytest.raises(canopen.SdoAbortedError, match="0x06090011"):
                node.sdo.upload(0x1018, 9)
            with pytest.raises(canopen.SdoAbortedError, match="0x06010002"):
                node.sdo.download(0x605A, 0, b"\x02\x00")
        finally:
            network.disconnect()


def test_canopen_sees_the_classical_heartbeats_and_statuswords(stand_in):
    with stand_in("classic") as bus, StandInBus(bus.address) as line:
        network = canopen.Network(line)
        heard = {}
        for node in range(1, 8):
            network.subscribe(0x180 + node, lambda can_id, data, stamp: heard.setdefault(can_id, bytes(data)))
            network.subscribe(0x700 + node, lambda can_id, data, stamp: heard.setdefault(can_id, bytes(data)))
        network.connect()
        try:
            deadline = time.monotonic() + 300
            while len(heard) < 14 and time.monotonic() < deadline:
                network.sync.transmit(1)
                time.sleep(0.002)
        finally:
            network.disconnect()
    assert set(heard) == {0x180 + n for n in range(1, 8)} | {0x700 + n for n in range(1, 8)}
    assert all(len(heard[0x180 + n]) == classic.TPDO1.size for n in range(1, 8))


@pytest.fixture
def with_plugin(tmp_path):
    """Environment in which python-can finds the plug-in by its entry point, as after an install."""
    with (Path(__file__).parents[2] / "pyproject.toml").open("rb") as file:
        points = tomllib.load(file)["project"]["entry-points"]["can.interface"]
    info = tmp_path / "site" / "s2r_entry_points-0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: s2r-entry-points\nVersion: 0\n")
    lines = "".join(f"{name} = {target}\n" for name, target in points.items())
    (info / "entry_points.txt").write_text(f"[can.interface]\n{lines}")
    return {**os.environ, "PYTHONPATH": str(info.parent), "TERM": "xterm", "LINES": "40", "COLUMNS": "160"}


def cycle_until(bus, enough):
    """Send SETs that ask for nothing, like a master would, until ``enough()``."""
    with CanLine(bus.address) as line:
        deadline, tick = time.monotonic() + 60.0, 0
        while not enough() and time.monotonic() < deadline:
            tick += 1
            line.send(fd.set_frame(fd.pack_set(tick, 0, tick, [0.0] * 7)))
            line.listen(0.005)
    assert enough()


def test_can_logger_writes_what_the_bus_carries(stand_in, tmp_path, with_plugin):
    log = tmp_path / "bus.log"
    with stand_in() as bus:
        command = [sys.executable, "-m", "can.logger", "-i", "s2r", "-c", bus.address, "-f", str(log)]
        tool = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=with_plugin,
            # Whoever runs the tests in the background has Ctrl-C ignored, and children inherit that.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )
        try:
            cycle_until(bus, lambda: log.exists() and log.stat().st_size > 20_000)
        finally:
            tool.send_signal(signal.SIGINT)
            output = tool.communicate(timeout=600)[0]
    assert log.exists(), output
    messages = list(can.LogReader(log))
    assert {m.arbitration_id for m in messages if not m.is_error_frame} == {0x080, *range(0x181, 0x188)}
    sets = [m for m in messages if m.arbitration_id == fd.SET_ID and not m.is_error_frame]
    assert all(m.is_fd and m.bitrate_switch and len(m.data) == 64 for m in sets)
    assert fd.unpack_set(bytes(sets[0].data)).control == 0


def test_can_viewer_shows_the_frames(stand_in, with_plugin):
    """The viewer draws with curses: it gets a terminal of its own."""
    with stand_in() as bus:
        terminal, theirs = pty.openpty()
        command = [sys.executable, "-m", "can.viewer", "-i", "s2r", "-c", bus.address]
        viewer = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=with_plugin)
        os.close(theirs)
        os.set_blocking(terminal, False)
        shown = bytearray()

        def drawn() -> bool:
            with suppress(OSError):  # nothing new, or the viewer has gone: the deadline decides
                shown.extend(os.read(terminal, 1 << 16))
            return all(f"0x{can_id:03X}".encode() in shown for can_id in (0x080, *range(0x181, 0x188)))

        try:
            cycle_until(bus, drawn)
        finally:
            viewer.terminate()
            viewer.wait(60)
            os.close(terminal)


# -- the client ---------------------------------------------------------------------------------------


def test_the_client_reads_numbers_and_text_and_names_what_is_missing(stand_in):
    with stand_in() as bus, CanLine(bus.address) as line:
        client = SdoClient(line, timeout_s=30.0)
        assert client.number(1, 0x1000) == 0x20192
        assert client.number(1, 0x60C2, 2, signed=True) == -3
        assert client.upload(7, 0x1008) == b"s2r stand-in drive, joint 7"
        with pytest.raises(SdoAbortError, match=r"node 2: object 0x6099:0: there is no such object"):
            client.upload(2, 0x6099)
        with pytest.raises(SdoTimeoutError, match="node 9 did not answer"):
            SdoClient(line, timeout_s=0.05).upload(9, 0x1000)


def test_a_bus_that_is_not_there_is_unreachable(tmp_path):
    with pytest.raises(UnreachableError, match=r"cannot be opened: [^;]*; is 's2r sim-arm' running\?$"):
        CanLine(f"unix:{tmp_path}/nobody.sock")
    with pytest.raises(UnreachableError, match="can:nosuch0 cannot be opened"):
        CanLine("can:nosuch0")


# -- commissioning ------------------------------------------------------------------------------------


@pytest.mark.parametrize("packing", PACKINGS)
def test_drives_in_order_pass_and_stay_off(stand_in, arm, packing):
    with stand_in(packing) as bus:
        found = commission(config_for(bus, packing), arm)
        assert found.passed, found.findings
        assert sorted(found.identities) == list(range(1, 8))
        assert found.identities[4]["serial"] == 1004
        assert all(drive.state == 1 and not drive.brake_released for drive in bus.plant.drives)


WRONG = [
    ((0x1000, 0), bytes.fromhex("91010200"), "device", "device profile 401"),
    ((0x1001, 0), b"\x21", "errors", "error register 0x21"),
    ((0x6060, 0), b"\x01", "mode", "mode of operation 1, expected 8"),
    ((0x6502, 0), bytes(4), "mode", "does not offer cyclic synchronous position"),
    ((0x605A, 0), b"\x02\x00", "quick stop", "option 2, expected 6"),
    ((0x6007, 0), b"\x00\x00", "on silence", "option for lost communication 0"),
    ((0x2010, 0), b"\x0a", "watchdog", "bridges 10 missed set-points"),
    ((0x60C2, 1), b"\x04", "period", "interpolation period 4 ms, the executor sends every 1 ms"),
    ((0x1017, 0), b"\x00\x00", "heartbeat", "heartbeat every 0 ms"),
    ((0x607D, 1), (-(2**31)).to_bytes(4, "little", signed=True), "positions", "position limits [-8.5899"),
    ((0x6080, 0), (10**6).to_bytes(4, "little"), "speed", "maximum speed 200 rad/s"),
    ((0x6072, 0), (500).to_bytes(2, "little"), "torque", "maximum torque"),
    ((0x6085, 0), (1).to_bytes(4, "little"), "quick-stop ramp", "quick-stop deceleration 0.0002"),
    ((0x6065, 0), (2**31).to_bytes(4, "little"), "following error", "following error window 8.59 rad"),
]


@pytest.mark.parametrize(("entry", "value", "name", "said"), WRONG, ids=[f"{e[0]:#x}" for e, *_ in WRONG])
def test_each_wrong_setting_is_named_with_its_fix(stand_in, arm, entry, value, name, said):
    with stand_in() as bus:
        bus.servers.changes[5] = {entry: value}
        found = problems(commission(config_for(bus), arm))
    assert list(found) == [f"node 5 {name}"]
    assert said in found[f"node 5 {name}"].text
    assert found[f"node 5 {name}"].fix


def test_a_missing_an_extra_and_a_doubled_node_are_named(arm):
    found = {f.topic: f.text for f in module._present({1: 1, 2: 2, 3: 1, 4: 1, 5: 1, 6: 1, 9: 1}, arm)}
    assert found["node 7"] == "no answer: joint 'joint7' has no drive on this bus"
    assert "nodes 1 to 7 only" in found["node 9"]
    assert "the node id is used twice" in found["node 2"]


def test_a_drive_that_the_scan_missed_is_asked_again(stand_in, arm):
    with stand_in() as bus:
        busy = {3, 6}

        def answer(can_id, packet):
            if (node := can_id - sdo.REQUEST_ID) in busy:
                busy.remove(node)
                return []
            return bus.servers.answer(can_id, packet)

        bus.responders[:] = [answer]
        assert problems(commission(config_for(bus), arm)) == {}


def test_a_node_id_used_twice_is_seen_on_the_bus(stand_in, arm):
    with stand_in() as bus:
        bus.responders.append(bus.servers.answer)  # a second drive that answers to everything
        found = problems(commission(config_for(bus), arm))
    assert {f"node {n}" for n in range(1, 8)} <= set(found)


def test_the_other_packing_is_noticed(stand_in, arm):
    with stand_in("classic") as bus:
        found = problems(commission(config_for(bus, "fd"), arm))
    assert "node 1 period" in found
    assert any("packing" in f.fix for topic, f in found.items() if topic.endswith(("answer", "packing")))


def test_a_drive_that_is_on_is_a_problem(arm):
    config = load_config(overrides={"bus": "unix:none"})
    seen = {node: (module.DriveState.SWITCH_ON_DISABLED, float(arm.q_home[node - 1])) for node in range(1, 8)}
    assert module._judge_probe(seen, config, arm)[0].level == Level.OK
    seen[2] = (module.DriveState.OPERATION_ENABLED, 0.0)
    seen[3] = (module.DriveState.SWITCH_ON_DISABLED, 9.0)
    found = {f.topic: f.text for f in module._judge_probe(seen, config, arm)}
    assert found["node 2 answer"] == "the drive is in OPERATION_ENABLED"
    assert found["node 3 answer"].startswith("joint 'joint3' stands at 9.0000 rad, outside")


def test_a_statusword_that_no_state_has_is_a_problem_of_its_drive(stand_in, arm, monkeypatch):
    own = classic.unpack_tpdo1
    positions = iter(range(10**6))

    def between_two_states(payload):
        return replace(own(payload), statusword=0x0213) if next(positions) % 7 == 2 else own(payload)

    with stand_in("classic") as bus:
        monkeypatch.setattr(module.classic, "unpack_tpdo1", between_two_states)
        found = problems(commission(config_for(bus, "classic"), arm))
    assert [f.text for f in found.values()] == ["statusword 0x0213 matches no CiA 402 state"]


def test_another_master_ends_commissioning_before_anything_is_sent(stand_in, arm):
    with stand_in() as bus:
        ended = threading.Event()

        def command() -> None:
            with connect_unix(bus.address) as socket:
                tick = 0
                while not ended.wait(0.005):
                    tick += 1
                    socket.send(fd.set_frame(fd.pack_set(tick, 0, tick, [0.0] * 7)).pack())

        master = threading.Thread(target=command, daemon=True)
        master.start()
        try:
            time.sleep(0.05)
            with pytest.raises(ForeignMasterError, match=r"another master is active .*0x080"):
                commission(config_for(bus), arm)
        finally:
            ended.set()
            master.join()


def test_an_exchanged_drive_is_noticed(stand_in, arm):
    with stand_in() as bus:
        first = commission(config_for(bus), arm)
        bus.servers.changes[6] = {(0x1018, 4): (4711).to_bytes(4, "little")}
        again = problems(commission(config_for(bus), arm, first.identities))
    assert list(again) == ["node 6 identity"]
    assert "serial 0x1267" in again["node 6 identity"].text
    assert "it was" in again["node 6 identity"].text


def test_the_command_keeps_a_record_that_the_executor_asks_for(stand_in, arm, tmp_path):
    record = tmp_path / "kept" / "commissioned.json"
    with stand_in() as bus:
        arguments = ["--commission", "--json", "--bus", bus.address, "--set", f"commissioned={record}"]
        result = CliRunner().invoke(executor, arguments)
        assert result.exit_code == 0, result.output
        config = config_for(bus, commissioned=str(record))
    check_record(record, config, arm)
    with pytest.raises(CommissioningError, match="commissioned for packing fd, now it is classic"):
        check_record(record, load_config(overrides={"bus": config.bus, "packing": "classic"}), arm)
    slower = load_config(overrides={"bus": config.bus, "core.tick_ns.fd": 2_000_000})
    with pytest.raises(CommissioningError, match="commissioned for tick_ns 1000000, now it is 2000000"):
        check_record(record, slower, arm)
    other = SimpleNamespace(model_hash=arm.model_hash, limit_hash=bytes(32))
    with pytest.raises(CommissioningError, match="commissioned for limit_hash"):
        check_record(record, config, other)
    with pytest.raises(CommissioningError, match="was never commissioned: run 's2r executor --commission'"):
        check_record(tmp_path / "nothing.json", config, arm)
    values = json.loads(record.read_text())
    record.write_text(json.dumps({**values, "passed": False}))
    with pytest.raises(CommissioningError, match="found problems: mend them"):
        check_record(record, config, arm)
    for rubbish in ("rubbish", "[]", '{"identities": {"1": 5}}', '{"identities": {"one": {}}}'):
        record.write_text(rubbish)
        with pytest.raises(CommissioningError, match="is no commissioning record"):
            check_record(record, config, arm)


def test_an_exchanged_drive_stays_a_problem_until_the_record_is_removed(stand_in, tmp_path):
    record = tmp_path / "commissioned.json"
    with stand_in() as bus:
        arguments = ["--commission", "--bus", bus.address, "--set", f"commissioned={record}"]
        assert CliRunner().invoke(executor, arguments).exit_code == 0
        bus.servers.changes[6] = {(0x1018, 4): (4711).to_bytes(4, "little")}
        for _ in range(2):
            result = CliRunner().invoke(executor, arguments)
            assert result.exit_code == 4
            assert "node 6 identity" in result.output
        record.unlink()
        assert CliRunner().invoke(executor, arguments).exit_code == 0


def test_a_drive_that_does_not_answer_keeps_its_identity_in_the_record(arm, tmp_path):
    record, config = tmp_path / "commissioned.json", load_config(overrides={"bus": "can:can0"})
    known = {1: {"serial": 1001}, 2: {}, 6: {"serial": 1006}}
    write_record(record, config, arm, Commissioning((), {1: {"serial": 1}, 2: {"serial": 1002}}), known)
    assert read_identities(record) == {1: {"serial": 1001}, 2: {"serial": 1002}, 6: {"serial": 1006}}


def test_a_command_that_finds_problems_says_so_with_its_code(stand_in, tmp_path):
    with stand_in() as bus:
        bus.servers.changes[1] = {(0x605A, 0): b"\x02\x00"}
        result = CliRunner().invoke(executor, ["--commission", "--bus", bus.address])
    assert result.exit_code == 4
    assert "quick stop" in result.output


def test_sdo_frames_are_the_standards():
    """CiA 301 by example: reading 0x1018:1 (four bytes) and 0x1008 (text) of a node."""
    assert sdo.pack_head(sdo.UPLOAD, 0x1018, 1) == bytes.fromhex("4018100100000000")
    assert sdo.upload_response(0x1018, 1, b"\x01\x02\x03\x04") == bytes.fromhex("4318100101020304")
    assert sdo.upload_response(0x1017, 0, b"\x64\x00") == bytes.fromhex("4b17100064000000")
    assert sdo.upload_response(0x1008, 0, b"hello") == bytes.fromhex("4108100005000000")
    assert sdo.segment(sdo.TOGGLE, b"abc", True) == bytes.fromhex("1961626300000000")
    assert sdo.segment_part(bytes.fromhex("1961626300000000")) == (b"abc", True)


def test_record_is_written_whole(tmp_path, arm):
    found = Commissioning((), {1: {"serial": 5}})
    write_record(tmp_path / "a.json", load_config(overrides={"bus": "can:can0"}), arm, found)
    assert read_identities(tmp_path / "a.json") == {1: {"serial": 5}}
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_frames_of_others_do_not_confuse_the_client(stand_in):
    with stand_in() as bus, CanLine(bus.address) as line, CanLine(bus.address) as other:
        other.send(CanFrame(0x581, bytes(7)))  # too short to be an answer
        other.send(CanFrame(0x123, b"x"))
        assert SdoClient(line, timeout_s=30.0).number(1, 0x1000) == 0x20192
