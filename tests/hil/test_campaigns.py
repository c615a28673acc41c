"""T25, T48, T59 in numbers: the core class in virtual time with drives and faults in C++, judged by the oracle.

The quick forms run with every `make test`; the long ones with `make prove`. An episode takes 8 ms of CPU; on a
loaded machine a thousand have taken longer than a test usually may.
"""

from __future__ import annotations

import campaign
import pytest


def test_t59_random_pairs_of_faults_violate_nothing_quick():
    totals = campaign.run("pairs", 0, 150, gaps_allowed=True)
    assert totals["episodes"] == 150


@pytest.mark.prove
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("part", range(10))
def test_t59_ten_thousand_random_pairs_of_faults_violate_nothing(part):
    totals = campaign.run("pairs", 1000 * part, 1000, gaps_allowed=True)
    print(totals)
    assert totals["episodes"] == 1000


def test_t48_emergency_stops_at_random_moments_violate_nothing_quick():
    assert campaign.run("estop", 0, 60, gaps_allowed=False)["episodes"] == 60


@pytest.mark.prove
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("part", range(5))
def test_t48_ten_thousand_emergency_stops_at_random_moments_violate_nothing(part):
    assert campaign.run("estop", 2000 * part, 2000, gaps_allowed=False)["episodes"] == 2000


def test_t25_a_stream_of_random_replacements_breaks_no_limit_quick():
    totals = campaign.run("stream", 7, 1500, gaps_allowed=False)
    assert totals["commands"] > 25_000


@pytest.mark.prove
@pytest.mark.timeout(3600)
def test_t25_a_hundred_thousand_random_replacements_break_no_limit():
    totals = campaign.run("stream", 11, 100_000, gaps_allowed=False)
    print(totals)
    assert totals["commands"] > 2_000_000


def test_stepped_clock_misses_no_setpoint_quick():
    assert campaign.run("ticks", 3, 30_000, gaps_allowed=False)["commands"] >= 30_000


@pytest.mark.prove
@pytest.mark.timeout(3600)
def test_stepped_clock_misses_no_setpoint_in_a_million_ticks():
    totals = campaign.run("ticks", 3, 1_000_000, gaps_allowed=False)
    print(totals)
    assert totals["commands"] >= 1_000_000
