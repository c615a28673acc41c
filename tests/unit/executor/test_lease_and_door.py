"""One holder, alive by its heartbeat; right process, arm and epoch; repeated messages act once."""

from __future__ import annotations

import pytest

from s2r_executor.door import Identity, SequenceBook, check_addressee, check_epoch
from s2r_executor.lease import Lease
from s2r_executor.plan import CommandRefusedError
from s2r_protocol.codec import Address
from s2r_protocol.faults import Refusal

ME = Identity(boot_id=7, model_hash=b"m" * 32, limit_hash=b"l" * 32)


def address(**changes):
    values = {
        "sender": "host:1",
        "boot_id": 7,
        "epoch": 3,
        "seq": 1,
        "model_hash": b"m" * 32,
        "limit_hash": b"l" * 32,
    }
    return Address(**{**values, **changes})


def test_of_two_hosts_exactly_one_gets_the_lease_and_the_other_is_told():
    lease = Lease(timeout_s=0.05)
    assert lease.request("a", 0.0).granted
    second = lease.request("b", 0.01)
    assert not second.granted
    assert second.holder == "a"
    assert "'a' holds the lease" in second.reason


def test_asking_again_renews_the_lease():
    lease = Lease(timeout_s=0.05)
    lease.request("a", 0.0)
    assert lease.request("a", 0.04).granted
    assert lease.expire(0.08) == ""


@pytest.mark.parametrize(("silence_s", "lost"), [(0.0625, ""), (0.0626, "a")])
def test_lease_ends_only_after_the_timeout(silence_s, lost):
    lease = Lease(timeout_s=0.0625)
    lease.request("a", 0.0)
    lease.beat("a", 1.0)
    assert lease.expire(1.0 + silence_s) == lost
    assert lease.holder == ("" if lost else "a")


def test_a_heartbeat_after_the_end_does_not_bring_the_lease_back():
    lease = Lease(timeout_s=0.05)
    lease.request("a", 0.0)
    lease.expire(1.0)
    assert not lease.beat("a", 1.0)
    assert lease.holder == ""


def test_heartbeats_of_others_do_not_keep_the_lease_alive():
    lease = Lease(timeout_s=0.05)
    lease.request("a", 0.0)
    assert not lease.beat("b", 0.05)
    assert lease.expire(0.06) == "a"


def test_a_late_heartbeat_is_counted_without_a_stop():
    lease = Lease(timeout_s=0.05)
    lease.request("a", 0.0)
    lease.beat("a", 0.03)
    lease.beat("a", 0.04)
    assert lease.late_beats == 1
    assert lease.holder == "a"


def test_only_the_holder_can_give_back():
    lease = Lease(timeout_s=0.05)
    lease.request("a", 0.0)
    assert not lease.release("b").granted
    assert lease.release("a").granted
    assert lease.request("b", 0.0).granted


def test_a_nameless_sender_gets_no_lease():
    assert not Lease(0.05).request("", 0.0).granted


def test_the_right_address_passes():
    check_addressee(address(), ME)
    check_epoch(address(), 3)


@pytest.mark.parametrize(
    ("changes", "code", "quantity"),
    [
        ({"boot_id": 8}, Refusal.STALE, "boot_id"),
        ({"boot_id": 0}, Refusal.STALE, "boot_id"),
        ({"model_hash": b"x" * 32}, Refusal.MODEL, "model_hash"),
        ({"model_hash": b""}, Refusal.MODEL, "model_hash"),
        ({"limit_hash": b"m" * 32}, Refusal.MODEL, "limits_hash"),
    ],
)
def test_another_process_model_or_limit_is_refused(changes, code, quantity):
    with pytest.raises(CommandRefusedError) as error:
        check_addressee(address(**changes), ME)
    assert (error.value.code, error.value.quantity) == (code, quantity)


@pytest.mark.parametrize("epoch", [2, 4])
def test_an_older_or_newer_epoch_is_refused(epoch):
    with pytest.raises(CommandRefusedError, match=f"epoch {epoch}, the executor is at 3") as error:
        check_epoch(address(epoch=epoch), 3)
    assert error.value.code is Refusal.STALE


def test_sequence_numbers_must_rise_per_sender():
    book = SequenceBook()
    book.admit(address(seq=5))
    book.admit(address(seq=1, sender="other"))
    book.admit(address(seq=9))
    for seq in (9, 8, 5, 0):
        with pytest.raises(CommandRefusedError) as error:
            book.admit(address(seq=seq))
        assert error.value.code is Refusal.STALE
    assert "go on from 10, or take a sender name of its own for every process" in str(error.value)


@pytest.mark.parametrize(
    ("theirs", "said"), [(b"", "'host:1' sent no model hash"), (b"x" * 32, "'host:1' sent model hash 787878")]
)
def test_a_missing_hash_is_told_from_another_one(theirs, said):
    with pytest.raises(CommandRefusedError) as error:
        check_addressee(address(model_hash=theirs), ME)
    assert str(error.value).startswith(said)


def test_the_same_bytes_get_the_same_answer_and_others_do_not():
    book = SequenceBook()
    book.admit(address(seq=5))
    book.remember(address(seq=5), b"plan", b"yes")
    for _ in range(1000):
        assert book.repeated(address(seq=5), b"plan") == b"yes"
    assert book.repeated(address(seq=5), b"other plan") is None
    assert book.repeated(address(seq=6), b"plan") is None
    assert book.repeated(address(seq=5, sender="other"), b"plan") is None
