"""Training data that is cut off, overwritten or old is named with what makes it anew."""

import numpy as np
import pytest

from s2r_host.learn.pair_files import load_pairs
from s2r_host.learn.push_files import load_pushes
from s2r_host.perception.errors import InputError


@pytest.fixture
def written(tmp_path):
    """A file as large as one object's."""
    path = tmp_path / "lid-train-00000.npz"
    np.savez_compressed(path, depth=np.random.default_rng(1).integers(0, 9000, (60, 60), dtype=np.uint16))
    return path


def _cut(data: bytes) -> bytes:
    return data[: len(data) // 2]


def _overwritten(data: bytes) -> bytes:
    return data[: len(data) // 2] + bytes(64) + data[len(data) // 2 + 64 :]


@pytest.mark.parametrize("damage", [_cut, _overwritten, lambda data: b""])
def test_a_damaged_file_is_named_with_the_command_that_draws_it_again(written, damage):
    written.write_bytes(damage(written.read_bytes()))
    with pytest.raises(
        InputError, match=r"lid-train-00000\.npz is damaged .*'s2r data pushes' with the same options"
    ):
        load_pushes(written, 0)
    with pytest.raises(
        InputError, match=r"lid-train-00000\.npz is damaged .*'s2r data pairs' with the same options"
    ):
        load_pairs(written)


def test_a_file_of_an_older_version_is_named_with_what_it_lacks(written):
    with pytest.raises(InputError, match=r"has no K, .*; make it anew with 's2r data pushes'"):
        load_pushes(written, 0)
