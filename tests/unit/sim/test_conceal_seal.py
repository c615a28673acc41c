"""Sealing, publishing and opening: nothing opens early, nothing can be exchanged unnoticed."""

import json

import pytest

from s2r_conceal.errors import SealError, VerdictsMissingError
from s2r_conceal.seal import (
    MANIFEST,
    SEALED,
    VERDICTS,
    Key,
    check_files,
    hash_verdicts,
    open_answers,
    publish,
    publish_verdicts,
    read_manifest,
    seal,
    sha256,
    unseal,
    weaknesses,
)

ANSWERS = {"case-0001": {"effects": ["backlash"]}, "case-0002": {"effects": []}}


@pytest.fixture
def sealed_set(tmp_path):
    """A published set of two cases with verdicts, and its key file beside it."""
    folder = tmp_path / "set"
    for case in ANSWERS:
        (folder / case).mkdir(parents=True)
        (folder / case / "fit.csv").write_text("t,q.joint1\n0,0\n")
    publish(folder, ANSWERS, key := Key.fresh({"seed": 5}))
    key.write(tmp_path / "key.json")
    (folder / "verdicts").mkdir()
    for case in ANSWERS:
        (folder / "verdicts" / f"{case}.json").write_text("{}")
    return folder, tmp_path / "key.json"


def test_sealed_answers_open_with_their_key():
    key = Key.fresh({})
    sealed, published = seal(ANSWERS, key)
    assert unseal(sealed, key, published) == ANSWERS


def test_sealed_answers_show_nothing():
    sealed, _ = seal(ANSWERS, Key.fresh({}))
    assert b"backlash" not in sealed
    assert b"case" not in sealed


def test_two_seals_of_one_answer_differ_in_hash_and_text():
    (one, hash_one), (two, hash_two) = (seal(ANSWERS, Key.fresh({})) for _ in range(2))
    assert one != two
    assert hash_one != hash_two


def test_another_key_does_not_open():
    sealed, published = seal(ANSWERS, Key.fresh({}))
    with pytest.raises(SealError, match="another key, or the file was changed"):
        unseal(sealed, Key.fresh({}), published)


def test_a_flipped_bit_is_noticed():
    key = Key.fresh({})
    sealed, published = seal(ANSWERS, key)
    changed = sealed[:-1] + bytes([sealed[-1] ^ 1])
    with pytest.raises(SealError, match="does not open"):
        unseal(changed, key, published)


def test_answers_other_than_the_published_ones_are_noticed():
    key = Key.fresh({})
    _, published = seal(ANSWERS, key)
    other, _ = seal({"case-0001": {"effects": ["cogging"]}}, key)
    with pytest.raises(SealError, match="published"):
        unseal(other, key, published)


def test_a_key_file_is_read_back_and_private(tmp_path):
    key = Key.fresh({"seed": 9})
    key.write(tmp_path / "key.json")
    assert Key.read(tmp_path / "key.json") == key
    assert (tmp_path / "key.json").stat().st_mode & 0o077 == 0


def test_a_file_that_is_no_key_is_named(tmp_path):
    (tmp_path / "x.json").write_text("{}")
    with pytest.raises(SealError, match=r"x\.json is no key file .*: it has no 'key'"):
        Key.read(tmp_path / "x.json")


def test_manifest_holds_hashes_but_no_seed(sealed_set):
    folder, _ = sealed_set
    manifest = read_manifest(folder)
    assert set(manifest) == {"schema", "answers_sha256_salted", "answers_file_sha256", "cases"}
    assert set(manifest["cases"]) == set(ANSWERS)


def test_answers_stay_shut_until_the_verdicts_are_hashed(sealed_set):
    folder, key = sealed_set
    with pytest.raises(VerdictsMissingError, match=r"verdicts\.json does not exist"):
        open_answers(folder, key)
    publish_verdicts(folder)
    assert open_answers(folder, key) == ANSWERS


def test_answers_stay_shut_while_a_verdict_is_missing(sealed_set):
    folder, key = sealed_set
    (folder / "verdicts" / "case-0002.json").unlink()
    publish_verdicts(folder)
    with pytest.raises(VerdictsMissingError, match="1 of 2 cases have no hashed verdict, first case-0002"):
        open_answers(folder, key)


def test_a_verdict_changed_after_hashing_is_noticed(sealed_set):
    folder, key = sealed_set
    publish_verdicts(folder)
    (folder / "verdicts" / "case-0001.json").write_text('{"better": 1}')
    with pytest.raises(SealError, match=r"case-0001\.json was changed after it was hashed"):
        open_answers(folder, key)


@pytest.mark.parametrize("left", ['{"better": 1}', None])
def test_a_verdict_changed_after_hashing_is_not_hashed_anew(sealed_set, left):
    folder, key = sealed_set
    publish_verdicts(folder)
    path = folder / "verdicts" / "case-0001.json"
    path.unlink() if left is None else path.write_text(left)
    with pytest.raises(SealError, match=r"case-0001\.json was changed after it was hashed"):
        publish_verdicts(folder)
    with pytest.raises(SealError, match=r"case-0001\.json was changed after it was hashed"):
        open_answers(folder, key)


def test_a_hash_of_a_verdict_changed_by_hand_is_noticed(sealed_set):
    folder, key = sealed_set
    publish_verdicts(folder)
    (folder / "verdicts" / "case-0001.json").write_text('{"better": 1}')
    body = json.loads((folder / VERDICTS).read_text())
    body["verdicts"] = hash_verdicts(folder)
    (folder / VERDICTS).write_text(json.dumps(body))
    with pytest.raises(SealError, match=r"verdicts\.json was changed: its hashes do not make the total"):
        open_answers(folder, key)


def test_a_case_left_out_of_the_manifest_is_noticed(sealed_set):
    folder, key = sealed_set
    publish_verdicts(folder)
    manifest = json.loads((folder / MANIFEST).read_text())
    del manifest["cases"]["case-0002"]
    (folder / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(
        SealError, match=r"manifest\.json lists other cases than have answers, case-0002 among them"
    ):
        open_answers(folder, key)


def test_a_recording_changed_after_drawing_is_noticed(sealed_set):
    folder, _ = sealed_set
    (folder / "case-0002" / "fit.csv").write_text("t,q.joint1\n0,1\n")
    with pytest.raises(SealError, match=r"case-0002/fit\.csv was changed"):
        check_files(folder, read_manifest(folder))


@pytest.mark.parametrize("schema", [1, 2])
def test_a_recording_changed_together_with_its_hash_is_noticed(sealed_set, schema):
    folder, key = sealed_set
    publish_verdicts(folder)
    path = folder / "case-0002" / "fit.csv"
    path.write_text("t,q.joint1\n0,1\n")
    manifest = json.loads((folder / MANIFEST).read_text())
    manifest["cases"]["case-0002"]["fit.csv"] = sha256(path.read_bytes())
    (folder / MANIFEST).write_text(json.dumps(manifest | {"schema": schema}))
    check_files(folder, read_manifest(folder))
    with pytest.raises(SealError, match=r"case-0002/fit\.csv is not what was drawn"):
        open_answers(folder, key)


def test_a_file_that_the_manifest_no_longer_lists_is_noticed(sealed_set):
    folder, key = sealed_set
    publish_verdicts(folder)
    manifest = json.loads((folder / MANIFEST).read_text())
    manifest["cases"]["case-0001"] = {}
    (folder / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(SealError, match=r"case-0001/fit\.csv is not what was drawn"):
        open_answers(folder, key)


def _as_an_older_version(folder, key_file):
    sealed, published = seal(ANSWERS, Key.read(key_file))
    (folder / SEALED).write_bytes(sealed)
    manifest = read_manifest(folder) | {"schema": 1, "answers_sha256_salted": published}
    (folder / MANIFEST).write_text(json.dumps(manifest))


def test_a_set_of_an_older_version_is_still_opened_and_told_apart(sealed_set):
    folder, key = sealed_set
    assert weaknesses(folder) == []
    _as_an_older_version(folder, key)
    publish_verdicts(folder)
    assert open_answers(folder, key) == ANSWERS
    alone, told = weaknesses(folder)
    assert "its seal holds the answers alone" in alone
    (folder / MANIFEST).write_text(json.dumps(read_manifest(folder) | {"schema": 2}))
    assert weaknesses(folder) == [told]
    assert "for some groups only, so that they told the answer" in told
    with pytest.raises(SealError, match="no hashes of its files"):
        open_answers(folder, key)


def test_verdict_hashes_that_were_cut_off_are_refused_with_the_next_step(sealed_set):
    folder, key = sealed_set
    publish_verdicts(folder)
    text = (folder / VERDICTS).read_text()
    (folder / VERDICTS).write_text(text[: len(text) // 2])
    for ask in (lambda: publish_verdicts(folder), lambda: open_answers(folder, key)):
        with pytest.raises(SealError, match=r"verdicts\.json cannot be read"):
            ask()


def test_a_hash_changed_in_the_manifest_is_noticed(sealed_set):
    folder, key = sealed_set
    publish_verdicts(folder)
    manifest = json.loads((folder / MANIFEST).read_text())
    manifest["answers_sha256_salted"] = "0" * 64
    (folder / MANIFEST).write_text(json.dumps(manifest))
    with pytest.raises(SealError, match="published 000"):
        open_answers(folder, key)
    assert (folder / SEALED).is_file()
