"""Success over CPU time per plan, one point per planner and population, one curve per planner."""

from __future__ import annotations

from pathlib import Path

from s2r_host.planning.bench.summary import Row, summary


def draw_curve(rows: list[Row], path: Path) -> None:
    """Write the picture; planners called ``name@samples`` are points of one curve."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    curves: dict[str, list[tuple[float, float, str]]] = {}
    for line in summary(rows):
        name, _, samples = line["planner"].partition("@")
        curves.setdefault(name, []).append((line["cpu_p50_s"], line["planned"] / line["plans"], samples))
    figure, axes = plt.subplots(figsize=(7.0, 4.5), layout="constrained")
    for name, points in curves.items():
        points.sort()
        cpu, share, samples = zip(*points, strict=True)
        axes.plot(cpu, [100.0 * value for value in share], "o-", label=name)
        for x, y, text in points:
            axes.annotate(text, (x, 100.0 * y), textcoords="offset points", xytext=(4, -11), fontsize=8)
    axes.set(
        xscale="log",
        xlabel="CPU of a plan, median [s]",
        ylabel="held on target in the fine model [%]",
        ylim=(-3.0, 105.0),
    )
    axes.grid(alpha=0.3, which="both")
    numbered = any(samples for points in curves.values() for _, _, samples in points)
    title = "numbers at the points: samples per iteration" if numbered else None
    axes.legend(title=title, fontsize=8, title_fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)
