"""A base install brings protocol and executor, and none of the heavy packages."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
UV = Path(sys.executable).with_name("uv")
HEAVY = ("torch", "open3d", "mujoco", "cv2", "matplotlib", "scipy")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not UV.exists(), reason="uv is not beside this interpreter"),
]


def _run(*command, **options):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, timeout=900, **options)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """A clean environment with the base lock and a wheel of this checkout."""
    folder = tmp_path_factory.mktemp("base")
    source, python = folder / "source", folder / "venv/bin/python"
    listed = _run("git", "ls-files", "-co", "--exclude-standard", cwd=ROOT).splitlines()
    for name in listed:
        if (ROOT / name).is_file() and not name.startswith("tests/"):
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, source / name)
    _run(sys.executable, "-m", "venv", "--without-pip", folder / "venv")
    _run(
        UV, "pip", "install", "--quiet", "--python", python, "--require-hashes", "-r", ROOT / "locks/base.txt"
    )
    path = f"{python.parent}:{os.environ['PATH']}"
    # Nothing here asks for speed, and C++ tests run elsewhere.
    quick = ("cmake.build-type=None", "cmake.define.S2R_BUILD_TESTS=OFF")
    _run(
        *(UV, "pip", "install", "--quiet", "--python", python, "--no-deps", "--no-build-isolation", source),
        *(part for setting in quick for part in ("-C", setting)),
        env={**os.environ, "PATH": path},
    )
    return python


def _s2r(python, *arguments):
    return subprocess.run([python.with_name("s2r"), *arguments], capture_output=True, text=True, timeout=600)


def test_heavy_packages_are_absent(base):
    code = f"import importlib.util as u; print([m for m in {HEAVY!r} if u.find_spec(m)])"
    assert _run(base, "-c", code).strip() == "[]"


def test_the_executor_and_its_native_core_are_there(base):
    code = (
        "import s2r_executor._native, s2r_executor.admission, pathlib\n"
        "folder = pathlib.Path(s2r_executor.__file__).parent\n"
        "print([p.name for p in folder.iterdir() if p.name == 's2r-rt'])"
    )
    assert _run(base, "-c", code, cwd="/").strip() == "['s2r-rt']"
    assert _s2r(base, "executor", "--help").returncode == 0


def test_a_command_of_another_part_says_what_to_install(base):
    ended = _s2r(base, "sim-arm", "--seed", "1")
    assert ended.returncode == 3
    assert "pip install 'sim2real2[sim]'" in ended.stderr
