"""``s2r executor --commission``: who is on the bus, and are they set up as the executor assumes? Nothing is enabled.

Order: listen (is another master there?), scan all node ids, read every drive's dictionary by SDO, then one command
that asks for nothing ("disable") to see that all drives speak this packing. No drive setting is ever written.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

from s2r_executor.commission_checks import CHECKS, Expected
from s2r_executor.commission_record import Commissioning
from s2r_executor.config import ExecutorConfig
from s2r_executor.sdo_client import CanLine, SdoAbortError, SdoClient, SdoTimeoutError
from s2r_protocol.arms import ArmDescription
from s2r_protocol.can import classic, fd
from s2r_protocol.can.drive import Control, DriveState
from s2r_protocol.can.frames import CanFrame, FrameRefusedError
from s2r_protocol.exits import RefusedError
from s2r_protocol.machine import Finding, Level

logger = logging.getLogger(__name__)

_LISTEN_S = 0.3
_SCAN_S = 0.05  # after each burst of sixteen requests
_PROBE_S = 0.5
_IDENTITY = {"vendor": 1, "product": 2, "revision": 3, "serial": 4}  # subindices of 0x1018


class ForeignMasterError(RefusedError):
    """Somebody else sends setpoints on this bus."""


def commission(
    config: ExecutorConfig,
    arm: ArmDescription,
    known: dict[int, dict[str, int]] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Commissioning:
    """Look at every drive on the bus.

    Args:
        config: Bus and packing.
        arm: What should be there: one drive per joint, node 1 for the first.
        known: Identities of an earlier commissioning; a drive that was exchanged is then a problem.
        progress: Told what is being done.

    Raises:
        UnreachableError: There is no such bus.
        ForeignMasterError: Somebody else commands these drives right now.
    """
    with CanLine(config.bus) as line:
        progress("listening for another master")
        _refuse_foreign_master(line.listen(_LISTEN_S), config)
        client = SdoClient(line)
        progress("scanning 127 node ids")
        answers = _scan(client, arm)
        findings = _present(answers, arm)
        identities = {}
        for node in (n for n in sorted(answers) if n <= arm.dof):
            progress(f"reading node {node}")
            findings += _settings(client, node, Expected.of(arm, node, config.tick_ns))
            identity = _identity(client, node)
            identities[node] = identity
            findings += _compare(node, identity, (known or {}).get(node))
        progress(f"asking for nothing in the {config.packing} packing")
        findings += _probe(line, config, arm)
    return Commissioning(tuple(findings), identities)


def _refuse_foreign_master(heard: list[CanFrame], config: ExecutorConfig) -> None:
    masters = {frame.can_id for frame in heard if frame.can_id in (fd.SET_ID, classic.NMT_ID)}
    masters |= {f.can_id for f in heard if classic.RPDO1_ID < f.can_id <= classic.RPDO1_ID + 127}
    if masters:
        ids = ", ".join(f"{can_id:#05x}" for can_id in sorted(masters))
        raise ForeignMasterError(
            f"another master is active on {config.bus} (frames {ids}): stop that executor before commissioning"
        )


def _scan(client: SdoClient, arm: ArmDescription) -> dict[int, int]:
    """Ask every node at once, and each of the arm's that has not answered in that short time by itself."""
    answers = client.present(_SCAN_S)
    for node in set(range(1, arm.dof + 1)) - set(answers):
        try:
            client.upload(node, 0x1000)
        except SdoTimeoutError:
            continue
        except SdoAbortError:
            logger.info("node %d tells no device type", node)
        answers[node] = 1
    return answers


def _present(answers: dict[int, int], arm: ArmDescription) -> list[Finding]:
    wanted = set(range(1, arm.dof + 1))
    findings = []
    for node in sorted(wanted - set(answers)):
        text = f"no answer: joint '{arm.joint_names[node - 1]}' has no drive on this bus"
        fix = "check power, wiring, bit rate and the drive's node id"
        findings.append(Finding(f"node {node}", Level.PROBLEM, text, fix))
    for node in sorted(set(answers) - wanted):
        text = f"answers, but this arm has nodes 1 to {arm.dof} only"
        findings.append(
            Finding(f"node {node}", Level.PROBLEM, text, "take it off this bus or correct its node id")
        )
    for node in sorted(node for node, count in answers.items() if count > 1):
        text = f"{answers[node]} answers to one request: the node id is used twice"
        findings.append(Finding(f"node {node}", Level.PROBLEM, text, "give every drive its own node id"))
    if not findings:
        findings.append(Finding("nodes", Level.OK, f"{arm.dof} drives, nodes 1 to {arm.dof}, nobody else"))
    return findings


def _settings(client: SdoClient, node: int, expected: Expected) -> list[Finding]:
    problems = []
    for check in CHECKS:
        topic = f"node {node} {check.name}"
        try:
            problem = check.judge(
                lambda index, sub=0, signed=False: client.number(node, index, sub, signed), expected
            )
        except SdoAbortError as error:
            if check.optional:
                text = f"cannot be read, look it up in the drive's manual: {error}"
                problems.append(Finding(topic, Level.NOTE, text, check.fix(expected)))
                continue
            problem = f"cannot be read: {error}"
        except SdoTimeoutError as error:
            problems.append(Finding(topic, Level.PROBLEM, str(error), "is the drive still powered?"))
            break
        if problem:
            problems.append(Finding(topic, Level.PROBLEM, problem, check.fix(expected)))
    return problems or [Finding(f"node {node}", Level.OK, f"{len(CHECKS)} settings as the executor assumes")]


def _identity(client: SdoClient, node: int) -> dict[str, int]:
    identity = {}
    for name, subindex in _IDENTITY.items():
        try:
            identity[name] = client.number(node, 0x1018, subindex)
        except (SdoAbortError, SdoTimeoutError) as error:
            logger.info("node %d tells no %s: %s", node, name, error)
    return identity


def _compare(node: int, identity: dict[str, int], known: dict[str, int] | None) -> list[Finding]:
    shown = ", ".join(f"{name} {value:#x}" for name, value in identity.items())
    topic = f"node {node} identity"
    if not known or known == identity:
        return [Finding(topic, Level.OK, shown or "none told")]
    was = ", ".join(f"{name} {value:#x}" for name, value in known.items())
    fix = "if the drive was exchanged on purpose: remove the commissioning file and commission again"
    return [Finding(topic, Level.PROBLEM, f"{shown or 'none told'}; it was {was}", fix)]


def _probe(line: CanLine, config: ExecutorConfig, arm: ArmDescription) -> list[Finding]:
    """One command that enables nothing; every drive must answer in this packing, unpowered and inside its limits."""
    if config.packing == "fd":
        # The counter a starting executor would use only after 255 others: drives ignore one that repeats.
        line.send(fd.set_frame(fd.pack_set(255, Control.DISABLE, 0, [0.0] * arm.dof)))
    else:
        line.send(CanFrame(classic.SYNC_ID, bytes([1])))
    seen: dict[int, tuple[DriveState | str, float]] = {}
    for frame in line.listen(_PROBE_S):
        node = frame.can_id - fd.STAT_ID  # TPDO1's base is the same
        if not 1 <= node <= arm.dof:
            continue
        try:
            if config.packing == "fd":
                status = fd.unpack_stat(frame.data, node)
                seen[node] = (status.state, status.q_meas)
            else:
                position = classic.unpack_tpdo1(frame.data)
                seen[node] = (_state_in(position), position.q_meas)
        except FrameRefusedError as error:
            text = f"answers in another packing: {error}"
            return [Finding(f"node {node} packing", Level.PROBLEM, text, "choose the other --packing")]
    return _judge_probe(seen, config, arm)


def _state_in(position: classic.Position) -> DriveState | str:
    """The drive's state, or why its statusword tells none: some are between two states when they are asked."""
    try:
        return position.state
    except ValueError as error:
        return str(error)


def _judge_probe(
    seen: Mapping[int, tuple[DriveState | str, float]], config: ExecutorConfig, arm: ArmDescription
) -> list[Finding]:
    findings = []
    for node, joint in enumerate(arm.joint_names, start=1):
        low, high = float(arm.limits.q_min[node - 1]), float(arm.limits.q_max[node - 1])
        topic = f"node {node} answer"
        if node not in seen:
            text = f"no answer in the {config.packing} packing"
            findings.append(
                Finding(topic, Level.PROBLEM, text, "choose the other --packing, or map the drive's PDOs")
            )
            continue
        state, q = seen[node]
        if isinstance(state, str):
            fix = "commission again once the drive has started; if it stays so, its manual says what the word means"
            findings.append(Finding(topic, Level.PROBLEM, state, fix))
        elif state not in (DriveState.SWITCH_ON_DISABLED, DriveState.READY_TO_SWITCH_ON):
            fix = "switch the drive off; clear a fault with its own tool or with RESET"
            findings.append(Finding(topic, Level.PROBLEM, f"the drive is in {state.name}", fix))
        elif not low <= q <= high:
            text = f"joint '{joint}' stands at {q:.4f} rad, outside [{low:.4f}, {high:.4f}]"
            fix = "check its zero (homing offset 0x607C), or move it by hand"
            findings.append(Finding(topic, Level.PROBLEM, text, fix))
    return findings or [
        Finding("answers", Level.OK, f"all drives speak the {config.packing} packing, power off")
    ]
