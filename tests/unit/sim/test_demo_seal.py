"""What `s2r demo` keeps from its host while that is at work."""

from contextlib import nullcontext

from click.testing import CliRunner

from s2r_protocol.exits import ExitCode
from s2r_sim.demo import cli, processes
from s2r_sim.sealed import host_seed
from s2r_sim.world import load_world


def test_the_host_is_told_neither_the_world_nor_its_seed(tmp_path, monkeypatch):
    told, started = [], []

    def run_host(arguments):
        told.extend(str(word) for word in arguments)
        assert not list(out.rglob("*.json"))
        return ExitCode.INTERRUPTED

    def peer(name, arguments, folder):
        started.extend(arguments)
        return nullcontext()

    out = tmp_path / "demo"
    monkeypatch.setattr(cli, "_run_host", run_host)
    monkeypatch.setattr(processes, "peer", peer)
    ended = CliRunner().invoke(cli.demo, ["--seed", "7301", "--out", str(out)], standalone_mode=False)
    assert ended.return_value == ExitCode.INTERRUPTED, ended.output
    assert told[told.index("--seed") + 1] == str(host_seed(7301))
    assert not [word for word in told if "7301" in word]
    hidden = started[started.index("--world") + 1]
    assert out not in hidden.parents
    assert not hidden.exists()
    assert load_world(out / "world.json").object.kind == "drawer"  # opened at the end
