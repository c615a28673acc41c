"""Settings of the planner: the sampler, the cascade of rollout models, the reward weights, the delivery checks."""

from __future__ import annotations

from dataclasses import dataclass, field

from s2r_host.planning.doubt import Doubt

USUAL_ROOM_M = 0.012


class PlanSettingsError(ValueError):
    """A setting is outside its allowed set."""


def _require(condition: bool, name: str, value: object, allowed: str) -> None:
    if not condition:
        raise PlanSettingsError(f"planner setting {name} = {value!r} is not allowed: it must be {allowed}")


@dataclass(frozen=True)
class IcemSettings:
    """The sampler (Pinneri et al., Sample-efficient Cross-Entropy Method for Real-time Planning, CoRL 2020).

    Each trick can be switched off: ``noise_beta = 0`` (white noise), ``decay = 1``, ``keep_elites``,
    ``shift_elites``, ``mean_in_last``, ``execute_best``, ``warm_start``, ``knots = None``.

    Attributes:
        population: Samples N of the first iteration.
        elites: Samples K that the next distribution is fitted to.
        iterations: Cross-entropy iterations per control step.
        horizon: Control steps h looked ahead.
        noise_beta: Exponent of the noise's power spectrum 1/f^beta along time.
        decay: The population shrinks by this factor with every iteration.
        keep_fraction: Share of the elites that is carried over.
        keep_elites: Carry elites from one iteration to the next.
        shift_elites: Carry elites, shifted by one step, from one control step to the next.
        mean_in_last: Evaluate the mean itself in the last iteration.
        execute_best: Execute the best sample seen instead of the mean of the elites.
        warm_start: Start from the previous mean, shifted by one step.
        momentum: Weight of the old mean and deviation in their update.
        sigma: First standard deviation, as a share of the half range of an action.
        knots: Draw the noise on so many linear knots over the horizon; None: one value per step.
    """

    population: int = 60
    elites: int = 10
    iterations: int = 2
    horizon: int = 10
    noise_beta: float = 2.5
    decay: float = 1.25
    keep_fraction: float = 0.3
    keep_elites: bool = True
    shift_elites: bool = True
    mean_in_last: bool = True
    execute_best: bool = True
    warm_start: bool = True
    momentum: float = 0.1
    sigma: float = 0.5
    knots: int | None = 3

    def __post_init__(self) -> None:
        _require(self.population >= 2, "population", self.population, "at least 2")
        _require(2 <= self.elites <= self.population, "elites", self.elites, "between 2 and the population")
        _require(self.iterations >= 1, "iterations", self.iterations, "at least 1")
        _require(self.horizon >= 2, "horizon", self.horizon, "at least 2")
        _require(self.noise_beta >= 0.0, "noise_beta", self.noise_beta, "zero or more")
        _require(self.decay >= 1.0, "decay", self.decay, "at least 1")
        _require(0.0 <= self.keep_fraction <= 1.0, "keep_fraction", self.keep_fraction, "within [0, 1]")
        _require(0.0 <= self.momentum < 1.0, "momentum", self.momentum, "within [0, 1)")
        _require(self.sigma > 0.0, "sigma", self.sigma, "positive")
        knots = self.knots
        _require(knots is None or 2 <= knots <= self.horizon, "knots", knots, "None or within [2, horizon]")


@dataclass(frozen=True)
class RewardWeights:
    """Weights of the reward's terms, as the paper's authors ran it, except the collision weight (their text: 60).

    Attributes:
        distance: Per m² between fingertip and its point on the part, for distances well below the width.
        distance_width_m: Beyond this the distance term grows linearly.
        turn_m: Length that makes an angle of the tool comparable with a distance; 0 ignores the orientation.
        target: At full remaining way; proportional to the share that remains.
        success: For being on target.
        contact: For the fingertip touching the part while there is progress.
        contact_after: Penalty for still touching once on target. The authors' 5 makes the fingertip let go early and
            the object coast to the target, which the slower timed motion cannot repeat.
        collision: Penalty for any other contact of the robot.
        speed: Per rad/s of weighted joint speed.
        acceleration: Per rad/s² of weighted joint acceleration.
        calm: Penalty per (m/s)² of a slide or (5 rad/s)² of a hinge.
        press: Penalty per newton of the fingertip on the part across the part's motion, beyond the free force.
        press_free_N: That free force.
        load: Penalty per unit of servo load over the torque limit; not in the paper, see ``rewards.r_load``.
        load_free: Share of the torque limit that costs nothing.
        joints: Weights of the joints in the speed and acceleration terms; arms with other counts repeat the last one.
    """

    distance: float = 1000.0
    distance_width_m: float = 0.05
    turn_m: float = 0.2
    target: float = 50.0
    success: float = 20.0
    contact: float = 10.0
    contact_after: float = 0.0
    collision: float = 60.0
    speed: float = 0.03
    acceleration: float = 0.01
    calm: float = 200.0
    press: float = 1.0
    press_free_N: float = 15.0
    load: float = 20.0
    load_free: float = 0.4
    joints: tuple[float, ...] = (2.0, 3.0, 2.0, 2.0, 2.0, 1.0, 1.0)


@dataclass(frozen=True)
class Stage:
    """One attempt of the cascade: how coarse the rollouts are and how many there are.

    Attributes:
        timestep_s: Physics step of the rollout model.
        population: Samples of the first iteration; elites scale along.
        self_collision: Also let the arm collide with itself in the rollouts.
        horizon: Control steps looked ahead; None: as many as the sampler's settings say.
    """

    timestep_s: float = 0.025
    population: int = 60
    self_collision: bool = False
    horizon: int | None = None


@dataclass(frozen=True)
class ServoSettings:
    """The position servos both models assume; the gains are those of the paper's authors.

    Attributes:
        kp: Stiffness [N·m/rad].
        kd: Damping [N·m·s/rad].
        armature: Inertia of the turning motor parts as seen at the joint [kg·m²].
        damping: Viscous joint friction [N·m·s/rad].
        finger_friction: Coefficient between robot and object, whatever the object file says. Low on purpose
            (the authors plan with 0): a plan that holds by shape holds for any friction, one that drags does not.
    """

    kp: float = 3000.0
    kd: float = 100.0
    armature: float = 0.1
    damping: float = 1.0
    finger_friction: float = 0.1


@dataclass(frozen=True)
class PlanSettings:
    """Everything the planner can be told besides the task itself.

    Attributes:
        control_dt_s: Time between two actions.
        action_max_rad: Largest change of a joint target per action.
        turn_steps: Control steps that the route with a hinge's part takes at least; None: as few as there may be. Near
            the axis the way is a centimetre: one action throws the part there, which the timed motion, as slow as a
            touch has to be, may not repeat.
        max_steps: Control steps after which a stage gives up.
        tolerance_m: Success band of a prismatic joint; the whole loop has to end within 5 mm.
        tolerance_rad: Success band of a revolute joint.
        hold_s: How long the target has to be held standing still.
        fine_timestep_s: Physics step of the execution model.
        torque_margin: Share of the torque limits a delivered plan may use.
        press_max_N: Largest force of the fingertip on the part across the part's motion. A few newtons come from
            friction; more is pressing on an edge.
        contact_margin: Share of a joint's torque limit that contact may take. The executor takes half of the limit
            for a collision.
        joint_margin_rad: Distance kept from the position limits.
        clearance_m: The rollouts count anything nearer than this to the robot, except the fingertip, as a collision.
        lead_in: Go to the place behind the part along the collision-free route, and let the sampler begin there.
        proposal_speeds: Speeds of the sequences along the hook's route that join each control step's first samples, as
            shares of the largest action; empty for none.
        retries: Ranked samples tried in the fine model before an action with an unexpected contact is taken.
        backtracks: How often a stage may go back some steps when every action touches something unexpected.
        hooks: Fingertip places on the part, with a free way there, that are prepared before planning.
        room_m: Way from a place to the touch that is wished for: more where it is less known where the part ends.
        deep: The fingertip reaches past the point it is to push by no less than its own thickness: where the part may
            end earlier than believed, what grazes its edge slips over it.
        missed: Fingertip places in the part's frame [m] from which a push has moved nothing; those like them come last.
        proven: The same of such from which one has moved it as was learnt from: those like them come first.
        apart_m: Distance that the robot keeps from everything at a place, on its way there and on with the part, where
            any place leaves so much; the fingertip keeps it from all but the part. 0: it is enough to touch nothing.
        along_route: Where sampling gets stuck, the route it was offered is also played as it is: a last resort for
            parts so heavy that no sample within the horizon moves them.
        ensemble: Believable objects that every sequence is rolled out with; its reward is their mean. 1: the believed
            one alone.
        doubt: How far the others may be from it.
        threads: Threads of the rollouts; 0 takes all processors. Plans do not depend on it.
        icem: The sampler.
        cascade: Attempts, tried in turn until one delivers; each takes the next best place for the fingertip.
        weights: Of the reward's terms.
        servo: The position servos.
    """

    control_dt_s: float = 0.05
    action_max_rad: float = 0.05
    turn_steps: int | None = None
    max_steps: int = 60
    tolerance_m: float = 0.002
    tolerance_rad: float = 0.01
    hold_s: float = 0.5
    fine_timestep_s: float = 0.002
    torque_margin: float = 0.9
    press_max_N: float = 40.0
    contact_margin: float = 0.35
    joint_margin_rad: float = 0.05
    clearance_m: float = 0.003
    lead_in: bool = True
    proposal_speeds: tuple[float, ...] = (1.0, 0.5, 0.2)
    retries: int = 8
    backtracks: int = 6
    hooks: int = 4
    room_m: float = USUAL_ROOM_M
    deep: bool = False
    missed: tuple[tuple[float, float, float], ...] = ()
    proven: tuple[tuple[float, float, float], ...] = ()
    apart_m: float = 0.0
    along_route: bool = False
    ensemble: int = 1
    doubt: Doubt = field(default_factory=Doubt)
    threads: int = 0
    icem: IcemSettings = field(default_factory=IcemSettings)
    cascade: tuple[Stage, ...] = (
        Stage(population=24, horizon=7),
        Stage(self_collision=True),
        Stage(0.010, 60, True),
        Stage(0.010, 150, True),
    )
    weights: RewardWeights = field(default_factory=RewardWeights)
    servo: ServoSettings = field(default_factory=ServoSettings)

    def __post_init__(self) -> None:
        _require(self.control_dt_s > 0.0, "control_dt_s", self.control_dt_s, "positive")
        _require(self.action_max_rad > 0.0, "action_max_rad", self.action_max_rad, "positive")
        turn_steps = self.turn_steps
        _require(turn_steps is None or turn_steps >= 1, "turn_steps", turn_steps, "None or at least 1")
        _require(self.max_steps >= 1, "max_steps", self.max_steps, "at least 1")
        _require(self.tolerance_m > 0.0, "tolerance_m", self.tolerance_m, "positive")
        _require(self.tolerance_rad > 0.0, "tolerance_rad", self.tolerance_rad, "positive")
        _require(0.0 < self.torque_margin <= 1.0, "torque_margin", self.torque_margin, "within (0, 1]")
        _require(self.room_m > 0.0, "room_m", self.room_m, "positive")
        _require(self.apart_m >= 0.0, "apart_m", self.apart_m, "zero or more")
        _require(self.press_max_N > 0.0, "press_max_N", self.press_max_N, "positive")
        _require(0.0 < self.contact_margin <= 1.0, "contact_margin", self.contact_margin, "within (0, 1]")
        _require(self.retries >= 1, "retries", self.retries, "at least 1")
        _require(self.backtracks >= 0, "backtracks", self.backtracks, "zero or more")
        _require(self.hooks >= 1, "hooks", self.hooks, "at least 1")
        _require(self.threads >= 0, "threads", self.threads, "zero or more")
        odd = self.ensemble >= 1 and self.ensemble % 2 == 1
        _require(
            odd, "ensemble", self.ensemble, "an odd number: the believed object and opposite pairs of others"
        )
        _require(len(self.cascade) >= 1, "cascade", self.cascade, "at least one stage")
        steps = [self.fine_timestep_s, *(stage.timestep_s for stage in self.cascade)]
        for step in steps:
            ratio = self.control_dt_s / step
            whole = ratio > 0.5 and abs(ratio - round(ratio)) < 1e-6
            _require(whole, "timestep_s", step, f"a whole fraction of control_dt_s = {self.control_dt_s}")


def paper_settings() -> PlanSettings:
    """The planner as the paper's authors ran it, on this project's models and checks.

    Plain cross-entropy: white noise, 300 samples, 20 elites, two iterations, 10 steps ahead, the elite mean executed,
    rollouts at 500 Hz, no sequences offered, no lead-in, 50 control steps at most.
    """
    icem = IcemSettings(
        population=300,
        elites=20,
        iterations=2,
        horizon=10,
        noise_beta=0.0,
        decay=1.0,
        keep_elites=True,
        shift_elites=False,
        mean_in_last=False,
        execute_best=False,
        warm_start=True,
        momentum=0.1,
        sigma=0.5,
        knots=None,
    )
    return PlanSettings(
        icem=icem,
        cascade=(Stage(0.002, 300, True),),
        lead_in=False,
        proposal_speeds=(),
        max_steps=50,
        retries=1,
        backtracks=0,
    )
