"""Slips in the options of ``s2r build-model`` are told by name, before anything is loaded."""

from __future__ import annotations

import click
import pytest

from s2r_host.model.cli import build_model, parse_region
from s2r_protocol.exits import UsageError


@pytest.mark.parametrize("text", ["nan,1,0,1,0,1", "0,1,0,nan,0,1", "0,1,1,0,0,1", "0,1,0,1,0"])
def test_a_region_that_is_no_box_is_refused(text):
    with pytest.raises(UsageError, match="six numbers"):
        parse_region(text)


def test_a_file_as_out_is_refused_at_once(tmp_path):
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(click.BadParameter, match="taken' is a file"):
        build_model.main(
            ["--before", "none.ply", "--after", "other.ply", "--out", str(tmp_path / "taken")],
            standalone_mode=False,
        )
    assert (tmp_path / "taken").read_text() == "mine"
