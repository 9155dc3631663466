"""Options of the form NAME=VALUE, which may be repeated."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig


def read_value(text: str) -> Any:
    """Return the value that a text is in a YAML file; None for the text None, too.

    Raises:
        InvalidConfig: the text is not YAML.
    """
    return None if text == "None" else yaml12.parse(f"value: {text}", repr(text))["value"]


def read_pairs(
    option: str,
    texts: Iterable[str] | None,
    form: str,
    example: str,
    *,
    read: Callable[[str], Any] = read_value,
    split: Callable[[str, str], tuple[str, str, str]] = str.partition,
) -> dict[str, Any]:
    """Read the texts of an option.

    Args:
        option: the option, such as `--set`.
        texts: its texts; None for none.
        form: names both sides of the equals sign, for errors.
        example: a text that is right, for errors.
        read: returns the value of the text behind the equals sign; its `ValueError` means another form.
        split: splits a text at the first equals sign; `str.rpartition` at the last one.

    Raises:
        InvalidConfig: another form, or a name occurs twice.
    """
    pairs: dict[str, Any] = {}
    for text in texts or ():
        name, _, value_text = split(text, "=")
        try:
            value = read(value_text)
        except ValueError:
            name = ""
        except InvalidConfig as error:
            raise InvalidConfig(f"{option} {text}: {error}") from None
        if not name or "=" not in text:
            raise InvalidConfig(f"{option} {text}: expected {form}, for example {option} {example}")
        if name in pairs:
            raise InvalidConfig(f"{option} {name} occurs twice: {pairs[name]} and {value}")
        pairs[name] = value
    return pairs


def read_parameters(texts: Iterable[str] | None) -> dict[str, Any]:
    """Read parameters or arguments, given with `--set`; see `read_pairs`."""
    return read_pairs("--set", texts, "a name and a value", "margin=0.5")


def read_rates(option: str, texts: Iterable[str] | None) -> dict[str, float | str]:
    """Read prices or emission factors of fuels: a number, or the name of a file; see `read_pairs`."""
    return read_pairs(option, texts, "a fuel and a number or file", "electricity=0.25", read=_read_rate)


def _read_rate(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        if not text:
            raise
        return text
