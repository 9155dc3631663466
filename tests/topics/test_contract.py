"""The contract as an AsyncAPI 3.0 document and as a page: they are what the code gives, and real messages fit them."""

import copy
import enum
import re
import struct
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import jsonschema
import msgpack
import pytest
import yaml
from pydantic_core import PydanticUndefined
from support import asyncapi_validators, contract_page
from support.contract_page import COMMAND, DOCUMENT, MASKED, PAGE, SAMPLE
from support.run_cli import ZENOSTAT, run_program

from zenostat.bridge.faults import read_plan
from zenostat.bridge.transport import session
from zenostat.topics import codec, keys, messages, yaml12
from zenostat.topics.asyncapi import channel_name, document, payload_classes
from zenostat.topics.errors import ZenostatError
from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.keys import TOPICS, Delivery, Role, Topic
from zenostat.topics.messages import ErrorReply, Message

CONTRACT = document()
CLASSES = sorted(payload_classes(), key=lambda kind: kind.__name__)
EVERY = sorted(
    (c for c in vars(messages).values() if isinstance(c, type) and issubclass(c, Message) and c is not Message),
    key=lambda kind: kind.__name__,
)

rows = pytest.mark.parametrize("topic", TOPICS, ids=lambda t: t.key)
every_class = pytest.mark.parametrize("kind", CLASSES, ids=lambda c: c.__name__)


def walk(value: Any) -> Iterator[dict[str, Any]]:
    """All maps of a document."""
    if isinstance(value, dict):
        yield value
        for inner in value.values():
            yield from walk(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from walk(inner)


def resolved(reference: str) -> Any:
    """Resolve a `$ref`; KeyError if it refers to nothing."""
    part_of_contract: Any = CONTRACT
    assert reference.startswith("#/")
    for part in reference[2:].split("/"):
        part_of_contract = part_of_contract[part.replace("~1", "/").replace("~0", "~")]
    return part_of_contract


# The document


def test_contract__it_has_the_form_of_asyncapi_3() -> None:
    asyncapi_validators.schema_validator().validate(CONTRACT)


@pytest.mark.slow
@pytest.mark.process
def test_contract__parser_of_the_standard_has_nothing_against_it() -> None:
    problems = asyncapi_validators.parser_problems(DOCUMENT)
    assert problems == []


def test_contract__schema_of_the_specification_refuses_a_discriminator_of_openapi() -> None:
    wrong = copy.deepcopy(CONTRACT)
    plan = wrong["components"]["schemas"]["FaultPlan"]["properties"]["faults"]["items"]
    plan["discriminator"] = {"propertyName": "kind"}
    worst = jsonschema.exceptions.best_match(asyncapi_validators.schema_validator().iter_errors(wrong))
    assert worst.absolute_path[-1] == "discriminator"


def test_a_discriminator__is_a_required_property_and_each_alternative_has_its_value() -> None:
    # AsyncAPI 3.0, Schema Object: the property must be defined at this schema and be required.
    schemas = [schema for schema in walk(CONTRACT["components"]["schemas"]) if "discriminator" in schema]
    assert schemas
    for schema in schemas:
        name = schema["discriminator"]
        assert name in schema["required"]
        values = [resolved(part["$ref"])["properties"][name]["const"] for part in schema["oneOf"]]
        assert sorted(schema["properties"][name]["enum"]) == sorted(values)


def test_contract__servers_are_the_endpoints_where_nodes_listen() -> None:
    locators = {}
    for name, server in CONTRACT["servers"].items():
        defaults = {variable: row["default"] for variable, row in server["variables"].items()}
        locators[name] = server["x-zenoh"]["locator"].format(**defaults)
        assert set(re.findall(r"\{(\w+)\}", server["host"])) == defaults.keys()
    assert locators == {"node": session.DEFAULT_ENDPOINT, "secured": session.DEFAULT_TLS_ENDPOINT}
    assert "security" not in CONTRACT["servers"]["node"]
    (needed,) = CONTRACT["servers"]["secured"]["security"]
    assert resolved(needed["$ref"])["type"] == "X509"


def test_contract__all_references_lead_somewhere() -> None:
    references = [node["$ref"] for node in walk(CONTRACT) if isinstance(node.get("$ref"), str)]
    assert len(references) > len(TOPICS)
    for reference in references:
        resolved(reference)


@rows
def test_contract__row_has_a_channel_at_its_key(topic: Topic) -> None:
    channel = CONTRACT["channels"][channel_name(topic)]
    address = channel["address"]
    assert address.format(node="office", name="one", sender="ppo-7") == topic.at("office", name="one", sender="ppo-7")
    assert set(channel["parameters"]) == set(re.findall(r"\{(\w+)\}", address))
    assert channel["x-zenoh"].get("congestion_control", "") == (
        str(topic.delivery) if topic.delivery in (Delivery.DROP, Delivery.BLOCK) else ""
    )


def test_contract__no_two_rows_share_a_channel() -> None:
    assert len(CONTRACT["channels"]) == len(TOPICS)
    assert len({channel["address"] for channel in CONTRACT["channels"].values()}) == len(TOPICS)


def _named(references: list[dict[str, str]]) -> list[str]:
    return [reference["$ref"].rpartition("/")[2] for reference in references]


@rows
def test_contract__row_has_an_operation_with_its_messages_and_replies(topic: Topic) -> None:
    operation = CONTRACT["operations"][channel_name(topic)]
    assert operation["action"] == ("send" if topic.sender is Role.NODE else "receive")
    assert _named(operation["messages"]) == [topic.message.__name__ if topic.message else "Presence"]
    asked = operation if topic.delivery is Delivery.QUERY else CONTRACT["operations"].get(f"{channel_name(topic)}.get")
    assert (asked is not None) == (topic.reply is not None)
    if asked is not None and topic.reply is not None:
        assert asked["action"] == "receive"
        assert _named(asked["reply"]["messages"]) == [topic.reply.__name__, ErrorReply.__name__]


def test_contract__operations_speak_of_messages_of_their_own_channel() -> None:
    # The specification: an operation's messages, and its reply's, are references into the channel.
    for operation in CONTRACT["operations"].values():
        for side in (operation, operation.get("reply")):
            for reference in side["messages"] if side else ():
                assert reference["$ref"].startswith(f"{side['channel']['$ref']}/messages/")


@every_class
def test_contract__message_has_its_encoding_and_a_schema(kind: type[Message]) -> None:
    message = CONTRACT["components"]["messages"][kind.__name__]
    assert message["contentType"] == codec.encoding(kind)
    assert resolved(message["payload"]["$ref"])["properties"].keys() == kind.model_fields.keys()


@pytest.mark.parametrize("kind", EVERY, ids=lambda c: c.__name__)
def test_contract__every_class_has_a_schema_that_is_closed(kind: type[Message]) -> None:
    schema = CONTRACT["components"]["schemas"][kind.__name__]
    jsonschema.Draft7Validator.check_schema(schema)
    assert schema["additionalProperties"] is False


def test_contract__schemas_need_nothing_that_is_newer_than_draft_7() -> None:
    # Schemas of AsyncAPI 3.0 that name no other format are a superset of JSON Schema draft 7.
    newer = {"$defs", "prefixItems", "unevaluatedProperties", "dependentRequired", "dependentSchemas", "minContains"}
    for schema in walk(CONTRACT["components"]["schemas"]):
        assert not newer & {key for key, value in schema.items() if not isinstance(value, dict) or "type" not in value}


def test_contract__every_error_is_named() -> None:
    named = CONTRACT["components"]["messages"]["ErrorReply"]["x-errors"]
    assert {"ZenostatError", "RequestRejected", "UnknownName", "NodeLost"} <= named.keys()
    assert all(issubclass(getattr(sys.modules["zenostat.topics.errors"], name), ZenostatError) for name in named)


# Real messages


def example(annotation: Any, name: str = "", *, full: bool) -> Any:
    """A value of an annotation; `full`: optional ones are there and lists have an entry."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return example(parts[0], name, full=full)
    if origin in (Union, types.UnionType):
        rest = [part for part in parts if part is not type(None)]
        return example(rest[0], name, full=full) if full or len(rest) == len(parts) else None
    if origin is Literal:
        return parts[0]
    if origin in (list, tuple):
        return [example(parts[0], name, full=full)]
    if origin is dict:
        return {"key": example(parts[1], name, full=full)} if full else {}
    if annotation is Any:
        return 1.5
    if issubclass(annotation, Message):
        return build_message(annotation, full=full)
    if issubclass(annotation, enum.Enum):
        return next(iter(annotation)).value
    return {bool: True, int: 2, float: 2.5, str: "name", bytes: struct.pack("<d", 2.5)}[annotation]


def build_message(kind: type[Message], *, full: bool) -> Message:
    """A message of a class: with every field given, or with those alone that it wants."""
    if kind is FaultPlan and full:
        return read_plan(
            Path(__file__).parents[2] / "examples" / "faults.yaml"
        )  # its times and shares are no numbers at will
    fields = {
        name: example(field.annotation, name, full=full)
        for name, field in kind.model_fields.items()
        if full or (field.default is PydanticUndefined and field.default_factory is None)
    }
    return kind.model_validate(fields)


def validator(kind: type[Message]) -> jsonschema.Draft7Validator:
    """Validator of a class, where msgpack's `bin` is what the schema calls a string of the format `binary`."""
    types_ = jsonschema.Draft7Validator.TYPE_CHECKER.redefine("string", lambda _, value: isinstance(value, str | bytes))
    checks = jsonschema.FormatChecker(formats=())
    checks.checks("binary")(lambda value: isinstance(value, bytes))
    strict = jsonschema.validators.extend(jsonschema.Draft7Validator, type_checker=types_)
    schema = {"$ref": f"#/components/schemas/{kind.__name__}", "components": CONTRACT["components"]}
    return strict(schema, format_checker=checks)


def fields_of(message: Message) -> dict[str, Any]:
    """Decode the fields as a stranger does, from the bytes."""
    return msgpack.unpackb(codec.encode(message))


@pytest.mark.parametrize("full", [True, False], ids=["full", "bare"])
@every_class
def test_contract__real_message_fits_its_schema(kind: type[Message], full: bool) -> None:
    message = build_message(kind, full=full)
    assert codec.decode(kind, codec.encode(message)) == message
    validator(kind).validate(fields_of(message))


@every_class
def test_contract__what_a_node_would_refuse_does_not_fit(kind: type[Message]) -> None:
    fields = fields_of(build_message(kind, full=True))
    assert not validator(kind).is_valid({**fields, "colour": "red"})
    required = [name for name, field in kind.model_fields.items() if field.is_required()]
    assert CONTRACT["components"]["schemas"][kind.__name__].get("required", []) == required
    for name in required:
        assert not validator(kind).is_valid({k: v for k, v in fields.items() if k != name})
    for name, value in fields.items():
        if isinstance(value, bytes):
            assert not validator(kind).is_valid({**fields, name: 5})
            assert not validator(kind).is_valid({**fields, name: "a text"})


def test_contract__raw_arrays_tell_their_elements() -> None:
    schemas = CONTRACT["components"]["schemas"]
    assert schemas["Sample"]["properties"]["values"]["x-items"] == "float64"
    assert schemas["Sample"]["properties"]["source_index"]["x-items"] == "uint16"
    mask = next(form for form in schemas["Command"]["properties"]["operations"]["anyOf"] if form["type"] == "string")
    assert mask["x-items"] == "uint8"
    for schema in walk(schemas):
        assert (schema.get("format") == "binary") == ("x-items" in schema)


# The file and the page


def test_contract__file_is_what_the_command_gives(tmp_path: Path) -> None:
    done = run_program("asyncapi", "--output", str(tmp_path / "asyncapi.yaml"))
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    text = (tmp_path / "asyncapi.yaml").read_text(encoding="utf-8")
    assert yaml.safe_load(text) == CONTRACT
    assert yaml12.parse(text, "the document") == CONTRACT
    assert DOCUMENT.read_text(encoding="utf-8") == text, "python tests/support/contract_page.py writes it again"


@pytest.mark.slow
def test_contract__command_prints_it_and_names_a_folder_that_is_not_there() -> None:
    command = [*ZENOSTAT, "asyncapi"]
    printed = subprocess.run(command, capture_output=True, text=True)
    assert yaml.safe_load(printed.stdout) == CONTRACT
    missing = subprocess.run([*command, "--output", "nowhere/a.yaml"], capture_output=True, text=True)
    assert (missing.returncode, missing.stdout) == (2, "")
    assert "there is no folder" in missing.stderr


def test_contract__page_is_what_the_code_gives() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert set(re.findall(r"<!-- made: (\w+) -->", text)) == contract_page.parts().keys()
    assert contract_page.page(text) == text, "python tests/support/contract_page.py writes it again"


def test_contract__page_names_every_array() -> None:
    documented = set(
        re.findall(
            r"^\| `(\w+)` \| `(\w+)` \| (?:(?:float|u?int)\d+|a list of .+) \|$", PAGE.read_text(encoding="utf-8"), re.M
        )
    )
    assert documented == {
        (kind.__name__, name)
        for kind in CLASSES
        for name, field in kind.model_fields.items()
        if bytes in {field.annotation, *get_args(field.annotation), *map(_plain, get_args(field.annotation))}
    }


def _plain(annotation: Any) -> Any:
    return get_args(annotation)[0] if get_origin(annotation) is Annotated else annotation


def _bytes_on_the_page(part: str) -> bytes:
    text = re.search(rf"<!-- made: {part} -->\n```text\n.*?\n\n(.*?)\n```", PAGE.read_text(encoding="utf-8"), re.S)
    return bytes.fromhex("".join(line[:60] for line in text[1].splitlines()).replace(" ", ""))


def test_contract__bytes_on_the_page_are_these_messages() -> None:
    """By hand: a stranger's msgpack, and floats as IEEE 754 has them."""
    command = msgpack.unpackb(_bytes_on_the_page("command"))
    assert command == {"episode": [0], "step": [3], "operations": None, "values": command["values"]}
    assert command["values"] == bytes.fromhex("00000000000034400000000000003a40")  # 1.25 * 2^4, 1.625 * 2^4
    masked = msgpack.unpackb(_bytes_on_the_page("masked"))
    assert (masked["operations"], masked["values"][8:]) == (b"\x00\x01", command["values"][8:])
    sample = msgpack.unpackb(_bytes_on_the_page("sample"))
    assert struct.unpack("<3d", sample["values"]) == (17.3, 23.5, 1.8e6)
    assert [sample["sources"][place] for place in struct.unpack("<2H", sample["source_index"])] == ["mine", ""]
    for message, part in ((COMMAND, "command"), (MASKED, "masked"), (SAMPLE, "sample")):
        assert codec.decode(type(message), _bytes_on_the_page(part)) == message


def test_contract__command_on_the_page_is_one_that_a_node_knows_by_its_first_bytes() -> None:
    head = codec.CommandHead([0], 16).at([3])
    assert _bytes_on_the_page("command") == head + COMMAND.values


def test_contract__keys_on_the_page_are_the_table() -> None:
    documented = re.findall(r"^\| `zenostat/v3/\{node\}/(\S+)` \|", PAGE.read_text(encoding="utf-8"), re.M)
    assert documented == [topic.key for topic in TOPICS]
    assert keys.PREFIX == "zenostat/v3"
