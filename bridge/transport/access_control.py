"""Access control on a secured bus: Zenoh's configuration, generated from the table of topics and the list of names.

A node or router applies the rules to each of its links, in both directions, by the common name in the peer's
certificate: the name of a program or a person. Who reads what depends on the roles of that name; what changes something
is bound to the name as well, which is in its key. Zenoh silently drops everything that no rule allows. Nodes and
routers trust each other: they forward messages of others, which the first of them has already checked.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from zenostat.topics import keys
from zenostat.topics.keys import TOPICS, Delivery, Role, Topic


class Direction(StrEnum):
    """Direction of a message from the point of view of the node or router."""

    IN = "ingress"
    OUT = "egress"


class Permission(StrEnum):
    """An operation on a topic."""

    SEND = "send"
    HEAR = "hear"
    ASK = "ask"
    ANSWER = "answer"
    SHOW = "show"  # declare a liveliness token
    SEE = "see"  # observe liveliness tokens


@dataclass(frozen=True, slots=True)
class Rule:
    """Allows these kinds of messages with these keys in this direction."""

    flow: Direction
    messages: tuple[str, ...]
    keys: tuple[str, ...]


ALL_MESSAGES = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
)
"""All kinds of messages that Zenoh's access control distinguishes."""

TRAINER = "trainer"
"""Name of the certificate with which environments connect."""

RESETTING = (Role.CONTROLLER, Role.OPERATOR)
"""Roles of a controller that also resets, as an operator: environments and districts."""

_RULES: dict[Permission, tuple[tuple[Direction, tuple[str, ...]], ...]] = {
    Permission.SEND: ((Direction.IN, ("put",)), (Direction.OUT, ("declare_subscriber",))),
    Permission.HEAR: ((Direction.IN, ("declare_subscriber",)), (Direction.OUT, ("put",))),
    Permission.ASK: ((Direction.IN, ("query",)), (Direction.OUT, ("reply", "declare_queryable"))),
    Permission.SHOW: (
        (Direction.IN, ("liveliness_token",)),
        (Direction.OUT, ("declare_liveliness_subscriber", "liveliness_query")),
    ),
    Permission.SEE: (
        (Direction.IN, ("declare_liveliness_subscriber", "liveliness_query")),
        (Direction.OUT, ("liveliness_token", "reply")),
    ),
}


def may(role: Role, topic: Topic) -> tuple[Permission, ...]:
    """Return the permissions of a role on a topic. Monitors only read, also where any other role may send."""
    if role is Role.NODE:
        return _node_may(topic)
    if topic.delivery is Delivery.TOKEN:
        return (Permission.SHOW, Permission.SEE) if _sends(role, topic) else (Permission.SEE,)
    if topic.delivery is Delivery.QUERY:
        return (Permission.ASK,) if topic.sender is Role.ANYONE or _sends(role, topic) else ()
    if topic.sender is Role.NODE:
        return (Permission.HEAR, Permission.ASK) if topic.reply else (Permission.HEAR,)
    return (Permission.SEND,) if _sends(role, topic) else ()


def _sends(role: Role, topic: Topic) -> bool:
    """Return whether a role sends on a topic."""
    return any(includes(role, sender) for sender in topic.senders)


def includes(role: Role, other: Role) -> bool:
    """Return whether a role may send what another may; a gateway may what a controller and an operator may."""
    return role is other or (role is Role.GATEWAY and other in RESETTING)


def _node_may(topic: Topic) -> tuple[Permission, ...]:
    if topic.delivery is Delivery.TOKEN:
        return (Permission.SHOW, Permission.SEE)
    if topic.delivery is Delivery.QUERY:
        return (Permission.ASK, Permission.ANSWER)
    return (
        (Permission.SEND, Permission.HEAR, Permission.ASK, Permission.ANSWER)
        if topic.reply
        else (Permission.SEND, Permission.HEAR)
    )


def rules(role: Role) -> tuple[Rule, ...]:
    """Return the rules for a link to a program with that role, except those that are bound to its name."""
    if role is Role.NODE:
        all_keys = (*(topic.everywhere() for topic in TOPICS), keys.stream("*"))
        return tuple(Rule(flow, ALL_MESSAGES, all_keys) for flow in Direction)
    result: list[Rule] = []
    for permission, parts in _RULES.items():
        topics = [topic for topic in TOPICS if permission in may(role, topic)]
        for flow, messages in parts:
            subscribes = "declare_subscriber" in messages and flow is Direction.IN
            allowed = [topic for topic in topics if not _is_bound(permission, flow, topic)]
            if allowed:
                result.append(Rule(flow, messages, _keys(allowed, subscribes=subscribes)))
    return tuple(result)


def name_rules(name: str, roles: Sequence[Role]) -> tuple[Rule, ...]:
    """Return the rules for what the holder of a certificate sends under its name, or a name below it."""
    result: list[Rule] = []
    for permission, parts in _RULES.items():
        topics = [topic for topic in TOPICS if any(permission in may(role, topic) for role in roles)]
        for flow, messages in parts:
            own = [
                topic.at("*", name="*", sender=sender)
                for topic in topics
                if _is_bound(permission, flow, topic)
                for sender in (name, f"{name}.$*")
            ]
            if own:
                result.append(Rule(flow, messages, tuple(own)))
    return tuple(result)


def _is_bound(permission: Permission, flow: Direction, topic: Topic) -> bool:
    """Return whether a message names its sender, so that its rule depends on the name in the certificate."""
    sends = permission in (Permission.SEND, Permission.ASK, Permission.SHOW)
    return sends and flow is Direction.IN and topic.has_sender


def _keys(topics: Iterable[Topic], *, subscribes: bool) -> tuple[str, ...]:
    expressions = [topic.everywhere() for topic in topics]
    return (*expressions, keys.stream("*")) if subscribes else tuple(expressions)


def acl_config(names: Mapping[str, Sequence[Role]]) -> dict[str, Any]:
    """Return Zenoh's `access_control` settings, which deny everything that the rules do not allow.

    Args:
        names: the roles of each name.
    """
    # A subject without common names would be everybody, so each name is a subject of its own.
    all_rules: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []

    def allow(label: str, allowed: Sequence[Rule], subjects: Sequence[str]) -> None:
        converted = [_zenoh(f"{label}-{number}", rule) for number, rule in enumerate(allowed)]
        if converted and subjects:
            all_rules.extend(converted)
            policies.append({"rules": [rule["id"] for rule in converted], "subjects": [*subjects]})

    for role in Role:
        allow(f"role-{role}", rules(role), [name for name, roles in names.items() if role in roles])
    for name, roles in names.items():
        if Role.NODE not in roles:
            allow(f"name-{name}", name_rules(name, roles), [name])
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": all_rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in names],
        "policies": policies,
    }


def _zenoh(name: str, rule: Rule) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": [rule.flow.value],
        "messages": list(rule.messages),
        "key_exprs": list(rule.keys),
    }
