"""From a plan to the trajectory that is sent: timed, replayed, and its end corrected until the replay is on target.

A plan is executed at the control rate with the object coasting behind the fingertip; timed within the arm's limits it
runs at another speed and ends elsewhere by some millimetres. That offset is systematic, so the end of the path is
moved by what is missing, along the part's motion, and the replay is asked again.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from s2r_host.planning.belief import Belief
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.part_alone import is_coupled
from s2r_host.planning.patience import Patience, TimeIsUpError
from s2r_host.planning.planner import plan_manipulation, scene_of
from s2r_host.planning.scene import Scene
from s2r_host.planning.staying import drift
from s2r_host.planning.task import PlanRefusedError, PlanRequest, PlanResult
from s2r_host.trajectory.perturb import farthest_m, perturbed
from s2r_host.trajectory.shift import shift_with_part
from s2r_host.trajectory.time_law import TimeLawSettings, time_law
from s2r_host.trajectory.trajectory import Trajectory, TrajectoryError
from s2r_host.trajectory.verify import Replay, replay, replays

logger = logging.getLogger(__name__)

SEED_STEP = 1000  # between the seeds of attempts at one task
_CORRECTIONS = 5
# Success bands that a slightly different object may be off, and, of what displaces a hinge, times its own turn at the
# fingertip, up to half of what is asked for: beside a knob's axis 3 mm are 6 degrees. More means the part was lost.
_FRAGILE, _DISPLACED, _LOST = 4.0, 1.25, 0.5
_LEAST_LEVER_M = 0.02
_FRAGILE_PRESS = 1.5  # of the press that the believed object may feel
_FRAGILE_CONTACT = 1.25  # of the joint torque that contact may cause
_LARGEST_M = 0.04  # a larger correction means that the fingertip lost the part


class MotionHitsError(PlanRefusedError):
    """A plan was found, but timed within the arm's limits its motion hits what it only just passes in the plan.

    Or two links of the arm come nearer to each other than the executor admits: the plan has them only not touch.
    """


@dataclass(frozen=True, eq=False)
class Delivery:
    """A trajectory that the fine model has followed to the target.

    Attributes:
        trajectory: What the executor gets.
        replay: What the fine model did with it.
        corrections: How often the end of the path was moved.
        followed: "motion" when the path is where the plan's arm was, "targets" when it is where it was told to be,
            "route" when it is the route through the hook that the plan's sampler was offered.
        speed: Share of the time law's full speed.
        fragile: With which slightly different object the motion fails, or that the contact is so hard that the executor
            may take it for a collision, in words; None: neither.
        hits: That object is touched by something else than the fingertip.
        strays: How far from the target any slightly different object ends that was tried [m or rad]; infinite where one
            of them, or the believed one, is touched, pressed or loaded more than it may be.
    """

    trajectory: Trajectory
    replay: Replay
    corrections: int
    followed: str
    speed: float
    fragile: str | None = None
    hits: bool = False
    strays: float = 0.0


def plan_trajectory(
    request: PlanRequest,
    settings: TimeLawSettings | None = None,
    attempts: int = 3,
    *,
    scene: Scene | None = None,
    patience: Patience | None = None,
    accept_fragile: bool = False,
    only_fragile: bool = False,
    only_found: bool = False,
) -> tuple[PlanResult, Delivery]:
    """Plan and deliver; a plan that cannot be delivered is planned again with another seed.

    After a motion that hits something, if only a slightly different object, the robot keeps as far from everything as
    that object may be displaced, see :func:`apart`.

    Args:
        request: The task.
        settings: Of the time law.
        attempts: Plans tried; the seeds are ``request.seed`` and those 1000 apart from it.
        scene: The request's scene, if it has been built already.
        patience: A limit on the time, and who is told about progress.
        accept_fragile: When no attempt survives the slightly different objects, take the first that was held with
            the believed one, or one that needs less contact torque; ``Delivery.fragile`` then says what it fails with.
        only_fragile: Plan again where a motion was fragile only; a first attempt without any ends it.
        only_found: Plan again where a plan was found that could not be delivered; an attempt without any ends it.

    Raises:
        PlanRefusedError: The request is absurd, or no attempt led to a delivery; the text has the last reason.
        OutOfReachError, SceneFileError, TrajectoryError, TimeIsUpError: As the planner and the time law say.
    """
    scene, patience = scene or scene_of(request), patience or Patience()
    second_best: tuple[PlanResult, Delivery] | None = None
    tight = False
    for attempt in range(attempts):
        found = False
        task = replace(apart(request) if tight else request, seed=request.seed + SEED_STEP * attempt)
        try:
            result = plan_manipulation(task, scene, patience)
            found = result.success
            delivery = deliver(
                request, result, settings, scene=scene, patience=patience, accept_fragile=accept_fragile
            )
            if delivery.fragile is None:
                return result, delivery
            if second_best is None or _calmer(delivery, second_best[1], request):
                second_best = result, delivery
            tight = second_best[1].hits
            if _is_settled(delivery, request, scene):
                break
        except (PlanRefusedError, TrajectoryError, TimeIsUpError) as error:
            logger.info("attempt %d of %d: %s", attempt + 1, attempts, error)
            newly_tight = isinstance(error, MotionHitsError) and not tight
            tight |= newly_tight
            hopeless = (only_fragile and second_best is None) or (only_found and not found)
            hopeless &= not newly_tight
            last = attempt == attempts - 1 or hopeless or isinstance(error, TimeIsUpError)
            if last and second_best is None:
                raise
            if last:
                break
    if second_best is None:
        raise ValueError(f"attempts = {attempts} is not allowed: at least 1")
    return second_best


def deliver(
    request: PlanRequest,
    result: PlanResult,
    settings: TimeLawSettings | None = None,
    perturbations: tuple[Belief, ...] | None = None,
    *,
    scene: Scene | None = None,
    patience: Patience | None = None,
    accept_fragile: bool = False,
) -> Delivery:
    """Time a plan, replay it in the fine model and correct its end until it is held on target.

    First along the motion the fine model made, which is known to be free of contact; then along the plan's
    targets; then along the route its sampler was offered; then along the motion at half the speed.

    Args:
        request: The task that was planned.
        result: Its plan, successful.
        settings: Of the time law.
        perturbations: Slightly different objects with which the motion must not lose the part either; None: those at
            the ends of the request's doubt.
        scene: The request's scene, if it has been built already.
        patience: A limit on the time, and who is told about progress.
        accept_fragile: Rather than refuse, take the first motion that is held with the believed object, or the one
            with the least contact torque where that is too much with the first.

    Raises:
        MotionHitsError: No attempt passed, and the last hit something.
        PlanRefusedError: No attempt passed; the text has the reason of the last one.
        TrajectoryError: The path cannot be timed.
        TimeIsUpError: The time limit has passed.
    """
    if not result.success:
        raise PlanRefusedError(result.reason)
    settings, patience = settings or TimeLawSettings(), patience or Patience()
    scene = scene or scene_of(request)
    if perturbations is None:
        perturbations = perturbed(request.settings.doubt, scene.axis_at_rest())
    problem = PlanRefusedError("no attempt")
    second_best: Delivery | None = None
    for followed, path, touch, speed in _paths(request, result):
        patience.check(f"timing the motion along the plan's {followed}")
        timed = replace(settings, speed=settings.speed * speed)
        try:
            delivery = _corrected(request, result, scene, path, touch, timed, followed)
        except (PlanRefusedError, TrajectoryError) as error:
            problem = error
        else:
            delivery = judged(delivery, request, scene, perturbations)
            if delivery.fragile is None:
                return delivery
            problem = PlanRefusedError(delivery.fragile)
            if second_best is None or _calmer(delivery, second_best, request):
                second_best = delivery
            if accept_fragile and _is_settled(delivery, request, scene, perturbations):
                break
        logger.info("timed along the plan's %s at speed %.1f: %s", followed, speed, problem)
    if second_best is not None and accept_fragile:
        return second_best
    raise problem


def apart(request: PlanRequest) -> PlanRequest:
    """The same task with the robot as far from everything as the object may be displaced, where there is room."""
    far_m = farthest_m(request.settings.doubt)
    return replace(request, settings=replace(request.settings, apart_m=far_m))


def _calmer(delivery: Delivery, other: Delivery, request: PlanRequest) -> bool:
    """Whether a fragile motion is to be preferred to an earlier one.

    By what contact takes with the believed object where that is much, else by how far slightly different ones stray.
    """
    share, other_share = delivery.replay.contact_share, other.replay.contact_share
    margin = request.settings.contact_margin
    if other_share > margin:
        return share < other_share
    return share <= margin and delivery.strays < other.strays


def _is_settled(
    delivery: Delivery,
    request: PlanRequest,
    scene: Scene,
    perturbations: tuple[Belief, ...] | None = None,
) -> bool:
    """Whether no other motion is less fragile: contact takes little, and it is the part that does not stay."""
    hard = delivery.replay.contact_share > request.settings.contact_margin
    return not hard and cannot_stay(request, scene, perturbations)


def judged(
    delivery: Delivery, request: PlanRequest, scene: Scene, perturbations: tuple[Belief, ...]
) -> Delivery:
    """The motion with what is found to be fragile about it: why it may end in a protection stop, or lose the part."""
    share, margin = delivery.replay.contact_share, request.settings.contact_margin
    if share > margin:
        hard = (
            f"fragile: contact takes {share:.0%} of a joint's torque limit, more than {margin:.0%}; "
            "the executor takes half of it for a collision"
        )
        return replace(delivery, fragile=hard, hits=False, strays=np.inf)
    scenes = [perturbation.applied(scene) for perturbation in perturbations]
    lever_m = _lever_m(delivery, scene, request.others)
    fragile, hits, strays = None, False, 0.0
    for perturbation, played in zip(
        perturbations, replays(delivery.trajectory, request, scenes), strict=True
    ):
        excess = _excess(played, request)
        strays = max(strays, abs(played.error) if excess is None else np.inf)
        if fragile is None and excess is not None:
            fragile, hits = f"fragile: with the {perturbation} {excess}", played.contact is not None
        elif fragile is None:
            fragile = _lost(played.error, lever_m, request, scene, perturbation)
    return replace(delivery, fragile=fragile, hits=hits, strays=strays)


def _excess(played: Replay, request: PlanRequest) -> str | None:
    """What a slightly different object meets too much of, wherever it ends: touch, press or torque; None: nothing."""
    settings = request.settings
    if played.contact is not None:
        return f"it touches {played.contact}"
    if played.press_N > _FRAGILE_PRESS * settings.press_max_N:
        return f"it presses across the motion with {played.press_N:.0f} N"
    if played.contact_share > _FRAGILE_CONTACT * settings.contact_margin:
        return f"contact takes {played.contact_share:.0%} of a joint's torque limit"
    return None


def _lost(
    error: float, lever_m: float, request: PlanRequest, scene: Scene, perturbation: Belief
) -> str | None:
    """Why a slightly different object that ends ``error`` from the target counts as lost; None: it does not."""
    tolerance = request.settings.tolerance_m if scene.prismatic else request.settings.tolerance_rad
    displaced = _DISPLACED * float(np.linalg.norm(perturbation.shift_m)) / lever_m
    most = min(displaced, _LOST * abs(request.s_target - request.s_initial))
    if abs(error) <= max(_FRAGILE * tolerance, most):
        return None
    falls = _falls_with(request, scene, perturbation)
    if falls is not None:
        return (
            f"fragile, as any plan would be: with the {perturbation} the part does not stay at its target: "
            f"{falls}"
        )
    return f"fragile: with the {perturbation} it ends {error:+.4f} from the target"


def _lever_m(delivery: Delivery, scene: Scene, others: np.ndarray | None) -> float:
    """How far a fingertip goes that takes the part along by one unit of the joint: 1 for a slide, its radius [m]."""
    if scene.prismatic:
        return 1.0
    played = delivery.replay
    world = FineWorld(scene, played.q_meas[-1], played.final, others)
    joint, p_tip = scene.joint_id, world.data.site_xpos[scene.tool_site]
    arm = np.cross(world.data.xaxis[joint], p_tip - world.data.xanchor[joint])
    return max(_LEAST_LEVER_M, float(np.linalg.norm(arm)))


def cannot_stay(request: PlanRequest, scene: Scene, perturbations: tuple[Belief, ...] | None = None) -> bool:
    """Whether a slightly different part would leave the target untouched: any plan is fragile then.

    ``perturbations``: as for :func:`deliver`.
    """
    if perturbations is None:
        perturbations = perturbed(request.settings.doubt, scene.axis_at_rest())
    return any(_falls_with(request, scene, perturbation) is not None for perturbation in perturbations)


def _falls_with(request: PlanRequest, scene: Scene, perturbation: Belief) -> str | None:
    """Why a slightly different part would leave the target untouched, or None."""
    if is_coupled(scene):
        return None
    tolerance = request.settings.tolerance_m if scene.prismatic else request.settings.tolerance_rad
    return drift(request, perturbation.applied(scene), tolerance, request.s_target)


def _paths(request: PlanRequest, result: PlanResult) -> list[tuple[str, np.ndarray, int, float]]:
    """What to try in turn: name, path (n, dof), row of the touch, share of the speed."""
    end = result.hold_step
    touch = min(result.touch_step or 0, end - 1)
    motion = np.concatenate([result.q_meas[:end], result.q_cmd[end : end + 1]])
    route = np.concatenate([np.asarray(request.q_initial)[None], result.route])
    return [
        ("motion", motion, touch, 1.0),
        ("targets", result.q_cmd[: end + 1], touch, 1.0),
        ("route", route, result.route_touch + 1, 1.0),
        ("motion", motion, touch, 0.5),
    ]


def _corrected(
    request: PlanRequest,
    result: PlanResult,
    scene: Scene,
    path: np.ndarray,
    touch: int,
    timed: TimeLawSettings,
    followed: str,
) -> Delivery:
    """The delivery along one path.

    Raises:
        MotionHitsError: It touches something unexpected, or two links come too near to each other.
        PlanRefusedError: It does not end on target, or takes too much.
        TrajectoryError: It cannot be timed.
    """
    tolerance = request.settings.tolerance_m if scene.prismatic else request.settings.tolerance_rad
    shift = shift_with_part(path[-1], result.final, scene, request.others)
    ramp = np.clip((np.arange(len(path)) - touch) / max(len(path) - 1 - touch, 1), 0.0, 1.0)[:, None]
    extra, problem = 0.0, ""
    for correction in range(_CORRECTIONS + 1):
        trajectory = time_law(path + ramp * extra * shift, request.arm, timed, touch, scene.gravity)
        played = replay(trajectory, request, scene)
        found = played.problem(tolerance, request.settings)
        if found is None and abs(played.offset) < 0.5 * tolerance:
            near = scene.links.near(trajectory.q)
            if near is not None:
                raise MotionHitsError(f"on the way {near}")
            return Delivery(trajectory, played, correction, followed, timed.speed)
        problem = found or f"the timed motion ends {played.offset:+.4f} from the target"
        if played.contact is not None:
            raise MotionHitsError(problem)
        extra += played.offset
        if played.press_N > request.settings.press_max_N:
            break
        if played.torque_share > request.settings.torque_margin:
            break
        if abs(extra) > max(_LARGEST_M, 0.3 * abs(request.s_target - request.s_initial)):
            break
    raise PlanRefusedError(problem)
