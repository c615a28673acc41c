"""Following a run under way: stages, views and the joint estimate from the recording it is writing."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from s2r_host.errors import RecordingError
from s2r_host.log.segments import notes
from s2r_host.log.tables import CAMERA_INFO, IMAGE, Recording, read_recording

STALE_S = 120.0


@dataclass(frozen=True)
class StageLine:
    """A stage of the run: phase is begun, ended or failed."""

    name: str
    phase: str
    note: str


@dataclass(frozen=True, eq=False)
class RunSight:
    """What a run has shown so far. ``cloud`` (n, 3) [m] in the base frame, with ``colours`` (n, 3) or None."""

    folder: Path
    stages: list[StageLine]
    views: int
    cloud: np.ndarray | None = None
    colours: np.ndarray | None = None
    axis: tuple[np.ndarray, np.ndarray, str] | None = None
    ended: bool = False


@dataclass
class RunWatch:
    """Finds the run under way below a folder and reads it again when it has grown."""

    root: Path
    _size: int = field(default=-1)
    _sight: RunSight | None = field(default=None)

    def look(self) -> RunSight | None:
        """The newest run, None when there is none of the last two minutes."""
        path = self._newest()
        if path is None:
            self._sight, self._size = None, -1
            return None
        size = path.stat().st_size
        if self._sight is None or self._sight.folder != path.parent or size != self._size:
            try:
                self._sight = sight_of(path)
            except RecordingError:  # its first bytes are not written yet
                return self._sight
            self._size = size
        # What lies beside the recording comes after its last byte.
        self._sight = replace(self._sight, axis=axis_of(path.parent), ended=_has_ended(path.parent))
        return self._sight

    def _newest(self) -> Path | None:
        patterns = ("*/run.mcap", "*/*/run.mcap", "*/*/*/run.mcap")
        found = [path for pattern in patterns for path in self.root.glob(pattern)]
        if not found:
            return None
        newest = max(found, key=lambda path: path.stat().st_mtime)
        return newest if time.time() - newest.stat().st_mtime < STALE_S else None


def sight_of(path: Path) -> RunSight:
    """Everything a run's recording shows.

    Raises:
        RecordingError: It is no recording.
    """
    recording = read_recording(path)
    stages: dict[str, StageLine] = {}
    for note in notes(recording):
        if note["kind"] == "stage":
            stages[note["name"]] = StageLine(note["name"], note["phase"], note["note"])
    cloud, colours, views = last_view(recording)
    folder = path.parent
    return RunSight(folder, list(stages.values()), views, cloud, colours, axis_of(folder), _has_ended(folder))


def _has_ended(run: Path) -> bool:
    return (run / "run.json").exists()


def last_view(recording: Recording) -> tuple[np.ndarray | None, np.ndarray | None, int]:
    """Cloud (n, 3) [m] in the base frame, its colours, and number of the newest view; None, None, 0 before any."""
    poses = [np.array(n["X_base_camera"]) for n in notes(recording) if n["kind"] == "view"]
    depths = [t for t in recording.of_type(IMAGE) if "/depth/" in t.name]
    colours = [t for t in recording.of_type(IMAGE) if "/color/" in t.name]
    infos = recording.of_type(CAMERA_INFO)
    if not (poses and depths and infos):
        return None, None, 0
    views = min(len(poses), len(depths[0].messages))
    image = recording.bodies(depths[0])[views - 1]
    K = np.asarray(recording.bodies(infos[0])[0]["k"], float).reshape(3, 3)
    shape = (int(image["height"]), int(image["width"]))
    depth = np.frombuffer(np.asarray(image["data"], np.uint8).tobytes(), "<f4").reshape(shape)
    points, seen = cloud_of(depth, K, poses[views - 1])
    rgb = None
    if colours and len(colours[0].messages) >= views:
        body = recording.bodies(colours[0])[views - 1]
        rgb = np.asarray(body["data"], np.uint8).reshape(*shape, 3)[seen]
    return points, rgb, views


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
