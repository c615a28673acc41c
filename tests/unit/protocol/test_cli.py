"""The root command: lazy, and every end has its documented exit code."""

import errno
import os
import re
import subprocess
import sys

import click
import pytest

from s2r_protocol import exits
from s2r_protocol.cli import root
from s2r_protocol.cli.commands import COMMANDS


def _exit_code(monkeypatch, error, capsys):
    def fail():
        raise error

    monkeypatch.setattr(root, "_load", lambda name: click.Command(name, callback=fail))
    with pytest.raises(SystemExit) as ended:
        root.main(["stop"])
    return ended.value.code, capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (exits.UsageError("no such file"), 2),
        (exits.NotReadyError("no wheel"), 3),
        (exits.RefusedError("joint1 too fast"), 4),
        (exits.UnreachableError("no executor"), 5),
        (exits.ProtectionStopError("following error"), 6),
        (KeyboardInterrupt(), 130),
        (click.BadParameter("not a number"), 2),
    ],
)
def test_errors_end_with_a_sentence_and_their_code(monkeypatch, capsys, error, code):
    got, err = _exit_code(monkeypatch, error, capsys)
    assert got == code
    assert "Traceback" not in err
    assert str(error) in err


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [
        (PermissionError(errno.EACCES, "Permission denied", "lab/r"), 2, "lab/r: Permission denied; .*a place of"),
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "lab/r"), 2, "lab/r: .*the one above it must"),
        (OSError(errno.ENOSPC, "No space left on device", "lab/r"), 3, "lab/r: No space left on device; make room"),
        (OSError(errno.EFBIG, "File too large", "lab/r"), 3, "lab/r: File too large; raise the limit .*ulimit -f"),
        (OSError(errno.ENOSPC, "No space left on device"), 3, "s2r: No space left on device; make room"),
        (FileNotFoundError(errno.ENOENT, "No such file or directory"), 1, "Traceback(.|\n)*this is a bug"),
    ],
)  # fmt: skip
def test_what_a_file_system_refuses_names_the_file_and_the_way_out(monkeypatch, capsys, error, code, says):
    got, err = _exit_code(monkeypatch, error, capsys)
    assert got == code
    assert re.search(says, err), err


def test_an_unexpected_error_is_a_bug_with_its_traceback(monkeypatch, capsys):
    got, err = _exit_code(monkeypatch, ZeroDivisionError("oops"), capsys)
    assert got == 1
    assert "Traceback" in err
    assert "this is a bug" in err


def test_a_missing_extra_names_the_install_that_helps(monkeypatch):
    def missing(name):
        raise ModuleNotFoundError(f"No module named {name!r}", name="open3d")

    monkeypatch.setattr(root.importlib, "import_module", missing)
    with pytest.raises(exits.NotReadyError, match=r"pip install 'sim2real2\[host\]'"):
        root._load("run")


def test_a_package_missing_only_when_the_command_runs_names_the_install_too(monkeypatch, capsys):
    def fail():
        raise ModuleNotFoundError("No module named 'mujoco'", name="mujoco")

    monkeypatch.setattr(root, "_load", lambda name: click.Command(name, callback=fail))
    with pytest.raises(SystemExit) as ended:
        root.main(["sim-arm"])
    assert ended.value.code == 3
    assert "pip install 'sim2real2[sim]'" in capsys.readouterr().err


def test_a_missing_module_of_our_own_is_a_bug(monkeypatch, capsys):
    def fail():
        raise ModuleNotFoundError("No module named 's2r_sim.gone'", name="s2r_sim.gone")

    monkeypatch.setattr(root, "_load", lambda name: click.Command(name, callback=fail))
    with pytest.raises(SystemExit) as ended:
        root.main(["sim-arm"])
    assert ended.value.code == 1
    assert "this is a bug" in capsys.readouterr().err


def test_a_background_job_hears_ctrl_c():
    code = (
        "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "from s2r_protocol.cli import root\n"
        "import click, os\n"
        "root._load = lambda name: click.Command(name, callback=lambda: os.kill(os.getpid(), signal.SIGINT))\n"
        "root.main(['stop'])\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert run.returncode == 130, run.stderr


def test_ctrl_c_that_meets_a_native_module_while_it_loads_is_no_bug():
    code = (
        "import os, signal\nimport click\nfrom s2r_protocol.cli import root\n"
        "def load():\n"
        "    try:\n        os.kill(os.getpid(), signal.SIGINT)\n"
        "    except KeyboardInterrupt:\n        raise ImportError('initialization failed') from None\n"
        "root._load = lambda name: click.Command(name, callback=load)\n"
        "root.main(['stop'])\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert run.returncode == 130, run.stderr
    assert run.stderr == "s2r: interrupted\n"


@pytest.mark.parametrize(("interrupted", "code"), [(True, 130), (False, 1)])
def test_what_a_module_makes_of_an_interrupt_while_it_loads_is_no_bug(tmp_path, interrupted, code):
    """Trimesh catches it at an optional import, and stumbles over what it did not get."""
    kill = "os.kill(os.getpid(), signal.SIGINT)" if interrupted else "raise ImportError"
    (tmp_path / "mesh_like.py").write_text(
        f"import os, signal\ntry:\n    {kill}\nexcept BaseException as error:\n    Path = error\n"
        "def area() -> Path | None: ...\n"
    )
    script = (
        "import importlib, click\nfrom s2r_protocol.cli import root\n"
        "load = lambda: importlib.import_module('mesh_like')\n"
        "root._load = lambda name: click.Command(name, callback=load)\n"
        "root.main(['stop'])\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        timeout=600,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
    )
    assert run.returncode == code, run.stderr
    assert (run.stderr == "s2r: interrupted\n") is interrupted


def test_help_imports_none_of_the_heavy_packages():
    code = (
        "import sys\nfrom s2r_protocol.cli.root import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'numpy', 'mujoco', 'open3d', 'zenoh', 'pinocchio', 'cv2'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert run.returncode == 0, run.stderr
    for name in COMMANDS:
        assert name in run.stdout


def test_stop_imports_only_what_asking_needs():
    """Its start is on the way of a hand to the keyboard; seconds are the bench's, modules are pinned here."""
    code = (
        "import sys\nbefore = set(sys.modules)\nfrom s2r_protocol.cli.root import main\n"
        "try:\n    main(['stop', '--executor', 'tcp/127.0.0.1:1', '--timeout', '0'])\n"
        "except SystemExit as end:\n    assert end.code == 5, end.code\n"
        "print(*{name.partition('.')[0] for name in set(sys.modules) - before})\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert run.returncode == 0, run.stderr
    loaded = set(run.stdout.split())
    assert loaded - sys.stdlib_module_names == {"click", "google", "s2r_host", "s2r_protocol", "zenoh"}
    slow = {
        "asyncio",
        "concurrent",
        "email",
        "hashlib",
        "http",
        "logging",
        "random",
        "ssl",
        "subprocess",
        "tempfile",
    }
    assert not loaded & slow


def test_every_command_of_the_table_loads():
    for name in COMMANDS:
        assert isinstance(root._load(name), click.Command), name
