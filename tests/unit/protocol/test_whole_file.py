"""A file that a full disk cuts off is not left behind."""

import resource
from contextlib import contextmanager

import pytest

from s2r_protocol.whole_file import write_whole


@contextmanager
def full_disk():
    """No file of this process may grow beyond a few bytes: what a full disk does, without one."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_what_is_cut_off_leaves_the_earlier_file_and_names_it(tmp_path):
    page = tmp_path / "page.html"
    with full_disk(), pytest.raises(OSError, match=r"page\.html"):
        write_whole(page, "x" * 100)
    assert list(tmp_path.iterdir()) == []
    write_whole(page, "earlier")
    with full_disk(), pytest.raises(OSError, match=r"page\.html"):
        write_whole(page, "x" * 100)
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    assert page.read_text() == "earlier"


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "page")
    write_whole(tmp_path / "link", "text")
    assert (tmp_path / "page").read_text() == "text"
