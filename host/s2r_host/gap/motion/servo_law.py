"""Which speed a position servo damps: the measured one alone, as many drives do, or its difference to the commanded.

A log may hold the commanded speed all the same. Read into a law that does not use it, it asks for kd times that speed
more than the drive gave, and a drive that is late by kd / kp seems to make up for it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from s2r_host.gap.recordings.recording import Recording

CLEARLY = 0.7  # spread of what the better law leaves of the effort, in that of the other


def with_speeds_used(rec: Recording) -> tuple[Recording, list[str]]:
    """The recording without commanded speeds that its position servos do not use, and a note for each.

    Only a recorded effort tells; without one the commanded speed is believed to count.
    """
    law, unused = rec.controller, []
    if law.kind != "position_servo":
        return rec, []
    for joint in rec.channels.get("dq_cmd", {}):
        q, q_cmd, tau = (rec.get(kind, joint) for kind in ("q", "q_cmd", "tau"))
        if q is None or q_cmd is None or tau is None or joint not in law.kp or not law.kd.get(joint):
            continue
        dq, ahead = rec.get("dq", joint), rec.get("tau_ff", joint)
        v = np.gradient(q, rec.t) if dq is None else dq
        asked = law.kp[joint] * (q_cmd - q) - law.kd[joint] * v + (0.0 if ahead is None else ahead)
        alone = float(np.std(tau - asked))
        both = float(np.std(tau - asked - law.kd[joint] * rec.channels["dq_cmd"][joint]))
        if alone < CLEARLY * both:
            unused.append(joint)
    if not unused:
        return rec, []
    kept = {j: x for j, x in rec.channels["dq_cmd"].items() if j not in unused}
    notes = [f"{rec.name}: the servo of '{j}' does not use its commanded speed" for j in unused]
    return replace(rec, channels=rec.channels | {"dq_cmd": kept}), notes
