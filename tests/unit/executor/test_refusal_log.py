"""What the executor's terminal shows of refusals: who, what, why, and how many more."""

from types import SimpleNamespace

from s2r_executor.refusal_log import RefusalLog


def test_a_burst_is_one_line_and_a_count(caplog):
    clock = SimpleNamespace(s=100.0)
    log = RefusalLog(lambda: clock.s)
    for number in range(1, 6):
        log.add(f"message {number} of 'mine' (lab/arm/plan)", ValueError("too fast"))
        log.tell()
    assert [r.message for r in caplog.records] == ["refused: message 1 of 'mine' (lab/arm/plan): too fast"]
    clock.s += 1.0
    log.tell()
    log.tell()
    assert [r.message for r in caplog.records][1:] == ["4 more refused since then"]


def test_the_next_refusal_comes_after_the_count_of_those_before_it(caplog):
    clock = SimpleNamespace(s=100.0)
    log = RefusalLog(lambda: clock.s)
    for number in (1, 2):
        log.add(f"message {number}", ValueError("no"))
    clock.s += 2.0
    log.add("message 3", ValueError("no"))
    assert [r.message for r in caplog.records] == [
        "refused: message 1: no",
        "1 more refused since then",
        "refused: message 3: no",
    ]
