"""One master per bus."""

import os

import pytest

from s2r_executor.one_master import OneMaster
from s2r_protocol.exits import NotReadyError


def test_a_second_master_of_a_bus_is_refused_until_the_first_has_gone(tmp_path):
    bus, other = f"unix:{tmp_path}/a.sock", f"unix:{tmp_path}/b.sock"
    with OneMaster(bus):
        with pytest.raises(NotReadyError, match=f"has a master already.*process id {os.getpid()}"):
            OneMaster(bus)
        with OneMaster(other):
            pass
    with OneMaster(bus):
        pass
    assert not list(tmp_path.iterdir())


def test_a_socket_is_one_bus_whatever_path_leads_to_it(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "folder")
    with OneMaster(f"unix:{tmp_path}/folder/a.sock"), pytest.raises(NotReadyError, match="has a master"):
        OneMaster(f"unix:{tmp_path}/link/a.sock")
