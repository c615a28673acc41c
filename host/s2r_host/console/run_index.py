"""The history of runs: an sqlite index of run folders, brought up to date by looking for ``run.json`` files."""

from __future__ import annotations

import json
import logging
import os
import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import Any

logger = logging.getLogger(__name__)

DEPTH = 3
INDEX_NAME = "index.sqlite"
NOT_ENDED = "not ended"
_VERSION = 3  # an index of another one is made anew
_SCHEMA = """
CREATE TABLE IF NOT EXISTS runs (
    folder TEXT PRIMARY KEY, mtime REAL, ended REAL, task TEXT, arm TEXT, unit TEXT, target REAL, delta REAL,
    code INTEGER, outcome TEXT, reason TEXT, plans INTEGER, wall_s REAL, seed INTEGER, arguments TEXT,
    told REAL
)
"""


@dataclass(frozen=True)
class RunEntry:
    """One run.

    ``target`` and ``delta`` [``unit``: m or rad] are None if it did not get that far; ``ended`` is Unix time. ``code``
    is None for a run that has told what it believes and not how it ended: it waits for a target, moves on, or was
    killed then. ``told`` [m or rad] is the first target of a run that asked for it, as ``--target`` counts, None before
    the answer. ``name`` is its folder below the runs, for lists: two runs may be called alike, in folders of two days.
    """

    name: str
    folder: Path
    ended: float
    task: str
    arm: str
    unit: str
    target: float | None
    delta: float | None
    code: int | None
    outcome: str
    reason: str
    plans: int
    wall_s: float
    seed: int
    arguments: tuple[str, ...]
    told: float | None

    @property
    def exit(self) -> str:
        """How it ended, in a word or two."""
        word = self.outcome.lower()
        return word if self.code is None else f"exit {self.code} {word}"


class RunIndex:
    """All runs below one folder.

    The index only saves reading every run again: it lies in that folder, or in memory where the folder takes no file
    (somebody else's, a full disk) or holds a damaged one.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._left_out: dict[str, float] = {}  # told once, and read again only when they have changed
        root.mkdir(parents=True, exist_ok=True)
        try:
            self._database = _opened(root / INDEX_NAME)
        except sqlite3.Error as error:
            self._database = self._in_memory(error)

    def refresh(self) -> int:
        """Read what is new or changed, forget what has gone; how many rows changed."""
        try:
            return self._refresh()
        except sqlite3.Error as error:
            self._database.close()
            self._database = self._in_memory(error)
            return self._refresh()

    def _in_memory(self, error: sqlite3.Error) -> sqlite3.Connection:
        logger.warning(
            "%s cannot be kept (%s); all runs are read anew at each start", self.root / INDEX_NAME, error
        )
        return _opened(":memory:")

    def _refresh(self) -> int:
        known = dict(self._database.execute("SELECT folder, mtime FROM runs"))
        present = {str(path.parent): path for path in _run_files(self.root)}
        gone = [(folder,) for folder in known if folder not in present]
        self._database.executemany("DELETE FROM runs WHERE folder = ?", gone)
        changed = 0
        for folder, path in present.items():
            mtime = path.stat().st_mtime
            if mtime in (known.get(folder), self._left_out.get(folder)):
                continue
            try:
                row = _row(path, mtime)
                self._database.execute(f"REPLACE INTO runs VALUES ({','.join('?' * len(row))})", row)
                changed += 1
            except (OSError, ValueError, LookupError, TypeError, OverflowError) as error:
                self._left_out[folder] = mtime
                what = f"{type(error).__name__}: {error}"
                logger.warning(
                    "%s", f"{path} is left out of the index: {what}".encode(errors="replace").decode()
                )
        self._database.commit()
        return changed + len(gone)

    def find(self, words: str = "", limit: int = 200) -> list[RunEntry]:
        """Runs in which every word occurs (folder, task, arm, outcome or reason), newest first."""
        clause, values = _matching(words)
        query = f"SELECT * FROM runs{clause} ORDER BY ended DESC LIMIT ?"
        return [_entry(row, self.root) for row in self._database.execute(query, [*values, limit]).fetchall()]

    def count(self, words: str = "") -> int:
        """How many runs :meth:`find` would find without a limit."""
        clause, values = _matching(words)
        (number,) = self._database.execute(f"SELECT COUNT(*) FROM runs{clause}", values).fetchone()
        return int(number)

    def close(self) -> None:
        """Close the database."""
        self._database.close()


def _matching(words: str) -> tuple[str, list[str]]:
    """The clause of a query for runs in which every word occurs, and its values."""
    one = "(folder || ' ' || task || ' ' || arm || ' ' || outcome || ' ' || reason) LIKE ?"
    values = [f"%{word}%" for word in words.split()]
    return (" WHERE " + " AND ".join([one] * len(values)) if values else ""), values


def _opened(place: Path | str) -> sqlite3.Connection:
    database = sqlite3.connect(place, check_same_thread=False)
    if database.execute("PRAGMA user_version").fetchone() != (_VERSION,):
        database.execute("DROP TABLE IF EXISTS runs")
        database.execute(f"PRAGMA user_version = {_VERSION}")
    database.execute(_SCHEMA)
    return database


def _run_files(root: Path) -> list[Path]:
    patterns = ["/".join(["*"] * depth + ["run.json"]) for depth in range(1, DEPTH + 1)]
    return [path for pattern in patterns for path in root.glob(pattern)]


def _row(path: Path, mtime: float) -> tuple[Any, ...]:
    run = json.loads(path.read_text(encoding="utf-8"))
    settings, ended = run["inputs"]["settings"], run.get("ended", True)
    target = None if run["s_target"] is None else float(run["s_target"] - run.get("s_origin", 0.0))
    return (
        str(path.parent),
        mtime,
        mtime,
        str(run["task"]),
        str(run["arm"]["name"]),
        str(run.get("unit", "m")),
        target,
        None if run["delta"] is None else float(run["delta"]),
        int(run["exit"]["code"]) if ended else None,
        str(run["exit"]["name"]) if ended else NOT_ENDED,
        str(run["exit"]["reason"]),
        len(run["verdicts"]),
        float(run["wall_s"]),
        int(settings["seed"]),
        json.dumps([str(word) for word in run["inputs"]["arguments"]]),
        _told(run, target),
    )


def _told(run: dict[str, Any], target: float | None) -> float | None:
    """What a run that asked for its first target was told; older ones do not keep it, it may be their only target."""
    if "target_told" not in run:
        return None if run["inputs"]["settings"].get("then") else target
    return None if run["target_told"] is None else float(run["target_told"])


def _entry(row: tuple[Any, ...], root: Path) -> RunEntry:
    folder, _, ended, task, arm, unit, target, delta = row[:8]
    code, outcome, reason, plans, wall_s, seed, line, told = row[8:]
    return RunEntry(
        os.path.relpath(folder, root), Path(folder), ended, task, arm, unit, target, delta, code, outcome, reason,
        plans, wall_s, seed, tuple(json.loads(line)), told,
    )  # fmt: skip
