"""Many JointState messages at once.

Joint names and array lengths never change for one arm, so all its messages share one layout:
a template is filled column by column with numpy, which packs a thousand messages in the time of a few.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_protocol.ros2.cdr import pack

JOINT_STATE = "sensor_msgs/msg/JointState"


class JointStateEncoder:
    """Packs blocks of JointState messages of one arm; the bytes equal those of :func:`cdr.pack`.

    Args:
        joint_names: In the arm's order.
        frame_id: Header frame.
        has_effort: Whether messages carry the effort array.
    """

    def __init__(self, joint_names: tuple[str, ...], frame_id: str = "", has_effort: bool = True) -> None:
        dof = len(joint_names)
        marks = np.arange(1.0, 3 * dof + 1.0) * np.pi  # found again below: never part of a name or a length
        values = {
            "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame_id},
            "name": list(joint_names),
            "position": marks[:dof],
            "velocity": marks[dof : 2 * dof],
            "effort": marks[2 * dof :] if has_effort else [],
        }
        template = pack(JOINT_STATE, values)
        names = ["position", "velocity", "effort"][: 3 if has_effort else 2]
        offsets = [template.index(marks[i * dof : (i + 1) * dof].tobytes()) for i in range(len(names))]
        self._dtype = np.dtype(
            {
                "names": ["sec", "nanosec", *names],
                "formats": ["<i4", "<u4"] + [("<f8", (dof,))] * len(names),
                "offsets": [4, 8, *offsets],
                "itemsize": len(template),
            }
        )
        self._template = np.frombuffer(template, dtype=np.uint8)
        self.has_effort = has_effort
        self.size_bytes = len(template)

    def block(
        self,
        stamp_ns: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        effort: np.ndarray | None = None,
    ) -> list[bytes]:
        """Pack n messages.

        Args:
            stamp_ns: Header stamps, nanoseconds since the Unix epoch, shape (n,).
            position: [rad], shape (n, dof).
            velocity: [rad/s], shape (n, dof).
            effort: [N·m], shape (n, dof); needed when the encoder has effort.

        Raises:
            ValueError: Effort is missing, or given to an encoder without it.
        """
        if (effort is not None) != self.has_effort:
            raise ValueError(f"this encoder {'needs' if self.has_effort else 'has no'} effort")
        stamps = np.asarray(stamp_ns, dtype=np.int64)
        raw = np.tile(self._template, (len(stamps), 1))
        rows = raw.view(self._dtype)[:, 0]
        rows["sec"] = stamps // 1_000_000_000
        rows["nanosec"] = stamps % 1_000_000_000
        rows["position"] = position
        rows["velocity"] = velocity
        if effort is not None:
            rows["effort"] = effort
        whole = raw.tobytes()
        size = self.size_bytes
        return [whole[i * size : (i + 1) * size] for i in range(len(stamps))]

    def rows(self, messages: Sequence[bytes]) -> np.ndarray:
        """The other way round: n messages of this very layout as an array with a field per column, shape (n,).

        Raises:
            ValueError: A message has another length, so other names or arrays.
        """
        if any(len(message) != self.size_bytes for message in messages):
            raise ValueError(f"not all messages are {self.size_bytes} bytes long, the length of this layout")
        return np.frombuffer(b"".join(messages), self._dtype)
