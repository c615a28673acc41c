"""One emulated servo drive: CiA 402 state machine, cyclic synchronous position mode, watchdog, brake.

A drive knows its set-point, its encoder and the nominal arm's torque; it does not know the true arm. It
protects itself: missing set-points are bridged for three periods at constant velocity, then it stops on its own ramp.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from s2r_protocol.arms import ArmDescription
from s2r_protocol.can.drive import DriveCommand, DriveError, DriveState
from s2r_sim.physics import rotor_inertia

# Position loop: a natural frequency of 90 rad/s on a typical load keeps the following error near 2 mrad at 6 rad/s².
LOAD_OVER_ROTOR = 2.0  # typical total inertia over rotor inertia
NATURAL_FREQUENCY = 90.0  # rad/s
DAMPING_RATIO = 0.9
INTEGRAL_TIME_S = 0.15
ACCELERATION_FILTER_S = 0.004  # set-point velocities come in steps of 2e-4 rad/s
INTEGRAL_SHARE = 0.15  # of the torque limit: enough for a 15 % gravity error

ENCODER_COUNTS_PER_RAD = (1 << 21) / 6.283185307179586  # 21 bits per turn, 3 µrad
EXTRAPOLATED_PERIODS = 3
FOLLOWING_WARNING_RAD = 0.02
FOLLOWING_FAULT_RAD = 0.10
FOLLOWING_FAULT_S = 0.010
BRAKE_RELEASE_S = 0.040  # torque is on before the brake lets go
BRAKE_FREQUENCY = 400.0  # rad/s: stiffness of the closed brake on the rotor inertia alone
BRAKE_OVER_TORQUE = 1.3  # holding torque over the drive's torque limit
QUICK_STOP_OVER_LIMIT = 2.0  # quick-stop deceleration (0x6085) over the planner's acceleration limit
AT_REST = 1e-3  # rad/s
AMBIENT_C = 31

_S, _C = DriveState, DriveCommand
# CiA 402, figure "state machine"; the numbers are the standard's. Fault and reset are handled where they arise.
TRANSITIONS: dict[tuple[DriveState, DriveCommand], DriveState] = {
    (_S.SWITCH_ON_DISABLED, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 2
    (_S.READY_TO_SWITCH_ON, _C.SWITCH_ON): _S.SWITCHED_ON,  # 3
    (_S.READY_TO_SWITCH_ON, _C.ENABLE_OPERATION): _S.SWITCHED_ON,  # 3, goes on to 4 by itself
    (_S.SWITCHED_ON, _C.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 4
    (_S.OPERATION_ENABLED, _C.SWITCH_ON): _S.SWITCHED_ON,  # 5, "disable operation"
    (_S.SWITCHED_ON, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 6
    (_S.READY_TO_SWITCH_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 7
    (_S.READY_TO_SWITCH_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 7
    (_S.OPERATION_ENABLED, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 8
    (_S.OPERATION_ENABLED, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 9
    (_S.SWITCHED_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 10
    (_S.SWITCHED_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 10
    (_S.OPERATION_ENABLED, _C.QUICK_STOP): _S.QUICK_STOP_ACTIVE,  # 11
    (_S.QUICK_STOP_ACTIVE, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 12; 16 is not offered (0x605A = 6)
}


@dataclass(frozen=True)
class DriveParameters:
    """Constants of one drive, SI units."""

    kp: float
    kd: float
    ki: float
    integral_max: float
    tau_max: float
    quick_stop_deceleration: float
    brake_stiffness: float
    brake_damping: float
    brake_torque: float


def drive_parameters(arm: ArmDescription) -> list[DriveParameters]:
    """Drives that suit an arm: gains from its rotors, limits from its description."""
    return [
        _parameters(float(rotor), float(tau), float(ddq))
        for rotor, tau, ddq in zip(rotor_inertia(arm), arm.limits.tau_max, arm.limits.ddq_max, strict=True)
    ]


def _parameters(rotor: float, tau_max: float, ddq_max: float) -> DriveParameters:
    load = LOAD_OVER_ROTOR * rotor
    kp = load * NATURAL_FREQUENCY**2
    return DriveParameters(
        kp=kp,
        kd=2.0 * DAMPING_RATIO * NATURAL_FREQUENCY * load,
        ki=kp / INTEGRAL_TIME_S,
        integral_max=INTEGRAL_SHARE * tau_max,
        tau_max=tau_max,
        quick_stop_deceleration=QUICK_STOP_OVER_LIMIT * ddq_max,
        brake_stiffness=rotor * BRAKE_FREQUENCY**2,
        brake_damping=1.4 * rotor * BRAKE_FREQUENCY,
        brake_torque=BRAKE_OVER_TORQUE * tau_max,
    )


class Drive:
    """One drive. ``command`` and ``set_point`` come from the bus; ``period`` and ``torque`` from the clock."""

    def __init__(self, node: int, parameters: DriveParameters, q: float) -> None:
        """A drive after its self test, power off, brake on, at position ``q`` [rad]."""
        self.node = node
        self.parameters = parameters
        self.state = DriveState.SWITCH_ON_DISABLED
        self.error = DriveError.NONE
        self.emergencies: list[DriveError] = []  # not yet sent; NONE says that an error is gone
        self.pdo_error = (
            0  # emergency error code of a PDO that was not as it should be; 0: none since a good one
        )
        self.q_meas = q
        self.dq_meas = 0.0
        self.tau_meas = 0.0
        self.temp_C = AMBIENT_C
        self.brake_released = False
        self.following_warning = False
        self._command = DriveCommand.DISABLE_VOLTAGE
        self._fault_reset = False
        self._q_from = self._q_to = self._q_set = q
        self._dq_set = self._dq_step = self._tau_ff = 0.0
        self.ddq_set = 0.0  # filtered acceleration of the set-points, for feed-forward
        self._fresh = False
        self._missed = 0
        self._integral = 0.0
        self._q_brake = q
        self._powered_s = 0.0
        self._following_s = 0.0
        # What a test or an operator may break: channels of the emergency stop chain that are open (bit 0, 1), a brake
        # that no longer moves (the state its sensor tells), and an encoder that lies (true angle -> told angle).
        self.estop_open = 0
        self.brake_stuck: bool | None = None
        self.encoder: Callable[[float], float] | None = None

    @property
    def following_error(self) -> float:
        """Set-point minus measured position [rad]."""
        return self._q_set - self.q_meas

    @property
    def braked(self) -> bool:
        """Brake on and not about to open; the joint may still give way in it a little."""
        return not self.brake_released and self.state != DriveState.OPERATION_ENABLED

    @property
    def stopped(self) -> bool:
        """Brake on and at rest: nothing will change without a command."""
        return self.braked and abs(self.dq_meas) < AT_REST

    def command(self, command: DriveCommand, fault_reset: bool = False) -> None:
        """Take a command, and the level of the fault-reset bit (it acts on its rising edge)."""
        if self.state == DriveState.FAULT and fault_reset and not self._fault_reset:
            self._enter(DriveState.SWITCH_ON_DISABLED)
        self._fault_reset = fault_reset
        self._command = command

    def restart(self) -> None:
        """Begin anew, as after a reset of the node: power off, brake on, nothing remembered."""
        self._enter(DriveState.SWITCH_ON_DISABLED)
        self._command, self._fault_reset = DriveCommand.DISABLE_VOLTAGE, False
        self.emergencies.clear()
        self.pdo_error = 0

    def lose_master(self) -> None:
        """The network was stopped: quick stop, whatever is asked for next (0x6007 = 3)."""
        self._command = DriveCommand.QUICK_STOP
        self._walk()

    def set_point(self, q: float, dq: float, tau_ff: float) -> None:
        """Take a target position [rad], velocity [rad/s] and torque feed-forward [N·m] for the coming period."""
        self._fresh = True
        if self.state not in _RAMPING:  # its own ramp obeys no set-point
            self._q_from, self._q_to = self._q_set, q
            self._dq_step = dq - self._dq_set
            self._dq_set, self._tau_ff = dq, tau_ff

    def period(self, period_s: float) -> None:
        """One communication period has passed: walk the state machine and mind the watchdog."""
        if self.estop_open and self.state not in _OFF:  # safe torque off: no power, whatever is asked
            faulty = self.state == DriveState.FAULT_REACTION  # its ramp is cut short, the fault stays latched
            self._enter(DriveState.FAULT if faulty else DriveState.SWITCH_ON_DISABLED)
        elif not self.estop_open:
            self._walk()
        if self.state != DriveState.OPERATION_ENABLED:
            self._missed, self._fresh, self.ddq_set = 0, False, 0.0
            return
        share = period_s / (period_s + ACCELERATION_FILTER_S)
        if self._fresh:
            self._missed, self._fresh = 0, False
            self.ddq_set += share * (self._dq_step / period_s - self.ddq_set)
            return
        self.ddq_set -= share * self.ddq_set
        self._missed += 1
        self._q_from = self._q_set
        self._tau_ff = 0.0
        if self._missed > EXTRAPOLATED_PERIODS:
            self._fail(DriveError.COMMUNICATION, DriveState.QUICK_STOP_ACTIVE)
        else:
            self._q_to = self._q_set + self._dq_set * period_s

    def _walk(self) -> None:
        """At most one transition per period, as the controlword asks."""
        state = TRANSITIONS.get((self.state, self._command))
        if state is not None:
            self._enter(state)

    def _enter(self, state: DriveState) -> None:
        self.state = state
        if state == DriveState.SWITCH_ON_DISABLED and self.error:
            self.error = DriveError.NONE
            self.emergencies.append(DriveError.NONE)
        if state == DriveState.OPERATION_ENABLED:
            self._q_from = self._q_to = self._q_set = self.q_meas
            self._dq_set = self._dq_step = self._tau_ff = self._integral = self._powered_s = 0.0
            self._missed, self._fresh = 0, True
        elif state not in _RAMPING:
            self._close_brake()

    def _close_brake(self) -> None:
        if self.brake_released:
            self._q_brake = self.q_meas
        self.brake_released = bool(self.brake_stuck)
        self.following_warning = False
        self._following_s = 0.0

    def _fail(self, error: DriveError, state: DriveState) -> None:
        self.error = error
        self.emergencies.append(error)
        self._enter(state)

    def measure(self, q: float, dq: float) -> None:
        """Read the encoder: true joint position [rad] and velocity [rad/s] in, quantised position kept."""
        if self.encoder is not None:
            q = self.encoder(q)
        self.q_meas = round(q * ENCODER_COUNTS_PER_RAD) / ENCODER_COUNTS_PER_RAD
        self.dq_meas = dq

    def torque(self, bias: float, phase: float, dt: float) -> float:
        """Torque on the joint for the next step [N·m], brake included.

        Args:
            bias: Nominal torque for the set-point's motion: gravity, velocity, inertia [N·m].
            phase: Share of the communication period that ends with this step, in (0, 1]: where to interpolate.
            dt: Step [s].
        """
        state = self.state
        if state == DriveState.OPERATION_ENABLED:
            self._q_set = self._q_from + (self._q_to - self._q_from) * phase
        elif state in _RAMPING:
            self._ramp(dt)
        # "Disable operation" keeps the torque until the brake has closed.
        holds = self.state == DriveState.SWITCHED_ON and self.brake_released
        self.tau_meas = self._servo(bias, dt) if self.state in _POWERED or holds else 0.0
        return self.tau_meas if self.brake_released else self.tau_meas + self._brake()

    def _servo(self, bias: float, dt: float) -> float:
        p = self.parameters
        error = self._q_set - self.q_meas
        if self.brake_released:
            self._integral = _clip(self._integral + p.ki * error * dt, p.integral_max)
            self._watch_following(abs(error), dt)
        elif self.state == DriveState.OPERATION_ENABLED:
            self._powered_s += dt
            opened = self._powered_s >= BRAKE_RELEASE_S
            self.brake_released = opened if self.brake_stuck is None else self.brake_stuck
        torque = p.kp * error + p.kd * (self._dq_set - self.dq_meas) + self._integral + bias + self._tau_ff
        return _clip(torque, p.tau_max)

    def _watch_following(self, error: float, dt: float) -> None:
        self.following_warning = error > FOLLOWING_WARNING_RAD
        self._following_s = self._following_s + dt if error > FOLLOWING_FAULT_RAD else 0.0
        if self._following_s > FOLLOWING_FAULT_S and self.state == DriveState.OPERATION_ENABLED:
            # The target is out of reach: brake from where the joint is.
            self._q_set, self._dq_set = self.q_meas, self.dq_meas
            self._fail(DriveError.FOLLOWING, DriveState.FAULT_REACTION)

    def _ramp(self, dt: float) -> None:
        """Slow the set-point to rest; then close the brake."""
        step = self.parameters.quick_stop_deceleration * dt
        self._tau_ff = 0.0
        self._dq_set -= _clip(self._dq_set, step)
        self._q_set += self._dq_set * dt
        if self._dq_set == 0.0 and abs(self.dq_meas) < 0.01 and self.brake_released:
            self._close_brake()
        if self.state == DriveState.FAULT_REACTION and not self.brake_released:
            self.state = DriveState.FAULT

    def _brake(self) -> float:
        """A closed friction brake: stiff until its holding torque, slipping beyond."""
        p = self.parameters
        torque = p.brake_stiffness * (self._q_brake - self.q_meas)
        if abs(torque) > p.brake_torque:
            torque = _clip(torque, p.brake_torque)
            self._q_brake = self.q_meas + torque / p.brake_stiffness
        return torque - p.brake_damping * self.dq_meas


_RAMPING = frozenset({DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION})
_POWERED = _RAMPING | {DriveState.OPERATION_ENABLED}
_OFF = frozenset({DriveState.NOT_READY, DriveState.SWITCH_ON_DISABLED, DriveState.FAULT})


def _clip(value: float, limit: float) -> float:
    return limit if value > limit else -limit if value < -limit else value
