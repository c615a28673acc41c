"""What a user may type wrongly: each ends with the documented exit code and a sentence that says what to do."""

from __future__ import annotations

import re

import pytest

from s2r_protocol.cli.root import main
from s2r_protocol.exits import ExitCode

USAGE, NOT_READY, REFUSED, UNREACHABLE = 2, 3, 4, 5
NOBODY = "tcp/127.0.0.1:1"

# (arguments, exit code, what the message says). {tmp} is an empty folder, {junk} a text file called junk.mcap,
# {empty} an empty file, {yaml} a YAML file with an unknown key, {run} a folder with a run.json but no recording.
CASES = [
    ("flub", USAGE, "No such command 'flub'"),
    ("run", USAGE, "Missing argument 'OBJECT'"),
    ("run cupboard --target 0.1", USAGE, "'cupboard' is not .*drawer"),
    ("run drawer", USAGE, "Missing option '--target'"),
    ("run drawer --target far", USAGE, "'far' is not a number"),
    ("run drawer --target 5 --out {tmp}/r", USAGE, r"\+5000.00 mm is outside"),
    ("run drawer --target 0.1 --attempts 0 --out {tmp}/r", USAGE, "0 is not in the range x>=1"),
    ("run drawer --target 0.1 --seed -1", USAGE, "-1 is not in the range x>=0"),
    ("run drawer --target 0.1 --then 5", USAGE, r"--then \+5000.00 mm is outside"),
    ("run drawer --target 0.1 --arm panda --out {tmp}/r --executor " + NOBODY, USAGE, "no arm 'panda'.*xmate3pro"),
    ("run drawer --target 0.1 --then 0.2 --learn-physics", USAGE, "third target, and there are only 2: add"),
    ("run laptop --target 20deg --push-near-axis", USAGE, "about levers, and a laptop has none; leave it out"),
    ("run drawer --target 0.1 --cell lab/one", USAGE, "cell name 'lab/one' may only hold"),
    ("run drawer --target 0.1 --out {empty}/r", USAGE, "empty/r: Not a directory"),
    ("run drawer --target 0.1 --executor 7447 --out {tmp}/r", USAGE, "address '7447'.*PROTOCOL/ADDRESS"),
    ("run drawer --target 0.1 --executor tcp/10.0.0.5:7447 --out {tmp}/r", USAGE, "certificates.*--tls"),
    ("run drawer --target 0.1 --out {full}", USAGE, "exists and is not empty"),
    ("run drawer --target 0.1 --executor " + NOBODY + " --out {tmp}/r", UNREACHABLE, "no executor answered"),
    ("stop --timeout 0.2 --executor " + NOBODY, UNREACHABLE, "nothing was stopped.*emergency stop"),
    ("stop --timeout nan", USAGE, r"--timeout nan s is outside 0\.\.3600 s; nothing was stopped"),
    ("stop --timeout -1", USAGE, "--timeout -1 s is outside"),
    ("stop --arm nobody --timeout 0 --executor " + NOBODY, UNREACHABLE, "correct --executor, --cell or --arm"),
    ("stop --timeout soon", USAGE, "'soon' is not a valid float"),
    ("stop --cell lab/one --executor " + NOBODY, USAGE, "cell name 'lab/one' may only hold"),
    ("stop --executor udp/127.0.0.1:7447", USAGE, "use tcp/127.0.0.1:PORT, or --tls"),
    ("executor --packing slow", USAGE, "'slow' is not one of 'fd', 'classic'"),
    ("executor --clock sundial", USAGE, "'sundial' is not one of 'real', 'lockstep'"),
    ("executor --config {tmp}/none.yaml", USAGE, "does not exist"),
    ("executor --config {yaml}", USAGE, "core.speed: there is no such key.*s2r config show"),
    ("executor --config {junk}", USAGE, "holds str, expected keys and values"),
    ("executor --set core.gate_margin", USAGE, "expected key=value"),
    ("executor --set core.gate_margin=7", USAGE, "core.gate_margin = 7: it should be less than or equal to 1.1"),
    ("executor --set nonsense=1", USAGE, "nonsense: there is no such key"),
    ("executor --set core.gate_margn=1.05", USAGE, "did you mean core.gate_margin"),
    ("executor --set cell.x=1", USAGE, "cell"),
    ("executor --host-timeout 9", USAGE, "host_timeout_s = 9.*less than or equal to 5"),
    ("executor --bus unix:{tmp}/no.sock --listen tcp/0.0.0.0:7447", (USAGE, UNREACHABLE), "certificates|no.sock"),
    ("executor --bus unix:{tmp}/no.sock --record {empty}/r", USAGE, "empty/r: Not a directory; correct the path"),
    ("executor --bus unix:{tmp}/no.sock --record {empty}", USAGE, "empty: File exists|is a file"),
    ("executor --arm panda", USAGE, "no arm 'panda'"),
    ("config show --set preflight.accept=[hypervisr]", USAGE, "preflight.accept.*'hypervisr'.*'hypervisor'"),
    ("config show --set core.feedback_stop_ticks=0", USAGE, "core.feedback_stop_ticks"),
    ("config show --config {yaml}", USAGE, "there is no such key"),
    ("bench planning --collection -1 --tasks nope --out {tmp}/b", USAGE, "-1 is not in the range x>=0"),
    ("bench planning --replays -1 --tasks nope --out {tmp}/b", USAGE, "-1 is not in the range x>=0"),
    ("bench planning --pieces -1 --tasks nope --out {tmp}/b", USAGE, "-1 is not in the range x>=0"),
    ("bench planning --patience nan --tasks nope --out {tmp}/b", USAGE, "nan is not a finite number"),
    ("bench planning --patience -1 --tasks nope --out {tmp}/b", USAGE, "-1.0 is not in the range x>0"),
    ("import-arm {tmp}/none.urdf --out {tmp}/arm", USAGE, "none.urdf' does not exist"),
    ("import-arm {junk} --out {tmp}/arm", USAGE, "junk.mcap is no readable URDF"),
    ("import-arm {empty} --out {tmp}/arm", USAGE, "is no readable URDF: no element found"),
    ("import-arm {junk} --out {full}", USAGE, "exists and is not empty"),
    ("import-arm {junk} --out {tmp}/arm --hold grip", USAGE, "--hold grip: expected JOINT=VALUE"),
    ("import-arm {junk} --out {tmp}/arm --hold grip=shut", USAGE, "--hold grip: could not convert.*'shut'"),
    ("import-arm {junk} --out {tmp}/arm --home 0,nan", USAGE, "--home: the numbers must be finite"),
    ("import-arm {junk} --out {tmp}/arm --exclude a", USAGE, "--exclude a: expected LINK,LINK"),
    ("import-arm {junk} --out {tmp}/arm --tip-axis w", USAGE, "'w' is not one of"),
    ("import-arm {junk} --out {tmp}/arm --ddq-max 0", USAGE, "0.0 is not in the range x>0"),
    ("completion powershell", USAGE, "'powershell' is not one of"),
    ("sim-arm", USAGE, "either --world FILE or --seed N"),
    ("sim-arm --seed x", USAGE, "'x' is not a valid integer"),
    ("sim-arm --seed -1", USAGE, "-1 is not in the range x>=0"),
    ("sim-arm --seed 1 --bus can:nobody0", NOT_READY, "cannot join can:nobody0"),
    ("sim-arm --seed 1 --pace -1", USAGE, "--pace -1.0 is outside 0..1000"),
    ("sim-arm --seed 1 --clock real --pace 0", USAGE, "real clock cannot"),
    ("sim-arm --world {junk}", USAGE, "junk.mcap"),
    ("sim-arm --seed 1 --inject drip:0x181@1 --bus unix:{tmp}/b.sock", USAGE, "ACTION:ID@FIRST"),
    ("world draw --seed 1", USAGE, "Missing option '--out'"),
    ("world draw --seed -1 --out {tmp}/w.json", USAGE, "-1 is not in the range x>=0"),
    ("world object --kind drawer --seed -1 --out {tmp}/o", USAGE, "-1 is not in the range x>=0"),
    ("plan --scene {junk} --joint j --target 1 --seed -1 --out {tmp}/p", USAGE, "-1 is not in the range x>=0"),
    ("conceal draw --workers 0 --out {tmp}/c", USAGE, "0 is not in the range x>=1"),
    ("build-model --before {junk} --after {empty} --seed -1 --out {tmp}/m", USAGE, "-1 is not in the range x>=0"),
    ("conceal draw --seed -1 --out {tmp}/c", USAGE, "-1 is not in the range x>=0"),
    ("conceal draw --cases clean=² --out {tmp}/c", USAGE, "'clean=²': write GROUP=NUMBER"),
    ("conceal draw --cases clean=1,clean=2 --out {tmp}/c", USAGE, "'clean=2': clean is asked for twice"),
    ("conceal draw --duration nan --out {tmp}/c", USAGE, "--duration': nan is not a finite number"),
    ("bench paper --trials 1 --pace nan --out {tmp}/b", USAGE, "--pace': nan is not a finite number"),
    ("bench paper --trials 1 --run-options 'open --out {tmp}/b", USAGE, "--run-options.*close every quotation"),
    ("bench paper --page-only --out {tmp}/b", USAGE, "holds no result of these kinds with --attempts 3; the page"),
    ("bench missing --page-only --out {tmp}/b", USAGE, "holds no result of these cases with --later 10; the page"),
    ("bench missing --what-if {tmp}/none.json --out {tmp}/b", USAGE, "none.json"),
    ("bench paper --trials 1 --compare {tmp} --out {tmp}/b", USAGE, "give LABEL=DIR"),
    ("world draw --seed 1 --out {empty}/w.json", USAGE, "w.json: Not a directory; correct the path"),
    ("world commit {tmp}/none.json", USAGE, "none.json"),
    ("replay {tmp}/none", USAGE, "does not exist"),
    ("replay {tmp}", USAGE, "holds no run.mcap"),
    ("replay {junk} --step nan", USAGE, "--step': nan is not a finite number"),
    ("replay {junk} --speed 0", USAGE, "0.0 is not in the range 0<x<=1"),
    ("replay {junk}", REFUSED, "junk.mcap is no MCAP recording: it begins with b'plain wo'"),
    ("replay {run} --executor " + NOBODY, USAGE, "add --real"),
    ("replay {run} --yes", USAGE, "add --real"),
    ("replay {run} --real --yes --world {run}", USAGE, "leave out --world, or --real"),
    ("replay {run} --loop 0", USAGE, "--loop"),
    ("log check {junk}", REFUSED, "no MCAP recording"),
    ("log check {empty}", REFUSED, "no MCAP recording: it is empty"),
    ("log check {tmp}", USAGE, "holds no run.mcap"),
    ("log export {junk} --to pdf", USAGE, "'pdf' is not one of"),
    ("log export {junk}", USAGE, "Missing option '--to'"),
    ("log export {junk} --to csv", REFUSED, "no MCAP recording"),
    ("log diff {junk}", USAGE, "Missing argument 'SECOND'"),
    ("log diff {junk} {junk} --tolerance -1", USAGE, "-1.0 is not in the range"),
    ("log recover {tmp}/none.mcap", USAGE, "does not exist"),
    ("view {tmp}/none.mcap", USAGE, "does not exist"),
    ("view {junk}", REFUSED, "no MCAP recording"),
    ("console --host 0.0.0.0", USAGE, "without a token.*--token-file"),
    ("console --host 0.0.0.0 --token-file {empty}", USAGE, "empty is empty; make one with: openssl"),
    ("console --token-file {empty}", USAGE, "empty is empty; make one with: openssl"),
    ("console --token-file {junk}", USAGE, "needs at least 16"),
    ("console --token-file {binary}", USAGE, "binary is not text; make one with: openssl"),
    ("console --port 99999", USAGE, "99999 is not in the range"),
    ("console --executor tcp/10.0.0.5:1 --runs {tmp} --port 0", USAGE, "without certificates"),
    ("console --runs {tmp}/typo --port 0", USAGE, "typo: there is no such folder; correct the path, or make it"),
    ("build-model --before {tmp}/a.ply --after {tmp}/b.ply --out {tmp}/m", USAGE, "a.ply"),
    ("doctor --arm panda", USAGE, "no arm 'panda'"),
    ("doctor --name robot", USAGE, "--name and --days.*--make-certs"),
    ("doctor --arm xmate3pro --bus can:can0", USAGE, "one at a time"),
    ("doctor --make-certs {tmp}/lab --name robot:7447", USAGE, "--name 'robot:7447' is neither an address nor a"),
    ("doctor --make-certs {empty}/lab", NOT_READY, "cannot be written to .*Not a directory; name a folder"),
    ("ros2 --listen tcp/0.0.0.0:7449", USAGE, "--listen.*ROS 2 brings no certificates"),
    ("ros2 --router tcp/10.0.0.5:7447", USAGE, "--router.*ROS 2 brings no certificates.*on their machine"),
    ("ros2 --router 7447", USAGE, "--router 7447: .*tcp/127.0.0.1:PORT"),
    ("ros2 --domain 300", USAGE, "300 is not in the range"),
    ("gap --out {tmp}/g", USAGE, "no model given"),
    ("gap --model {tmp}/m.xml --fit {junk} --out {tmp}/g --seed -1", USAGE, "-1 is not in the range x>=0"),
    ("gap --model {tmp}/m.xml --fit {junk} --out {tmp}/g", (USAGE, REFUSED), "m.xml"),
    ("demo --out {full}", USAGE, "exists and is not empty"),
    ("demo --seed -1 --out {tmp}/d", USAGE, "-1 is not in the range x>=0"),
    ("demo --attempts 0 --out {tmp}/d", USAGE, "0 is not in the range x>=1"),
    ("demo --pace nan --out {tmp}/d", USAGE, "--pace': nan is not a finite number"),
    ("demo --clock sundial", USAGE, "'sundial' is not one of"),
]  # fmt: skip


@pytest.fixture
def places(tmp_path):
    (tmp_path / "tmp").mkdir()
    (tmp_path / "run").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full/something").touch()
    (tmp_path / "run/run.json").write_text("{}")
    (tmp_path / "junk.mcap").write_text("plain words\n")
    (tmp_path / "empty").touch()
    (tmp_path / "binary").write_bytes(b"\x98\xff\x00")
    (tmp_path / "keys.yaml").write_text("core:\n  speed: 9\n")
    names = {
        "tmp": "tmp",
        "run": "run",
        "full": "full",
        "junk": "junk.mcap",
        "empty": "empty",
        "binary": "binary",
        "yaml": "keys.yaml",
    }
    return {name: str(tmp_path / path) for name, path in names.items()}


def test_the_list_is_long_enough():
    assert len(CASES) >= 40


@pytest.mark.parametrize(("line", "code", "says"), CASES, ids=[case[0] for case in CASES])
def test_a_wrong_input_ends_with_its_code_and_says_what_to_do(line, code, says, places, capfd):
    with pytest.raises(SystemExit) as ended:
        main([word.format(**places) for word in line.split()])
    said = " ".join(capfd.readouterr().err.split())
    codes = code if isinstance(code, tuple) else (code,)
    assert ended.value.code in codes, f"exit {ended.value.code}: {said}"
    assert re.search(says, said), said
    assert "Traceback" not in said
    assert ExitCode(ended.value.code) is not ExitCode.BUG
