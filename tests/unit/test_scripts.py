"""The scripts in trees made for it: failures are not lost, what an interruption left is not taken for whole."""

import importlib.machinery
import importlib.util
import os
import re
import shutil
import subprocess
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def _program(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def _script(tree, name):
    (tree / "scripts").mkdir(parents=True, exist_ok=True)
    return shutil.copy(ROOT / "scripts" / name, tree / "scripts" / name)


def _run(tree, *words, **environment):
    path = f"{tree / 'bin'}:{os.environ['PATH']}"
    return subprocess.run(
        words, cwd=tree, capture_output=True, text=True, timeout=60, check=False,
        env=os.environ | {"PATH": path} | environment,
    )  # fmt: skip


@pytest.fixture
def proven(tmp_path):
    """A tree with ``scripts/prove`` and built C++ tests "one" and "two", below a folder with a space."""
    tree = tmp_path / "a checkout"
    _script(tree, "prove")
    (tree / "executor/native").mkdir(parents=True)
    (tree / "executor/native/gate.cpp").write_text("")
    (tree / "host/native").mkdir(parents=True)
    for words in (["init", "-q"], ["add", "."]):
        subprocess.run(["git", *words], cwd=tree, check=True)
    return tree


def _cpp_tests(tree, second_ends):
    binary = tree / "build/prove-plain/executor/native/tests/s2r_cpp_tests"
    _program(binary, f'[ $# = 0 ] && printf "one\\ntwo\\n"\n[ "$1" = two ] && exit {second_ends}\nexit 0')


def test_a_cpp_test_that_fails_is_a_step_that_failed(proven):
    _cpp_tests(proven, 1)
    ended = _run(proven, "scripts/prove", "native")
    assert ended.returncode != 0, ended.stdout
    assert "two failed" in ended.stderr
    assert not (proven / "build/prove/native.passed").exists()
    assert not (proven / "build/prove/native.txt").exists()


def test_cpp_tests_that_pass_are_counted_also_beside_a_file_that_is_gone(proven):
    _cpp_tests(proven, 0)
    (proven / "executor/native/gate.cpp").unlink()
    ended = _run(proven, "scripts/prove", "native")
    assert ended.returncode == 0, ended.stderr
    assert (proven / "build/prove/native.txt").read_text() == "2 C++ tests pass\n"


def test_lint_of_the_native_parts_is_done_again_for_either_of_them(proven):
    _program(proven / "scripts/lint-cpp", "exit 0")
    states = []
    for text in ("int a;", "int b;"):
        (proven / "host/native/reward.cpp").write_text(text)
        assert _run(proven, "scripts/prove", "tidy").returncode == 0
        states.append((proven / "build/prove/tidy.passed").read_text())
    assert states[0] != states[1]


def _checked(tree):
    """A tree with `scripts/check` whose style is as it should be."""
    _script(tree, "check")
    subprocess.run(["git", "init", "-q"], cwd=tree, check=True)
    for name in ("ruff", "lint-imports", "clang-format"):
        _program(tree / ".venv/bin" / name, "exit 0")


def test_wrong_types_end_clang_tidy_too(tmp_path):
    _checked(tmp_path)
    _program(tmp_path / "scripts/lint-cpp", "sleep 90 & echo $! >begun; mv begun tidy\nwait")
    _program(tmp_path / ".venv/bin/basedpyright", "while [ ! -e tidy ]; do sleep 0.05; done; exit 1")
    ended = _run(tmp_path, "scripts/check", "quick")
    assert ended.returncode == 1, ended.stderr
    assert not _runs(int((tmp_path / "tidy").read_text()))


def test_wrong_types_fail_the_check_though_the_tests_pass(tmp_path):
    _checked(tmp_path)
    _program(tmp_path / ".venv/bin/python", "echo all passed")
    _program(tmp_path / ".venv/bin/basedpyright", "echo a wrong type; exit 1")
    _program(tmp_path / "scripts/lint-cpp", "exit 0")
    ended = _run(tmp_path, "scripts/check")
    assert (ended.returncode, "all passed" in ended.stdout, "a wrong type" in ended.stdout) == (1, True, True)
    _program(tmp_path / ".venv/bin/basedpyright", "exit 0")
    assert _run(tmp_path, "scripts/check").returncode == 0
    _program(tmp_path / ".venv/bin/python", "exit 1")
    assert _run(tmp_path, "scripts/check").returncode == 1


def _runs(pid):
    """Whether a process still runs, a second after it was told to end."""
    for _ in range(20):
        state = Path(f"/proc/{pid}/stat")
        if not state.exists() or ") Z " in state.read_text():
            return False
        time.sleep(0.05)
    return True


def test_fault_tests_are_run_again_when_any_package_they_use_changes():
    loader = importlib.machinery.SourceFileLoader("prove_faults", str(ROOT / "scripts/prove-faults"))
    faults = importlib.util.module_from_spec(importlib.util.spec_from_loader("prove_faults", loader))
    loader.exec_module(faults)
    files = [f for p in faults.TESTS for f in ([ROOT / p] if p.endswith(".py") else (ROOT / p).rglob("*.py"))]
    used = {
        name
        for file in files
        for name in re.findall(r"^\s*(?:from|import) s2r_(\w+)", file.read_text(), re.M)
    }
    assert used <= set(faults.SOURCES)


def test_an_environment_whose_making_was_interrupted_is_completed(tmp_path):
    _script(tmp_path, "bootstrap")
    _program(tmp_path / ".venv/bin/python", "exit 0")  # there, and pip is not
    _program(tmp_path / "bin/dpkg-query", "echo install ok installed")
    _program(tmp_path / "bin/python3", '[ "$1" = -m ] && touch made\nexit 0')
    _run(tmp_path, "scripts/bootstrap", "base")
    assert (tmp_path / "made").exists()


def test_half_a_debian_tree_is_not_kept(tmp_path):
    _script(tmp_path, "fresh-debian")
    _program(tmp_path / "bin/id", "echo 0")
    _program(tmp_path / "bin/umount", "exit 1")
    _program(tmp_path / "bin/debootstrap", 'mkdir -p "$3/etc"; exit 1')
    ended = _run(tmp_path, "scripts/fresh-debian", "demo", TMPDIR=str(tmp_path))
    assert ended.returncode != 0
    assert not (tmp_path / "s2r-bookworm").exists()


def test_tests_of_training_are_named_without_their_compiled_forms(tmp_path):
    shutil.copy(ROOT / "Makefile", tmp_path / "Makefile")
    for name in ("test_learn.py", "__pycache__/test_learn.cpython-311.pyc"):
        path = tmp_path / "tests" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("needs the extra 'learn'")
    said = _run(tmp_path, "make", "-n", "test-learn").stdout
    named = re.search(r"\$\((grep .*)\)", said)[1]
    assert _run(tmp_path, "sh", "-c", named).stdout.split() == ["tests/test_learn.py"]
