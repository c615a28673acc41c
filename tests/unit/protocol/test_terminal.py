"""Commands whose terminal or reader is gone while nobody tells them: a forgotten job, a cut connection, a ``head``."""

import os
import subprocess
import sys

import pytest

from s2r_protocol.exits import ExitCode

S2R = [sys.executable, "-c", "from s2r_protocol.cli.root import main; main()"]


@pytest.mark.parametrize(
    ("arguments", "code"),
    [(["--help"], ExitCode.OK), (["state", "--executor", "tcp/127.0.0.1:1"], ExitCode.UNREACHABLE)],
)
def test_a_command_ends_as_it_would_with_its_terminal(arguments, code):
    ours, theirs = os.openpty()
    process = subprocess.Popen([*S2R, *arguments], stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    os.close(ours)
    assert process.wait(timeout=120) == code


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--help"], ExitCode.OK),
        (["completion", "bash"], ExitCode.OK),
        (["config", "show"], ExitCode.OK),
        (["state", "--executor", "tcp/127.0.0.1:1"], ExitCode.UNREACHABLE),
    ],
)
def test_a_command_ends_as_it_would_with_the_reader_of_its_pipe(arguments, code):
    ours, theirs = os.pipe()
    os.close(ours)
    process = subprocess.Popen([*S2R, *arguments], stdout=theirs, stderr=theirs)
    os.close(theirs)
    assert process.wait(timeout=120) == code


def test_lines_arrive_while_the_terminal_is_there():
    ours, theirs = os.openpty()
    process = subprocess.Popen([*S2R, "--version"], stdin=theirs, stdout=theirs, stderr=theirs)
    os.close(theirs)
    printed = b""
    try:
        while chunk := os.read(ours, 4096):
            printed += chunk
    except OSError:  # the other end is closed
        pass
    assert process.wait(timeout=120) == ExitCode.OK
    assert printed.startswith(b"s2r, version")
