"""The map that betrays an effect: the residual over the quantity that the effect follows, before and after."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import Effect
from s2r_host.gap.motion.quantities import Quantity
from s2r_host.gap.motion.session import Session
from s2r_host.gap.output.drawing import AFTER, BEFORE, MEASURED, MUTED, WIDTH_IN, binned, dots, plain
from s2r_host.gap.pipeline import Analysis
from s2r_host.gap.regression.rows import compare, picks_of, residual
from s2r_host.gap.verdict.naming import Named

MEAN = {"marker": "o", "ms": 2.5}  # of a bin: all rows of one direction may be in a single one


@dataclass(frozen=True)
class EffectMap:
    """Rows of one joint over the quantity by which an effect betrays itself, all shape (rows,).

    Attributes:
        joint: On which the effect shows most.
        quantity: What ``x`` is; efforts are turned with the motion where it says so.
        x, before: Quantity and residual effort of the nominal model [N·m or N]; ``forward`` where the joint moves up.
        x_after, after: The same of what is left beside everything that was named.
        effect: Effort that the fitted effect asks for along ``x``; None where its numbers are not in the regression.
        alone: What everything but this effect leaves, along ``x``; None as well.
    """

    joint: int
    quantity: Quantity
    label: str
    x: np.ndarray
    before: np.ndarray
    forward: np.ndarray
    x_after: np.ndarray
    after: np.ndarray
    effect: np.ndarray | None
    alone: np.ndarray | None


def effect_map(a: Analysis, named: Named) -> EffectMap | None:
    """The map of a named effect; None for what is no effect of the catalogue."""
    assert a.problem is not None
    assert a.decision is not None
    effect = catalogue().get(named.term.effect)
    if effect is None:
        return None
    p, ctx, shape = a.problem, a.problem.ctx, dict(named.term.shape)
    joint = _joint(a, effect, named)
    quantity = effect.shown_over(shape)
    fitted = _fitted(a, named)
    # What the control law or two sensors told was set right before the regression: it shows in the rows as read.
    read = {s.index: s for s in [*a.fit, *a.hold]}
    parts: dict[str, list[np.ndarray]] = {k: [] for k in ("x", "before", "up", "x_after", "after", "effect")}
    for b in p.blocks:
        if b.joint != joint:
            continue
        s = b.session if fitted else read.get(b.session.index, b.session)
        picks = b.picks if fitted else picks_of(s, joint)
        turn, turn_after = (
            one.sign(joint)[rows] if quantity.turned else 1.0
            for one, rows in ((s, picks), (b.session, b.picks))
        )
        before = p.raw[b.rows] if fitted else residual(ctx.model, s, joint)[picks]
        asked = _asked(a, effect, named, s, joint)
        parts["x"].append(quantity.along(ctx.model, s, joint, shape)[picks])
        parts["before"].append(turn * before)
        parts["up"].append(s.v[picks, joint] > 0)
        parts["x_after"].append(quantity.along(ctx.model, b.session, joint, shape)[b.picks])
        parts["after"].append(turn_after * a.decision.solution.unexplained[b.rows])
        if asked is not None:
            parts["effect"].append(turn * asked[picks])
    if not parts["x"]:
        return None
    x, before, up, x_after, after = (
        np.concatenate(parts[k]) for k in ("x", "before", "up", "x_after", "after")
    )
    drawn = np.concatenate(parts["effect"]) if len(parts["effect"]) == len(parts["x"]) else None
    alone = after + drawn if fitted and drawn is not None else None
    label = quantity.label(ctx.model, joint, shape)
    return EffectMap(joint, quantity, label, x, before, up, x_after, after, drawn, alone)


def _fitted(a: Analysis, named: Named) -> bool:
    """Is the effect among the terms of the regression, or a part of one of them?"""
    assert a.decision is not None
    keys = {t.key for t in a.decision.solution.terms}
    brings = (catalogue()[t.effect] for t in a.decision.solution.terms if t.effect in catalogue())
    return named.term.key in keys or any(named.term.effect in e.contains for e in brings)


def _joint(a: Analysis, effect: Effect, named: Named) -> int:
    """The joint named; of what acts on all of them the one on which it is largest in noise floors."""
    assert a.problem is not None
    p = a.problem
    if named.term.joint >= 0:
        return named.term.joint
    size = dict.fromkeys(p.joints, 0.0)
    for b in p.blocks:
        asked = _asked(a, effect, named, b.session, b.joint)
        if asked is not None:
            size[b.joint] = max(size[b.joint], float(np.std(asked)) / p.floor[b.joint])
    return max(size, key=lambda j: size[j])


def _asked(a: Analysis, effect: Effect, named: Named, s: Session, joint: int) -> np.ndarray | None:
    """Effort that the fitted effect asks for in the band of the comparison, (time,); None where it has no numbers."""
    assert a.problem is not None
    if not effect.applies(a.problem.ctx, named.term.joint):
        return None  # as a session's friction that only a held-out recording shows
    columns = effect.columns(a.problem.ctx, s, named.term.joint, dict(named.term.shape))
    if len(columns.linear) != len(named.theta) or not (columns.linear or columns.fixed is not None):
        return None
    total = np.zeros(len(s.t))
    for x, size in [*zip(columns.linear, named.theta, strict=True), (columns.fixed, 1.0)]:
        if x is not None:
            total = total + size * (x[:, joint] if x.ndim == 2 else x)
    return compare(total, s, joint, not columns.smooth)


def effect_figure(a: Analysis, m: EffectMap) -> Figure:
    """Before and after beside the effect alone with its fitted curve."""
    assert a.problem is not None
    alone = m.alone is not None
    figure = Figure(figsize=(WIDTH_IN, 3.4), layout="constrained")
    panels = figure.subplots(1, 1 + alone, sharey=True, squeeze=False)[0]
    _before_and_after(panels[0], m, a.problem.floor[m.joint])
    if alone:
        _alone(panels[1], m, a.problem.floor[m.joint])
    turned = ",\ncounted against the motion" if m.quantity.turned else ""
    panels[0].set_ylabel(f"residual effort{turned} [{a.model.effort_unit(a.model.joints[m.joint])}]")
    for axes in panels:
        plain(axes)
        axes.set_xlabel(m.label)
        axes.legend(fontsize=8, frameon=False)
    return figure


def _before_and_after(axes: Axes, m: EffectMap, floor: float) -> None:
    dots(axes, m.x, m.before, BEFORE)
    dots(axes, m.x_after, m.after, AFTER)
    _by_direction(axes, m, m.before, BEFORE, "before")
    axes.plot(*binned(m.x_after, m.after), color=AFTER, lw=1.8, label="after everything named", **MEAN)
    if m.alone is None and m.effect is not None:
        _by_direction(axes, m, m.effect, MEASURED, "the fitted effect")
    axes.axhspan(-floor, floor, color=MUTED, alpha=0.15, lw=0)


def _alone(axes: Axes, m: EffectMap, floor: float) -> None:
    assert m.alone is not None
    assert m.effect is not None
    dots(axes, m.x, m.alone, BEFORE)
    axes.plot(*binned(m.x, m.alone), color=BEFORE, lw=1.4, label="without this effect alone", **MEAN)
    _by_direction(axes, m, m.effect, MEASURED, "the fitted effect")
    axes.axhspan(-floor, floor, color=MUTED, alpha=0.15, lw=0)


def _by_direction(axes: Axes, m: EffectMap, y: np.ndarray, colour: str, name: str) -> None:
    """Means over bins, forward and backward apart where the quantity does not tell them from each other."""
    if m.quantity.turned:
        axes.plot(*binned(m.x, y), color=colour, lw=1.8, label=name, **MEAN)
        return
    for mask, style, way in ((m.forward, "-", "forward"), (~m.forward, "--", "backward")):
        if mask.any():
            axes.plot(
                *binned(m.x[mask], y[mask]), style, color=colour, lw=1.6, label=f"{name}, {way}", **MEAN
            )
