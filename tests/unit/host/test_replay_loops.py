"""Several replays of one plan: what was made is kept and told, however the row of them ends."""

from types import SimpleNamespace
from typing import Any

import pytest

from s2r_host import cli_replay
from s2r_host.errors import ArmStoppedError
from s2r_protocol.faults import Cause


def test_a_stop_in_the_third_replay_loses_neither_of_the_two_before_it(tmp_path, capsys):
    told: list[int] = []

    def once(number: int) -> Any:
        if number == 3:
            raise ArmStoppedError("met something", Cause.COLLISION)
        return SimpleNamespace(recording=f"replay {number}".encode())

    folder = tmp_path / "replay-1"
    with pytest.raises(ArmStoppedError, match="met something"):
        cli_replay._replays(5, once, folder, lambda done: told.append(len(done)) or 0)
    assert {path.name: path.read_text() for path in folder.iterdir()} == {
        "replay-1.mcap": "replay 1",
        "replay-2.mcap": "replay 2",
    }
    assert told == [2]
    assert "2 of 5 replays were made before it ended" in capsys.readouterr().err


def test_nothing_is_reported_where_the_first_replay_failed(tmp_path):
    def once(_: int) -> Any:
        raise RuntimeError("first")

    with pytest.raises(RuntimeError, match="first"):
        cli_replay._replays(5, once, tmp_path, lambda _: pytest.fail("reported"))
