"""Sealing the answers: a published salted hash commits to them, a key kept apart opens them.

``answers.sealed`` is JSON in SHAKE-256 counter-free stream encryption (keystream = SHAKE-256(key ‖ nonce), as
long as the text) under HMAC-SHA-256, encrypt-then-MAC.  The text holds the answers and SHA-256 of every file the tool
gets.  Before anything is run, ``manifest.json`` holds SHA-256(salt ‖ text) and the same hashes of the files in the
open: who changes a recording can write its new hash there, but not under the seal.  The salt lies inside the key file,
so the hash cannot be searched by redrawing small seeds.  In sets of schema 1 the text holds the answers alone; in
those of schema 2 what a model file has built in and whether effort is recorded depend on what is hidden.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from s2r_conceal.errors import SealError, VerdictsMissingError
from s2r_protocol.whole_file import write_whole

SEALED, MANIFEST, VERDICTS = "answers.sealed", "manifest.json", "verdicts.json"
SCHEMA = 3  # of what is drawn and of what is sealed
_TAG_BYTES, _NONCE_BYTES = 32, 16


@dataclass(frozen=True)
class Key:
    """What opens a sealed set. ``drawn_with`` says how to draw the set again, ``unfinished`` that it is being drawn."""

    key: bytes
    salt: bytes
    drawn_with: dict[str, Any]
    unfinished: bool = False

    @classmethod
    def fresh(cls, drawn_with: dict[str, Any], unfinished: bool = False) -> Key:
        """A new random key."""
        return cls(secrets.token_bytes(32), secrets.token_bytes(32), drawn_with, unfinished)

    def finished(self) -> Key:
        """The same key, of a set that is drawn."""
        return replace(self, unfinished=False)

    def write(self, path: Path) -> None:
        """Write the key file, readable by its owner only."""
        path.parent.mkdir(parents=True, exist_ok=True)
        body: dict[str, Any] = {"key": self.key.hex(), "salt": self.salt.hex(), "drawn_with": self.drawn_with}
        if self.unfinished:
            body["unfinished"] = True
        half = path.with_name(path.name + ".half")  # a key cut short would open nothing any more
        half.touch(mode=0o600)
        half.write_text(json.dumps(body, indent=1) + "\n")
        os.replace(half, path)

    @classmethod
    def read(cls, path: Path) -> Key:
        """Read a key file.

        Raises:
            SealError: It is not one.
        """
        try:
            body = json.loads(path.read_text())
            return cls(
                bytes.fromhex(body["key"]),
                bytes.fromhex(body["salt"]),
                body["drawn_with"],
                bool(body.get("unfinished")),
            )
        except KeyError as error:
            raise SealError(f"{path} is no key file of 's2r conceal draw': it has no {error}") from error
        except (OSError, ValueError, TypeError) as error:
            raise SealError(f"{path} is no key file of 's2r conceal draw': {error}") from error


def sha256(data: bytes) -> str:
    """Hexadecimal SHA-256."""
    return hashlib.sha256(data).hexdigest()


def seal(answers: dict[str, Any], key: Key) -> tuple[bytes, str]:
    """Encrypted answers, and the salted hash that commits to them."""
    text = json.dumps(answers, sort_keys=True, allow_nan=True).encode()
    nonce = hashlib.sha256(b"nonce" + key.salt + text).digest()[:_NONCE_BYTES]
    body = nonce + _stream(text, key.key, nonce)
    return _tag(body, key.key) + body, sha256(key.salt + text)


def unseal(sealed: bytes, key: Key, published: str) -> dict[str, Any]:
    """Open sealed answers and check them against the published hash.

    Raises:
        SealError: Wrong key, changed file, or answers other than those committed to.
    """
    text = _text(sealed, key)
    found = sha256(key.salt + text)
    if found != published:
        raise SealError(f"the answers' hash is {found}, but {MANIFEST} published {published} before")
    return json.loads(text)


def open_sealed(sealed: bytes, key: Key) -> dict[str, Any]:
    """Open what the key itself vouches for: nothing of it was published.

    Raises:
        SealError: Wrong key, or a changed file.
    """
    return json.loads(_text(sealed, key))


def _text(sealed: bytes, key: Key) -> bytes:
    tag, body = sealed[:_TAG_BYTES], sealed[_TAG_BYTES:]
    if not hmac.compare_digest(tag, _tag(body, key.key)):
        raise SealError(f"{SEALED} does not open: another key, or the file was changed")
    return _stream(body[_NONCE_BYTES:], key.key, body[:_NONCE_BYTES])


def _stream(text: bytes, key: bytes, nonce: bytes) -> bytes:
    stream = hashlib.shake_256(key + nonce).digest(len(text))
    return bytes(a ^ b for a, b in zip(text, stream, strict=True))


def _tag(body: bytes, key: bytes) -> bytes:
    return hmac.new(hashlib.sha256(b"tag" + key).digest(), body, hashlib.sha256).digest()


# -- folders -------------------------------------------------------------------------------------------


def publish(folder: Path, answers: dict[str, Any], key: Key) -> None:
    """Write ``answers.sealed`` and ``manifest.json`` of a drawn set; the manifest names no seed."""
    files = {case: hashes_of(folder / case) for case in sorted(answers)}
    sealed, published = seal({"schema": SCHEMA, "answers": answers, "files": files}, key)
    (folder / SEALED).write_bytes(sealed)
    manifest = {
        "schema": SCHEMA,
        "answers_sha256_salted": published,
        "answers_file_sha256": sha256(sealed),
        "cases": files,
    }
    write_whole(folder / MANIFEST, json.dumps(manifest, indent=1) + "\n")


def hashes_of(case: Path) -> dict[str, str]:
    """SHA-256 of every file of a case by name; of none where there is no such folder."""
    return {f.name: sha256(f.read_bytes()) for f in sorted(case.iterdir())} if case.is_dir() else {}


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a drawn set.

    Raises:
        SealError: There is none, or it cannot be read.
    """
    try:
        return json.loads((folder / MANIFEST).read_text())
    except (OSError, ValueError) as error:
        raise SealError(f"{folder} holds no readable {MANIFEST}: draw a set first ({error})") from error


def check_files(folder: Path, manifest: dict[str, Any]) -> None:
    """Compare every file the tool gets with its published hash.

    Raises:
        SealError: A file was changed or is gone.
    """
    for case, files in manifest["cases"].items():
        for name, published in files.items():
            path = folder / case / name
            if not path.is_file():
                raise SealError(f"{path} is gone; {MANIFEST} lists it")
            if sha256(path.read_bytes()) != published:
                raise SealError(f"{path} was changed after it was drawn: its hash differs from {MANIFEST}")


def hash_verdicts(folder: Path) -> dict[str, str]:
    """Hash of every verdict there is, by case."""
    found = sorted(folder.glob("verdicts/case-*.json"))
    return {path.stem: sha256(path.read_bytes()) for path in found}


def hashed_verdicts(folder: Path) -> dict[str, str]:
    """The published hash of every verdict, by case; none before they are published.

    Raises:
        SealError: The file is there and cannot be read.
    """
    path = folder / VERDICTS
    if not path.is_file():
        return {}
    try:
        return dict(json.loads(path.read_text())["verdicts"])
    except (ValueError, KeyError, TypeError) as error:
        raise SealError(
            f"{path} cannot be read, so that nobody knows what was hashed: put back its copy, or run the tool over a "
            "copy of the set without verdicts/ and verdicts.json"
        ) from error


def publish_verdicts(folder: Path) -> str:
    """Write ``verdicts.json`` with the hash of every verdict; returns the hash over all of them.

    Raises:
        SealError: A verdict was changed after it was hashed: it is not hashed anew.
    """
    check_hashed(folder)
    hashes = hash_verdicts(folder)
    total = _total(hashes)
    write_whole(folder / VERDICTS, json.dumps({"total_sha256": total, "verdicts": hashes}, indent=1) + "\n")
    return total


def _total(hashes: dict[str, str]) -> str:
    return sha256(json.dumps(hashes, sort_keys=True).encode())


def check_hashed(folder: Path) -> None:
    """Compare every verdict that is hashed with its hash; fine where none is yet.

    Raises:
        SealError: One was changed or is gone, or so are the hashes.
    """
    path = folder / VERDICTS
    if not path.is_file():
        return
    stated = hashed_verdicts(folder)
    if json.loads(path.read_text()).get("total_sha256") != _total(stated):
        raise SealError(f"{path} was changed: its hashes do not make the total that it states")
    for case, published in stated.items():
        verdict = folder / "verdicts" / f"{case}.json"
        if not verdict.is_file() or sha256(verdict.read_bytes()) != published:
            raise SealError(f"{verdict} was changed after it was hashed in {VERDICTS}")


def check_verdicts(folder: Path, manifest: dict[str, Any]) -> None:
    """Allow opening the answers only when every verdict exists and is the one that was hashed.

    Raises:
        VerdictsMissingError: Verdicts are missing or not hashed.
        SealError: A verdict was changed after it was hashed.
    """
    path = folder / VERDICTS
    if not path.is_file():
        raise VerdictsMissingError(f"{path} does not exist: run 's2r conceal run {folder} --command …' first")
    stated = hashed_verdicts(folder)
    missing = sorted(set(manifest["cases"]) - set(stated))
    if missing:
        raise VerdictsMissingError(
            f"{len(missing)} of {len(manifest['cases'])} cases have no hashed verdict, first {missing[0]}; "
            "run 's2r conceal run' to the end"
        )
    check_hashed(folder)


def open_answers(folder: Path, key_file: Path) -> dict[str, Any]:
    """The answers of a set whose verdicts are complete and hashed.

    Raises:
        VerdictsMissingError: Not yet.
        SealError: Something was changed, or the key is another one.
    """
    manifest = read_manifest(folder)
    check_files(folder, manifest)
    check_verdicts(folder, manifest)
    sealed = (folder / SEALED).read_bytes()
    content = unseal(sealed, Key.read(key_file), manifest["answers_sha256_salted"])
    answers = content["answers"] if "files" in content else content
    listed = manifest["cases"]
    if answers.keys() != listed.keys():
        other = min(answers.keys() ^ listed.keys())
        raise SealError(f"{MANIFEST} lists other cases than have answers, {other} among them")
    if "files" in content:
        _check_listed(listed, content["files"])
    elif manifest.get("schema") != 1:
        raise SealError(
            f"{MANIFEST} was changed: under the seal of this set there are no hashes of its files"
        )
    return answers


def _check_listed(listed: dict[str, dict[str, str]], sealed: dict[str, dict[str, str]]) -> None:
    for case, files in sealed.items():
        if listed[case] != files:
            name = min(k for k in listed[case].keys() | files.keys() if listed[case].get(k) != files.get(k))
            raise SealError(
                f"{case}/{name} is not what was drawn: its hash in {MANIFEST} differs from that under the seal"
            )


def weaknesses(folder: Path) -> list[str]:
    """What a set of an older version proves less than one drawn now, a sentence each."""
    schema, found = read_manifest(folder).get("schema"), []
    if schema == 1:
        found.append(
            f"its seal holds the answers alone, and only {MANIFEST} says what its recordings and models were"
        )
    if schema in (1, 2):
        found.append(
            "files with something built in and files without effort were drawn for some groups only, so that they "
            "told the answer"
        )
    return found
