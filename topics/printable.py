"""Control characters in texts that come from elsewhere: replaced before anybody sees them."""

from __future__ import annotations

import re

_ESCAPING = r"\x00-\x1f\x7f-\x9f"
_BREAKING = r"\u2028\u2029"
_REORDERING = r"\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"
_SURROGATES = r"\ud800-\udfff"
_CONTROLS = re.compile(f"[{_ESCAPING}{_BREAKING}{_REORDERING}{_SURROGATES}]")
_PICTURES, _DELETE, _REPLACEMENT = 0x2400, "\x7f", "\N{REPLACEMENT CHARACTER}"


def replace_controls(text: str, *, keep: str = "") -> str:
    r"""Return a text with a visible character in place of each one that a terminal, a log or a page would obey.

    These are the control characters of ASCII and ISO 8859-1 (line breaks and the escape of ANSI sequences included),
    DEL, Unicode's line separators and directional formatting characters, and lone surrogates, which cannot be encoded.
    Those of ASCII become Unicode's pictures of them, such as U+241B for the escape, and the others U+FFFD. The length
    does not change, so a limit holds before and after, and the result of a second replacement is the same.

    Args:
        text: from a message, a key or a file.
        keep: control characters that stay, such as `"\n\t"` in a text of several lines.
    """
    if text.isprintable():
        return text
    return _CONTROLS.sub(lambda match: match[0] if match[0] in keep else _picture(match[0]), text)


def replace_controls_in_lines(text: str) -> str:
    """Return a text of several lines without control characters but line breaks and tabs."""
    return replace_controls(text, keep="\n\t")


def _picture(character: str) -> str:
    if character == _DELETE:
        return "\N{SYMBOL FOR DELETE}"
    return chr(_PICTURES + ord(character)) if character < " " else _REPLACEMENT
