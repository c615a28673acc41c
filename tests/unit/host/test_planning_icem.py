"""The sampler on its own: it knows no robot, so a quadratic does."""

from dataclasses import replace

import numpy as np
import pytest

from s2r_host.planning.icem import Icem
from s2r_host.planning.settings import IcemSettings, PlanSettingsError

BOUND = np.full(3, 0.05)
GOAL = np.linspace(-0.04, 0.04, 10)[:, None] * np.array([1.0, -1.0, 0.5])


def solve(settings: IcemSettings, seed: int = 0, steps: int = 1) -> tuple[Icem, float]:
    """Run control steps on a quadratic around GOAL; the best reward of the last one."""
    icem = Icem(settings, BOUND, np.random.default_rng(seed))
    for _ in range(steps):
        icem.begin()
        for _ in range(settings.iterations):
            samples = icem.sample()
            icem.update(samples, -((samples - GOAL) ** 2).sum(axis=(1, 2)))
    return icem, float(icem.ranked()[1][0])


def test_samples_stay_within_the_action_bound():
    icem = Icem(replace(IcemSettings(), sigma=5.0), BOUND, np.random.default_rng(0))
    icem.begin()
    assert np.abs(icem.sample()).max() <= 0.05


def test_iterations_improve_the_best_sample():
    few = solve(replace(IcemSettings(), iterations=1))[1]
    many = solve(replace(IcemSettings(), iterations=8))[1]
    assert many > 0.3 * few
    assert many > few


def test_population_decays_but_keeps_twice_the_elites():
    icem = Icem(replace(IcemSettings(), iterations=6), BOUND, np.random.default_rng(0))
    assert [icem.population(i) for i in range(6)] == [60, 48, 38, 30, 24, 20]


def test_kept_elites_return_in_the_next_iteration_and_only_if_switched_on():
    for keep in (True, False):
        icem = Icem(
            replace(IcemSettings(), keep_elites=keep, mean_in_last=False), BOUND, np.random.default_rng(0)
        )
        icem.begin()
        samples = icem.sample()
        best = samples[7]
        rewards = np.zeros(len(samples))
        rewards[7] = 1.0
        icem.update(samples, rewards)
        again = icem.sample()
        assert any(np.array_equal(best, sample) for sample in again) == keep
        assert len(again) == icem.population(1) + (3 if keep else 0)


def test_shifted_elites_start_the_next_control_step():
    icem = Icem(replace(IcemSettings(), iterations=1, mean_in_last=False), BOUND, np.random.default_rng(0))
    icem.begin()
    samples = icem.sample()
    rewards = np.zeros(len(samples))
    rewards[4] = 1.0
    icem.update(samples, rewards)
    icem.advance()
    icem.begin()
    expected = np.concatenate([samples[4][1:], samples[4][-1:]])
    assert np.array_equal(icem.sample()[60], expected)


def test_mean_is_evaluated_in_the_last_iteration_only():
    icem = Icem(replace(IcemSettings(), keep_elites=False), BOUND, np.random.default_rng(0))
    icem.begin()
    assert len(icem.sample()) == 60
    icem.update(np.zeros((60, 10, 3)), np.zeros(60))
    last = icem.sample()
    assert len(last) == 49
    assert not last[-1].any()


def test_proposals_join_the_first_iteration():
    icem = Icem(IcemSettings(), BOUND, np.random.default_rng(0))
    icem.begin()
    proposal = np.full((1, 10, 3), 0.01)
    samples = icem.sample(proposal)
    assert np.array_equal(samples[-1:], proposal)
    icem.update(samples, np.zeros(len(samples)))
    assert len(icem.sample(proposal)) == 48 + 3 + 1


def test_best_sample_is_executed_or_the_mean_if_told():
    best = solve(IcemSettings())[0].ranked()
    assert best[1][0] == best[1].max()
    mean = solve(replace(IcemSettings(), execute_best=False))[0].ranked()
    assert np.array_equal(mean[0][1], best[0][0])


def test_warm_start_keeps_the_mean_between_control_steps():
    warm = solve(replace(IcemSettings(), shift_elites=False), steps=6)[1]
    cold = solve(replace(IcemSettings(), shift_elites=False, warm_start=False), steps=6)[1]
    assert warm > cold


def test_rewards_that_are_not_finite_never_win():
    icem = Icem(replace(IcemSettings(), iterations=1), BOUND, np.random.default_rng(0))
    icem.begin()
    samples = icem.sample()
    rewards = np.zeros(len(samples))
    rewards[:20] = np.nan
    icem.update(samples, rewards)
    assert np.array_equal(icem.ranked()[0][0], samples[20])


def test_forgetting_drops_mean_and_elites():
    icem = solve(IcemSettings())[0]
    icem.forget()
    icem.begin()
    assert len(icem.sample()) == 60


@pytest.mark.parametrize(
    ("name", "value"),
    [("population", 1), ("elites", 1), ("elites", 61), ("decay", 0.9), ("knots", 11), ("momentum", 1.0)],
)
def test_settings_outside_their_range_are_refused_by_name(name, value):
    with pytest.raises(PlanSettingsError, match=name):
        replace(IcemSettings(), **{name: value})
