"""A page per machine: what is known of it, what the tool was given and answered, and the picture that shows it."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import dataclass
from html import unescape
from pathlib import Path

from .case import Case, Check, describe

COLOURS = 96  # of a picture: its dots need no more
MOST_EFFECTS = 12
PICTURES = (  # of a report, by their texts: the first kind that it has
    re.compile(r"residual effort of .* over .*\], before and after"),
    re.compile(r"residual effort of .* over speed\b.*"),
    re.compile(r"residual of each joint .*"),
)


@dataclass(frozen=True)
class Page:
    """What a person knows of a machine and its recordings; sentences in Markdown.

    Attributes:
        title: Name of the machine.
        source, licence: Of the recordings.
        known: What was known before the tool answered.
        given: What it was given.
        missed: Why it did not find what the table says it did not; empty where it did.
    """

    title: str
    source: str
    licence: str
    known: str
    given: str
    missed: str = ""


@dataclass(frozen=True)
class Answered:
    """One case of a machine with its answer; ``checks`` compare it with what is known."""

    case: Case
    answer: dict | None
    checks: list[Check]


def write_page(page: Page, machine: str, answers: list[Answered], reports: Path, docs: Path) -> Path:
    """Write ``docs/MACHINE.md`` with its pictures; returns its path.

    Args:
        page: Text about the machine.
        machine: Its name in the bench.
        answers: Its cases.
        reports: Folder with a folder per case, which holds ``report.html``.
        docs: Where pages go; their pictures into ``pictures/`` there.
    """
    pictures = docs / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    lines = [
        f"# {page.title}",
        "",
        f"Written by `python tests/bench/bench_gap_real.py --only {machine} --out DIR --pages docs/machines` from the "
        "tool's own answers; of all machines together: [benchmarks](../benchmarks/gap.md#real-machines).",
        "",
        f"**Recordings.** {page.source} Licence: {page.licence} They are not part of the project.",
        "",
        f"**Known.** {page.known}",
        "",
        f"**Given to the tool.** {page.given}",
    ]
    for one in answers:
        lines += ["", f"## {one.case.name}", "", *_answer(one)]
        shown = picture_of(reports / one.case.name / "report.html")
        if shown is not None:
            text, content = shown
            (pictures / f"{one.case.name}.png").write_bytes(content)
            lines += ["", f"![{text}](pictures/{one.case.name}.png)", "", f"*From its report: {text}.*"]
    if page.missed:
        lines += ["", "## What was missed, and why", "", page.missed]
    path = docs / f"{machine}.md"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _answer(one: Answered) -> list[str]:
    answer = one.answer
    if answer is None:
        return [f"No answer: {one.checks[0].found}."]
    lines = [f"Verdict: **{answer['verdict'].replace('_', ' ')}**."]
    effects = answer["effects"]
    lines += [""] if effects or answer["parameters_off"] else []
    lines += [f"- {describe(e)} on `{e['joint']}`" for e in effects[:MOST_EFFECTS]]
    lines += [
        f"- {p['name']} of `{p.get('body', p.get('joint'))}`: {p['from']:.4g} → {p['to']:.4g} {p['unit']}"
        for p in answer["parameters_off"][:MOST_EFFECTS]
    ]
    more = max(0, len(effects) - MOST_EFFECTS) + max(0, len(answer["parameters_off"]) - MOST_EFFECTS)
    lines += [f"- and {more} more in `gap.json`"] if more else []
    lines += ["", *_errors(answer["fit"])]
    if answer["verdict"] in ("insufficient", "unknown") and answer["notes"]:
        lines += ["It says: " + "; ".join(answer["notes"][:2]) + ".", ""]
    lines += ["| known, or asked for | found | |", "|---|---|---|"]
    return lines + [f"| {c.known} | {c.found} | {'yes' if c.ok else '**no**'} |" for c in one.checks]


def _errors(fit: dict) -> list[str]:
    told = []
    for key, words in (
        ("effort_holdout", "effort [N·m or N]"),
        ("open_loop_holdout", f"open loop [{fit['unit']}]"),
    ):
        before, after = fit.get(f"{key}_before"), fit.get(f"{key}_after")
        if before is not None and after is not None:
            told.append(f"{words} {before:.3g} → {after:.3g}")
    return [f"Held out, rms before and after: {'; '.join(told)}.", ""] if told else []


def picture_of(report: Path) -> tuple[str, bytes] | None:
    """The picture of a report that shows best what was found, with its text; None without a report or a picture."""
    if not report.is_file():
        return None
    found = re.findall(
        r"<img alt='([^']*)' src='data:image/png;base64,([^']*)'", report.read_text(encoding="utf-8")
    )
    for kind in PICTURES:
        for alt, content in found:
            if kind.fullmatch(unescape(alt)):
                return unescape(alt), _small(base64.b64decode(content))
    return None


def _small(content: bytes) -> bytes:
    """A PNG with few colours, a third of its size."""
    from PIL import Image

    stream = io.BytesIO()
    Image.open(io.BytesIO(content)).convert("RGB").quantize(COLOURS).save(stream, format="PNG", optimize=True)
    return stream.getvalue()
