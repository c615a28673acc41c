"""Planners by name: ours, others in its place, ours with one thing switched off."""

from __future__ import annotations

from dataclasses import dataclass, replace

from s2r_host.planning.bench.judo_peer import JudoSettings, judo_sampler, require_judo
from s2r_host.planning.sampler import SamplerFactory, icem_sampler
from s2r_host.planning.settings import PlanSettings, Stage, paper_settings
from s2r_protocol.exits import UsageError


@dataclass(frozen=True)
class Planner:
    """One side of a comparison. All share the scene, the places for the fingertip, the way there and the fine check.

    Attributes:
        settings: Of the planner.
        sampler: What draws the action sequences.
        doubted: Delivered only if slightly different objects are moved as well.
        places_free: The CPU of the search for places is not counted: the place to push at is a gift.
    """

    settings: PlanSettings
    sampler: SamplerFactory = icem_sampler
    doubted: bool = True
    places_free: bool = False

    def with_population(self, population: int) -> Planner:
        """One stage with so many samples per iteration, for curves of success over cost."""
        stage = replace(self.settings.cascade[0], population=population)
        return replace(self, settings=replace(self.settings, cascade=(stage,)))


def planner_named(name: str) -> Planner:
    """A planner by its name; ``name@N`` is that planner in one stage with N samples per iteration.

    Raises:
        UsageError: There is no such planner.
        NotReadyError: It is Judo, which is not installed.
    """
    base, at, population = name.partition("@")
    known = all_planners()
    if base not in known or (at and not population.isdigit()):
        raise UsageError(
            f"unknown planner {name!r}; there are {', '.join(known)}, each also as NAME@SAMPLES in one stage"
        )
    if base.startswith("judo"):
        require_judo()  # before anything is planned, not once per plan
    return known[base].with_population(int(population)) if at else known[base]


def all_planners() -> dict[str, Planner]:
    """All of them."""
    ours = PlanSettings()
    paper = replace(paper_settings(), backtracks=ours.backtracks)
    return {
        "ours": Planner(ours),
        "undoubted": Planner(ours, doubted=False),
        "ensemble3": Planner(replace(ours, ensemble=3)),
        "ensemble5": Planner(replace(ours, ensemble=5)),
        "ensemble3_undoubted": Planner(replace(ours, ensemble=3), doubted=False),
        "paper": Planner(paper, places_free=True),
        "paper_led": Planner(replace(paper, lead_in=True)),
        **_judo(ours),
        **{name: Planner(settings) for name, settings in _ablations(ours).items()},
    }


def _judo(ours: PlanSettings) -> dict[str, Planner]:
    """Judo's cross-entropy method at several settings, from the start pose; "judo" is the best on development tasks.

    The place to push at is given; proposals, cascade and retries are ours alone. "judo_led" also gets our way there.
    The weight on acceleration is zero: with the paper's, Judo's white knots freeze.
    """
    weights = replace(ours.weights, acceleration=0.0)
    base = replace(ours, weights=weights, proposal_speeds=(), retries=1, lead_in=False)

    def judo(stage: Stage, settings: JudoSettings) -> Planner:
        return Planner(replace(base, cascade=(stage,)), judo_sampler(settings), places_free=True)

    fine, coarse = Stage(0.010, 100, True), Stage(0.025, 60, True)
    best = judo(coarse, JudoSettings(elites=6))
    return {
        "judo": best,
        "judo_led": replace(best, settings=replace(best.settings, lead_in=True), places_free=False),
        "judo_10ms": judo(fine, JudoSettings()),
        "judo_wide": judo(coarse, JudoSettings(sigma_min=0.1, sigma_max=1.0)),
        "judo_4_knots": judo(coarse, JudoSettings(nodes=4)),
        "judo_10_elites": judo(coarse, JudoSettings()),
        "judo_100": judo(replace(coarse, population=100), JudoSettings()),
        "judo_7_ahead": judo(replace(coarse, horizon=7), JudoSettings(elites=6)),
        "judo_24": judo(replace(coarse, population=24, horizon=7), JudoSettings(elites=4)),
        "judo_shipped": judo(Stage(0.010, 16, True), JudoSettings(4, 2, 0.1, 1.0, 1)),
    }


def _ablations(ours: PlanSettings) -> dict[str, PlanSettings]:
    one = replace(ours, cascade=ours.cascade[:1])
    icem, weights = ours.icem, ours.weights
    # Alone: no sequences along a route that was found without the reward; the reward has to do all the work, in as many
    # control steps as the paper's planner has.
    alone = replace(one, proposal_speeds=(), max_steps=paper_settings().max_steps)

    # From the arm's home the reward has to find the way to the part as well.
    home = replace(alone, lead_in=False)
    terms = {
        "r_dist": {"distance": 0.0},
        "r_target": {"target": 0.0},
        "r_contact": {"contact": 0.0, "collision": 0.0},
        "r_reg": {"speed": 0.0, "acceleration": 0.0},
        "r_success": {"success": 0.0},
        "r_added": {"press": 0.0, "calm": 0.0, "load": 0.0},
    }

    def without(base: PlanSettings, name: str) -> PlanSettings:
        return replace(base, weights=replace(weights, **terms[name]))

    return {
        "no_cascade": one,
        "white_noise": replace(one, icem=replace(icem, noise_beta=0.0, knots=None)),
        "no_elite_memory": replace(one, icem=replace(icem, keep_elites=False, shift_elites=False)),
        "execute_mean": replace(one, icem=replace(icem, execute_best=False)),
        "no_proposals": alone,
        "home": home,
        **{f"no_{name}": without(alone, name) for name in terms},
        **{f"home_no_{name}": without(home, name) for name in terms},
    }
