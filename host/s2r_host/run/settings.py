"""What a run can be told; checked once, then frozen."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from s2r_host.motion.lever_proposals import LeverPushSettings
from s2r_host.motion.lid_proposals import LidPushSettings
from s2r_host.motion.push_proposals import PushSettings
from s2r_host.motion.scene import Region
from s2r_host.perception.network_pushes import NetworkPushSettings
from s2r_host.run.task import DRAWER, LAPTOP, Point, Task
from s2r_protocol.cli.options import check_unused
from s2r_protocol.exits import UsageError

DEFAULT_EXECUTOR = "tcp/127.0.0.1:7447"
DEFAULT_CAMERA = "tcp/127.0.0.1:7448"

TEACHERS = ("torque", "touch", "gap")
"""Joint torques tell mass and friction of the part, touches and misses where its surfaces are, ``s2r gap`` names what
physics is left out (with ``learn_physics`` only)."""


@dataclass(frozen=True)
class RunSettings:
    """One run of ``s2r run``.

    Attributes:
        target: Wanted joint value [m or rad], 0 = as found in the first view; the task says which way is positive.
            None: asked for once the joint is known.
        from_pushed: The target counts from where the first push leaves the part instead.
        then: Further targets, one after the other, each from where the one before left the part; counted like it.
        task: Kind of object.
        out: Run folder; must be new or empty.
        executor, camera: Zenoh endpoints.
        tls: Folder with this host's certificate; None when both are on this machine.
        cell, camera_name: Names in the key space.
        arm: Shipped arm or a folder with one.
        seed: Of all chance on the host.
        pushes: First pushes at most: a further one only where the views so far do not tell the joint.
        attempts: Planned manipulations at most: the first and its corrections.
        plan_time_s: No further try at a plan that ends on target is begun after so much wall time, and none at the next
            best after as much again.
        ensemble: Believable objects that the planner scores every sequence with, drawn from the estimate's intervals.
        reactive: Watch the part while it is moved, and correct the motion on its way.
        learn_physics: After every third target, let the gap tool read what the arm felt of the joint, and plan on with
            what it names; after every target, learn how far beside the foreseen place motions leave the part.
        go_on: After a target that was missed or cannot be planned for, go on to the next one.
        without: What the run shall not learn from, of ``TEACHERS``; for measuring what it is worth.
        push_speed, travel_speed, plan_speed: Share of the time law's full speed. The time law itself keeps a plan
            calm while the tip moves the part: braking harder than friction does, it would let the part coast on.
        settle_s: Wait between the end of a motion and a picture.
        acknowledge_contact: After a protection stop for a collision on the way into contact, reset and go back the way
            the arm came. Otherwise the run ends there, and resetting is the operator's.
        dry_run: Look and plan the push, move nothing.
        push, lid_push, lever_push: Geometry of the first push on a drawer's front, a lid or a lever.
        network_push: Of pushes the push network proposes where nothing looks like a lever, or none of it gives way.
        at: Point of the part that is to be pushed, where there are several [m, base frame]; None: the host chooses.
        region: Where the object is looked for.
    """

    target: float | None
    out: Path
    task: Task = DRAWER
    then: tuple[float, ...] = ()
    from_pushed: bool = False
    executor: str = DEFAULT_EXECUTOR
    camera: str = DEFAULT_CAMERA
    tls: Path | None = None
    cell: str = "lab"
    camera_name: str = "front"
    arm: str = "xmate3pro"
    seed: int = 0
    pushes: int = 9
    attempts: int = 3
    plan_time_s: float = 300.0
    ensemble: int = 1
    reactive: bool = False
    learn_physics: bool = False
    go_on: bool = False
    without: tuple[str, ...] = ()
    push_speed: float = 0.25
    travel_speed: float = 0.6
    plan_speed: float = 0.6
    settle_s: float = 0.2
    acknowledge_contact: bool = False
    dry_run: bool = False
    at: Point | None = None
    push: PushSettings = field(default_factory=PushSettings)
    lid_push: LidPushSettings = field(default_factory=LidPushSettings)
    lever_push: LeverPushSettings = field(default_factory=LeverPushSettings)
    network_push: NetworkPushSettings = field(
        default_factory=lambda: NetworkPushSettings(depth_m=0.03, least_likelihood=0.05)
    )
    region: Region = field(default_factory=Region)

    def __post_init__(self) -> None:
        known = self.then if self.target is None else (self.target, *self.then)
        for target in known:
            self.task.targets.check(target)
        show = self.task.unit.show
        for before, after in pairwise(known):
            if abs(after - before) < self.task.tolerance:
                raise UsageError(
                    f"--then {show(after)} is where the target before it leaves the part ({show(before)}, good to "
                    f"{show(self.task.tolerance)[1:]}); leave it out"
                )
        if self.at is not None and self.task is LAPTOP:
            raise UsageError("--at chooses among several parts; a laptop has one lid, leave it out")
        for name in ("pushes", "attempts", "ensemble"):
            if getattr(self, name) < 1:
                raise UsageError(f"--{name} {getattr(self, name)} is not allowed; at least 1")
        if self.ensemble % 2 == 0:
            raise UsageError(
                f"--ensemble {self.ensemble} is not allowed; an odd number: the believed object and opposite pairs of "
                "others"
            )
        if unknown := set(self.without) - set(TEACHERS):
            raise UsageError(f"--without {sorted(unknown)[0]!r} is unknown; there are {', '.join(TEACHERS)}")
        if "gap" in self.without and not self.learn_physics:
            raise UsageError(
                "--without gap leaves out a part of --learn-physics; add that, or leave this out"
            )
        for name in ("push_speed", "travel_speed", "plan_speed"):
            value = getattr(self, name)
            if not 0.0 < value <= 1.0:
                raise UsageError(f"{name} = {value:g} is outside (0, 1]")
        check_unused(self.out)
