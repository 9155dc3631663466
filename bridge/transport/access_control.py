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


class Flow(StrEnum):
    """The direction of a message, as the node or router sees it."""

    IN = "ingress"
    OUT = "egress"


class May(StrEnum):
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

    flow: Flow
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

_RULES: dict[May, tuple[tuple[Flow, tuple[str, ...]], ...]] = {
    May.SEND: ((Flow.IN, ("put",)), (Flow.OUT, ("declare_subscriber",))),
    May.HEAR: ((Flow.IN, ("declare_subscriber",)), (Flow.OUT, ("put",))),
    May.ASK: ((Flow.IN, ("query",)), (Flow.OUT, ("reply", "declare_queryable"))),
    May.SHOW: ((Flow.IN, ("liveliness_token",)), (Flow.OUT, ("declare_liveliness_subscriber", "liveliness_query"))),
    May.SEE: (
        (Flow.IN, ("declare_liveliness_subscriber", "liveliness_query")),
        (Flow.OUT, ("liveliness_token", "reply")),
    ),
}


def common_name(role: Role) -> str:
    """What stands in a role's certificates, and in the rules."""
    return f"zenostat-{role}"


def may(role: Role, topic: Topic) -> tuple[May, ...]:
    """What a role may do with a topic. A monitor only reads: it sends nothing, also where anyone else may."""
    if role is Role.NODE:
        return _node_may(topic)
    commands = role is Role.CONTROLLER and topic.sender is not Role.NODE
    if topic.delivery is Delivery.TOKEN:
        return (May.SHOW, May.SEE) if commands else (May.SEE,)
    if topic.delivery is Delivery.QUERY:
        return (May.ASK,) if commands or topic.sender is Role.ANYONE else ()
    if topic.sender is Role.NODE:
        return (May.HEAR, May.ASK) if topic.reply else (May.HEAR,)
    return (May.SEND,) if commands else ()


def _node_may(topic: Topic) -> tuple[May, ...]:
    if topic.delivery is Delivery.TOKEN:
        return (May.SHOW, May.SEE)
    if topic.delivery is Delivery.QUERY:
        return (May.ASK, May.ANSWER)
    return (May.SEND, May.HEAR, May.ASK, May.ANSWER) if topic.reply else (May.SEND, May.HEAR)


def rules(role: Role) -> tuple[Rule, ...]:
    """The rules for a link to a program of that role."""
    if role is Role.NODE:
        everything = (*(topic.at("*", name="*") for topic in TOPICS), keys.stream("*"))
        return tuple(Rule(flow, ALL_MESSAGES, everything) for flow in Flow)
    found: list[Rule] = []
    for kind, parts in _RULES.items():
        topics = [topic for topic in TOPICS if kind in may(role, topic)]
        for flow, messages in parts if topics else ():
            found.append(
                Rule(flow, messages, _keys(topics, listens="declare_subscriber" in messages and flow is Flow.IN))
            )
    return tuple(found)


def _keys(topics: Iterable[Topic], *, listens: bool) -> tuple[str, ...]:
    found = [topic.at("*", name="*") for topic in topics]
    return (*found, keys.stream("*")) if listens else tuple(found)


def control() -> dict[str, Any]:
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
