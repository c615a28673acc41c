"""An arm's description is rarely finished: no friction at all, no motors, link masses from a drawing.

Such gaps sit on every joint at once. A search that adds one effect at a time would spend itself on them, and each
joint would be judged by a noise level set by the worst other joint. So, for models of three joints and more, friction
on every joint that has none, motor inertia likewise, and the inertial parameters of all links are first weighed
together, each joint with its own noise level; what does not pay for itself is dropped again. The search goes on from
there. Links are in it only where the model has no friction: who wrote that down measured the rest as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from s2r_host.gap.effects.base import Context
from s2r_host.gap.regression.base_terms import PREFIX
from s2r_host.gap.regression.link_group import LINKS, LinkGroup
from s2r_host.gap.regression.regression import TEMPER
from s2r_host.gap.regression.solution import Scored, Term

if TYPE_CHECKING:
    from s2r_host.gap.search.search import Search

LEAST_JOINTS = 3
BARE_SHARE = 0.5
LEAST_GAIN = 12.0
LEAST_LEVEL = 0.3
EDGE_STEPS = 10.0
ROUNDS = 3
RICHER = ("stribeck", "presliding", "asymmetric_friction", "load_dependent_friction")
BODY = ("mass", "inertia", "com_x", "com_y", "com_z")


@dataclass(frozen=True)
class _Part:
    """Columns of one candidate in the joint regression."""

    term: Term
    columns: np.ndarray
    prior: np.ndarray


def complete(search: Search) -> tuple[list[Term], list[list[Scored]]]:
    """Friction the model lacks on its joints, and link parameters, as chosen terms with their alternatives.

    Brings the rows of every joint to unit leftover on the way (``Problem.weight``), so that later terms are judged
    by the noise of their own joint.

    Returns:
        Terms and slots in the form of the search; empty for models that need none of this.
    """
    p = search.problem
    m = p.ctx.model.model
    if len(p.joints) < LEAST_JOINTS:
        return [], []
    bare = _most(p.joints, [j for j in p.joints if m.dof_frictionloss[j] == 0 and m.dof_damping[j] == 0])
    motorless = _most(p.joints, [j for j in p.joints if m.dof_armature[j] == 0])
    if not bare and not motorless:
        return [], []
    parts = [
        _Part(Term(name, j), *_columns(search, Term(name, j)))
        for j in bare
        for name in ("coulomb_friction", "viscous_friction")
        if not search.effects[name].blocked(p.ctx, j)
    ] if {"coulomb_friction", "viscous_friction"} <= set(search.effects) else []  # fmt: skip
    if "armature" in search.effects:
        parts += [_Part(Term("armature", j), *_columns(search, Term("armature", j))) for j in motorless]
    zeros = [Term(f"{PREFIX}effort@{p.ctx.model.joints[j]}", -1) for j in p.joints]
    parts += [_Part(t, *_columns(search, t)) for t in zeros if t.effect in search.effects]
    members = [b for b in p.base if b.name in BODY]
    if members and bare:
        search.effects[LINKS] = LinkGroup(members)
        parts.append(_Part(Term(LINKS, -1), *_columns(search, Term(LINKS, -1))))
    for _ in range(ROUNDS):
        factors = _level(search, parts)
        parts = [_Part(x.term, x.columns * factors[:, None], x.prior) for x in parts]
    gains: dict[tuple[str, int], float] = {}
    while parts:
        gains = _gains(search, parts)
        weakest = min(parts, key=lambda x: gains[x.term.key])
        if gains[weakest.term.key] > LEAST_GAIN:
            break
        parts.remove(weakest)
    parts = _without_links(search, parts, gains)
    terms = [x.term for x in parts]
    for x in parts:
        search.log(f"  + {x.term.effect} on {search.joint_name(x.term)}: gain {gains[x.term.key]:.0f}")
    slots = []
    for i, x in enumerate(parts):
        others = [t for k, t in enumerate(terms) if k != i]
        share = _held_share(search, others, x.term)
        own = Scored(x.term, gains[x.term.key], gains[x.term.key], share, np.zeros(0))
        slots.append([own])
    return _richer(search, terms, slots)


def _most(joints: list[int], without: list[int]) -> list[int]:
    """The joints a description is silent about, where those are at least half of all; none otherwise."""
    return without if len(without) >= BARE_SHARE * len(joints) else []


def _without_links(search: Search, parts: list[_Part], gains: dict[tuple[str, int], float]) -> list[_Part]:
    """Leave all links out again where one load, one tilt or one other cause explains as much as all of them."""
    others = [x for x in parts if x.term.effect != LINKS]
    if len(others) == len(parts):
        return parts
    terms = [x.term for x in others]
    scored, _ = search.scan(terms, TEMPER)
    best = next((s for s in scored if not s.term.effect.startswith(PREFIX)), None)
    if best is None or best.gain < gains[(LINKS, -1)]:
        return parts
    search.log(f"  {best.term.effect} on {search.joint_name(best.term)} explains as much as all links")
    return others


def _columns(search: Search, term: Term) -> tuple[np.ndarray, np.ndarray]:
    C, _, _, prior = search.matrix(term)
    return C, prior


def _level(search: Search, parts: list[_Part]) -> np.ndarray:
    """Divide the rows of each joint by its leftover under all parts; returns the factor applied, shape (rows,)."""
    p = search.problem
    X, prior = _stack(search, parts)
    fit = ~p.held
    theta = np.linalg.solve(X[fit].T @ X[fit] + np.diag(1.0 / prior**2), X[fit].T @ p.y[fit])
    left = search.without_drift(p.y - X @ theta, 1.0)
    factor = np.ones(len(p.y))
    for j in p.joints:
        rows = np.concatenate([np.arange(b.rows.start, b.rows.stop) for b in p.blocks if b.joint == j])
        mine = rows[fit[rows]]
        level = float(np.sqrt(np.mean(left[mine] ** 2))) if mine.size else 1.0
        factor[rows] = 1.0 / max(level, LEAST_LEVEL)
        if p.floor_source != "repeat" and level < 1.0:  # the estimate held what these few parameters explain
            p.floor[j] *= max(level, LEAST_LEVEL)
    p.y *= factor
    p.effort *= factor
    p.weight *= factor
    p.B *= factor[:, None]
    for d in p.drift:
        d.columns *= factor[d.rows][:, None]
    search.forget()
    return factor


def _stack(search: Search, parts: list[_Part]) -> tuple[np.ndarray, np.ndarray]:
    p = search.problem
    return (
        np.concatenate([p.B, *[x.columns for x in parts]], axis=1),
        np.concatenate([p.prior, *[x.prior for x in parts]]),
    )


def _gains(search: Search, parts: list[_Part]) -> dict[tuple[str, int], float]:
    """What leaving each part out costs: log evidence of the fit rows plus log prediction of the held-out rows."""
    p = search.problem
    X, prior = _stack(search, parts)
    fit = ~p.held
    G, g = X[fit].T @ X[fit], X[fit].T @ p.y[fit]
    H, h = X[p.held].T @ X[p.held], X[p.held].T @ p.y[p.held]
    edges = np.cumsum([p.B.shape[1], *[x.columns.shape[1] for x in parts]])

    def score(active: np.ndarray) -> float:
        a = np.ix_(active, active)
        A = G[a] / TEMPER + np.diag(1.0 / prior[active] ** 2)
        theta = np.linalg.solve(A, g[active] / TEMPER)
        _, logdet = np.linalg.slogdet(A)
        evidence = (
            0.5 * float(g[active] @ theta) / TEMPER - 0.5 * logdet - float(np.sum(np.log(prior[active])))
        )
        held = float(theta @ H[a] @ theta - 2.0 * theta @ h[active])
        return evidence - 0.5 * held / TEMPER

    everything = np.ones(X.shape[1], dtype=bool)
    full = score(everything)
    found = {}
    for k, part in enumerate(parts):
        without = everything.copy()
        without[edges[k] : edges[k + 1]] = False
        found[part.term.key] = full - score(without)
    return found


def _only_the_edge(ctx: Context, term: Term) -> bool:
    """Presliding over a few encoder steps is Coulomb friction with a better edge."""
    width = dict(term.shape).get("width")
    least = max(float(s.q_lsb[term.joint]) for s in ctx.sessions)
    return term.effect == "presliding" and width is not None and width < EDGE_STEPS * least


def _held_share(search: Search, others: list[Term], term: Term) -> float:
    """Share of the held-out misfit, on the rows of its joint, that a term takes."""
    p = search.problem
    mask = p.held & np.concatenate(
        [np.full(b.rows.stop - b.rows.start, term.joint in (-1, b.joint)) for b in p.blocks]
    )
    without, _, _, _ = _left(search, others, TEMPER)
    with_it, _, _, _ = _left(search, [*others, term], TEMPER)
    return 1.0 - float(np.sum(with_it[mask] ** 2)) / max(float(np.sum(without[mask] ** 2)), 1e-30)


def _left(
    search: Search, terms: list[Term], noise: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    x, B, y, covariance = search.solve(terms, noise)
    return search.without_drift(y - B @ x, noise), x, B, covariance


def _richer(
    search: Search, terms: list[Term], slots: list[list[Scored]]
) -> tuple[list[Term], list[list[Scored]]]:
    """Let a richer friction take the place of Coulomb's on its joint where the data ask for it."""
    p = search.problem
    fit = ~p.held
    for i, term in enumerate(terms):
        if term.effect != "coulomb_friction":
            continue
        others = [t for k, t in enumerate(terms) if k != i]
        base = search.marginal(others, fit, TEMPER)
        plain = search.best_shape(term.key, base, fit, TEMPER, refine=False)
        if plain is None:
            continue
        reference = plain[0] + search.predict([*others, term], TEMPER)[0]
        for name in RICHER:
            key = (name, term.joint)
            effect = search.effects.get(name)
            if effect is None or not effect.applies(p.ctx, term.joint) or effect.blocked(p.ctx, term.joint):
                continue
            best = search.best_shape(key, base, fit, TEMPER, refine=True)
            if best is None or _only_the_edge(p.ctx, best[1]):
                continue
            score = best[0] + search.predict([*others, best[1]], TEMPER)[0]
            gain = slots[i][0].gain if slots[i][0].term == term else 0.0
            share = _held_share(search, others, best[1])
            slots[i].append(Scored(best[1], score, gain + score - reference, share, np.zeros(0)))
        best_one = max(slots[i], key=lambda s: s.gain)
        if best_one.gain > slots[i][0].gain + LEAST_GAIN:
            search.log(f"    {best_one.term.effect} takes the place of Coulomb on {search.joint_name(term)}")
            terms[i] = best_one.term
        else:  # a lead too small to name a richer friction is no lead
            for s in slots[i][1:]:
                s.gain = min(s.gain, slots[i][0].gain - 1.0)
        slots[i].sort(key=lambda s: -s.gain)
    return terms, slots
