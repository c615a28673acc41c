"""A spring that returns a joint, with a loop beside it, is no cable.

A cable or hose rests amid the travel and bends both ways. A straight spring with a loop whose rest lies clear of the
travel pulls one way: that is a spring return and the loop of something else, which both have names of their own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from s2r_host.gap.effects.spring_return import EDGE

if TYPE_CHECKING:
    from s2r_host.gap.regression.solution import Scored, Term
    from s2r_host.gap.search.search import Search

LOOPS = ("hysteresis", "presliding")


def spring_and_loop(
    search: Search, chosen: list[Term], slots: list[list[Scored]]
) -> tuple[list[Term], list[list[Scored]]]:
    """Terms and slots with a cable that pulls one way taken apart, where both parts explain as much; else the same."""
    for i, term in enumerate(chosen):
        others = [t for k, t in enumerate(chosen) if k != i]
        if term.effect != "cable_spring" or not _pulls_one_way(search, others, term):
            continue
        scored, _ = search.scan_profiled(others)
        spring = next((s for s in scored if s.term.key == ("spring_return", term.joint)), None)
        own = next((s for s in scored if s.term.key == term.key), None)
        if spring is None or own is None:
            continue
        loops = [s for s in search.scan_profiled([*others, spring.term])[0] if s.term.key != term.key]
        if not loops or loops[0].term.effect not in LOOPS or spring.gain + loops[0].gain < own.gain:
            continue
        springs, _ = search.scan_profiled([*others, loops[0].term])
        if springs[0].term.key != spring.term.key:
            continue
        search.log(f"  cable_spring is {springs[0].term.effect} and {loops[0].term.effect}")
        rest = [s for k, s in enumerate(slots) if k != i]
        return [*others, springs[0].term, loops[0].term], [*rest, springs, loops]
    return chosen, slots


def _pulls_one_way(search: Search, others: list[Term], term: Term) -> bool:
    """Is the spring straight and its rest clear of the travel?"""
    ctx, fit = search.problem.ctx, ~search.problem.held
    low, high = ctx.span(term.joint)
    edge = EDGE * (high - low)
    base = search.marginal(others, fit, search.noise_level([*others, term]))
    theta = search.weigh(base, fit, term)[0].theta
    found = search.effects[term.effect].parameters(ctx, term.joint, dict(term.shape), theta)
    straight = not dict(term.shape)["hardens"]
    return straight and "rest" in found and not low - edge < found["rest"].value < high + edge
