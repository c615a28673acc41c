"""``s2r log export --to rrd``: a Rerun recording with the arm in 3D, references, torques, texts and depth views."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from s2r_host.errors import MissingPartError
from s2r_host.log.arm_of import arm_of, in_arms_order
from s2r_host.log.arm_time import arm_times
from s2r_host.log.segments import notes
from s2r_host.log.tables import EXECUTOR_STATE, IMAGE, LOG, Joints, Recording
from s2r_host.report.arm_shapes import ArmShapes, quat_wxyz
from s2r_protocol.cli.outputs import check_place
from s2r_protocol.faults import ExecutorState
from s2r_protocol.ros2 import unpack

TIMELINE = "time"
POSE_HZ = 50.0
_LEVELS = {10: "DEBUG", 20: "INFO", 30: "WARN", 40: "ERROR", 50: "CRITICAL"}
_MEASURED, _REFERENCE = (217, 114, 46, 255), (59, 111, 182, 90)


def export_rrd(recording: Recording, path: Path, arm_name: str | None = None) -> Path:
    """Write the file; open it with ``rerun FILE`` or ``s2r view FILE``.

    Raises:
        MissingPartError: rerun-sdk is not installed.
        RecordingError: No joint states, or the arm is unknown.
        UsageError: ``path`` is a folder or lies in none.
    """
    check_place(path)
    try:
        import rerun as rr
    except ImportError as error:
        raise MissingPartError(
            "export to rrd needs the package rerun-sdk; install it with: pip install rerun-sdk"
        ) from error
    arm = arm_of(recording, arm_name)
    shapes = ArmShapes(arm)
    measured = in_arms_order(recording.joints(), arm, recording)
    # Rerun shows recordings of one name as one, and every run's is run.mcap.
    stream = rr.RecordingStream("s2r", recording_id=f"{recording.path.stem}-{measured.stamp_ns[0]}")
    with path.open("ab"):  # an OSError that names the file; Rerun's own is a bare RuntimeError
        pass
    stream.save(str(path), default_blueprint=_layout(tuple(measured.names)))
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _log_arm(rr, stream, shapes, measured, "arm/measured", _MEASURED)
    _log_joints(rr, stream, measured, "measured")
    if recording.has_references():
        reference = in_arms_order(recording.joints("joint_commands"), arm, recording)
        _log_arm(rr, stream, shapes, reference, "arm/reference", _REFERENCE)
        _log_joints(rr, stream, reference, "reference")
    _log_states(rr, stream, recording)
    _log_texts(rr, stream, recording)
    _log_views(rr, stream, recording)
    stream.flush()
    stream.disconnect()
    return path


def _layout(joints: tuple[str, ...]):  # noqa: ANN202 - rerun is imported late, it has types of its own
    """The arm and what the camera saw on the left, one plot per quantity and the events on the right."""
    import rerun.blueprint as rrb

    plots = [
        rrb.TimeSeriesView(
            origin="/joints", contents=[f"/joints/{joint}/{quantity}/measured" for joint in joints], name=name
        )
        for quantity, name in (("q_rad", "position [rad]"), ("tau_Nm", "torque [N·m]"))
    ]
    right = rrb.Vertical(*plots, rrb.TextLogView(origin="/executor", name="executor"), row_shares=[2, 2, 1])
    scene = rrb.Spatial3DView(origin="/", name="arm")
    return rrb.Blueprint(rrb.Horizontal(scene, right, column_shares=[3, 2]), collapse_panels=True)


def _times(rr, stamp_ns: np.ndarray):  # noqa: ANN001, ANN202 - rerun is imported late, it has types of its own
    return rr.TimeColumn(TIMELINE, timestamp=np.asarray(stamp_ns, "datetime64[ns]"))


def _log_arm(rr, stream, shapes: ArmShapes, joints: Joints, root: str, colour: tuple) -> None:  # noqa: ANN001
    for body in shapes.bodies:
        if len(body.vertices):
            mesh = rr.Mesh3D(
                vertex_positions=body.vertices, triangle_indices=body.faces, albedo_factor=colour
            )
            stream.log(f"{root}/{body.name}", mesh, static=True)
    chosen = _thinned(joints.stamp_ns, POSE_HZ)
    poses = np.array([shapes.poses(q) for q in joints.q[chosen]])
    for i, body in enumerate(shapes.bodies):
        quats = np.array([quat_wxyz(X[:3, :3]) for X in poses[:, i]])[:, [1, 2, 3, 0]]  # rerun wants xyzw
        columns = rr.Transform3D.columns(translation=poses[:, i, :3, 3], quaternion=quats)
        stream.send_columns(f"{root}/{body.name}", [_times(rr, joints.stamp_ns[chosen])], columns)


def _log_joints(rr, stream, joints: Joints, who: str) -> None:  # noqa: ANN001
    for quantity, values in (("q_rad", joints.q), ("dq_rad_s", joints.dq), ("tau_Nm", joints.tau)):
        if values is None:
            continue
        for i, name in enumerate(joints.names):
            columns = rr.Scalars.columns(scalars=values[:, i])
            stream.send_columns(f"joints/{name}/{quantity}/{who}", [_times(rr, joints.stamp_ns)], columns)


def _thinned(stamp_ns: np.ndarray, rate_hz: float) -> np.ndarray:
    """Indices at most so often, the last one included."""
    slots = (stamp_ns - stamp_ns[0]) // round(1e9 / rate_hz)
    _, first = np.unique(slots, return_index=True)
    return np.unique(np.append(first, len(stamp_ns) - 1))


def _log_states(rr, stream, recording: Recording) -> None:  # noqa: ANN001
    for topic in recording.of_type(EXECUTOR_STATE):
        last = None
        for stamp, data in zip(topic.stamp_ns, topic.messages, strict=True):
            body = unpack(EXECUTOR_STATE, data)
            if body["state"] != last:
                last = body["state"]
                stream.set_time(TIMELINE, timestamp=np.datetime64(stamp, "ns"))
                stream.log("executor/state", rr.TextLog(ExecutorState(int(last)).name, level="INFO"))


def _log_texts(rr, stream, recording: Recording) -> None:  # noqa: ANN001
    for topic in recording.of_type(LOG):
        for stamp, data in zip(topic.stamp_ns, topic.messages, strict=True):
            body = unpack(LOG, data)
            stream.set_time(TIMELINE, timestamp=np.datetime64(stamp, "ns"))
            stream.log(
                "executor/events", rr.TextLog(body["msg"], level=_LEVELS.get(int(body["level"]), "INFO"))
            )


def _log_views(rr, stream, recording: Recording) -> None:  # noqa: ANN001
    poses = [np.array(n["X_base_camera"]) for n in notes(recording) if n["kind"] == "view"]
    depths = [t for t in recording.of_type(IMAGE) if "/depth/" in t.name]
    infos = [t for t in recording.topics.values() if t.name.endswith("/depth/camera_info")]
    if not (poses and depths and infos):
        return
    stamps = np.asarray(arm_times(recording).get(depths[0].name, depths[0].stamp_ns)).astype("datetime64[ns]")
    for X, stamp, image, info in zip(
        poses, stamps, recording.bodies(depths[0]), recording.bodies(infos[0]), strict=False
    ):
        stream.set_time(TIMELINE, timestamp=stamp)
        stream.log("camera", rr.Transform3D(translation=X[:3, 3], mat3x3=X[:3, :3]))
        shape = (int(image["height"]), int(image["width"]))
        K = np.asarray(info["k"], float).reshape(3, 3)
        stream.log("camera/depth", rr.Pinhole(image_from_camera=K, width=shape[1], height=shape[0]))
        depth = np.frombuffer(np.asarray(image["data"], np.uint8).tobytes(), "<f4").reshape(shape)
        stream.log("camera/depth", rr.DepthImage(depth, meter=1.0))
