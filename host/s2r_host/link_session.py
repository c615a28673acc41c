"""Opening a Zenoh session and asking one question: no arrays, no messages, quick to import."""

from __future__ import annotations

import json

import zenoh


def open_session(endpoint: str) -> zenoh.Session:
    """A peer that connects to one endpoint, retries every 100 ms, listens nowhere and scouts nobody.

    Returns at once even when nobody listens there; a query then has zero replies.
    """
    config = zenoh.Config()
    for key, value in (
        ("mode", "peer"),
        ("connect/endpoints", [endpoint]),
        ("connect/timeout_ms", 0),
        ("connect/exit_on_failure", False),
        ("connect/retry", {"period_init_ms": 100, "period_max_ms": 100, "period_increase_factor": 1}),
        ("listen/endpoints", []),
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
    ):
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def ask(session: zenoh.Session, key: str, wire: bytes, timeout_s: float) -> list[bytes]:
    """Send one query; all good replies' payloads in order. Empty means refused unread, dead or absent."""
    # Without NONE, Zenoh keeps only the newest reply of a key, and a recording comes as several.
    replies = session.get(key, payload=wire, timeout=timeout_s, consolidation=zenoh.ConsolidationMode.NONE)
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]
