"""Who may say what on a closed bus: Zenoh's access control, made of the table of topics.

A node or router applies the rules to each of its links, in both directions, by the common name in the certificate at
the other end. What no rule allows is dropped without a word. Nodes and routers trust each other: they pass on what
others say, whom the first of them has checked already.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from topics import keys
from topics.keys import TOPICS, Delivery, Role, Topic


class Direction(StrEnum):
    """The direction of a message, as the node or router sees it."""

    IN = "ingress"
    OUT = "egress"


class Permission(StrEnum):
    """What a role may do with a topic."""

    SEND = "send"
    HEAR = "hear"
    ASK = "ask"
    ANSWER = "answer"
    SHOW = "show"  # a token of presence
    SEE = "see"


@dataclass(frozen=True, slots=True)
class Rule:
    """Messages of these kinds with these keys may pass in this direction."""

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
"""Every kind of message that Zenoh tells apart."""

ROLES = (Role.NODE, Role.CONTROLLER, Role.MONITOR)
"""The roles that rules and certificates are made for."""

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
    """What stands in a role's certificates, and in the rules."""
    return f"zenostat-{role}"


def may(role: Role, topic: Topic) -> tuple[Permission, ...]:
    """What a role may do with a topic. A monitor only reads: it sends nothing, also where anyone else may."""
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
    """The rules for a link to a program of that role."""
    if role is Role.NODE:
        everything = (*(topic.at("*", name="*") for topic in TOPICS), keys.stream("*"))
        return tuple(Rule(flow, ALL_MESSAGES, everything) for flow in Direction)
    found: list[Rule] = []
    for kind, parts in _RULES.items():
        topics = [topic for topic in TOPICS if kind in may(role, topic)]
        for flow, messages in parts if topics else ():
            found.append(
                Rule(flow, messages, _keys(topics, listens="declare_subscriber" in messages and flow is Direction.IN))
            )
    return tuple(found)


def _keys(topics: Iterable[Topic], *, listens: bool) -> tuple[str, ...]:
    found = [topic.at("*", name="*") for topic in topics]
    return (*found, keys.stream("*")) if listens else tuple(found)


def acl_config() -> dict[str, Any]:
    """Zenoh's `access_control`: nothing is allowed but what the rules of the link's role allow."""
    made = {role: [_zenoh(f"{role}-{i}", rule) for i, rule in enumerate(rules(role))] for role in ROLES}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for of_role in made.values() for rule in of_role],
        "subjects": [{"id": role.value, "cert_common_names": [common_name(role)]} for role in ROLES],
        "policies": [{"rules": [rule["id"] for rule in made[role]], "subjects": [role.value]} for role in ROLES],
    }


def _zenoh(name: str, rule: Rule) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": [rule.flow.value],
        "messages": list(rule.messages),
        "key_exprs": list(rule.keys),
    }
