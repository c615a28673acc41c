"""Inside user-mode-linux: the executor on a kernel CAN interface, with candump as the witness.

Run by scripts/prove-socketcan. Every row of the result is one claim, judged from candump's log or from what the
executor answered.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from s2r_host.link import ExecutorLink, ExecutorStatus

Claim = Callable[[str, bool, str], None]
"""(what is claimed, whether it holds, what was seen)"""

INTERFACE = "can0"
PORT = 7447
SEED = 7
LIMIT_MARGIN = 1.02  # the gate's own factor on velocity, acceleration and jerk
READY_TIMEOUT_S = 240.0
HOST_TIMEOUT_S = 5.0  # the most the executor takes
MOST_TRIES = 3  # of a packing, where the machine below had no time for the guest


def serve_drives(packing: str) -> None:
    """The emulated drives of the stand-in on the kernel's interface (no camera), until SIGTERM."""
    from s2r_protocol.arms import load_arm
    from s2r_protocol.can.timing import BitRate
    from s2r_sim.bus.bus import Bus
    from s2r_sim.bus.can_hub import CanHub
    from s2r_sim.bus.object_dictionary import SdoServers
    from s2r_sim.bus.wire import Wire
    from s2r_sim.plant import Plant
    from s2r_sim.stand_in import NODES
    from s2r_sim.world import draw_world

    arm = load_arm("xmate3pro")
    plant = Plant(arm, draw_world(SEED, salt="socketcan"))
    nodes = NODES[packing](plant.drives)
    bus = Bus(CanHub(f"can:{INTERFACE}"), Wire(nodes.tick_ns, BitRate()), nodes, plant)
    bus.responders.append(SdoServers(plant.drives, arm, nodes.tick_ns, nodes.is_stopped).answer)
    signal.signal(signal.SIGTERM, lambda *_: bus.stop())
    print("drives ready", flush=True)
    bus.run_lockstep(0.0)


@contextmanager
def running(
    command: list[str], log: Path, ready: str = "", number: int = signal.SIGTERM
) -> Iterator[subprocess.Popen[bytes]]:
    """A process beside us, once its output holds ``ready``."""
    with log.open("w") as file:
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT)
    try:
        deadline = time.monotonic() + READY_TIMEOUT_S
        while ready and ready not in log.read_text(errors="replace"):
            if process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError(
                    f"{command[1:4]} did not get ready:\n{log.read_text(errors='replace')[-2000:]}"
                )
            time.sleep(0.05)
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(number)
        process.wait(120)


def s2r(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "s2r_protocol", *arguments]


def executor_arguments(packing: str) -> list[str]:
    settings = ["--bus", f"can:{INTERFACE}", "--packing", packing, "--clock", "lockstep", "--pace", "0"]
    # user-mode-linux has one CPU, no FIFO and a coarse clock; lock-step makes all that irrelevant.
    slow = [
        "allow_not_realtime=true",
        f"host_timeout_s={HOST_TIMEOUT_S}",
        "core.front_end_timeout_s=30",
        "core.answer_timeout_s=30",
        "core.arming_timeout_s=60",
    ]
    return [*settings, *(item for setting in slow for item in ("--set", setting))]


def prove(packing: str, out: Path, claim: Claim) -> None:
    """One packing from an empty bus to a latched fault."""
    me = [sys.executable, "-B", __file__]
    with (
        running(["candump", "-L", "-r", "33554432", f"{INTERFACE},0:0,#1FFFFFFF"], out / f"{packing}.log"),
        running([*me, "--drives", packing], out / f"{packing}-drives.log", "drives ready"),
    ):
        commissioned = subprocess.run(
            s2r("executor", "--commission", "--json", *executor_arguments(packing)),
            capture_output=True,
            text=True,
        )
        claim(
            "commissioning finds seven drives in order over SDO",
            commissioned.returncode == 0,
            f"exit {commissioned.returncode}",
        )
        command = s2r("executor", *executor_arguments(packing), "--listen", f"tcp/127.0.0.1:{PORT}")
        log = out / f"{packing}-executor.log"
        with running(command, log, "s2r executor ready", signal.SIGINT) as executor:
            said = log.read_text()
            claim("the executor runs on can0", f"bus can:{INTERFACE} ({packing}" in said, said)
            claim("a machine without real-time rights is capped", "speed capped at 25%" in said, "")
            move(packing, claim)
            if packing == "fd":
                disturb(claim)
        claim("Ctrl-C ends it in order", executor.returncode == 0, f"exit {executor.returncode}")
    judge_dump(packing, out / f"{packing}.log", claim)


def plan_for(q: np.ndarray, dof: int, duration_s: float = 1.0, step_rad: float = 0.05) -> SimpleNamespace:
    """A minimum-jerk move of all joints."""
    import numpy as np

    t = np.linspace(0.0, duration_s, 11)
    x = t / duration_s
    s = x**3 * (10 - 15 * x + 6 * x**2)
    ds, dds = 30 * x**2 * (1 - x) ** 2 / duration_s, 60 * x * (1 - x) * (1 - 2 * x) / duration_s**2
    delta = step_rad * np.ones(dof)
    return SimpleNamespace(t=t, q=q + s[:, None] * delta, dq=ds[:, None] * delta, ddq=dds[:, None] * delta)


def move(packing: str, claim: Claim) -> None:
    """Lease, arm, one plan to its end, disarm: everything a host does."""
    import numpy as np

    from s2r_host.link import ExecutorLink
    from s2r_protocol.arms import load_arm

    arm = load_arm("xmate3pro")
    with (
        ExecutorLink(f"tcp/127.0.0.1:{PORT}", arm, connect_timeout_s=60.0, query_timeout_s=60.0) as link,
        link.leased(),
    ):
        held = link.arm_drives(timeout_s=120.0)
        claim(
            "seven drives are enabled over the kernel's CAN stack", held.state.name == "HOLD", held.state.name
        )
        plan = plan_for(np.array(held.q_ref), arm.dof)
        done = link.wait_done(link.send_plan(plan, f"socketcan {packing}"), stalled_s=120.0)
        error = float(np.abs(np.array(done.q_ref) - plan.q[-1]).max())
        claim("the reference ends at the plan's end", error < 1e-9, f"{error:.1e} rad")
        error = float(np.abs(np.array(done.q_meas) - plan.q[-1]).max())
        claim("the drives follow", error < 5e-3, f"{error:.1e} rad")
        link.disarm()


def disturb(claim: Claim) -> None:
    """A second master on the bus while the arm holds."""
    from s2r_host.link import ExecutorLink
    from s2r_protocol.arms import load_arm
    from s2r_protocol.faults import Cause

    with (
        ExecutorLink(f"tcp/127.0.0.1:{PORT}", load_arm("xmate3pro"), query_timeout_s=60.0) as link,
        link.leased(),
    ):
        link.arm_drives(timeout_s=120.0)
        subprocess.run(["cansend", INTERFACE, "080##1" + "00" * 64], check=True)
        status = until_off(link)
        claim(
            "a second master stops the arm",
            status.cause == Cause.FOREIGN_MASTER,
            f"{status.state.name}, {status.cause.name}",
        )


def until_off(link: ExecutorLink, timeout_s: float = 120.0) -> ExecutorStatus:
    """The state once the arm no longer holds or moves."""
    deadline = time.monotonic() + timeout_s
    while (status := link.status()).state.name in (
        "HOLD",
        "RUN",
        "STOPPING",
        "STOP1",
    ) and time.monotonic() < deadline:
        time.sleep(0.05)
    return status


def judge_dump(packing: str, log: Path, claim: Claim) -> None:
    """What candump saw, and nothing else."""
    import numpy as np

    from s2r_protocol.arms import load_arm
    from s2r_protocol.can import classic, fd

    arm = load_arm("xmate3pro")
    limits = arm.limits
    frames = [parse(line) for line in log.read_text().splitlines() if line.startswith("(")]
    ids = Counter(can_id for _, can_id, _, _ in frames)
    allowed = {0x080, *range(0x181, 0x188), *range(0x581, 0x588), *range(0x601, 0x680)}
    if packing == "classic":
        allowed |= {
            *range(0x081, 0x088),
            *range(0x201, 0x208),
            *range(0x281, 0x288),
            *range(0x701, 0x708),
            0x000,
        }
    claim(
        "only the packing's identifiers were on the bus",
        set(ids) <= allowed,
        f"{sorted(hex(i) for i in set(ids) - allowed)}",
    )
    if packing == "fd":
        sets = [(data, flags) for _, can_id, data, flags in frames if can_id == fd.SET_ID and any(data[8:])]
        claim(
            "SET frames are CAN FD with bit-rate switch",
            all(flags & 1 for _, flags in sets),
            f"{len(sets)} frames",
        )
        points = [fd.unpack_set(data) for data, _ in sets]  # raises when a checksum is wrong
        claim("every SET has a right checksum", True, f"{len(points)} frames")
        steps = {(b.tick - a.tick) & 0xFFFF for a, b in pairwise(points)}
        claim("ticks count without a gap", steps <= {1}, f"steps {sorted(steps)[:5]}")
        answered = {(seq, node) for node in range(1, 8) for seq in ticks_answered(frames, node)}
        missing = sum((p.tick, node) not in answered for p in points for node in range(1, 8))
        claim(
            "each SET is answered by all seven drives",
            missing <= 7,
            f"{missing} of {7 * len(points)} missing",
        )
        runs = contiguous([(p.tick, p.q) for p in points if p.control == 2])
        dt = fd.TICK_NS * 1e-9
    else:
        rows: dict[int, list[float]] = {node: [] for node in range(1, 8)}
        for _, can_id, data, _ in frames:
            if classic.RPDO1_ID < can_id <= classic.RPDO1_ID + 7:
                command = classic.unpack_rpdo1(data)
                if command.controlword & 0x0F == 0x0F:
                    rows[can_id - classic.RPDO1_ID].append(command.q)
        count = min(map(len, rows.values()))
        runs = [np.array([rows[node][:count] for node in range(1, 8)]).T]
        dt = classic.TICK_NS * 1e-9
        claim(
            "one SYNC per seven commands",
            abs(ids[classic.SYNC_ID] - ids[classic.RPDO1_ID + 1]) <= 2,
            f"{ids[classic.SYNC_ID]}",
        )
    count = sum(map(len, runs))
    inside = all(np.all(q >= limits.q_min) and np.all(q <= limits.q_max) for q in runs)
    claim("every setpoint is inside the position limits", inside and count > 500, f"{count} setpoints")
    # Counts of 4 nrad: one count of rounding is 4e-3 rad/s² at 1 kHz.
    for name, order, limit in (("velocity", 1, limits.dq_max), ("acceleration", 2, limits.ddq_max)):
        use = max(float((np.abs(np.diff(q, n=order, axis=0)) / dt**order / limit).max()) for q in runs)
        claim(f"and inside the {name} limits", use <= LIMIT_MARGIN, f"{use:.3f} of the limit")


def contiguous(points: list[tuple[int, tuple[float, ...]]]) -> list[np.ndarray]:
    """Setpoints in stretches whose ticks follow each other, each of shape (ticks, dof), at least four long."""
    import numpy as np

    stretches: list[list[tuple[float, ...]]] = [[]]
    last = None
    for tick, q in points:
        if last is not None and (tick - last) & 0xFFFF != 1:
            stretches.append([])
        stretches[-1].append(q)
        last = tick
    return [np.array(stretch) for stretch in stretches if len(stretch) > 3]


def ticks_answered(frames: list[tuple[float, int, bytes, int]], node: int) -> Iterator[int]:
    """Ticks that this drive's STAT frames echo."""
    from s2r_protocol.can import fd

    for _, can_id, data, _ in frames:
        if can_id == fd.STAT_ID + node:
            yield fd.unpack_stat(data, node).tick


def parse(line: str) -> tuple[float, int, bytes, int]:
    """One line of ``candump -L``: (stamp) interface id#data, or id##flags data for CAN FD."""
    stamp, _, text = line.split(" ")[:3]
    can_id, _, rest = text.partition("#")
    flags = 0
    if rest.startswith("#"):
        flags, rest = int(rest[1], 16), rest[2:]
    return float(stamp.strip("()")), int(can_id, 16), bytes.fromhex(rest), flags


def starved(error: Exception) -> bool:
    """Whether the executor stopped because the host beside it got no processor: right, and no matter of the bus."""
    from s2r_host.errors import ArmStoppedError
    from s2r_protocol.faults import Cause

    return isinstance(error, ArmStoppedError) and error.cause == Cause.HOST_LOST


def main(out: Path) -> None:
    from s2r_executor.core_process import native_executable

    rows: list[dict[str, object]] = []
    started = time.monotonic()
    for packing in ("fd", "classic"):
        for attempt in range(1, MOST_TRIES + 1):
            found: list[dict[str, object]] = []

            def claim(
                text: str,
                holds: bool,
                seen: str,
                packing: str = packing,
                found: list[dict[str, object]] = found,
            ) -> None:
                found.append(
                    {"packing": packing, "claim": text, "holds": bool(holds), "seen": seen.strip()[-300:]}
                )
                print(f"{'ok  ' if holds else 'FAIL'} {packing}: {text} {seen.strip()[-200:]}", flush=True)

            try:
                prove(packing, out, claim)
            except Exception as error:  # noqa: BLE001 - the guest's only way to tell is its result
                if starved(error) and attempt < MOST_TRIES:
                    print(f"again {packing}: the host had no processor for {HOST_TIMEOUT_S} s", flush=True)
                    continue
                claim("ran to its end", False, traceback.format_exc()[-1500:])
            rows += found
            break
    result = {
        "kernel": " ".join(os.uname()[i] for i in (0, 2, 3)),
        "s2r_rt_sha256": hashlib.sha256(native_executable().read_bytes()).hexdigest(),
        "wall_s": round(time.monotonic() - started, 1),
        "claims": rows,
    }
    (out / "socketcan.json.part").write_text(json.dumps(result, indent=1) + "\n")
    (out / "socketcan.json.part").rename(out / "socketcan.json")


def show(path: Path) -> int:
    """Print the result; exit 7 if a claim does not hold."""
    result = json.loads(path.read_text())
    print(f"{result['kernel']}, s2r-rt {result['s2r_rt_sha256'][:12]}, {result['wall_s']} s in the guest")
    for row in result["claims"]:
        print(f"  {'ok  ' if row['holds'] else 'FAIL'}  {row['packing']:7}  {row['claim']}  ({row['seen']})")
    failed = [row for row in result["claims"] if not row["holds"]]
    print(f"{len(result['claims']) - len(failed)} of {len(result['claims'])} claims hold")
    return 7 if failed or not result["claims"] else 0


if __name__ == "__main__":
    if sys.argv[1] == "--drives":
        serve_drives(sys.argv[2])
    elif sys.argv[1] == "--show":
        sys.exit(show(Path(sys.argv[2])))
    else:
        main(Path(sys.argv[1]))
