"""Following a run under way: stages, views and the joint estimate from the recording it is writing."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from mcap.records import Message

from s2r_host.errors import RecordingError
from s2r_host.log.scan import Scan
from s2r_host.log.segments import NOTES, note_of
from s2r_host.log.tables import CAMERA_INFO, IMAGE, TEXT, Channels, Topic
from s2r_protocol.ros2 import unpack

STALE_S = 120.0
RUN_JSON = "run.json"


@dataclass(frozen=True)
class StageLine:
    """A stage of the run: phase is begun, ended or failed."""

    name: str
    phase: str
    note: str


@dataclass(frozen=True, eq=False)
class RunSight:
    """What a run has shown so far. ``cloud`` (n, 3) [m] in the base frame, with ``colours`` (n, 3) or None.

    ``outcome`` is how it ended, in a sentence; empty before that.
    """

    folder: Path
    stages: list[StageLine]
    views: int
    cloud: np.ndarray | None = None
    colours: np.ndarray | None = None
    axis: tuple[np.ndarray, np.ndarray, str] | None = None
    ended: bool = False
    outcome: str = ""


@dataclass
class RunWatch:
    """Finds the run under way below a folder and reads what has come when its recording has grown."""

    root: Path
    _size: int = field(default=-1)
    _reader: RunReader | None = field(default=None)

    def look(self) -> RunSight | None:
        """The newest run, None when there is none of the last two minutes."""
        path = self._newest()
        if path is None:
            self._reader, self._size = None, -1
            return None
        size = path.stat().st_size
        if self._reader is None or self._reader.path != path or size < self._size:
            self._reader, self._size = RunReader(path), -1
        if size != self._size:
            try:
                self._reader.read_on()
            except RecordingError:  # its first bytes are not written yet
                return None
            self._size = size
        return self._reader.sight()

    def _newest(self) -> Path | None:
        patterns = ("*/run.mcap", "*/*/run.mcap", "*/*/*/run.mcap")
        found = [path for pattern in patterns for path in self.root.glob(pattern)]
        if not found:
            return None
        newest = max(found, key=lambda path: path.stat().st_mtime)
        return newest if time.time() - newest.stat().st_mtime < STALE_S else None


class RunReader:
    """What a run's recording shows, read as far as it is written; of its pictures only the newest are kept."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._scan = Scan(path)
        self._channels = Channels()
        self._stages: dict[str, StageLine] = {}
        self._poses: list[np.ndarray] = []
        self._depths, self._colours = Pictures("/depth/"), Pictures("/color/")
        self._K: np.ndarray | None = None
        self._shown: tuple[int, np.ndarray | None, np.ndarray | None] = (0, None, None)

    def read_on(self) -> None:
        """Read what has been written since the last time.

        Raises:
            RecordingError: It is no recording.
        """
        for record in self._scan.records():
            topic = self._channels.topic_of(record)
            if topic is not None and isinstance(record, Message):
                self._take(topic, record.data)
        views = min(len(self._poses), self._depths.count)
        depth = self._depths.image(views)
        if views > self._shown[0] and depth is not None and self._K is not None:
            self._shown = views, *seen_in(depth, self._colours.image(views), self._K, self._poses[views - 1])

    def _take(self, topic: Topic, data: bytes) -> None:
        if topic.type_name == TEXT and topic.short == NOTES:
            note = note_of(data)
            if note["kind"] == "stage":
                self._stages[note["name"]] = StageLine(note["name"], note["phase"], note["note"])
            elif note["kind"] == "view":
                self._poses.append(np.array(note["X_base_camera"]))
        elif topic.type_name == IMAGE:
            for pictures in (self._depths, self._colours):
                pictures.take(topic.name, data, beyond=self._shown[0])
        elif topic.type_name == CAMERA_INFO and self._K is None:
            self._K = np.asarray(unpack(CAMERA_INFO, data)["k"], float).reshape(3, 3)

    def sight(self) -> RunSight:
        """What has been read so far; what lies beside the recording, which comes after its last byte, is looked at."""
        views, cloud, colours = self._shown
        folder = self.path.parent
        return RunSight(
            folder,
            list(self._stages.values()),
            views,
            cloud,
            colours,
            axis_of(folder),
            *_ending(folder),
        )


class Pictures:
    """The images of the first topic with ``part`` in its name, counted from 1; those that were shown are let go."""

    def __init__(self, part: str) -> None:
        self._part, self._name = part, ""
        self._kept: dict[int, bytes] = {}
        self.count = 0

    def take(self, name: str, data: bytes, beyond: int) -> None:
        """Keep an image, if it is one of these, and of those before it none up to number ``beyond``."""
        if self._part not in name or self._name not in ("", name):
            return
        self._name = name
        self.count += 1
        self._kept = {number: kept for number, kept in self._kept.items() if number > beyond}
        self._kept[self.count] = data

    def image(self, number: int) -> Mapping[str, Any] | None:
        """One that is kept, decoded; None if there is none of this number."""
        data = self._kept.get(number)
        return None if data is None else unpack(IMAGE, data)


def sight_of(path: Path) -> RunSight:
    """Everything a run's recording shows.

    Raises:
        RecordingError: It is no recording.
    """
    reader = RunReader(path)
    reader.read_on()
    return reader.sight()


def _ending(run: Path) -> tuple[bool, str]:
    """Whether a run has ended, and how, in a sentence; a run that asks for its target writes ``run.json`` before."""
    try:
        text = (run / RUN_JSON).read_text(encoding="utf-8")
    except OSError:
        return False, ""
    try:
        told = json.loads(text)
        if not told.get("ended", True):
            return False, ""
        how = told["exit"]
        return True, f"exit {how['code']} {how['name'].lower()}: {how['reason']}"
    except (ValueError, LookupError, TypeError, AttributeError):  # of another release
        return True, ""


def seen_in(
    depth: Mapping[str, Any], colour: Mapping[str, Any] | None, K: np.ndarray, X_base_camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """Cloud (n, 3) [m] in the base frame of one view's images, and its colours."""
    shape = (int(depth["height"]), int(depth["width"]))
    depth_m = np.frombuffer(np.asarray(depth["data"], np.uint8).tobytes(), "<f4").reshape(shape)
    points, seen = cloud_of(depth_m, K, X_base_camera)
    if colour is None:
        return points, None
    return points, np.asarray(colour["data"], np.uint8).reshape(*shape, 3)[seen]


def cloud_of(depth_m: np.ndarray, K: np.ndarray, X_base_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) in the base frame of all pixels with depth, and which pixels those are (h, w)."""
    seen = (depth_m > 0) & np.isfinite(depth_m)
    v, u = np.nonzero(seen)
    z = depth_m[seen].astype(float)
    p_camera = np.column_stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z])
    return p_camera @ X_base_camera[:3, :3].T + X_base_camera[:3, 3], seen


def axis_of(run: Path) -> tuple[np.ndarray, np.ndarray, str] | None:
    """Where to draw the estimated joint, from the model the run has built; None before that.

    Returns:
        A point [m] in the base frame, on the axis of a hinge and in the moving part of a slide, whose axis is only a
        direction; the unit direction; the kind of joint.
    """
    path = run / "model/object.urdf"
    if not path.is_file():
        return None
    try:
        robot = ElementTree.parse(path).getroot()
    except ElementTree.ParseError:  # being written
        return None
    joint = robot.find("joint[@name='object_joint']")
    axis, origin = (None, None) if joint is None else (joint.find("axis"), joint.find("origin"))
    if joint is None or axis is None or origin is None:
        return None
    kind, direction = joint.attrib["type"], _vector(axis)
    mass = robot.find("link[@name='object_part']/inertial/origin")
    start = _vector(origin) + (_vector(mass) if kind == "prismatic" and mass is not None else 0.0)
    return start, direction / np.linalg.norm(direction), kind


def _vector(element: ElementTree.Element) -> np.ndarray:
    return np.array([float(x) for x in element.attrib["xyz"].split()])
