"""Before the core starts: may this machine drive this bus, and how fast?

Only a hardware bus is guarded. On the stand-in nothing can be hurt; a slow machine stretches its time or misses ticks.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

from s2r_executor.config import ExecutorConfig
from s2r_protocol.exits import NotReadyError
from s2r_protocol.machine import Level
from s2r_protocol.machine.can_interface import check_interface
from s2r_protocol.machine.realtime import Check, RealtimeFacts, Verdict, judge, read_facts, worst

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Preflight:
    """The verdict on this machine, and the largest share of planned speed that it allows.

    Attributes:
        verdict: Worst of the checks, after what the configuration accepts.
        checks: Everything that was looked at.
        speed_cap: In (0, 1]; 1 on the stand-in whatever the verdict.
    """

    verdict: Verdict
    checks: tuple[Check, ...]
    speed_cap: float

    @property
    def line(self) -> str:
        """One clause for the summary."""
        bad = [check.topic for check in self.checks if check.verdict != Verdict.RT_OK]
        text = f"preflight {self.verdict.name}"
        if bad:
            text += f" ({', '.join(bad)}; see 's2r doctor')"
        return text if self.speed_cap == 1.0 else f"{text}, speed capped at {self.speed_cap:.0%}"


def run_preflight(config: ExecutorConfig) -> Preflight:
    """Look at this machine for this configuration; every lack is logged with its fix.

    Raises:
        NotReadyError: It must not drive this hardware bus; the text holds each reason with its fix.
    """
    kind, _, interface = config.bus.partition(":")
    name = interface if kind == "can" else None
    facts = read_facts(name, config.core.realtime_priority or 1, cpu=config.core.cpu)
    return decide(config, facts, _interface_checks(name, config.packing) if name else ())


def decide(config: ExecutorConfig, facts: RealtimeFacts, more: Sequence[Check] = ()) -> Preflight:
    """The same from given facts: pure but for the log.

    Raises:
        NotReadyError: As :func:`run_preflight`.
    """
    interface = config.bus.partition(":")[2]
    judged = [*judge(facts, config.core.realtime_priority, interface), *more]
    checks = tuple(_accepted(check, config) for check in judged)
    verdict = worst(list(checks))
    if config.is_stand_in:
        return Preflight(verdict, checks, 1.0)
    for check in checks:
        if check.verdict != Verdict.RT_OK:
            logger.warning("preflight: %s: %s. Fix: %s", check.topic, check.text, check.fix)
    if verdict == Verdict.REFUSED:
        reasons = "\n".join(
            f"  {c.topic}: {c.text}\n    fix: {c.fix}" for c in checks if c.verdict == Verdict.REFUSED
        )
        raise NotReadyError(f"this machine must not drive {config.bus}:\n{reasons}")
    cap = 1.0 if verdict == Verdict.RT_OK else config.preflight.degraded_speed
    return Preflight(verdict, checks, cap)


def after_start(before: Preflight, config: ExecutorConfig, realtime: bool) -> Preflight:
    """The same once the core runs. What was tried in this process is not yet what that one got.

    Args:
        before: Of :func:`run_preflight`.
        config: Of the executor.
        realtime: The core has FIFO priority, its memory locked, and the CPU that was asked for.
    """
    if realtime or config.is_stand_in:
        return before
    text = "s2r-rt does not run in real time, whatever was permitted before it started"
    fix = "clock: real, and FIFO priority, its CPU and all of its memory for s2r-rt (LimitMEMLOCK=infinity)"
    logger.warning("preflight: real-time core: %s. Fix: %s", text, fix)
    return Preflight(
        max(before.verdict, Verdict.DEGRADED),
        (*before.checks, Check("real-time core", Verdict.DEGRADED, text, fix)),
        min(before.speed_cap, config.preflight.degraded_speed),
    )


def _accepted(check: Check, config: ExecutorConfig) -> Check:
    """What the operator has said to live with. Missing real-time rights then still cost speed."""
    if check.verdict == Verdict.REFUSED and config.allow_not_realtime and not check.topic.startswith("CAN"):
        return Check(check.topic, Verdict.DEGRADED, f"{check.text} (allow_not_realtime)", check.fix)
    if check.verdict == Verdict.DEGRADED and check.topic in config.preflight.accept:
        logger.warning("preflight: %s: %s, accepted by the configuration", check.topic, check.text)
        return Check(check.topic, Verdict.RT_OK, f"{check.text} (accepted)")
    return check


def _interface_checks(name: str, packing: str) -> list[Check]:
    return [
        Check(f.topic, Verdict.REFUSED if f.level == Level.PROBLEM else Verdict.RT_OK, f.text, f.fix)
        for f in check_interface(name, packing)
    ]
