"""Which rows of a table count, and what a column holds in them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.recordings.coarse_columns import between, coarsest, is_coarse
from s2r_host.gap.recordings.holes import LONGEST_S, MOVING, unknown_rows

MIN_SAMPLES = 50
LEAST_RATE_HZ = 1.0  # below it nothing of a motion is seen: 't' has another unit
NEEDED = ("q.", "tau.")  # columns without which nothing is compared
BURST_STEP, BURST_SHARE = 0.1, 0.3  # of the mean step, of the rows: more that come closer are no jitter


@dataclass(frozen=True, eq=False)
class UsableRows:
    """Rows of a table that count.

    Attributes:
        t: Time of all rows of the table [s], shape (rows,).
        rising: Those whose time rises, as indices; ``kept``: those of them that are compared.
    """

    t: np.ndarray
    rising: np.ndarray
    kept: np.ndarray

    def filled(self, column: str, values: np.ndarray, warnings: list[str]) -> np.ndarray | None:
        """A column in the kept rows, its empty cells interpolated; None where it holds too few numbers.

        Args:
            column: Its name.
            values: Of all rows of the table, shape (rows,).
            warnings: What that costs is added.
        """
        present = np.isfinite(values[self.rising])
        kept, own = values[self.kept], self.rising[present]
        empty = int(np.sum(~np.isfinite(kept)))
        if not empty:
            return kept
        if len(own) < MIN_SAMPLES:
            warnings.append(f"column '{column}' holds {len(own)} numbers and is ignored")
            return None
        coarse = _coarse_step_s(column, self.t, values, self.rising)
        if coarse * LEAST_RATE_HZ > 1.0:
            warnings.append(
                f"column '{column}' holds a number every {coarse:.3g} s, too rarely for a motion, and is ignored"
            )
            return None
        warnings.append(f"column '{column}': {empty} missing cells are interpolated")
        if coarse:
            return between(column, self.t[own], values[own], self.t[self.kept])
        return np.interp(self.t[self.kept], self.t[own], values[own])


def usable_rows(path: Path, t: np.ndarray, table: dict[str, np.ndarray], warnings: list[str]) -> UsableRows:
    """The rows of a table that count; what that costs is added to ``warnings``.

    Raises:
        GapRecordingError: Time falls back or is none, or too few rows are left.
    """
    rising = _rising_rows(path, t, warnings)
    kept = _rows_of_the_coarsest(t, table, rising, warnings)
    _check_rate(path, t[kept], warnings)
    return UsableRows(t, rising, _known_rows(path, t, table, rising, kept, warnings))


def _moves(column: str) -> bool:
    """Is this a channel that says how a joint moved or was driven?"""
    kind, _, joint = column.partition(".")
    return kind in MOVING and bool(joint)


def _rising_rows(path: Path, t: np.ndarray, warnings: list[str]) -> np.ndarray:
    keep = np.isfinite(t)
    if np.sum(~keep):
        warnings.append(f"{int(np.sum(~keep))} rows without a time are dropped")
    index = np.flatnonzero(keep)
    step = np.diff(t[index])
    if np.any(step < 0):
        row = int(index[np.argmax(step < 0) + 1])
        raise GapRecordingError(
            f"{path.name}: time falls back at row {row + 2} (t = {t[row]:.6g} s); it must rise"
        )
    double = np.flatnonzero(step == 0)
    if double.size:
        warnings.append(f"{double.size} rows repeat a time stamp and are dropped")
        index = np.delete(index, double + 1)
    if index.size < MIN_SAMPLES:
        raise GapRecordingError(f"{path.name}: {index.size} usable rows, at least {MIN_SAMPLES} are needed")
    return index


def _rows_of_the_coarsest(
    t: np.ndarray, table: dict[str, np.ndarray], rising: np.ndarray, warnings: list[str]
) -> np.ndarray:
    """The rows in which the coarsest channel of the motion holds numbers; all where none is coarse."""
    steps_s = {column: _coarse_step_s(column, t, x, rising) for column, x in table.items()}
    column = coarsest({c: step_s for c, step_s in steps_s.items() if 0.0 < step_s * LEAST_RATE_HZ <= 1.0})
    if column is None:
        return rising
    rows = rising[np.isfinite(table[column][rising])]
    without = "" if column.startswith(NEEDED) else "; without it all rows are"
    warnings.append(
        f"column '{column}' holds numbers in {len(rows)} of {len(rising)} rows, {1.0 / steps_s[column]:.3g} per "
        f"second: only these rows are compared{without}"
    )
    return rows


def _coarse_step_s(column: str, t: np.ndarray, x: np.ndarray, rising: np.ndarray) -> float:
    """Step between the numbers of a channel of the motion that holds them in few rows [s]; 0 of any other column.

    One that stays the same loses nothing between its numbers.
    """
    present = np.isfinite(x[rising])
    if not _moves(column) or present.sum() < MIN_SAMPLES or not is_coarse(present):
        return 0.0
    own = rising[present]
    return float(np.median(np.diff(t[own]))) if np.ptp(x[own]) > 0.0 else 0.0


def _check_rate(path: Path, t: np.ndarray, warnings: list[str]) -> None:
    steps = np.diff(t)
    _refuse_bursts(path, steps)
    dropped = int(np.sum(np.maximum(np.round(steps / np.median(steps)) - 1, 0)))
    if dropped:
        warnings.append(f"{dropped} samples are missing between the time stamps")
    rate_hz = round(1.0 / float(np.median(steps)), 3)
    if rate_hz < LEAST_RATE_HZ:
        raise GapRecordingError(
            f"{path.name}: rows are {np.median(steps):.4g} s apart; is 't' in ms or ns? Declare it under 'units' in "
            "the side file"
        )
    if rate_hz < 100.0:
        warnings.append(
            f"sampled at {rate_hz:.0f} Hz: effects faster than {rate_hz / 5:.0f} Hz cannot be seen"
        )


def _refuse_bursts(path: Path, steps: np.ndarray) -> None:
    """Refuse rows that come in bursts: stamped when they were read, the motion between them would be invented."""
    near = steps[steps <= LONGEST_S]
    usual = float(np.mean(near)) if near.size else 0.0
    close = near < BURST_STEP * usual
    share = float(np.sum(close)) / steps.size
    if share > BURST_SHARE:
        raise GapRecordingError(
            f"{path.name}: {share:.0%} of its rows come {np.median(near[close]):.2g} s after the one before, "
            f"at {usual:.2g} s from row to row on average; a driver that reads several frames at once stamps when it "
            "read them: stamp each when it was measured, or keep the last of each burst"
        )


def _known_rows(
    path: Path,
    t: np.ndarray,
    table: dict[str, np.ndarray],
    rising: np.ndarray,
    kept: np.ndarray,
    warnings: list[str],
) -> np.ndarray:
    """The kept rows without those in which a channel of the motion is empty for too long to be interpolated."""
    unknown = np.zeros(len(t), dtype=bool)
    for column, raw in table.items():
        present = np.isfinite(raw[rising])
        if not _moves(column) or present.all() or present.sum() < MIN_SAMPLES:
            continue
        own = np.zeros(len(t), dtype=bool)
        own[rising] = unknown_rows(t[rising], present)
        if own[kept].any():
            warnings.append(
                f"column '{column}' is empty for long in {int(own[kept].sum())} rows, which are left out"
            )
            unknown |= own
    known = kept[~unknown[kept]]
    if len(known) < MIN_SAMPLES:
        raise GapRecordingError(
            f"{path.name}: the columns hold numbers together in {len(known)} rows, at least {MIN_SAMPLES} are needed"
        )
    return known
