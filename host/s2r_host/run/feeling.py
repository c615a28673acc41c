"""What the arm feels of the object while it pushes it, and what the belief makes of that.

All motions of a run that touched nothing teach the arm's own torques, and every push does until it comes near the part.
With these, every push is a recording of the object's joint. The more pushes, the better friction and mass are known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.object_shapes import part_obstacles
from s2r_host.object_names import JOINT
from s2r_host.proprioception.following import PushedPart, free_rows
from s2r_host.proprioception.object_log import Touch, touches, write_log
from s2r_host.proprioception.object_numbers import learn_numbers
from s2r_host.proprioception.own_torques import learn_own_torques
from s2r_host.proprioception.samples import Samples, samples_in
from s2r_host.run.belief import Belief, holding_friction
from s2r_host.run.object_file import with_lean, with_numbers
from s2r_host.run.session import Executed

SESSION = "run"  # its motions follow within minutes: friction has no reason to change from one to the next
SEARCH_M, SEARCH_RAD = 0.2, 0.8  # beyond what a part was moved it is not looked for


@dataclass(frozen=True, eq=False)
class _Push:
    """A motion that pushed the part: how the arm moved, the part as then believed, where it was before and after."""

    samples: Samples
    part: PushedPart
    s_from: float
    s_to: float
    most: float


def _push(belief: Belief, samples: Samples, s_from: float, s_to: float) -> _Push:
    positive = s_to > s_from
    part = PushedPart(
        part_obstacles(belief.path(positive))(0.0),
        belief.template.pose,
        belief.template.velocity,
        positive,
    )
    most = SEARCH_M if belief.template.slides else SEARCH_RAD
    return _Push(samples, part, s_from, s_to, abs(s_to - s_from) + most)


@dataclass
class Feeling:
    """Grows with every motion of a run.

    Attributes:
        arm: Whose torques these are.
        folder: Where the recordings of the object's joint go.
        by_motion: What was felt of the part so far, by the label of the motion.
    """

    arm: ArmModel
    folder: Path
    by_motion: dict[str, list[Touch]] = field(default_factory=dict)
    _free: list[Samples] = field(default_factory=list)
    _heard: set[int] = field(default_factory=set)
    _pushes: dict[str, _Push] = field(default_factory=dict)

    def feel(
        self,
        belief: Belief,
        executed: Sequence[Executed],
        pushed: Executed,
        s_from: float,
        s_to: float,
    ) -> list[Touch]:
        """What a motion that pushed the part tells about its joint; written down as a recording, too.

        Earlier ones are felt anew: the arm is known better by now.

        Args:
            belief: So far; the part's surface is taken from it.
            executed: All motions of the run so far: those that touched nothing teach the arm.
            pushed: The one that pushed the part.
            s_from, s_to: Joint value before and after it, by the camera [m or rad].
        """
        self._learn_arm(executed)
        samples = samples_in(pushed.recording) if pushed.recording is not None else None
        if samples is None:
            return []
        push = _push(belief, samples, s_from, s_to)
        self._free.append(samples.part(slice(0, free_rows(self.arm, samples, push.part, s_from))))
        self._pushes[pushed.label] = push
        own = learn_own_torques(self.arm.arm, self._free)
        if own is None:
            return []
        for label, push in self._pushes.items():
            felt = touches(own, self.arm, push.samples, push.part, push.s_from, push.s_to, push.most)
            self._write(label, felt, hinged=not belief.template.slides)
            self.by_motion[label] = felt
        return self.by_motion[pushed.label]

    @property
    def touched(self) -> list[Touch]:
        """All that was felt of the part so far."""
        return [touch for felt in self.by_motion.values() for touch in felt]

    def tell_anew(self, belief: Belief, moved: Mapping[str, tuple[float, float]]) -> None:
        """The part turned out to be hinged elsewhere: pushes are felt anew in that joint, by the next motion.

        Those that nothing tells in it are forgotten; what the arm taught of itself stays. Recordings go until then:
        they are of another joint than those that follow.

        Args:
            belief: In the other joint.
            moved: By the label of a motion, where the part was before and after it, by that joint [m or rad].
        """
        pushes = dict(self._pushes)
        for label in pushes:
            self._write(label, (), hinged=True)
        self._pushes.clear()
        self.by_motion.clear()
        for label in pushes.keys() & moved.keys():
            self._pushes[label] = _push(belief, pushes[label].samples, *moved[label])

    def _write(self, label: str, felt: Sequence[Touch], *, hinged: bool) -> None:
        """Put the recordings of a motion in the place of earlier ones of it."""
        write_log(felt, JOINT, self.folder, label.replace(" ", "-"), SESSION, hinged=hinged)

    def _learn_arm(self, executed: Sequence[Executed]) -> None:
        for one in executed:
            if one.free_from < 1.0 and one.recording is not None and one.seq not in self._heard:
                self._heard.add(one.seq)
                samples = samples_in(one.recording)
                if samples is not None:
                    self._free.append(samples.part(slice(int(one.free_from * len(samples)), None)))


def with_felt(belief: Belief, touched: Sequence[Touch], folder: Path) -> Belief:
    """The belief with mass and friction of the part as felt.

    A hinge's friction also holds its part wherever that was left: it is not believed smaller than that takes.

    Args:
        belief: So far.
        touched: All that was felt.
        folder: For the new files.
    """
    numbers = learn_numbers(belief.model.mjcf_path, JOINT, touched)
    if numbers is None:
        return belief
    friction = numbers.friction
    if not belief.template.slides:
        held = numbers.mass_share * holding_friction(belief.model.mjcf_path, belief.model.range)
        friction = max(friction, held)
    before = belief.felt.mass_share if belief.felt is not None else 1.0
    falling, growing = (
        with_numbers(
            source, JOINT, numbers.mass_share / before, friction, numbers.damping, folder / f"{name}-felt.xml"
        )
        for source, name in ((belief.falling, "falling"), (belief.growing, "growing"))
    )
    learnt = replace(belief, falling=falling, growing=growing, felt=numbers)
    felt_object(learnt, folder / "felt.xml")
    return learnt


def felt_object(belief: Belief, path: Path) -> Path:
    """Write the object as built, with mass, friction, damping and lean as felt: what recordings are held against.

    Args:
        belief: Of an object that was felt.
        path: Where the file goes.
    """
    felt = belief.felt
    assert felt is not None
    with_numbers(belief.model.mjcf_path, JOINT, felt.mass_share, felt.friction, felt.damping, path)
    return with_lean(path, JOINT, felt.lean, path)
