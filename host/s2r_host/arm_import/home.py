"""The home pose of an imported arm: the one that was asked for, one of its SRDF, or the best that a search finds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from s2r_host.arm_import.convert import Imported, Wishes
from s2r_host.arm_import.home_search import Home, HomeSearch
from s2r_host.arm_import.srdf import named_poses
from s2r_protocol.arms import ArmDescription

_CHANGE = "change it with --home, or q_home in the file"


def with_home(found: Imported, urdf: Path, wishes: Wishes) -> Imported:
    """Give an arm its home pose, and say what it is based on."""
    arm = ArmDescription(found.source, urdf.parent)
    search = HomeSearch(arm)
    if wishes.home:
        home = search.judge(np.array(wishes.home))
        return _told(found, [f"home is as given: {home.told()}", *_warned(home)])
    told: list[str] = []
    for name, file, q in named_poses(urdf, arm.source):
        home = search.judge(q)
        if not home.faults:
            return _at(found, home, [f"home is '{name}' of {file.name}: {home.told()}; {_CHANGE}"])
        told.append(f"'{name}' of {file.name} is not taken for home: {'; '.join(home.faults)}")
    home = search.search()
    if home.faults:
        told.append(
            f"no home pose was found that keeps all that is asked; the best: {home.told()}; {_CHANGE}"
        )
    else:
        told.append(f"home was looked for: {home.told()}; {_CHANGE}")
    return _at(found, home, [*told, *_warned(home)])


def _warned(home: Home) -> list[str]:
    told = [f"home: {fault}" for fault in home.faults]
    if home.in_the_way is not None:
        first, second = home.in_the_way
        told.append(
            f"home: most poses fell out only as '{first}' and '{second}' are too near to each other there: if "
            f"these two cannot hurt each other, give --exclude {first},{second}"
        )
    return told


def _at(found: Imported, home: Home, told: list[str]) -> Imported:
    return _told(Imported(found.source.model_copy(update={"q_home": home.q}), found.told), told)


def _told(found: Imported, told: list[str]) -> Imported:
    return Imported(found.source, (*found.told, *told))
