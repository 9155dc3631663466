"""The contract as an AsyncAPI 3.0 document, made of the table of topics and the message classes. No I/O.

The application that it describes is a node: what the node sends is `send`, what others send to it is `receive`.
AsyncAPI has no bindings for Zenoh; `x-zenoh` says how a channel's messages travel.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

from pydantic.json_schema import models_json_schema

from topics import codec, errors
from topics.errors import ZenostatError
from topics.keys import PREFIX, TOPICS, Delivery, Role, Topic
from topics.messages import SCHEMA_VERSION, ErrorReply, Message

ASYNCAPI = "3.0.0"
QUESTION = "Question"
"""A Zenoh query without a payload."""
PRESENCE = "Presence"
"""A liveliness token."""

_NO_PAYLOAD = {
    QUESTION: "A Zenoh query (`get`) without a payload.",
    PRESENCE: "A Zenoh liveliness token: there as long as who declared it; it carries no payload.",
}
_ITEMS = {"operations": "uint8", "payload": "uint8", "source_index": "uint16"}
_TRAVEL = {
    Delivery.DROP: {"primitive": "put", "congestion_control": "drop"},
    Delivery.BLOCK: {"primitive": "put", "congestion_control": "block"},
    Delivery.QUERY: {"primitive": "query"},
    Delivery.TOKEN: {"primitive": "liveliness"},
}
_ABOUT = (
    "The topics of a Zenostat node on a Zenoh bus. A payload is one msgpack map of its message's fields, and the Zenoh "
    "encoding that it travels with is its message's content type. Fields of the format `binary` are msgpack `bin`: raw "
    "arrays in C order, of little-endian float64, of little-endian uint16 or of uint8, as `x-items` says."
)


def document() -> dict[str, Any]:
    """The AsyncAPI document: a mapping of plain values."""
    return {
        "asyncapi": ASYNCAPI,
        "info": {"title": "Zenostat node", "version": str(SCHEMA_VERSION), "description": _ABOUT},
        "defaultContentType": "application/msgpack",
        "channels": {channel_name(topic): _channel(topic) for topic in TOPICS},
        "operations": {name: made for topic in TOPICS for name, made in _operations(topic)},
        "components": {"messages": _messages(), "schemas": _schemas()},
    }


def channel_name(topic: Topic) -> str:
    """The row's name in the document: `sample`, `sensor`, `rpc.claim`, `live.node`."""
    return topic.key.removeprefix("@").removesuffix("/{name}").replace("/", ".")


def travelling() -> list[type[Message]]:
    """The classes of all payloads, in the order of the table."""
    found = [kind for topic in TOPICS for kind in (topic.message, topic.reply) if kind is not None]
    return list(dict.fromkeys([*found, ErrorReply]))


def _channel(topic: Topic) -> dict[str, Any]:
    names = dict.fromkeys([*_sent(topic), *_asked(topic), *_answers(topic)])
    parameters = {"node": {"description": "The node's name."}}
    if "{name}" in topic.key:
        parameters["name"] = {"description": "Of the point, the controller or the node's instance."}
    return {
        "address": f"{PREFIX}/{{node}}/{topic.key}",
        "messages": {name: {"$ref": f"#/components/messages/{name}"} for name in names},
        "parameters": parameters,
        "x-zenoh": dict(_TRAVEL[topic.delivery]),
    }


def _sent(topic: Topic) -> list[str]:
    """What is put or declared, or asked with a payload."""
    return [topic.message.__name__ if topic.message else PRESENCE]


def _asked(topic: Topic) -> list[str]:
    """A published topic that can be asked for as well takes a query without a payload."""
    return [QUESTION] if topic.reply and topic.delivery is not Delivery.QUERY else []


def _answers(topic: Topic) -> list[str]:
    if topic.reply is None:
        return []
    return [topic.reply.__name__] + ([ErrorReply.__name__] if topic.delivery is Delivery.QUERY else [])


def _operations(topic: Topic) -> Iterator[tuple[str, dict[str, Any]]]:
    name = channel_name(topic)
    says = f"From: {topic.sender}."
    if topic.delivery is Delivery.QUERY:
        yield name, _operation(topic, "receive", _sent(topic), says, asks=True)
        return
    yield name, _operation(topic, "send" if topic.sender is Role.NODE else "receive", _sent(topic), says)
    if topic.reply is not None:
        yield f"{name}.get", _operation(topic, "receive", _asked(topic), f"From: {Role.ANYONE}.", asks=True)


def _operation(topic: Topic, action: str, messages: list[str], says: str, *, asks: bool = False) -> dict[str, Any]:
    channel = f"#/channels/{channel_name(topic)}"
    made: dict[str, Any] = {
        "action": action,
        "summary": says,
        "channel": {"$ref": channel},
        "messages": [{"$ref": f"{channel}/messages/{name}"} for name in messages],
    }
    if asks:
        answers = [{"$ref": f"{channel}/messages/{name}"} for name in _answers(topic)]
        made["reply"] = {"channel": {"$ref": channel}, "messages": answers}
    return made


def _messages() -> dict[str, Any]:
    found: dict[str, Any] = {
        kind.__name__: {
            "name": kind.__name__,
            "contentType": codec.encoding(kind),
            "summary": inspect.getdoc(kind),
            "payload": {"$ref": f"#/components/schemas/{kind.__name__}"},
        }
        for kind in travelling()
    }
    found[ErrorReply.__name__]["x-errors"] = {kind.__name__: inspect.getdoc(kind) for kind in _errors(ZenostatError)}
    return found | {name: {"name": name, "summary": text} for name, text in _NO_PAYLOAD.items()}


def _errors(kind: type[ZenostatError]) -> Iterator[type[ZenostatError]]:
    yield kind
    for child in kind.__subclasses__():
        if child.__module__ == errors.__name__:
            yield from _errors(child)


def _schemas() -> dict[str, Any]:
    """JSON schemas of all payloads and of what is in them."""
    wanted = [(kind, "validation") for kind in travelling()]
    _, made = models_json_schema(wanted, ref_template="#/components/schemas/{model}")  # type: ignore[arg-type]
    schemas: dict[str, Any] = made["$defs"]
    for schema in schemas.values():
        for name, field in schema.get("properties", {}).items():
            for form in (field, *field.get("anyOf", [])):
                if form.get("format") == "binary":
                    form["x-items"] = _ITEMS.get(name, "float64")
    return {name: _of_draft_7(schema) for name, schema in sorted(schemas.items())}


def _of_draft_7(schema: Any) -> Any:
    """AsyncAPI's own form of a schema: a tuple's parts stand in `items`."""
    if isinstance(schema, list):
        return [_of_draft_7(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    return {"items" if key == "prefixItems" else key: _of_draft_7(part) for key, part in schema.items()}
