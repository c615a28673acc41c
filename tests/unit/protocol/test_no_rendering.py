"""Stand-in and host render nothing, and load nothing to render with."""

import os
import subprocess
import sys

import pytest

# A command that ends once it has loaded MuJoCo, in a process of its own.
SCRIPT = """
import sys
from s2r_protocol.cli.root import main
try:
    main(sys.argv[1:])
except SystemExit:
    import os
    print(*[name in sys.modules for name in ("mujoco", "glfw")], os.environ["MUJOCO_GL"])
"""


def loaded(folder, *words: str, **more: str) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"} | more
    command = [sys.executable, "-c", SCRIPT, *words]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=True
    )
    return done.stdout.splitlines()[-1]


STAND_IN = ("sim-arm", "--seed", "1", "--inject", "burn:it")
HOST = ("run", "drawer", "--target=0.1", "--executor", "tcp/127.0.0.1:9", "--camera", "tcp/127.0.0.1:9")


@pytest.mark.parametrize("words", [STAND_IN, HOST], ids=["stand-in", "host"])
def test_what_renders_nothing_loads_no_opengl(tmp_path, words):
    assert loaded(tmp_path, *words) == "True False disable"


def test_what_a_user_has_set_stays(tmp_path):
    assert loaded(tmp_path, *STAND_IN, MUJOCO_GL="egl").endswith(" egl")
