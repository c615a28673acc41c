"""pytest plug-in ``s2r``: write a hardware-in-the-loop test in ten lines, run it on the stand-in or on the arm.

Fixtures: ``standin`` (the cell: where executor and camera listen), ``executor`` (a link that holds the lease, drives
enabled), ``bus_faults`` (frames of your own on the bus), ``virtual_time`` (the arm's own clock).
Marker ``s2r(seed=…, clock=…, pace=…, faults=[…])`` chooses the stand-in's world, clock and disturbances.
``--s2r-hardware ENDPOINT`` runs the same tests against a running executor of a real arm; tests that need the
stand-in are skipped there.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from s2r_host.testing.cell import BusFaults, Lab, LabExecutor, VirtualTime

_CHOICES = ("seed", "clock", "pace", "faults")


def pytest_addoption(parser: pytest.Parser) -> None:
    """The flag that means a real arm, and which arm."""
    group = parser.getgroup("s2r", "hardware-in-the-loop tests of an arm")
    group.addoption(
        "--s2r-hardware",
        metavar="ENDPOINT",
        default=None,
        help="Run against the executor at ENDPOINT (e.g. tcp/127.0.0.1:7447) instead of a stand-in. It moves an arm.",
    )
    group.addoption(
        "--s2r-camera", metavar="ENDPOINT", default="tcp/127.0.0.1:7448", help="With --s2r-hardware."
    )
    group.addoption(
        "--s2r-arm", metavar="NAME", default="xmate3pro", help="Shipped arm, or a folder with arm.yaml."
    )


def pytest_configure(config: pytest.Config) -> None:
    """Make the marker known."""
    config.addinivalue_line(
        "markers",
        "s2r(seed=1, clock='lockstep', pace=0, faults=()): the stand-in's world, clock and bus disturbances",
    )


@pytest.fixture
def standin(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Lab]:
    """The cell under test: a fresh stand-in with an executor, or the hardware that was named."""
    from s2r_host.testing.cell import hardware_lab, stand_in_lab

    config = request.config
    hardware: str | None = config.getoption("--s2r-hardware")
    arm = str(config.getoption("--s2r-arm"))
    wanted = _wanted(request.node.get_closest_marker("s2r"))
    lab: Lab
    if hardware is not None:
        if wanted.get("faults"):
            pytest.skip("bus faults are injected on the stand-in only")
        yield hardware_lab(hardware, str(config.getoption("--s2r-camera")), arm)
        return
    with stand_in_lab(tmp_path / "standin", arm, **wanted) as lab:
        yield lab


def _wanted(marker: pytest.Mark | None) -> dict[str, Any]:
    """What a test's marker asks of the stand-in; anything else would be lost without a word."""
    if marker is None:
        return {}
    other = [*map(repr, marker.args), *(name for name in marker.kwargs if name not in _CHOICES)]
    if other:
        text = f"@pytest.mark.s2r takes {', '.join(f'{name}=…' for name in _CHOICES)}, not {', '.join(other)}"
        pytest.fail(text, pytrace=False)
    return dict(marker.kwargs)


@pytest.fixture
def executor(standin: Lab) -> Iterator[LabExecutor]:
    """A link to the executor that holds the lease, with the drives enabled; leaves the arm at rest."""
    from s2r_host.testing.cell import open_executor

    with open_executor(standin) as link:
        yield link


@pytest.fixture
def bus_faults(standin: Lab) -> Iterator[BusFaults]:
    """A node of your own on the stand-in's bus: watch frames, send foreign ones."""
    from s2r_host.testing.cell import BusFaults

    if standin.bus is None:
        pytest.skip("bus faults are injected on the stand-in only")
    with BusFaults(standin.bus) as faults:
        yield faults


@pytest.fixture
def virtual_time(executor: LabExecutor) -> VirtualTime:
    """The arm's own clock: ticks of the executor, however fast or slow the machine is."""
    from s2r_host.testing.cell import VirtualTime

    return VirtualTime(executor)
