"""``s2r doctor``: is this machine ready, and is this arm description complete?"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click
import numpy as np

from s2r_protocol.arms import ArmDescription, load_arm
from s2r_protocol.arms.bus_range import off_bus
from s2r_protocol.arms.clearance import LINKS_APART_M
from s2r_protocol.arms.inertias import gyration_m, placeholders
from s2r_protocol.arms.source import FINGER_PREFIX
from s2r_protocol.cli.findings import print_findings
from s2r_protocol.exits import ExitCode, UsageError
from s2r_protocol.machine import Finding, Level
from s2r_protocol.machine.can_interface import check_interface, list_interfaces
from s2r_protocol.machine.realtime import Verdict, judge, read_facts, worst
from s2r_protocol.machine.software import check_software
from s2r_protocol.machine.surroundings import check_surroundings

_LONGEST_OFFSET_M = 3.0  # the longest link of an arm that stands on a table is a third of it
_TIP_OFF_M = 2e-3
_WIDEST_M = 2.0  # radius of gyration
_FARTHEST_LIMIT_RAD = 10 * np.pi  # no cable takes more turns; most limits in degrees are farther
_CERTIFICATE_DAYS = 365
_HOLDING_SHARE = 0.9  # what admission leaves of a torque limit


def check_machine(bus: str = "", packing: str = "fd") -> list[Finding]:
    """Look at this machine; nothing is changed.

    Args:
        bus: ``can:IFACE`` to judge it for that hardware; empty for the stand-in, which needs no real-time rights.
        packing: "fd" or "classic".

    Raises:
        UsageError: ``bus`` is something else.
    """
    return [*check_software(), *_realtime(bus), *_can(bus, packing), *check_surroundings()]


def _interface(bus: str) -> str:
    kind, _, name = bus.partition(":")
    if bus and (kind != "can" or not name):
        raise UsageError(
            f"--bus {bus}: expected can:INTERFACE; the stand-in's unix: bus needs nothing checked"
        )
    return name


def _realtime(bus: str) -> list[Finding]:
    interface = _interface(bus)
    checks = judge(read_facts(interface or None), interface=interface)
    verdict = worst(checks)
    bad = Level.PROBLEM if bus and verdict == Verdict.REFUSED else Level.NOTE
    findings = [
        Finding(
            c.topic,
            Level.OK if c.verdict == Verdict.RT_OK else bad if c.verdict == Verdict.REFUSED else Level.NOTE,
            c.text,
            c.fix,
        )
        for c in checks
    ]
    meaning = {
        Verdict.RT_OK: Finding("preflight", Level.OK, "RT_OK: full speed on a hardware bus"),
        Verdict.DEGRADED: Finding(
            "preflight",
            Level.NOTE,
            "DEGRADED: the executor caps the speed on a hardware bus; the stand-in is not affected",
            "see the notes above",
        ),
        Verdict.REFUSED: Finding(
            "preflight",
            bad,
            "REFUSED: the executor does not open a hardware bus; the stand-in is not affected",
            "see the lines above",
        ),
    }
    return [*findings, meaning[verdict]]


def _can(bus: str, packing: str) -> list[Finding]:
    if bus:
        return check_interface(_interface(bus), packing)
    found = list_interfaces()
    if not found:
        return [Finding("CAN", Level.OK, "no interface; the stand-in's local bus needs none")]
    return [finding for name in found for finding in check_interface(name, packing)]


def check_arm(arm: ArmDescription) -> list[Finding]:
    """Look closer at an arm whose description is complete."""
    findings = [
        Finding(
            "description",
            Level.OK,
            f"{arm.source.vendor}: {arm.dof} joints, {len(arm.source.shapes)} shapes",
        ),
        Finding("model hash", Level.OK, arm.model_hash.hex()),
        Finding("limit hash", Level.OK, arm.limit_hash.hex()),
    ]
    bare = [link.name for link in arm.source.links if not arm.source.shapes_of(link.name)]
    if bare:
        text = f"no collision shape on: {', '.join(bare)}"
        fix = "add at least one capsule, cylinder or box per link"
        findings.append(Finding("shapes", Level.PROBLEM, text, fix))
    for link in sorted({arm.source.tool.parent} - {s.link for s in arm.source.shapes}):
        findings.append(
            Finding("tool", Level.PROBLEM, f"tool link '{link}' has no shape", "describe the fingertip")
        )
    if not any(s.name.startswith(FINGER_PREFIX) for s in arm.source.shapes):
        text = f"no shape's name begins with '{FINGER_PREFIX}': nothing may touch the object"
        fix = "name the fingertip's shapes finger_left, …"
        findings.append(Finding("fingertip", Level.PROBLEM, text, fix))
    return [
        *findings,
        *_fingertip(arm),
        _offsets(arm),
        *_inertias(arm),
        _angles(arm),
        *_bus(arm),
        *_home_pose(arm),
    ]


def _fingertip(arm: ArmDescription) -> list[Finding]:
    """Pushes are planned for a fingertip that ends at the tool frame."""
    from s2r_protocol.arms.home_pose import finger_beyond_tool

    beyond_m = finger_beyond_tool(arm)
    if beyond_m is None or abs(beyond_m) <= _TIP_OFF_M:
        return []
    side = "beyond" if beyond_m > 0.0 else "before"
    text = f"the finger's shapes end {1e3 * abs(beyond_m):.3g} mm {side} '{arm.tool_frame}', along its z axis"
    fix = (
        "the tool frame is the centre of the fingertip's end face, z outwards: correct tool.origin and tool.rpy, or "
        "the shapes"
    )
    return [Finding("fingertip", Level.NOTE, text, fix)]


def _bus(arm: ArmDescription) -> list[Finding]:
    off = [Finding(found.what, Level.PROBLEM, found.text, found.fix) for found in off_bus(arm)]
    return off or [Finding("bus", Level.OK, "all limits fit the bus")]


def _angles(arm: ArmDescription) -> Finding:
    far = np.maximum(np.abs(arm.limits.q_min), np.abs(arm.limits.q_max))
    joint = int(np.argmax(far))
    text = f"farthest joint limit: {far[joint]:.4g} rad ('{arm.joint_names[joint]}')"
    if far[joint] <= _FARTHEST_LIMIT_RAD:
        return Finding("angles", Level.OK, text)
    return Finding("angles", Level.PROBLEM, text, "angles are radians, not degrees")


def _offsets(arm: ArmDescription) -> Finding:
    # Loads Pinocchio, which the machine's check does not need.
    from s2r_protocol.arms.home_pose import longest_offset

    name, length_m = longest_offset(arm.source)
    text = f"largest offset between frames: {length_m:.3g} m ('{name}')"
    if length_m <= _LONGEST_OFFSET_M:
        return Finding("lengths", Level.OK, text)
    return Finding("lengths", Level.PROBLEM, text, "lengths are metres, not millimetres")


def _inertias(arm: ArmDescription) -> list[Finding]:
    radii_m = {link.name: gyration_m(link) for link in arm.source.links}
    name = max(radii_m, key=radii_m.__getitem__)
    text = f"'{name}' has the largest inertia for its mass, as if {radii_m[name]:.3g} m around its centre of mass"
    if radii_m[name] <= _WIDEST_M:
        widest = Finding("inertias", Level.OK, text)
    else:
        fix = "masses are kg and inertias kg m², not kg mm² or g mm²"
        return [Finding("inertias", Level.PROBLEM, text, fix)]
    return [
        widest,
        *(
            Finding(
                "inertias",
                Level.PROBLEM,
                f"'{link.name}' has the inertia of a body {gyration_m(link):.3g} m around its centre of mass; its "
                f"shapes reach {reach_m:.3g} m",
                "no body is so: correct its inertia",
            )
            for link, reach_m in placeholders(arm.source)
        ),
    ]


def _home_pose(arm: ArmDescription) -> list[Finding]:
    """Every motion on the stand-in begins at home: over the table, and held by torques to spare."""
    from s2r_protocol.arms.home_pose import holding_torques, lowest_shape, nearest_links

    torques = np.abs(holding_torques(arm, arm.q_home))
    joint = int(np.argmax(torques / arm.limits.tau_max))
    name, torque, limit = arm.joint_names[joint], torques[joint], arm.limits.tau_max[joint]
    held = f"'{name}' holds {torque:.3g} N·m of its {limit:.3g} N·m at home"
    shape, height_m = lowest_shape(arm, arm.q_home)
    over = f"'{shape}' is the lowest shape at home, {height_m:.3g} m over the base"
    heavy, low = torque > _HOLDING_SHARE * limit, height_m <= 0.0
    nearest = nearest_links(arm, arm.q_home)
    apart = []
    if nearest is not None:
        first, second, distance_m = nearest
        close = distance_m <= LINKS_APART_M + 1e-4
        text = f"'{first}' and '{second}' are the nearest links at home, {1e3 * distance_m:.3g} mm apart"
        fix = (
            f"the executor refuses every motion from there: more than {1e3 * LINKS_APART_M:.0f} mm must be between "
            "links; choose another home pose or smaller shapes, or name in collision_exclude a pair that touches by "
            "construction"
        )
        apart = [Finding("links", Level.PROBLEM if close else Level.OK, text, fix if close else "")]
    return [
        Finding(
            "torque",
            Level.PROBLEM if heavy else Level.OK,
            held,
            "check masses, lengths and tau_max, or choose a home pose that hangs less far out"
            if heavy
            else "",
        ),
        Finding(
            "table",
            Level.PROBLEM if low else Level.OK,
            over,
            "choose a home pose over the table on which the base stands" if low else "",
        ),
        *apart,
    ]


def _make_certificates(folder: Path, names: tuple[str, ...], days: int) -> list[Finding]:
    from s2r_protocol.session.certificates import make_certificates

    findings = [
        Finding(
            issued.name,
            Level.OK,
            f"{issued.path}, until {issued.not_after:%Y-%m-%d}"
            + (f", for {', '.join(issued.names)}" if issued.names else ""),
        )
        for issued in make_certificates(folder, names, days)
    ]
    text = f"keep {folder / 'ca.key'} on this machine only"
    fix = f"copy ca.pem and one role's .pem and .key to each machine; start with --tls {folder}"
    return [*findings, Finding("next", Level.OK, text, fix)]


@click.command()
@click.option("--arm", metavar="NAME|DIR", help="Check an arm description instead of this machine.")
@click.option("--bus", default="", metavar="can:IFACE", help="Judge this machine for an arm on that bus.")
@click.option(
    "--packing",
    type=click.Choice(["fd", "classic"]),
    default="fd",
    show_default=True,
    help="With --bus: CAN FD at 1 kHz or classical CAN at 250 Hz.",
)
@click.option(
    "--make-certs",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Make the lab's certificate authority in DIR, or use the one there, and a certificate per role.",
)
@click.option(
    "--name",
    "names",
    multiple=True,
    help="With --make-certs: host name or address under which executor and camera are reached, besides those in DIR's "
    "certificates. Repeatable.",
)
@click.option(
    "--days", default=_CERTIFICATE_DAYS, show_default=True, help="With --make-certs: how long they hold."
)
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def doctor(
    arm: str | None,
    bus: str,
    packing: str,
    make_certs: Path | None,
    names: tuple[str, ...],
    days: int,
    as_json: bool,
) -> int:
    """Check this machine, or an arm description of yours; every problem comes with its fix.

    Exit 0: ready, perhaps with notes. 2: the arm description is incomplete. 3: this machine is not ready.
    """
    if make_certs is None and (names or days != _CERTIFICATE_DAYS):
        raise UsageError("--name and --days say what --make-certs DIR shall make; add it")
    if arm is not None and (bus or make_certs is not None):
        raise UsageError(
            "--arm checks a description, --bus this machine, --make-certs writes files: one at a time"
        )
    if make_certs is not None:
        findings = _make_certificates(make_certs, names, days)
    else:
        findings = check_machine(bus, packing) if arm is None else check_arm(load_arm(arm))
    if as_json:
        click.echo(json.dumps([asdict(f) for f in findings], indent=2))
    else:
        print_findings(findings)
    if not any(f.level == Level.PROBLEM for f in findings):
        return int(ExitCode.OK)
    return int(ExitCode.NOT_READY if arm is None else ExitCode.USAGE)
