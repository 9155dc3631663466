"""Statements of a graph in memory, and as Turtle; needs no library."""

from __future__ import annotations

import re
from collections.abc import Mapping
from urllib.parse import quote

_SAFE_LOCAL = re.compile(r"[A-Za-z0-9_](?:(?:[A-Za-z0-9_.\-]|%[0-9A-F]{2})*(?:[A-Za-z0-9_\-]|%[0-9A-F]{2}))?")
"""Local names that Turtle takes without an escape (a part of its `PN_LOCAL`)."""

_ESCAPES = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\r": "\\r"}
_ESCAPED = re.compile(r'[\\"\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]')


class Iri(str):
    """An absolute URI without characters that Turtle would have to escape."""

    __slots__ = ()


Value = Iri | str | int | float
"""An object of a statement: a URI, or the value of a literal."""


def encoded_name(text: str) -> str:
    """Return a text as a part of a URI, and of a local name of Turtle; half of a surrogate pair becomes U+FFFD."""
    return (
        quote(text.encode(errors="surrogatepass").decode(errors="replace"), safe="")
        .replace(".", "%2E")
        .replace("~", "%7E")
    )


class Triples:
    """Statements without repetitions, in the order in which they were added.

    Args:
        prefixes: namespaces by the prefix that stands for them.
    """

    def __init__(self, prefixes: Mapping[str, str]) -> None:
        self._prefixes = dict(prefixes)
        self._by_namespace = {namespace: prefix for prefix, namespace in prefixes.items()}
        self._statements: dict[tuple[Iri, Iri, Value], None] = {}

    def __len__(self) -> int:
        return len(self._statements)

    def add(self, subject: Iri, predicate: Iri, value: Value) -> None:
        """Add a statement."""
        self._statements[subject, predicate, value] = None

    def turtle(self) -> str:
        """Return the statements as Turtle (https://www.w3.org/TR/turtle/), the same text for the same statements."""
        lines = [f"@prefix {prefix}: <{namespace}> ." for prefix, namespace in self._prefixes.items()]
        present: Iri | None = None
        for subject, predicate, value in self._statements:
            if subject != present:
                lines[-1] += "" if present is None else " ."
                lines.append(self._term(subject))
            else:
                lines[-1] += " ;"
            lines.append(f"  {self._term(predicate)} {self._term(value)}")
            present = subject
        return "\n".join((*lines, "")) if present is None else "\n".join((*lines[:-1], f"{lines[-1]} .", ""))

    def _term(self, value: Value) -> str:
        if isinstance(value, Iri):
            namespace, local = _split(value)
            prefix = self._by_namespace.get(namespace)
            return f"{prefix}:{local}" if prefix is not None and _SAFE_LOCAL.fullmatch(local) else f"<{value}>"
        return f'"{_ESCAPED.sub(_escape, value)}"' if isinstance(value, str) else repr(value)


def _split(iri: Iri) -> tuple[str, str]:
    """Split a URI after its last `#`, or else after its last `/`."""
    cut = (iri.rfind("#") if "#" in iri else iri.rfind("/")) + 1
    return iri[:cut], iri[cut:]


def _escape(match: re.Match[str]) -> str:
    """Escape a character in a literal; half of a surrogate pair, which is no character, becomes U+FFFD."""
    character = match[0]
    if "\ud800" <= character <= "\udfff":
        return "\ufffd"
    return _ESCAPES.get(character) or f"\\u{ord(character):04X}"
