"""The stand-in's bus from outside: real sockets, real frames, lock-step and real clock."""

import socket
import struct
import time

import can
import pytest

from s2r_protocol.arms import load_arm
from s2r_protocol.can import classic, fd
from s2r_protocol.can.drive import Control, DriveCommand, DriveError, DriveState
from s2r_protocol.can.frames import CAN_ERR_CRTL, CanFrame, connect_unix
from s2r_protocol.can.python_can import StandInBus
from s2r_sim.bus.classic_nodes import ClassicNodes
from s2r_sim.bus.fd_nodes import FdNodes
from s2r_sim.bus.hub import Hub
from s2r_sim.bus.object_dictionary import SdoServers
from s2r_sim.drives_alone import DrivesAlone
from s2r_sim.errors import StandInError


def wait_until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


def swing(master, ticks, speed=0.3):
    """Move joint 1 at constant speed; returns the last answers."""
    q = list(master.q)
    for _ in range(ticks):
        q[0] += speed * 1e-3
        answers = master.cycle(2, q, [speed, 0, 0, 0, 0, 0, 0])
    master.q = q
    return answers


def test_every_set_is_answered_by_seven_stats_with_its_counters(stand_in, fd_master):
    with stand_in() as bus:
        master = fd_master(bus.address)
        for _ in range(5):
            answers = master.cycle(0)
            assert [s.node for s in answers] == [1, 2, 3, 4, 5, 6, 7]
            assert {(s.seq, s.tick) for s in answers} == {(master.tick, master.tick)}
        wait_until(lambda: bus.ticks == 5)
        assert bus.plant.t_ns == 5_000_000


def test_time_stands_still_without_set(stand_in, fd_master):
    with stand_in() as bus:
        master = fd_master(bus.address)
        master.cycle(0)
        master.socket.send(CanFrame(0x123, b"\x01").pack())
        time.sleep(0.1)
        assert bus.plant.t_ns == 1_000_000


def test_arm_follows_set_points_over_the_bus(stand_in, fd_master):
    with stand_in() as bus:
        master = fd_master(bus.address)
        start = master.enable()[0].q_meas
        answers = swing(master, 500)
        assert answers[0].q_meas - start == pytest.approx(0.15, abs=2e-3)
        assert not any(s.following_warning or s.error for s in answers)


def test_same_commands_give_the_same_truth_bytes(stand_in, fd_master, tmp_path):
    logs = []
    for run in ("a", "b"):
        truth = tmp_path / f"{run}.csv"
        with stand_in(truth=truth) as bus:
            master = fd_master(bus.address)
            master.enable()
            swing(master, 300)
            master.socket.close()
            wait_until(lambda: bus.plant.at_rest)
        logs.append(truth.read_bytes())
    assert logs[0] == logs[1]
    assert len(logs[0].splitlines()) > 30


def test_damaged_or_repeated_set_is_ignored(stand_in, fd_master):
    with stand_in() as bus:
        master = fd_master(bus.address)
        master.cycle(0)
        good = fd.set_frame(fd.pack_set(9, 2, 9, [0.0] * 7)).pack()
        bad = bytearray(good)
        bad[40] ^= 1
        short = CanFrame(0x080, bytes(48), is_fd=True, brs=True).pack()
        for packet in (bytes(bad), short):
            master.socket.send(packet)
        wait_until(lambda: bus.ticks == 3)
        assert bus.nodes.refused == 2
        assert bus.plant.drives[0].state == DriveState.SWITCH_ON_DISABLED
        for _ in range(2):
            master.socket.send(good)
        assert {s.seq for s in master.receive()} == {9}
        wait_until(lambda: bus.ticks == 5)
        assert bus.nodes.refused == 3


@pytest.mark.parametrize("state", list(DriveState))
def test_a_standing_enable_takes_no_drive_up(arm, state):
    drives = DrivesAlone(arm).drives
    nodes = FdNodes(drives)
    for seq in range(4):
        if seq == 1:
            drives[2].state = state
        nodes.receive(fd.SET_ID, fd.set_frame(fd.pack_set(seq, Control.ENABLE, seq, [0.0] * 7)).pack())
        drives[2].period(1e-3)
    assert drives[2].state == state


def test_three_lost_sets_are_bridged(stand_in, fd_master):
    with stand_in(injections=["drop:0x080@250-252"]) as bus:
        master = fd_master(bus.address)
        master.enable()
        while master.tick < 250:
            swing(master, 1)
        for _ in range(3):
            master.q[0] += 0.3e-3
            master.send(2, master.q, [0.3, 0, 0, 0, 0, 0, 0])  # nobody answers
        answers = swing(master, 20)
        assert {s.state for s in answers} == {DriveState.OPERATION_ENABLED}
        assert abs(answers[0].q_meas - master.q[0]) < 2e-3


def test_four_lost_sets_stop_the_drives(stand_in, fd_master):
    with stand_in(injections=["drop:0x080@250-253"]) as bus:
        master = fd_master(bus.address)
        master.enable()
        while master.tick < 250:
            swing(master, 1)
        for _ in range(4):
            master.send(2)
        answers = master.cycle(2)
        assert {s.state for s in answers} == {DriveState.QUICK_STOP_ACTIVE}
        assert {s.error for s in answers} == {DriveError.COMMUNICATION}


def test_one_joints_lost_answer_leaves_the_others(stand_in, fd_master):
    with stand_in(injections=["drop:0x183@2"]) as bus:
        master = fd_master(bus.address)
        master.cycle(0)
        master.cycle(0)
        master.send(0)
        assert [s.node for s in master.receive(6)] == [1, 2, 4, 5, 6, 7]


def test_full_transmit_queue_reaches_the_sender_as_an_error_frame(stand_in, fd_master):
    with stand_in(injections=["enobufs:0x123@0"]) as bus:
        node = connect_unix(bus.address)
        node.settimeout(5.0)
        node.send(CanFrame(0x123, b"").pack())
        frame = CanFrame.unpack(node.recv(128))
        assert frame.is_error
        assert frame.can_id == CAN_ERR_CRTL
        node.close()


def test_dead_master_brings_the_arm_to_rest_by_itself(stand_in, fd_master):
    with stand_in() as bus:
        master = fd_master(bus.address)
        master.enable()
        swing(master, 200, speed=0.8)
        master.socket.close()
        wait_until(lambda: bus.plant.at_rest)
        assert {d.error for d in bus.plant.drives} == {DriveError.COMMUNICATION}


def test_a_master_that_leaves_is_warned_of_only_while_a_brake_is_open(stand_in, fd_master, caplog):
    """The joints give way in the closed brakes for some ticks more: that is no rest, and no open brake either."""
    for braked in (True, False):
        caplog.clear()
        with stand_in() as bus:
            master = fd_master(bus.address)
            master.enable()
            if braked:
                while not all(drive.braked for drive in bus.plant.drives):
                    master.cycle(DriveCommand.DISABLE_VOLTAGE)
                assert not bus.plant.at_rest
            master.socket.close()
            wait_until(lambda bus=bus: bus.plant.at_rest)
        assert ("left before all brakes were on" not in caplog.text) is braked


def test_new_master_may_enable_again_after_the_old_one_died(stand_in, fd_master):
    with stand_in() as bus:
        for _ in range(2):
            master = fd_master(bus.address)
            assert {s.state for s in master.enable()} == {DriveState.OPERATION_ENABLED}
            master.socket.close()
            wait_until(lambda: bus.plant.at_rest)


def test_python_can_listener_sees_the_traffic(stand_in, fd_master):
    with stand_in() as bus, StandInBus(bus.address) as listener:
        wait_until(lambda: len(bus.hub.clients) == 1)
        master = fd_master(bus.address)
        master.cycle(0)
        seen = [listener.recv(5.0).arbitration_id for _ in range(8)]
        assert seen == [0x080, *range(0x181, 0x188)]
        listener.send(can.Message(arbitration_id=0x123, data=[1], is_extended_id=False))
        assert master.next_frame() == CanFrame(0x123, b"\x01")


def test_listener_that_never_reads_holds_up_nobody(stand_in, fd_master):
    with stand_in() as bus:
        deaf = connect_unix(bus.address)
        wait_until(lambda: len(bus.hub.clients) == 1)
        client = bus.hub.clients[0]
        master = fd_master(bus.address)
        for _ in range(300):
            master.cycle(0)
        assert client.lost > 0
        deaf.close()


def test_load_of_the_cyclic_traffic_is_the_computed_one(stand_in, fd_master):
    with stand_in() as bus:
        master = fd_master(bus.address)
        for _ in range(120):
            master.cycle(0)
        wait_until(lambda: bus.ticks == 120)
        assert bus.wire.load == pytest.approx(0.678, abs=1e-3)


def test_babbling_node_keeps_answers_off_the_bus(stand_in, fd_master):
    with stand_in() as bus:
        master = fd_master(bus.address)
        master.cycle(0)
        babbler = connect_unix(bus.address)
        for _ in range(40):
            babbler.send(CanFrame(0x001, bytes(8)).pack())
        wait_until(lambda: len(bus.wire._waiting) > 20)
        master.send(0)
        wait_until(lambda: bus.ticks == 2)
        assert bus.wire.load > 0.8
        assert 0x080 in {frame.can_id for frame in bus.wire._waiting}
        babbler.close()


def enabled(master):
    """Where the drives stand [rad], (7,), with the drives on."""
    q = [a.q_meas for a in master.cycle(DriveCommand.DISABLE_VOLTAGE, [0.0] * 7)]
    master.enable(q)
    return q


def test_classic_drives_walk_and_follow(stand_in, classic_master):
    with stand_in("classic") as bus:
        master = classic_master(bus.address)
        q = enabled(master)
        for _ in range(100):
            q[0] += 0.3 * 4e-3
            answers = master.cycle(DriveCommand.ENABLE_OPERATION, q, [0.3, 0, 0, 0, 0, 0, 0])
        assert answers[0].q_meas == pytest.approx(q[0], abs=4e-3)
        assert bus.plant.t_ns == master.count * 4_000_000
        assert set(master.health) == set(range(1, 8))
        assert {state for _, state in master.heartbeats} == {0x00, 0x05}


def test_classic_drive_without_targets_sends_an_emergency(stand_in, classic_master):
    with stand_in("classic", injections=["drop:0x203@40-60"]) as bus:
        master = classic_master(bus.address)
        q = enabled(master)
        for _ in range(50):
            answers = master.cycle(DriveCommand.ENABLE_OPERATION, q)
        assert master.emergencies == [(3, 0x8130)]
        assert answers[2].state == DriveState.QUICK_STOP_ACTIVE
        assert answers[0].state == DriveState.OPERATION_ENABLED
        assert bus.nodes.refused == 0


def network(master, command, node=0):
    master.socket.send(CanFrame(classic.NMT_ID, bytes([command, node])).pack())


def test_a_stopped_network_is_lost_communication_and_ends_in_the_drives_quick_stop(stand_in, classic_master):
    """On the ramp, not on the brakes: what their dictionaries say at 0x6007."""
    with stand_in("classic") as bus:
        master = classic_master(bus.address)
        q = enabled(master)
        for _ in range(100):
            q[0] += 0.3 * 4e-3
            master.cycle(DriveCommand.ENABLE_OPERATION, q, [0.3, 0, 0, 0, 0, 0, 0])
        network(master, classic.NMT_STOP)
        master.sync()
        wait_until(lambda: {d.state for d in bus.plant.drives} == {DriveState.QUICK_STOP_ACTIVE})
        assert bus.plant.drives[0].brake_released
        for _ in range(50):
            master.sync()
        wait_until(lambda: all(d.stopped for d in bus.plant.drives))
        network(master, classic.NMT_START)
        answers = master.cycle(DriveCommand.ENABLE_OPERATION, q)
        assert {a.state for a in answers} == {DriveState.QUICK_STOP_ACTIVE}
        answers = master.cycle(DriveCommand.DISABLE_VOLTAGE, q)
        assert {a.state for a in answers} == {DriveState.SWITCH_ON_DISABLED}
        assert master.emergencies == []


def test_a_node_that_is_pre_operational_misses_its_set_points(stand_in, classic_master):
    with stand_in("classic") as bus:
        master = classic_master(bus.address)
        enabled(master)
        network(master, classic.NMT_PRE_OPERATIONAL, 3)
        for _ in range(5):
            master.sync()
        wait_until(lambda: bus.plant.drives[2].error == DriveError.COMMUNICATION)
        assert bus.plant.drives[2].state == DriveState.QUICK_STOP_ACTIVE


def test_a_stopped_node_tells_its_newest_emergency_later_and_nothing_by_sdo():
    drives = DrivesAlone(load_arm("xmate3pro")).drives
    nodes = ClassicNodes(drives)
    servers = SdoServers(drives, load_arm("xmate3pro"), 4_000_000, nodes.is_stopped)
    read = CanFrame(0x603, bytes([0x40, 0x01, 0x10, 0, 0, 0, 0, 0])).pack()
    nodes.answers()
    nodes.receive(classic.NMT_ID, CanFrame(classic.NMT_ID, bytes([classic.NMT_STOP, 3])).pack())
    drives[2]._fail(DriveError.OVER_CURRENT, DriveState.FAULT_REACTION)
    drives[2]._fail(DriveError.TEMPERATURE, DriveState.FAULT_REACTION)
    assert nodes.answers() == []
    assert servers.answer(0x603, read) == []
    nodes.receive(classic.NMT_ID, CanFrame(classic.NMT_ID, bytes([classic.NMT_START, 3])).pack())
    (told,) = (CanFrame.unpack(packet) for packet in nodes.answers())
    assert (told.can_id, *classic.EMCY.unpack(told.data)[:2]) == (0x083, 0x4200, 0x09)
    (register,) = servers.answer(0x603, read)
    assert CanFrame.unpack(register).data[4] == 0x09


@pytest.mark.parametrize(("length", "code", "moves"), [(6, 0x8210, False), (12, 0x8220, True)])
def test_targets_of_another_length_are_an_emergency_until_they_are_right_again(length, code, moves):
    drives = DrivesAlone(load_arm("xmate3pro")).drives
    nodes = ClassicNodes(drives)
    nodes.answers()
    payload = classic.pack_rpdo1(classic.Command(0x06, 0.1, 0.0))

    def told(data):
        """Code and error register of emergencies; a header tells a length that classical CAN cannot have."""
        packet = struct.pack("<IB3x", 0x203, len(data)) + data.ljust(8, bytes(1))
        nodes.receive(0x203, packet)
        nodes._sync()
        frames = [CanFrame.unpack(packet) for packet in nodes.answers()]
        return [classic.EMCY.unpack(f.data)[:2] for f in frames if f.can_id == 0x083]

    assert told((payload + bytes(8))[:length]) == [(code, 0x11)]
    assert told((payload + bytes(8))[:length]) == []
    assert (drives[2]._command == DriveCommand.SHUTDOWN) == moves
    assert told(payload) == [(0x0000, 0x00)]
    assert told(payload) == []


def test_a_fault_that_is_reset_is_told_to_be_gone(stand_in, classic_master):
    with stand_in("classic") as bus:
        master = classic_master(bus.address)
        q = enabled(master)
        bus.plant.drives[2]._fail(DriveError.OVER_CURRENT, DriveState.FAULT_REACTION)
        for _ in range(50):
            answers = master.cycle(DriveCommand.DISABLE_VOLTAGE, q)
        assert answers[2].state == DriveState.FAULT
        assert master.emergencies == [(3, 0x2300)]
        for _ in range(2):
            master.cycle(DriveCommand.DISABLE_VOLTAGE, q, fault_reset=True)
        assert master.emergencies == [(3, 0x2300), (3, 0x0000)]


def test_a_node_that_is_reset_boots_and_forgets_its_error(stand_in, classic_master):
    with stand_in("classic", injections=["drop:0x203@40-60"]) as bus:
        master = classic_master(bus.address)
        q = enabled(master)
        for _ in range(50):
            master.cycle(DriveCommand.ENABLE_OPERATION, q)
        assert bus.plant.drives[2].error == DriveError.COMMUNICATION
        master.heartbeats.clear()
        master.socket.send(CanFrame(classic.NMT_ID, bytes([classic.NMT_RESET_NODE, 3])).pack())
        answers = master.cycle(DriveCommand.DISABLE_VOLTAGE, q)
        master.cycle(DriveCommand.DISABLE_VOLTAGE, q)
        assert (3, classic.HEARTBEAT_BOOT) in master.heartbeats
        assert answers[2].state == DriveState.SWITCH_ON_DISABLED
        assert bus.plant.drives[2].error == DriveError.NONE


def test_real_clock_runs_without_a_master_and_brakes_hold(stand_in, arm):
    with stand_in(clock="real", pace=1.0) as bus:
        wait_until(lambda: bus.ticks > 200)
        assert bus.plant.physics.q == pytest.approx(arm.q_home, abs=2e-3)
        assert bus.plant.at_rest


def test_real_clock_stops_drives_whose_master_fell_silent(stand_in, fd_master):
    with stand_in(clock="real", pace=0.05) as bus:  # slow motion: a busy machine has time to answer
        master = fd_master(bus.address)
        master.enable()
        wait_until(lambda: bus.plant.drives[0].state == DriveState.QUICK_STOP_ACTIVE)
        assert bus.plant.drives[0].error == DriveError.COMMUNICATION


def test_second_stand_in_on_the_same_address_is_refused(stand_in):
    with stand_in() as bus, pytest.raises(StandInError, match="another stand-in already listens"):
        Hub(bus.address)


def test_socket_left_over_from_a_crash_is_replaced(tmp_path):
    path = tmp_path / "old.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(path))
    hub = Hub(f"unix:{path}")
    hub.close()
    assert not path.exists()


@pytest.mark.parametrize("make", [lambda path: path.write_text("mine"), lambda path: path.mkdir()])
def test_what_is_no_socket_is_not_taken_for_one_left_over(tmp_path, make):
    make(tmp_path / "notes.txt")
    with pytest.raises(StandInError, match=r"notes\.txt: what is there is no socket; choose another --bus"):
        Hub(f"unix:{tmp_path}/notes.txt")
    assert (tmp_path / "notes.txt").exists()


@pytest.mark.parametrize("packing", ["fd", "classic"])
def test_another_executors_ticks_begin_anew_and_a_master_that_left_keeps_its_last(
    stand_in, fd_master, classic_master, packing
):
    with stand_in(packing) as bus:
        for _ in range(2):
            if packing == "fd":
                master = fd_master(bus.address)
                for _ in range(30):
                    master.cycle(0)
            else:
                master = classic_master(bus.address)
                for _ in range(30):
                    master.cycle(DriveCommand.DISABLE_VOLTAGE, [d.q_meas for d in bus.plant.drives])
            last = bus.nodes.master_tick
            assert last <= 31
            master.socket.close()
            wait_until(lambda: not bus.hub.clients)
            assert bus.nodes.master_tick == last


def test_masters_tick_is_unwrapped_beyond_16_bits(stand_in, fd_master):
    with stand_in() as bus:
        master = fd_master(bus.address)
        for tick in (65_534, 65_535, 65_536, 65_537, 131_071, 131_072):
            master.tick = tick - 1
            master.cycle(0)
        wait_until(lambda: bus.ticks == 6)
        assert bus.nodes.master_tick == 131_072
        assert bus.plant.master_tick == 131_072
