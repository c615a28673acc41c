"""One master per bus: a lock that an executor holds as long as it lives, however it ends."""

from __future__ import annotations

import fcntl
import os
import tempfile
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

from s2r_protocol.exits import NotReadyError

_FOLDER = Path("/run/lock")  # of all users, empty after a start of the machine


class OneMaster:
    """Held while this process drives a bus. Another machine's or network name space's master is not seen by it."""

    def __init__(self, bus: str) -> None:
        """Take the lock.

        Args:
            bus: ``unix:PATH`` or ``can:IFACE``.

        Raises:
            NotReadyError: A process of this machine drives that bus already, the lock is another user's alone, or the
                folder that all users share takes no lock of an interface.
        """
        self._path = _lock_of(bus)
        self._file = _locked(self._path, bus)
        with suppress(OSError):  # of another user, who has gone: the lock holds, only the number is not ours
            os.ftruncate(self._file, 0)
            os.pwrite(self._file, f"{os.getpid()}\n".encode(), 0)

    def close(self) -> None:
        """Let the next master come."""
        with suppress(PermissionError):  # another user's file stays, and is no lock by itself
            self._path.unlink(missing_ok=True)
        os.close(self._file)


def _lock_of(bus: str) -> Path:
    """Beside a stand-in's socket, whatever path leads to it; of an interface, apart by its network name space.

    Where the socket's folder takes no files, or is not there at all, opening the bus is what tells so. An interface has
    one place for its lock: in a folder of its own (a service's private /tmp), a process would never meet another's.

    Raises:
        NotReadyError: That place takes no files.
    """
    kind, _, name = bus.partition(":")
    if kind == "unix":
        name = os.path.realpath(name)
        if _takes_files(Path(name).parent):
            return Path(f"{name}.lock")
    shared = _takes_files(_FOLDER)
    if kind == "can" and not shared:
        raise NotReadyError(
            f"{_FOLDER} takes no files of this user, so nothing keeps a second executor off {bus}: "
            f"'sudo install -d -m 1777 {_FOLDER}', and ReadWritePaths={_FOLDER} in a unit with ProtectSystem=strict"
        )
    folder = _FOLDER if shared else Path(tempfile.gettempdir())
    return folder / f"s2r-{kind}-{quote(name, safe='')}-{os.stat('/proc/self/ns/net').st_ino}.lock"


def _takes_files(folder: Path) -> bool:
    return os.access(folder, os.W_OK | os.X_OK)


def _locked(path: Path, bus: str) -> int:
    """Descriptor of the locked file; one that its holder took away meanwhile is no lock."""
    while True:
        file = _opened(path, bus)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.pread(file, 32, 0).decode(errors="replace").strip() or "unknown"
            os.close(file)
            raise NotReadyError(
                f"bus {bus} has a master already: the executor with process id {holder}; two would send setpoints to "
                "the same drives. Stop that one first, or name another --bus"
            ) from error
        if _is(file, path):
            return file
        os.close(file)


def _opened(path: Path, bus: str) -> int:
    """Descriptor of the file, made where there is none; of another user's to read, which is enough to lock it.

    Without O_CREAT on one that is there: in a folder of all users the kernel refuses that on the files of others.
    """
    for flags in (os.O_RDWR, os.O_RDONLY):
        try:
            return os.open(path, flags | os.O_CLOEXEC)
        except FileNotFoundError:
            return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except PermissionError:
            continue
    raise NotReadyError(
        f"bus {bus} has a master of another user, or had one: its lock {path} cannot be opened. End that executor, "
        "or have its user remove the file when there is none"
    )


def _is(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False
