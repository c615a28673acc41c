"""Read joint states of a recording with mcap-ros2-support alone: any ROS 2 reader will do."""

import sys

import numpy as np
from mcap_ros2.reader import read_ros2_messages

rows = [
    (m.log_time_ns, list(m.ros_msg.position))
    for m in read_ros2_messages(sys.argv[1])
    if m.channel.topic.endswith("/joint_states")
]
t = np.array([stamp for stamp, _ in rows]) * 1e-9
q = np.array([position for _, position in rows])
print(
    f"{len(t)} joint states over {t[-1] - t[0]:.2f} s, joint 1 from {q[:, 0].min():+.3f} to {q[:, 0].max():+.3f} rad"
)
