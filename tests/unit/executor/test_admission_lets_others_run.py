"""While a long plan is checked, beats to the core and heartbeats of the host come through: no call holds them up."""

from __future__ import annotations

import threading
import time

import numpy as np
import pinocchio as pin
import pytest

from s2r_executor import _native
from s2r_executor.checks import collision, dynamics

KNOTS = 4096  # the largest plan


@pytest.fixture
def rounds():
    """How often another thread came to run, once a millisecond where it may."""
    count, ended = [0], threading.Event()

    def run():
        while not ended.wait(1e-3):
            count[0] += 1

    thread = threading.Thread(target=run)
    thread.start()
    yield count
    ended.set()
    thread.join()


def test_other_threads_run_while_stops_are_searched(admission, smooth_plan, arm, rounds, monkeypatch):
    search, during = _native.shortest_blends, []

    def watched(*arguments):
        before, begun = rounds[0], time.perf_counter()
        found = search(*arguments)
        during.append((rounds[0] - before, time.perf_counter() - begun))
        return found

    monkeypatch.setattr(_native, "shortest_blends", watched)
    admission.admit(smooth_plan(duration_s=120.0, knots=KNOTS), arm.q_home)
    ((ran, took_s),) = during
    assert took_s > 0.02
    assert ran >= 5


def test_pinocchio_gets_long_plans_in_pieces(admission, smooth_plan, arm, monkeypatch):
    def noting(name, sizes):
        call = getattr(pin, name)

        def noted(*arguments):
            sizes.append(arguments[2].shape[1])
            return call(*arguments)

        monkeypatch.setattr(pin, name, noted)

    torques, poses = [], []
    noting("rneaInParallel", torques)
    noting("computeCollisionsInParallel", poses)
    monkeypatch.setattr(collision, "_AT_ONCE", 64)
    admission.admit(smooth_plan(duration_s=60.0, knots=600), arm.q_home)
    assert sum(torques) > max(torques) == dynamics._AT_ONCE
    assert sum(poses) > max(poses) == 64


def test_torques_in_pieces_are_the_torques(admission, monkeypatch):
    rng = np.random.default_rng(5)
    q, dq, ddq = (rng.uniform(-1.0, 1.0, (500, 7)) for _ in range(3))
    whole = admission._dynamics.torque(q, dq, ddq)
    monkeypatch.setattr(dynamics, "_AT_ONCE", 64)
    np.testing.assert_array_equal(admission._dynamics.torque(q, dq, ddq), whole)
