"""``s2r log export --to lerobot``: a LeRobot dataset (format v2.1), one episode per executed plan.

Layout: ``meta/info.json``, ``meta/tasks.jsonl``, ``meta/episodes.jsonl``, ``meta/episodes_stats.jsonl`` and
``data/chunk-000/episode_NNNNNN.parquet``. State: measured q, dq, tau. Action: the reference q one frame later.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from s2r_host.errors import RecordingError
from s2r_host.log.segments import Segment, inside, segments
from s2r_host.log.tables import Joints, Recording

CODEBASE_VERSION = "v2.1"
CHUNK = 1000
_DATA_PATH = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"


def export_lerobot(recording: Recording, folder: Path, fps: int = 50) -> int:
    """Write a dataset; the number of episodes.

    Raises:
        RecordingError: No executed plan with references in it, or the folder is not empty.
    """
    if folder.exists() and any(folder.iterdir()):
        raise RecordingError(f"{folder} exists and is not empty; name a new folder with --out")
    measured, reference = recording.joints(), recording.joints("joint_commands")
    found = segments(recording)
    episodes = [e for e in (_episode(measured, reference, s, fps) for s in found) if e is not None]
    if not episodes:
        raise RecordingError(f"{recording.path} holds no executed plan of at least two frames at {fps} Hz")
    tasks = list(dict.fromkeys(label for label, _ in episodes))
    (folder / "meta").mkdir(parents=True, exist_ok=True)
    total = 0
    lines, statistics = [], []
    for number, (label, frames) in enumerate(episodes):
        n = len(frames["timestamp"])
        frames |= {
            "frame_index": np.arange(n, dtype=np.int64),
            "episode_index": np.full(n, number, np.int64),
            "index": np.arange(total, total + n, dtype=np.int64),
            "task_index": np.full(n, tasks.index(label), np.int64),
        }
        path = folder / _DATA_PATH.format(episode_chunk=number // CHUNK, episode_index=number)
        path.parent.mkdir(parents=True, exist_ok=True)
        pa.parquet.write_table(_table(frames), path)
        lines.append({"episode_index": number, "tasks": [label], "length": n})
        statistics.append({"episode_index": number, "stats": {k: _statistics(v) for k, v in frames.items()}})
        total += n
    _write_lines(folder / "meta/tasks.jsonl", [{"task_index": i, "task": t} for i, t in enumerate(tasks)])
    _write_lines(folder / "meta/episodes.jsonl", lines)
    _write_lines(folder / "meta/episodes_stats.jsonl", statistics)
    info = _info(recording, measured, fps, len(episodes), total, len(tasks))
    (folder / "meta/info.json").write_text(json.dumps(info, indent=4) + "\n")
    return len(episodes)


def _episode(
    measured: Joints, reference: Joints, segment: Segment, fps: int
) -> tuple[str, dict[str, np.ndarray]] | None:
    keep = inside(measured.stamp_ns, segment)
    if keep.sum() < 2:
        return None
    t_have = (measured.stamp_ns[keep] - segment.begin_ns) * 1e-9
    t = np.arange(0.0, t_have[-1], 1.0 / fps)
    if len(t) < 2:
        return None
    state = [measured.q[keep], measured.dq[keep]]
    if measured.tau is not None:
        state.append(measured.tau[keep])
    t_reference = (reference.stamp_ns - segment.begin_ns) * 1e-9
    return segment.label, {
        "observation.state": _sampled(t, t_have, np.hstack(state)),
        "action": _sampled(t + 1.0 / fps, t_reference, reference.q),
        "timestamp": t.astype(np.float32),
    }


def _sampled(t: np.ndarray, t_have: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(t, t_have, column) for column in values.T]).astype(np.float32)


def _table(frames: dict[str, np.ndarray]) -> pa.Table:
    columns = {}
    for name, values in frames.items():
        if values.ndim == 2:
            columns[name] = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
        else:
            columns[name] = pa.array(values)
    return pa.table(columns)


def _statistics(values: np.ndarray) -> dict[str, list]:
    rows = values.reshape(len(values), -1).astype(float)
    return {
        "min": rows.min(axis=0).tolist(),
        "max": rows.max(axis=0).tolist(),
        "mean": rows.mean(axis=0).tolist(),
        "std": rows.std(axis=0).tolist(),
        "count": [len(rows)],
    }


def _info(
    recording: Recording, joints: Joints, fps: int, episodes: int, frames: int, tasks: int
) -> dict[str, Any]:
    quantities = ["q", "dq"] + (["tau"] if joints.tau is not None else [])
    state = [f"{quantity}.{name}" for quantity in quantities for name in joints.names]
    vector = lambda names: {"dtype": "float32", "shape": [len(names)], "names": names}  # noqa: E731
    number = lambda kind: {"dtype": kind, "shape": [1], "names": None}  # noqa: E731
    return {
        "codebase_version": CODEBASE_VERSION,
        "robot_type": recording.metadata.get("s2r", {}).get("arm", "unknown"),
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "total_videos": 0,
        "total_chunks": (episodes - 1) // CHUNK + 1,
        "chunks_size": CHUNK,
        "fps": fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": _DATA_PATH,
        "video_path": None,
        "features": {
            "observation.state": vector(state),
            "action": vector([f"q.{name}" for name in joints.names]),
            "timestamp": number("float32"),
            "frame_index": number("int64"),
            "episode_index": number("int64"),
            "index": number("int64"),
            "task_index": number("int64"),
        },
    }


def _write_lines(path: Path, rows: list[dict]) -> None:
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
