"""Design matrix: the whitened columns of every term, made once and kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_host.gap.effects import catalogue
from s2r_host.gap.effects.base import Effect
from s2r_host.gap.motion.model import FEW_JOINTS
from s2r_host.gap.regression.base_terms import base_terms, with_directions_held
from s2r_host.gap.regression.link_group import LinkGroup
from s2r_host.gap.regression.problem import Problem
from s2r_host.gap.regression.solution import Term


@dataclass(frozen=True)
class Stored:
    """Columns of one term on the rows they touch: those of its joint, or all (``joint`` -1)."""

    joint: int
    C: np.ndarray
    fixed: np.ndarray | None
    positive: np.ndarray
    prior: np.ndarray


class Design:
    """Keeps whitened columns, so that the same shape is never filtered twice."""

    def __init__(
        self,
        problem: Problem,
        skip: frozenset[str] = frozenset(),
    ) -> None:
        self.problem = problem
        self.looseness: float | np.ndarray = 1.0  # of the base parameters' priors, alike or one by one
        self.effects: dict[str, Effect] = {n: e for n, e in catalogue().items() if n not in skip}
        # A skipped effect that is a number of the model, too (a motor's inertia), is none there either.
        numbers = base_terms([p for p in problem.base if p.name not in skip])
        # On few joints a turned centre of mass and a turned zero are the same.
        self.effects |= (
            with_directions_held(numbers) if len(problem.ctx.model.joints) <= FEW_JOINTS else numbers
        )
        self._columns: dict[Term, Stored] = {}
        self.rows_of = {
            j: np.concatenate([np.arange(b.rows.start, b.rows.stop) for b in problem.blocks if b.joint == j])
            for j in problem.joints
        }  # fmt: skip

    def forget(self) -> None:
        """Drop stored columns after the problem's rows were scaled anew."""
        self._columns.clear()

    def matrix(self, term: Term) -> tuple[np.ndarray, np.ndarray | None, np.ndarray, np.ndarray]:
        """Whitened columns on all rows, fixed column, sign mask, prior deviations of a term."""
        s = self.stored(term)
        if s.joint < 0:
            return s.C, s.fixed, s.positive, s.prior
        C = np.zeros((len(self.problem.y), s.C.shape[1]))
        C[self.rows_of[s.joint]] = s.C
        fixed = None
        if s.fixed is not None:
            fixed = np.zeros(len(self.problem.y))
            fixed[self.rows_of[s.joint]] = s.fixed
        return C, fixed, s.positive, s.prior

    def stored(self, term: Term) -> Stored:
        """Columns of a term, made once."""
        stored = self._columns.get(term)
        if stored is None:
            effect = self.effects[term.effect]
            shape = dict(term.shape)
            sessions = {b.session.index: b.session for b in self.problem.blocks}
            per_session = {
                k: effect.columns(self.problem.ctx, s, term.joint, shape) for k, s in sessions.items()
            }
            C, fixed = self.problem.columns(per_session, term.joint)
            first = next(iter(per_session.values()))
            positive = np.array(first.positive or (False,) * C.shape[1], dtype=bool)
            own = [x.ndim == 1 for x in (*first.linear, *([] if first.fixed is None else [first.fixed]))]
            joint = term.joint if len(self.rows_of) > 1 and term.joint in self.rows_of and all(own) else -1
            if joint >= 0:
                rows = self.rows_of[joint]
                C, fixed = C[rows], None if fixed is None else fixed[rows]
            effort = self.problem.effort if joint < 0 else self.problem.effort[self.rows_of[joint]]
            # Where nothing drives the motion, what the model asks for is all there is to compare with.
            wanted = self.problem.y if joint < 0 else self.problem.y[self.rows_of[joint]]
            effort_rms = float(np.sqrt(max(np.mean(effort**2), np.mean(wanted**2)))) + 1e-12
            size = np.sqrt(np.mean(C**2, axis=0)) + 1e-12 * effort_rms
            prior = effect.deviations() if isinstance(effect, LinkGroup) else 0.5 * effort_rms / size
            stored = self._columns[term] = Stored(joint, C, fixed, positive, prior)
        return stored
