"""Recordings that are read together: short strokes of one joint, each too short to say how much it leaves over."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import count_reversals
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.rows import LEAST_ROWS, Block

STROKE_ROWS = 4 * LEAST_ROWS  # from which on a part of a recording has a root mean square of its own


def together(problem: Problem) -> list[list[Block]]:
    """Blocks in groups: strokes of one joint and session with few rows as one, any other block by itself."""
    groups: dict[object, list[Block]] = {}
    for block in problem.blocks:
        short = len(block.picks) < STROKE_ROWS and not count_reversals(block.session, block.joint)
        key = (block.session.rec.session, block.joint) if short else block.rows.start
        groups.setdefault(key, []).append(block)
    return list(groups.values())


def left_over(problem: Problem, rows: np.ndarray, blocks: list[Block], *, held: bool) -> float | None:
    """Root mean square of what some blocks leave over, in noise floors; None where they have no such rows.

    Args:
        problem: With the floor.
        rows: Leftover effort of all rows [N·m or N], (rows,).
        blocks: Of one joint.
        held: Of the rows held out; else of those fitted.
    """
    masks = [(b, b.held if held else ~b.held) for b in blocks]
    parts = [(problem.rms(rows, b, mask) ** 2, int(mask.sum())) for b, mask in masks if mask.any()]
    if not parts:
        return None
    square = np.average([x for x, _ in parts], weights=[n for _, n in parts])
    return float(np.sqrt(square)) / problem.floor[blocks[0].joint]
