"""The contract as an AsyncAPI 3.0 document, generated from the table of topics and the message classes. No I/O.

The document describes a node as the application: its actions are `send` for messages of the node and `receive` for
messages to it. AsyncAPI has no bindings for Zenoh; `x-zenoh` describes how a channel's messages are delivered.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

from pydantic.json_schema import models_json_schema

from zenostat.topics import codec, errors
from zenostat.topics.errors import ZenostatError
from zenostat.topics.keys import DEFAULT_HOST, DEFAULT_PORT, PREFIX, TOPICS, Delivery, Role, Topic
from zenostat.topics.messages import SCHEMA_VERSION, ErrorReply, Message

ASYNCAPI = "3.0.0"
QUESTION = "Question"
"""A Zenoh query without a payload."""
PRESENCE = "Presence"
"""A liveliness token."""

_NO_PAYLOAD = {
    QUESTION: (
        "A Zenoh query (`get`) without a payload, on the key of a message that is also published. The reply is the "
        "latest such message; a query with a payload is rejected with an `ErrorReply`."
    ),
    PRESENCE: "A Zenoh liveliness token: it exists as long as its owner is connected and has no payload. Whoever "
    "watches one subscribes with Zenoh's `history`: the loss of a token is reported only to whoever has received it.",
}
_CERTIFICATE = "certificate"
_ITEMS = {
    "corner_counts": "uint16",
    "corners": "float32",
    "exposed": "uint8",
    "kinds": "uint8",
    "operations": "uint8",
    "payload": "uint8",
    "samples": "uint8",
    "source_index": "uint16",
    "zone_index": "int16",
}
_DELIVERIES = {
    Delivery.DROP: {"primitive": "put", "congestion_control": "drop"},
    Delivery.BLOCK: {"primitive": "put", "congestion_control": "block"},
    Delivery.QUERY: {"primitive": "query"},
    Delivery.TOKEN: {"primitive": "liveliness"},
}
_DESCRIPTION = (
    "The topics of a Zenostat node on a Zenoh bus. A payload is one msgpack map of its message's fields; its Zenoh "
    "encoding is the message's content type. Fields of the format `binary` are msgpack `bin`: raw arrays in C order, "
    "little-endian, of the type given by `x-items`. Messages without a payload are Zenoh queries and liveliness tokens."
)
_SERVERS = {
    "node": ("tcp", "A node without keys: every program on the machine can connect.", ()),
    "secured": (
        "tls",
        "A node with keys: connections are encrypted, and both sides have a certificate.",
        (_CERTIFICATE,),
    ),
}
"""For each server its Zenoh transport, what it is, and what secures it."""
_TLS_CONFIG = {
    "transport/link/tls": {
        "root_ca_certificate": "ca.pem",
        "connect_certificate": "NAME.pem",
        "connect_private_key": "NAME.key",
        "enable_mtls": True,
    }
}
"""Zenoh's configuration of a client with keys, whose files are in its folder of keys."""


def document() -> dict[str, Any]:
    """Return the AsyncAPI document as a mapping of built-in types."""
    return {
        "asyncapi": ASYNCAPI,
        "info": {"title": "Zenostat node", "version": str(SCHEMA_VERSION), "description": _DESCRIPTION},
        "defaultContentType": "application/msgpack",
        "servers": {name: _server(*row) for name, row in _SERVERS.items()},
        "channels": {channel_name(topic): _channel(topic) for topic in TOPICS},
        "operations": {name: operation for topic in TOPICS for name, operation in _operations(topic)},
        "components": {"messages": _messages(), "schemas": _schemas(), "securitySchemes": _security()},
    }


def _server(transport: str, description: str, security: tuple[str, ...]) -> dict[str, Any]:
    server: dict[str, Any] = {
        "host": "{host}:{port}",
        "protocol": "zenoh",
        "description": f"{description} It routes messages between all its clients; connect in Zenoh's mode `client`.",
        "variables": {
            "host": {"default": DEFAULT_HOST, "description": "Address on which the node listens."},
            "port": {"default": str(DEFAULT_PORT), "description": "Port on which the node listens."},
        },
        "x-zenoh": {"locator": f"{transport}/{{host}}:{{port}}", "mode": "client", "multicast_scouting": False},
    }
    if security:
        server["x-zenoh"]["config"] = _TLS_CONFIG
        server["security"] = [{"$ref": f"#/components/securitySchemes/{name}"} for name in security]
    return server


def _security() -> dict[str, Any]:
    roles = ", ".join(f"`{role}`" for role in Role if role is not Role.ANYONE)
    text = (
        "A certificate of the node's own authority. Its common name is the sender's name, which its messages have in "
        f"their keys; its roles limit the topics: {roles}."
    )
    return {_CERTIFICATE: {"type": "X509", "description": text}}


def channel_name(topic: Topic) -> str:
    """Return a topic's channel name: `sample`, `sensor`, `rpc.claim`, `live.node`."""
    return topic.key.removeprefix("@").removesuffix("/{name}").removesuffix("/{sender}").replace("/", ".")


def payload_classes() -> list[type[Message]]:
    """Return the classes of all payloads, in the order of the table."""
    classes = [kind for topic in TOPICS for kind in (topic.message, topic.reply) if kind is not None]
    return list(dict.fromkeys([*classes, ErrorReply]))


def _channel(topic: Topic) -> dict[str, Any]:
    names = dict.fromkeys([*_sent(topic), *_queries(topic), *_replies(topic)])
    parameters = {"node": {"description": "The node's name."}}
    if "{name}" in topic.key:
        parameters["name"] = {"description": "The name of the point or the node's instance."}
    if topic.has_sender:
        parameters["sender"] = {
            "description": "The sender's name: with keys, that of its certificate, or one below it (`name.part`)."
        }
    return {
        "address": f"{PREFIX}/{{node}}/{topic.key}",
        "messages": {name: {"$ref": f"#/components/messages/{name}"} for name in names},
        "parameters": parameters,
        "x-zenoh": dict(_DELIVERIES[topic.delivery]),
    }


def _sent(topic: Topic) -> list[str]:
    """Names of the messages that are put, declared or sent as a query's payload."""
    return [topic.message.__name__ if topic.message else PRESENCE]


def _queries(topic: Topic) -> list[str]:
    """Names of the queries without a payload, which published topics with a reply accept."""
    return [QUESTION] if topic.reply and topic.delivery is not Delivery.QUERY else []


def _replies(topic: Topic) -> list[str]:
    return [] if topic.reply is None else [topic.reply.__name__, ErrorReply.__name__]


def _operations(topic: Topic) -> Iterator[tuple[str, dict[str, Any]]]:
    name = channel_name(topic)
    summary = f"From: {' or '.join(topic.senders)}."
    if topic.delivery is Delivery.QUERY:
        yield name, _operation(topic, "receive", _sent(topic), summary, has_reply=True)
        return
    yield name, _operation(topic, "send" if topic.sender is Role.NODE else "receive", _sent(topic), summary)
    if topic.reply is not None:
        yield f"{name}.get", _operation(topic, "receive", _queries(topic), f"From: {Role.ANYONE}.", has_reply=True)


def _operation(
    topic: Topic, action: str, messages: list[str], summary: str, *, has_reply: bool = False
) -> dict[str, Any]:
    channel = f"#/channels/{channel_name(topic)}"
    operation: dict[str, Any] = {
        "action": action,
        "summary": summary,
        "channel": {"$ref": channel},
        "messages": [{"$ref": f"{channel}/messages/{name}"} for name in messages],
    }
    if has_reply:
        replies = [{"$ref": f"{channel}/messages/{name}"} for name in _replies(topic)]
        operation["reply"] = {"channel": {"$ref": channel}, "messages": replies}
    return operation


def _messages() -> dict[str, Any]:
    messages: dict[str, Any] = {
        kind.__name__: {
            "name": kind.__name__,
            "contentType": codec.encoding(kind),
            "summary": inspect.getdoc(kind),
            "payload": {"$ref": f"#/components/schemas/{kind.__name__}"},
        }
        for kind in payload_classes()
    }
    messages[ErrorReply.__name__]["x-errors"] = {kind.__name__: inspect.getdoc(kind) for kind in _errors(ZenostatError)}
    return messages | {name: {"name": name, "summary": text} for name, text in _NO_PAYLOAD.items()}


def _errors(kind: type[ZenostatError]) -> Iterator[type[ZenostatError]]:
    yield kind
    for child in kind.__subclasses__():
        if child.__module__ == errors.__name__:
            yield from _errors(child)


def _schemas() -> dict[str, Any]:
    """JSON schemas of all payloads and of their nested classes."""
    classes = [(kind, "validation") for kind in payload_classes()]
    _, document = models_json_schema(classes, ref_template="#/components/schemas/{model}")  # type: ignore[arg-type]
    schemas: dict[str, Any] = document["$defs"]
    for schema in schemas.values():
        for name, field in schema.get("properties", {}).items():
            for form in (field, *field.get("anyOf", []), field.get("items", {})):
                if form.get("format") == "binary":
                    form["x-items"] = _ITEMS.get(name, "float64")
    return {name: _of_draft_7(schema) for name, schema in sorted(schemas.items())}


def _of_draft_7(schema: Any) -> Any:
    """Convert a schema to AsyncAPI's dialect, draft 7 with a discriminator of its own.

    A tuple's schemas are in `items`. A discriminator is the name of a property, which its schema has and requires;
    each alternative determines its value by `const`. (OpenAPI's is a map, which pydantic generates.)
    """
    if isinstance(schema, list):
        return [_of_draft_7(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    converted = {"items" if key == "prefixItems" else key: _of_draft_7(part) for key, part in schema.items()}
    discriminator = converted.get("discriminator")
    if isinstance(discriminator, dict) and "oneOf" in converted:
        name = discriminator["propertyName"]
        values = {"type": "string", "enum": list(discriminator["mapping"])}
        converted |= {"discriminator": name, "type": "object", "properties": {name: values}, "required": [name]}
    return converted
