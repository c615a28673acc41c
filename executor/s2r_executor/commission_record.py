"""What a commissioning found, kept in a file; the executor asks for it at every start on hardware."""

from __future__ import annotations

import datetime
import json
from dataclasses import asdict, dataclass
from pathlib import Path

from s2r_executor.config import ExecutorConfig
from s2r_protocol.arms import ArmDescription
from s2r_protocol.exits import NotReadyError
from s2r_protocol.machine import Finding, Level


class CommissioningError(NotReadyError):
    """The bus was not commissioned, or not for this arm."""


@dataclass(frozen=True)
class Commissioning:
    """What was found.

    Attributes:
        findings: In the order they were made.
        identities: Node -> vendor, product, revision, serial.
    """

    findings: tuple[Finding, ...]
    identities: dict[int, dict[str, int]]

    @property
    def passed(self) -> bool:
        """No problem was found."""
        return all(finding.level != Level.PROBLEM for finding in self.findings)


def write_record(
    path: Path,
    config: ExecutorConfig,
    arm: ArmDescription,
    found: Commissioning,
    known: dict[int, dict[str, int]] | None = None,
) -> None:
    """Keep what was found; the executor asks for it at every start on hardware.

    Args:
        path: The record.
        config: Bus, packing and period.
        arm: What was commissioned.
        found: Findings and identities.
        known: Identities of the record before. They stay: a drive that was exchanged, or did not answer this time,
            would otherwise be taken for the right one the next time.
    """
    told = {node: identity for node, identity in (known or {}).items() if identity}
    record = {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "bus": config.bus,
        "packing": config.packing,
        "tick_ns": config.tick_ns,
        "arm": arm.name,
        "model_hash": arm.model_hash.hex(),
        "limit_hash": arm.limit_hash.hex(),
        "passed": found.passed,
        "identities": {str(node): identity for node, identity in {**found.identities, **told}.items()},
        "findings": [asdict(finding) for finding in found.findings],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.tmp")
    beside.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    beside.replace(path)


def read_identities(path: Path) -> dict[int, dict[str, int]] | None:
    """Identities of an earlier commissioning, or None if there was none.

    Raises:
        CommissioningError: The file cannot be read.
    """
    if not path.exists():
        return None
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        return {int(node): dict(identity) for node, identity in record["identities"].items()}
    except (OSError, ValueError, KeyError, AttributeError, TypeError) as error:
        raise CommissioningError(
            f"{path} is no commissioning record ({error}); remove it and commission anew"
        ) from error


def check_record(path: Path, config: ExecutorConfig, arm: ArmDescription) -> None:
    """Refuse to start on drives that were not commissioned for this arm, these limits, this packing and period.

    Raises:
        CommissioningError: Names what differs.
    """
    again = f"run 's2r executor --commission' with the same configuration, with the arm free to stand still, for {path}"
    if not path.exists():
        raise CommissioningError(f"{config.bus} was never commissioned: {again}")
    read_identities(path)
    record = json.loads(path.read_text(encoding="utf-8"))
    if not record.get("passed"):
        raise CommissioningError(
            f"the commissioning of {record.get('date')} found problems: mend them and {again}"
        )
    for what, expected in (
        ("bus", config.bus),
        ("packing", config.packing),
        ("tick_ns", config.tick_ns),  # the drives' interpolation period was compared with it
        ("model_hash", arm.model_hash.hex()),
        ("limit_hash", arm.limit_hash.hex()),
    ):
        if record.get(what) != expected:
            raise CommissioningError(
                f"commissioned for {what} {record.get(what)}, now it is {expected}: {again}"
            )
