"""Who may send what to whom: the cell's services as a table, and Zenoh's access control made of it.

Everything that is not in the table is denied, in both directions, at every process that has a certificate.
Zenoh matches a peer by the common name of its certificate (https://zenoh.io/docs/manual/access-control).
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any

from s2r_protocol.keys import ArmKeys
from s2r_protocol.session.tls import Role

_READERS = (Role.HOST, Role.MONITOR)


class Kind(enum.Enum):
    """What travels on a key."""

    QUERY = "query"  # clients ask, the owner replies
    STREAM = "stream"  # the owner puts, clients listen
    PRESENCE = "presence"  # the owner holds liveliness tokens, clients look


@dataclass(frozen=True)
class Service:
    """One row: ``owner`` offers ``key`` to ``clients``."""

    name: str
    kind: Kind
    key: str
    owner: Role
    clients: tuple[Role, ...]


# Messages from client to owner, and from owner to client, by kind. A declaration is a message too.
_ASKED: dict[Kind, tuple[str, ...]] = {
    Kind.QUERY: ("query",),
    Kind.STREAM: ("declare_subscriber",),
    Kind.PRESENCE: ("liveliness_query", "declare_liveliness_subscriber"),
}
_GIVEN: dict[Kind, tuple[str, ...]] = {
    Kind.QUERY: ("declare_queryable", "reply"),
    Kind.STREAM: ("put", "delete"),
    Kind.PRESENCE: ("liveliness_token", "reply"),
}


def services(keys: ArmKeys) -> tuple[Service, ...]:
    """Every service of one arm's cell."""
    base, domain = keys.base, "*"  # the ROS domain is no secret and no right
    return (
        Service("hello", Kind.QUERY, keys.hello, Role.EXECUTOR, _READERS),
        Service("lease", Kind.QUERY, keys.lease, Role.EXECUTOR, (Role.HOST,)),
        Service("plan", Kind.QUERY, keys.plan, Role.EXECUTOR, (Role.HOST,)),
        Service("control", Kind.QUERY, keys.control, Role.EXECUTOR, (Role.HOST,)),
        Service("heartbeat", Kind.STREAM, keys.heartbeat, Role.HOST, (Role.EXECUTOR,)),
        Service("recording", Kind.QUERY, keys.recording, Role.EXECUTOR, _READERS),
        Service("observations", Kind.STREAM, f"{domain}/{base}/**", Role.EXECUTOR, _READERS),
        Service("ROS 2 graph", Kind.PRESENCE, "@ros2_lv/**", Role.EXECUTOR, _READERS),
        Service("capture", Kind.QUERY, keys.capture("*"), Role.CAMERA, _READERS),
    )


def access_control(me: Role, keys: ArmKeys) -> dict[str, Any]:
    """Zenoh's ``access_control`` block for a process of role ``me``: deny by default."""
    rules, policies = [], []
    for service in services(keys):
        for owner, peers in _sides(service, me):
            asked, given = ("ingress", "egress") if owner else ("egress", "ingress")
            for flow, messages in ((asked, _ASKED[service.kind]), (given, _GIVEN[service.kind])):
                name = f"{service.name}, {flow}"
                rules.append(
                    {
                        "id": name,
                        "permission": "allow",
                        "flows": [flow],
                        "messages": list(messages),
                        "key_exprs": [service.key],
                    }
                )
                policies.append({"rules": [name], "subjects": [str(peer) for peer in peers]})
    known = sorted({subject for policy in policies for subject in policy["subjects"]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in known],
        "policies": policies,
    }


def _sides(service: Service, me: Role) -> list[tuple[bool, tuple[Role, ...]]]:
    """Whether ``me`` is the owner, and whom it deals with there."""
    if service.owner == me:
        return [(True, service.clients)]
    if me in service.clients:
        return [(False, (service.owner,))]
    return []
