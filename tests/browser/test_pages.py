"""Written pages on a screen, a phone and paper."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure

from s2r_host.report.markup import page, section, table
from s2r_host.report.style import inline_png, inline_svg

A4_PX = 760  # its width between the margins

RIGHT = (
    "() => Math.max(...[...document.querySelectorAll('img, svg')].map(e => e.getBoundingClientRect().right))"
)


@pytest.fixture
def report(tmp_path):
    """A page with a wide figure of either kind and a table."""
    figure = Figure(figsize=(12.5, 4.0))
    figure.subplots().plot([0.0, 1.0])
    rows = [("joint", "prismatic")] * 3
    parts = [
        section("Seen", inline_png(figure, "a line")),
        section("Over time", inline_svg(figure)),
        table(("a", "b"), rows),
    ]
    path = tmp_path / "report.html"
    path.write_text(page("Report", parts), encoding="utf-8")
    return path.as_uri()


@pytest.mark.parametrize(("medium", "inside"), [("print", True), ("screen", False)])
def test_figures_are_swiped_on_a_phone_and_whole_on_paper(browser, report, medium, inside):
    opened = browser.new_page(viewport={"width": A4_PX, "height": 1000})
    opened.emulate_media(media=medium)
    opened.goto(report)
    assert (opened.evaluate(RIGHT) <= A4_PX) == inside
    assert opened.evaluate("() => document.documentElement.scrollWidth") <= A4_PX
    opened.close()
