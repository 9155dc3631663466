"""The parts of docs/contract.md that are made of the code; `python tests/support/contract_page.py` writes them again.

A part stands between `<!-- made: NAME -->` and `<!-- end -->`.
"""

import inspect
import re
import struct
from pathlib import Path
from typing import Any

import msgpack

from zenostat.topics import asyncapi, codec, errors, yaml12
from zenostat.topics.errors import ZenostatError
from zenostat.topics.keys import PREFIX, TOPICS, Delivery, Topic
from zenostat.topics.messages import Command, CommandOp, Flag, Sample

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "contract.md"
DOCUMENT = ROOT / "docs" / "asyncapi.yaml"

SETPOINTS = (20.0, 26.0)
COMMAND = Command(episode=[0], step=[3], operations=None, values=struct.pack("<2d", *SETPOINTS))
MASKED = Command(
    episode=[0],
    step=[3],
    operations=bytes([CommandOp.KEEP, CommandOp.SET]),
    values=struct.pack("<2d", 0.0, SETPOINTS[1]),
)
SAMPLE = Sample(
    episode=[0],
    step=[3],
    time=["2017-07-03T00:45:00"],
    elapsed_s=[2700.0],
    flags=[Flag.NONE],
    values=struct.pack("<3d", 17.3, 23.5, 1.8e6),
    effective=struct.pack("<2d", *SETPOINTS),
    commanded=struct.pack("<2d", *SETPOINTS),
    source_index=struct.pack("<2H", 1, 0),
    sources=["", "mine"],
)
"""Two sensors and a meter, two actuators of which the first is set by `mine`."""

_A_LINE = 16
_WIDTH = 60


def parts() -> dict[str, str]:
    """Each made part by its name."""
    return {
        "keys": _keys(),
        "arrays": _arrays(),
        "command": _fenced(COMMAND),
        "masked": _fenced(MASKED),
        "sample": _fenced(SAMPLE),
        "errors": _errors(ZenostatError, 0),
    }


def page(text: str) -> str:
    """A page with its made parts made anew."""
    generated = parts()

    def part(match: re.Match[str]) -> str:
        return f"<!-- made: {match[1]} -->\n{generated[match[1]]}\n<!-- end -->"

    return re.sub(r"<!-- made: (\w+) -->\n.*?<!-- end -->", part, text, flags=re.DOTALL)


def _keys() -> str:
    rows = ["| key | who sends | how | message | reply |", "|---|---|---|---|---|"]
    for topic in TOPICS:
        message = f"`{topic.message.__name__}`" if topic.message else "none"
        reply = f"`{topic.reply.__name__}`" if topic.reply else ""
        rows.append(
            f"| `{PREFIX}/{{node}}/{topic.key}` | {' or '.join(topic.senders)} | {_how(topic)} | {message} | {reply} |"
        )
    return "\n".join(rows)


def _arrays() -> str:
    rows = ["| message | field | elements |", "|---|---|---|"]
    schemas = asyncapi.document()["components"]["schemas"]
    for kind in asyncapi.payload_classes():
        for name, field in schemas[kind.__name__]["properties"].items():
            arrays = {
                form["x-items"]
                for form in (field, *field.get("anyOf", []), field.get("items", {}))
                if "x-items" in form
            }
            if name == "samples":
                arrays = {"a list of encoded `Sample` messages, each a `bin`"}
            rows += [f"| `{kind.__name__}` | `{name}` | {items} |" for items in arrays]
    return "\n".join(rows)


def _how(topic: Topic) -> str:
    if topic.delivery is Delivery.QUERY:
        return "query"
    if topic.delivery is Delivery.TOKEN:
        return "liveliness token"
    return f"put, {topic.delivery}" + ("; query" if topic.reply else "")


def _fenced(message: Command | Sample) -> str:
    payload = codec.encode(message)
    caption = f"{len(payload)} bytes, encoding {codec.encoding(type(message))}"
    return "\n".join(["```text", caption, "", *diagnosed(payload), "```"])


def diagnosed(payload: bytes) -> list[str]:
    """A msgpack map as lines of hexadecimal bytes, each with what they mean."""
    fields: dict[str, Any] = msgpack.unpackb(payload)
    head = payload[: len(payload) - sum(len(msgpack.packb(part)) for pair in fields.items() for part in pair)]
    lines = [_line(head, f"a map of {len(fields)}")]
    for name, value in fields.items():
        lines += [_line(msgpack.packb(name), f'"{name}"'), *_value(name, value)]
    assert bytes.fromhex("".join(line[:_WIDTH] for line in lines).replace(" ", "")) == payload
    return lines


def _line(raw: bytes, meaning: str) -> str:
    return f"{raw.hex(' '):<{_WIDTH}}{meaning}".rstrip()


def _value(name: str, value: Any) -> list[str]:
    packed, meaning = msgpack.packb(value), str(value).replace("'", '"').replace("None", "nil")
    begin = 0
    if isinstance(value, bytes):
        begin = len(packed) - len(value)
        kind = {"operations": "B", "source_index": "H"}.get(name, "d")
        meaning = str(struct.unpack(f"<{len(value) // struct.calcsize(kind)}{kind}", value))
    first = [_line(packed[:begin], f"bin of {len(packed) - begin} bytes")] if begin else []
    pieces = [packed[i : i + _A_LINE] for i in range(begin, len(packed), _A_LINE)]
    return first + [_line(piece, "" if number else meaning) for number, piece in enumerate(pieces)]


def _errors(kind: type[ZenostatError], depth: int) -> str:
    description = (inspect.getdoc(kind) or "").replace("\n", " ")
    below = [_errors(child, depth + 1) for child in kind.__subclasses__() if child.__module__ == errors.__name__]
    return "\n".join([f"{'    ' * depth}- `{kind.__name__}`: {description}", *below])


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    DOCUMENT.write_text(yaml12.dump(asyncapi.document()), encoding="utf-8")
