"""One master per bus."""

import os
from contextlib import closing

import pytest

from s2r_executor import one_master
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


def test_an_interface_whose_lock_others_would_not_see_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(one_master, "_FOLDER", tmp_path / "missing")
    with pytest.raises(NotReadyError, match=r"missing takes no files of this user.*ReadWritePaths="):
        OneMaster("can:can0")
    monkeypatch.setattr(one_master, "_FOLDER", tmp_path)
    with closing(OneMaster("can:can0")), pytest.raises(NotReadyError, match="has a master"):
        OneMaster("can:can0")


def of_another_user(monkeypatch, readable):
    """The kernel's answers on a file of another user in a folder of all users."""
    own = os.open

    def opened(path, flags, mode=0o777):
        refused = flags & (os.O_RDWR | os.O_CREAT) or not readable
        if refused and str(path).endswith(".lock") and os.path.exists(path):
            raise PermissionError(13, "Permission denied", str(path))
        return own(path, flags, mode)

    monkeypatch.setattr(os, "open", opened)


def test_the_master_of_another_user_is_told_as_such(tmp_path, monkeypatch):
    bus = f"unix:{tmp_path}/a.sock"
    with closing(OneMaster(bus)):
        of_another_user(monkeypatch, readable=True)
        with pytest.raises(NotReadyError, match=f"has a master already.*process id {os.getpid()}"):
            OneMaster(bus)
        of_another_user(monkeypatch, readable=False)
        with pytest.raises(NotReadyError, match="master of another user, or had one"):
            OneMaster(bus)


def test_a_lock_that_another_user_left_behind_is_taken(tmp_path, monkeypatch):
    bus = f"unix:{tmp_path}/a.sock"
    (tmp_path / "a.sock.lock").write_text("999999\n")

    def refused(*_arguments, **_more):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "unlink", refused)
    of_another_user(monkeypatch, readable=True)
    with closing(OneMaster(bus)), pytest.raises(NotReadyError, match="has a master already"):
        OneMaster(bus)
    with closing(OneMaster(bus)):
        pass
