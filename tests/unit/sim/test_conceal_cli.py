"""``s2r conceal`` on the command line."""

from click.testing import CliRunner

from s2r_conceal.cli import conceal
from s2r_conceal.errors import VerdictsMissingError
from s2r_conceal.seal import Key


def _invoke(*arguments):
    return CliRunner().invoke(conceal, [str(a) for a in arguments])


def test_a_set_is_drawn_with_a_random_seed_that_only_the_key_knows(tmp_path):
    out = tmp_path / "set"
    ended = _invoke("draw", "--cases", "clean=1", "--duration", "1.0", "--out", out)
    assert ended.exit_code == 0, ended.output
    seed = Key.read(tmp_path / "set.key.json").drawn_with["seed"]
    assert seed > 0
    assert all(
        str(seed) not in p.read_text() for p in out.rglob("*") if p.suffix in (".json", ".xml", ".yaml")
    )


def test_scoring_before_the_verdicts_are_hashed_is_refused(tmp_path):
    out = tmp_path / "set"
    _invoke("draw", "--seed", 1, "--cases", "clean=1", "--duration", "1.0", "--out", out)
    ended = _invoke("score", out, "--key", tmp_path / "set.key.json")
    assert isinstance(ended.exception, VerdictsMissingError)


def test_a_set_without_a_case_is_refused(tmp_path):
    ended = _invoke("draw", "--cases", "single=0,clean=0", "--out", tmp_path / "set")
    assert ended.exit_code == 2
    assert "ask for at least one" in ended.output
    assert not list(tmp_path.iterdir())


def test_a_malformed_count_is_named():
    ended = _invoke("draw", "--cases", "single:4", "--out", "x")
    assert ended.exit_code == 2
    assert "'single:4': write GROUP=NUMBER" in ended.output
