"""One emulated drive, stepped by hand."""

import itertools

import pytest

from s2r_protocol.can.drive import DriveCommand, DriveError, DriveState
from s2r_sim.drives import BRAKE_RELEASE_S, EXTRAPOLATED_PERIODS, TRANSITIONS, Drive, drive_parameters

DT = 1e-3
INERTIA = 1.2


class Bench:
    """A drive on a free rotor: no gravity, no friction."""

    def __init__(self, arm, locked=False):
        self.drive = Drive(1, drive_parameters(arm)[0], 0.0)
        self.q = self.dq = 0.0
        self.locked = locked

    def period(self, command=None, q=None, dq=0.0):
        if command is not None:
            self.drive.command(command)
        if q is not None:
            self.drive.set_point(q, dq, 0.0)
        self.drive.period(DT)
        tau = self.drive.torque(0.0, 1.0, DT)
        if not self.locked:
            self.dq += tau / INERTIA * DT
            self.q += self.dq * DT
        self.drive.measure(self.q, self.dq)

    def enable(self):
        for command in (DriveCommand.SHUTDOWN, DriveCommand.SWITCH_ON, DriveCommand.ENABLE_OPERATION):
            self.period(command, 0.0)
        for _ in range(round(BRAKE_RELEASE_S / DT) + 2):
            self.period(DriveCommand.ENABLE_OPERATION, 0.0)
        assert self.drive.state == DriveState.OPERATION_ENABLED
        assert self.drive.brake_released


@pytest.fixture
def bench(arm):
    return Bench(arm)


def move(bench, speed, periods, start=0.0):
    for k in range(1, periods + 1):
        bench.period(DriveCommand.ENABLE_OPERATION, start + speed * DT * k, speed)
    return start + speed * DT * periods


def test_states_are_walked_one_per_period(bench):
    seen = [bench.drive.state]
    for command in (DriveCommand.SHUTDOWN, DriveCommand.ENABLE_OPERATION, DriveCommand.ENABLE_OPERATION):
        bench.period(command, 0.0)
        seen.append(bench.drive.state)
    assert seen == [
        DriveState.SWITCH_ON_DISABLED,
        DriveState.READY_TO_SWITCH_ON,
        DriveState.SWITCHED_ON,
        DriveState.OPERATION_ENABLED,
    ]


@pytest.mark.parametrize(("state", "command"), list(itertools.product(DriveState, DriveCommand)))
def test_only_the_standards_transitions_happen(arm, state, command):
    bench = Bench(arm)
    bench.drive.state = state
    bench.period(command, 0.0)
    settles = {DriveState.FAULT_REACTION: DriveState.FAULT}  # the reaction of a drive at rest is over at once
    assert bench.drive.state == TRANSITIONS.get((state, command), settles.get(state, state))


def test_every_state_but_the_latched_ones_is_left_by_disable_voltage():
    powered = set(DriveState) - {
        DriveState.NOT_READY,
        DriveState.SWITCH_ON_DISABLED,
        DriveState.FAULT,
        DriveState.FAULT_REACTION,
    }
    assert powered == {s for s, c in TRANSITIONS if c == DriveCommand.DISABLE_VOLTAGE}


def test_brake_opens_only_after_torque_is_on(bench):
    for command in (DriveCommand.SHUTDOWN, DriveCommand.SWITCH_ON, DriveCommand.ENABLE_OPERATION):
        bench.period(command, 0.0)
    assert not bench.drive.brake_released
    for _ in range(round(BRAKE_RELEASE_S / DT) + 1):
        bench.period(DriveCommand.ENABLE_OPERATION, 0.0)
    assert bench.drive.brake_released


def test_closed_brake_holds(bench):
    bench.drive.brake_released = False
    for _ in range(300):
        bench.drive.period(DT)
        tau = bench.drive.torque(0.0, 1.0, DT) + 30.0  # gravity pulls
        bench.dq += tau / INERTIA * DT
        bench.q += bench.dq * DT
        bench.drive.measure(bench.q, bench.dq)
    assert abs(bench.q) < 1e-3
    assert abs(bench.dq) < 1e-3


def test_set_points_are_followed(bench):
    bench.enable()
    end = move(bench, 1.0, 300)
    assert abs(bench.q - end) < 2e-3
    for _ in range(1500):
        bench.period(DriveCommand.ENABLE_OPERATION, end)
    assert abs(bench.q - end) < 1e-5


def test_few_missing_set_points_are_bridged_at_constant_velocity(bench):
    bench.enable()
    end = move(bench, 1.0, 300)
    for k in range(1, EXTRAPOLATED_PERIODS + 1):
        bench.period()
        assert bench.drive.state == DriveState.OPERATION_ENABLED
        assert bench.drive.following_error + bench.drive.q_meas == pytest.approx(end + k * DT, abs=2e-6 + DT)
    move(bench, 1.0, 50, end + EXTRAPOLATED_PERIODS * DT)
    assert bench.drive.state == DriveState.OPERATION_ENABLED


def test_many_missing_set_points_end_in_the_drives_own_quick_stop(bench):
    bench.enable()
    move(bench, 1.0, 300)
    before = bench.q
    for _ in range(EXTRAPOLATED_PERIODS + 1):
        bench.period()
    assert bench.drive.state == DriveState.QUICK_STOP_ACTIVE
    assert bench.drive.error == DriveError.COMMUNICATION
    for _ in range(400):
        bench.period()
    ramp = 0.5 / bench.drive.parameters.quick_stop_deceleration  # v²/2a at 1 rad/s
    assert bench.q - before == pytest.approx(ramp + 3.5 * DT, abs=3e-3)
    assert bench.drive.stopped
    assert bench.drive.emergencies == [DriveError.COMMUNICATION]


def test_set_points_alone_do_not_end_a_quick_stop(bench):
    bench.enable()
    for _ in range(10):
        bench.period()
    for _ in range(100):
        bench.period(DriveCommand.ENABLE_OPERATION, bench.q)
    assert bench.drive.state == DriveState.QUICK_STOP_ACTIVE
    bench.period(DriveCommand.DISABLE_VOLTAGE, bench.q)
    assert bench.drive.state == DriveState.SWITCH_ON_DISABLED
    assert bench.drive.error == DriveError.NONE


def test_blocked_joint_faults_and_only_a_rising_reset_clears_it(arm):
    bench = Bench(arm)
    bench.enable()
    bench.locked = True
    for k in range(1, 300):
        bench.period(DriveCommand.ENABLE_OPERATION, k * DT, 1.0)
    assert bench.drive.state == DriveState.FAULT
    assert bench.drive.error == DriveError.FOLLOWING
    assert not bench.drive.brake_released
    bench.period(DriveCommand.ENABLE_OPERATION, bench.q)
    bench.period(DriveCommand.DISABLE_VOLTAGE, bench.q)
    assert bench.drive.state == DriveState.FAULT
    bench.drive.command(DriveCommand.DISABLE_VOLTAGE, fault_reset=True)
    assert bench.drive.state == DriveState.SWITCH_ON_DISABLED
    assert bench.drive.error == DriveError.NONE


def test_set_points_do_not_disturb_a_commanded_quick_stop(bench):
    bench.enable()
    end = move(bench, 1.0, 300)
    for k in range(400):
        bench.period(DriveCommand.QUICK_STOP, end + 1.0 * DT * k, 1.0)
    assert bench.drive.state == DriveState.QUICK_STOP_ACTIVE
    assert bench.drive.stopped
    assert bench.q - end < 0.06


def test_reset_held_high_does_not_clear_a_later_fault(bench):
    bench.drive.command(DriveCommand.DISABLE_VOLTAGE, fault_reset=True)
    bench.drive.state = DriveState.FAULT
    bench.drive.command(DriveCommand.DISABLE_VOLTAGE, fault_reset=True)
    assert bench.drive.state == DriveState.FAULT


def test_an_emergency_stop_in_the_middle_of_a_fault_reaction_clears_no_fault(bench):
    bench.enable()
    move(bench, 1.0, 100)
    bench.drive.encoder = lambda q: q + 0.3  # slips by a tooth
    while bench.drive.state == DriveState.OPERATION_ENABLED:
        bench.period(DriveCommand.ENABLE_OPERATION, bench.q, 1.0)
    assert bench.drive.state == DriveState.FAULT_REACTION
    bench.drive.estop_open = 3
    bench.period(DriveCommand.ENABLE_OPERATION)
    bench.drive.estop_open = 0
    bench.period(DriveCommand.SHUTDOWN)
    assert (bench.drive.state, bench.drive.error) == (DriveState.FAULT, DriveError.FOLLOWING)


def test_an_emergency_stop_in_a_quick_stop_leaves_no_error_of_before(bench):
    bench.enable()
    move(bench, 1.0, 100)
    while bench.drive.state == DriveState.OPERATION_ENABLED:
        bench.period()  # set-points are missing
    assert bench.drive.error == DriveError.COMMUNICATION
    bench.drive.estop_open = 3
    bench.period()
    assert (bench.drive.state, bench.drive.error) == (DriveState.SWITCH_ON_DISABLED, DriveError.NONE)


def test_torque_never_exceeds_its_limit(arm):
    bench = Bench(arm, locked=True)
    bench.enable()
    limit = arm.limits.tau_max[0]
    for k in range(1, 60):
        bench.period(DriveCommand.ENABLE_OPERATION, 2.0 * k * DT, 2.0)
        assert abs(bench.drive.tau_meas) <= limit
