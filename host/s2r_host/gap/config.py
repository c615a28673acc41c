"""``GAP.yaml``: the few switches of a run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from s2r_host.gap.effects import catalogue
from s2r_host.gap.errors import GapUsageError
from s2r_host.gap.yaml_files import read_yaml


@dataclass(frozen=True)
class GapConfig:
    """Switches of a run.

    Attributes:
        skip: Effects to leave out of the catalogue (ablation).
        simulate: Run the forward simulations.
        open_loop_window_s: Length of an open-loop window; infinite means the whole recording.
        baselines: Fit the two baselines.
        calibrate_s: Seconds of each held-out session that may set one friction factor (0: none).
        report: Write the report.
        next_experiment: Look for the motion that would split the remaining candidates.
    """

    skip: tuple[str, ...] = ()
    simulate: bool = True
    open_loop_window_s: float = 2.0
    baselines: bool = True
    calibrate_s: float = 0.0
    report: bool = True
    next_experiment: bool = True

    def __post_init__(self) -> None:
        unknown = [n for n in self.skip if n not in catalogue()]
        if unknown:
            raise GapUsageError(
                f"config: skip names '{unknown[0]}'; the catalogue has {', '.join(catalogue())}"
            )
        if not self.open_loop_window_s >= 0.1:
            raise GapUsageError(f"config: open_loop_window_s = {self.open_loop_window_s} is below 0.1 s")
        if not self.calibrate_s >= 0.0:
            raise GapUsageError(
                f"config: calibrate_s = {self.calibrate_s}; it is a number of seconds, 0 for none"
            )


def read_config(path: Path | None) -> GapConfig:
    """Read a configuration file; None gives the defaults.

    Raises:
        GapUsageError: Not readable, or a key or value that makes no sense.
    """
    if path is None:
        return GapConfig()
    raw = read_yaml(path, "config", "correct the path, or leave --config out for the defaults") or {}
    allowed = set(GapConfig.__dataclass_fields__)
    if not isinstance(raw, dict) or set(raw) - allowed:
        raise GapUsageError(f"config '{path}': keys are {', '.join(sorted(allowed))}")
    try:
        if "skip" in raw:
            names = raw["skip"] or []
            raw["skip"] = (names,) if isinstance(names, str) else tuple(map(str, names))
        for key in ("open_loop_window_s", "calibrate_s"):
            if key in raw:
                raw[key] = math.inf if raw[key] == "inf" else float(raw[key])
        switches = [k for k, v in GapConfig.__dataclass_fields__.items() if v.type == "bool" and k in raw]
        for key in switches:
            if not isinstance(raw[key], bool):
                raise GapUsageError(f"config '{path}': {key} is true or false, not {raw[key]!r}")
        return GapConfig(**raw)
    except (TypeError, ValueError) as error:
        raise GapUsageError(f"config '{path}': {error}") from error
