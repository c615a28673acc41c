"""One master per bus."""

import os
from contextlib import closing

import pytest

from s2r_executor.one_master import OneMaster
from s2r_protocol.exits import NotReadyError


def test_a_second_master_of_a_bus_is_refused_until_the_first_has_gone(tmp_path):
    bus, other = f"unix:{tmp_path}/a.sock", f"unix:{tmp_path}/b.sock"
    with closing(OneMaster(bus)):
        with pytest.raises(NotReadyError, match=f"has a master already.*process id {os.getpid()}"):
            OneMaster(bus)
        with closing(OneMaster(other)):
            pass
    with closing(OneMaster(bus)):
        pass
    assert not list(tmp_path.iterdir())


def test_a_socket_is_one_bus_whatever_path_leads_to_it(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "folder")
    with (
        closing(OneMaster(f"unix:{tmp_path}/folder/a.sock")),
        pytest.raises(NotReadyError, match="has a master"),
    ):
        OneMaster(f"unix:{tmp_path}/link/a.sock")


def test_a_socket_in_a_folder_that_is_not_there_is_left_to_whoever_opens_it(tmp_path):
    bus = f"unix:{tmp_path}/missing/a.sock"
    with closing(OneMaster(bus)), pytest.raises(NotReadyError, match="has a master"):
        OneMaster(bus)
    assert not list(tmp_path.iterdir())
