"""Access control on a secured bus: Zenoh's configuration, generated from the table of topics.

A node or router applies the rules to each of its links, in both directions, by the common name in the peer's
certificate. Zenoh silently drops everything that no rule allows. Nodes and routers trust each other: they forward
messages of others, which the first of them has already checked.
"""

from __future__ import annotations

from collections.abc import Iterable
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

ROLES = (Role.NODE, Role.CONTROLLER, Role.MONITOR)
"""The roles with rules and certificates."""

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


def common_name(role: Role) -> str:
    """Return the common name of a role's certificates, to which the rules refer."""
    return f"zenostat-{role}"


def may(role: Role, topic: Topic) -> tuple[Permission, ...]:
    """Return the permissions of a role on a topic. Monitors only read, also where any other role may send."""
    if role is Role.NODE:
        return _node_may(topic)
    commands = role is Role.CONTROLLER and topic.sender is not Role.NODE
    if topic.delivery is Delivery.TOKEN:
        return (Permission.SHOW, Permission.SEE) if commands else (Permission.SEE,)
    if topic.delivery is Delivery.QUERY:
        return (Permission.ASK,) if commands or topic.sender is Role.ANYONE else ()
    if topic.sender is Role.NODE:
        return (Permission.HEAR, Permission.ASK) if topic.reply else (Permission.HEAR,)
    return (Permission.SEND,) if commands else ()


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
    """Return the rules for a link to a program with that role."""
    if role is Role.NODE:
        all_keys = (*(topic.at("*", name="*") for topic in TOPICS), keys.stream("*"))
        return tuple(Rule(flow, ALL_MESSAGES, all_keys) for flow in Direction)
    result: list[Rule] = []
    for kind, parts in _RULES.items():
        topics = [topic for topic in TOPICS if kind in may(role, topic)]
        for flow, messages in parts if topics else ():
            subscribes = "declare_subscriber" in messages and flow is Direction.IN
            result.append(Rule(flow, messages, _keys(topics, subscribes=subscribes)))
    return tuple(result)


def _keys(topics: Iterable[Topic], *, subscribes: bool) -> tuple[str, ...]:
    expressions = [topic.at("*", name="*") for topic in topics]
    return (*expressions, keys.stream("*")) if subscribes else tuple(expressions)


def acl_config() -> dict[str, Any]:
    """Return Zenoh's `access_control` settings, which deny everything that the rules do not allow."""
    by_role = {role: [_zenoh(f"{role}-{i}", rule) for i, rule in enumerate(rules(role))] for role in ROLES}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for role_rules in by_role.values() for rule in role_rules],
        "subjects": [{"id": role.value, "cert_common_names": [common_name(role)]} for role in ROLES],
        "policies": [{"rules": [rule["id"] for rule in by_role[role]], "subjects": [role.value]} for role in ROLES],
    }


def _zenoh(name: str, rule: Rule) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": [rule.flow.value],
        "messages": list(rule.messages),
        "key_exprs": list(rule.keys),
    }
