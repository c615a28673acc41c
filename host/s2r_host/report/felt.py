"""Plot of what the arm felt of the object's joint: effort over position and over speed, beside the learnt model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib as mpl
from matplotlib.figure import Figure

from s2r_host.object_names import JOINT
from s2r_host.proprioception.object_log import Touch
from s2r_host.proprioception.object_numbers import explained
from s2r_host.report.style import RC
from s2r_host.run.belief import Belief
from s2r_host.run.task import Task

COLOURS = ("#20639b", "#d1495b", "#3c8d5a", "#8d6a9f", "#b8860b", "#555555")


def felt_figure(
    felt: Mapping[str, Sequence[Touch]], belief: Belief, task: Task, origin: float = 0.0
) -> Figure:
    """One colour per motion; left over the joint's position, right over time.

    Args:
        felt: Touches by the label of their motion.
        belief: What was learnt from them.
        task: For the unit of the joint.
        origin: Joint value that targets count from, 0 in the plot [m or rad].
    """
    scale, unit = task.unit.factor, task.unit.name
    effort = "N" if belief.template.slides else "N·m"
    with mpl.rc_context(RC):
        figure = Figure(figsize=(12.5, 3.8), layout="constrained")
        over_s, over_t = figure.subplots(1, 2, sharey=True)
        begun = 0.0
        for k, (label, touches) in enumerate(felt.items()):
            colour = COLOURS[k % len(COLOURS)]
            for number, one in enumerate(touches):
                name = label if number == 0 else None
                for axes, x in ((over_s, scale * (one.s - origin)), (over_t, begun + one.t - one.t[0])):
                    axes.fill_between(
                        x, one.effort - one.sigma, one.effort + one.sigma, color=colour, alpha=0.18, lw=0
                    )
                    axes.plot(x, one.effort, color=colour, lw=1.2, label=name)
                    if belief.felt is not None:
                        model = explained(belief.model.mjcf_path, JOINT, one, belief.felt)
                        axes.plot(x, model, color=colour, lw=1.2, ls="--")
                begun += float(one.t[-1] - one.t[0]) + 0.1
        for axes in (over_s, over_t):
            axes.axhline(0.0, color="#999999", lw=0.8)
        over_s.set(xlabel=f"{task.part} [{unit}]", ylabel=f"effort on the joint [{effort}]")
        over_t.set_xlabel("time in contact [s], one motion after the other")
        over_s.legend(fontsize=8)
        efforts = [0.0, *(float(v) for touches in felt.values() for one in touches for v in one.effort)]
        margin = (
            0.15 * (max(efforts) - min(efforts)) + 1e-6
        )  # the model's ends, where nothing moves, may leave the axes
        over_s.set_ylim(min(efforts) - margin, max(efforts) + margin)
        return figure
