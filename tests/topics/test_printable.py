"""Control characters of texts that others wrote are replaced in every message, and nothing else is changed."""

import sys
import unicodedata
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import zenostat.topics.alarm_rules
import zenostat.topics.fault_plan
import zenostat.topics.recording
from zenostat.topics import codec, keys
from zenostat.topics.errors import BadMessage
from zenostat.topics.messages import Claim, ErrorReply, Event, EventKind, Manifest, Message, Sample, ScenarioText, Write
from zenostat.topics.printable import replace_controls, replace_controls_in_lines

EVIL = "\x1b[31mred\x9b0m\x7f\u202etxt\u2066\r\n\x00"
HARMLESS = "␛[31mred\ufffd0m␡\ufffdtxt\ufffd␍␊␀"
BIDIRECTIONAL = {"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"}
MARKS = {"ARABIC LETTER MARK", "LEFT-TO-RIGHT MARK", "RIGHT-TO-LEFT MARK"}

assert zenostat.topics.fault_plan
assert zenostat.topics.recording
assert zenostat.topics.alarm_rules


def is_control(character: str) -> bool:
    """By Unicode's own tables: controls, line separators, surrogates, and what changes the direction of a text."""
    return (
        unicodedata.category(character) in ("Cc", "Zl", "Zp", "Cs")
        or unicodedata.bidirectional(character) in BIDIRECTIONAL
        or unicodedata.name(character, "") in MARKS
    )


def test_printable__exactly_the_controls_of_unicode_are_replaced_one_for_one() -> None:
    every = "".join(map(chr, range(sys.maxunicode + 1)))
    replaced = replace_controls(every)
    assert len(replaced) == len(every)
    different = {old for old, new in zip(every, replaced, strict=True) if old != new}
    assert different == {character for character in every if is_control(character)}
    assert not any(map(is_control, set(replaced)))


@given(st.text())
def test_printable__replacement_is_final_and_keeps_the_length(text: str) -> None:
    once = replace_controls(text)
    assert replace_controls(once) == once
    assert len(once) == len(text)
    assert replace_controls_in_lines(text).count("\n") == text.count("\n")


def test_printable__texts_in_any_script_stay_as_they_are() -> None:
    for text in ("Zürich °C", "مبنى المكتب", "משרד", "办公楼", "👩‍🔬", "a\u00a0b", "[bold]x[/bold]"):
        assert replace_controls(text) == text


def subclasses(kind: type[Message]) -> Iterator[type[Message]]:
    for child in kind.__subclasses__():
        yield child
        yield from subclasses(child)


def bare_texts(schema: Any, path: str) -> Iterator[str]:
    """Yield the paths of strings in a core schema that no validator follows and no pattern restricts."""
    if isinstance(schema, list | tuple):
        for part in schema:
            yield from bare_texts(part, path)
    elif isinstance(schema, dict):
        function = schema.get("function")
        replacing = (replace_controls, replace_controls_in_lines)
        if isinstance(function, dict) and function.get("function") in replacing:
            return
        if schema.get("type") == "str" and "pattern" not in schema:
            yield path
        for name, part in schema.items():
            if name not in ("metadata", "serialization"):
                yield from bare_texts(part, f"{path}.{name}")


def test_printable__no_field_of_any_message_is_left_out() -> None:
    classes = [kind for kind in subclasses(Message) if kind.__module__.startswith("zenostat.topics.")]
    assert len(classes) > 60
    for kind in classes:
        kind.model_rebuild()
        assert list(bare_texts(kind.__pydantic_core_schema__, kind.__name__)) == []


def test_printable__decoded_message_has_no_controls() -> None:
    raw = codec.pack(kind="warning", text=EVIL, source=EVIL, error=EVIL)
    event = codec.decode(Event, raw)
    assert (event.source, event.error) == (HARMLESS, HARMLESS)
    assert event.text == HARMLESS.replace("␊", "\n")
    assert Event(kind=EventKind.WARNING, text="a\x1bb").text == "a␛b"  # the sender's own, too
    with pytest.raises(BadMessage) as caught:
        codec.decode(Write, codec.pack(value=1.0, source="\x1b" * 128))
    assert str(caught.value).isprintable()
    text = "building: office\n# tab\there\n"
    assert codec.decode(ScenarioText, codec.pack(text=text)).text == text
    assert codec.decode(ErrorReply, codec.pack(error="X\x1b", message="a\nb\x07")).message == "a\nb␇"


def test_printable__points_of_a_manifest_and_the_sources_of_a_sample_have_none() -> None:
    from zenostat.agent_sdk.testing import FakeEnv

    fields = FakeEnv().manifest.model_dump(mode="json")
    fields["building"] = fields["sensors"][0]["unit"] = fields["location"] = EVIL
    fields["versions"]["energyplus"], fields["zones"] = EVIL, [EVIL]
    manifest = Manifest.model_validate(fields)
    texts = (manifest.building, manifest.sensors[0].unit, manifest.zones[0], manifest.location)
    assert (*texts, manifest.versions.energyplus) == (HARMLESS,) * 5
    sample = codec.pack(
        episode=[0], step=[0], time=["2017-07-01\x1b"], elapsed_s=[0.0], flags=[0], values=b"", effective=b"",
        source_index=b"", sources=["baseline", EVIL],
    )  # fmt: skip
    decoded = codec.decode(Sample, sample)
    assert (decoded.sources[1], decoded.time) == (HARMLESS, ["2017-07-01␛"])


def test_printable__name_with_controls_is_no_name_and_the_error_has_none() -> None:
    with pytest.raises(BadMessage) as caught:
        codec.decode(Claim, codec.pack(controller=EVIL, **{f"field{EVIL}": 1}))
    assert str(caught.value).isprintable()


def test_printable__names_in_keys_have_no_controls() -> None:
    key = f"zenostat/v3/off\x1b[2Jice/command/a{chr(0x202E)}b"
    assert (keys.node_of(key), keys.last_chunk(key)) == ("off␛[2Jice", "a\ufffdb")
