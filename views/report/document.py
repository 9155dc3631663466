"""An HTML document that requests nothing from anywhere, and runs one script of its own."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable
from html import escape
from pathlib import Path

from zenostat.views.report.theme import DARK, LIGHT

_STYLE = Path(__file__).with_name("page.css")
REPORT_SCRIPT = Path(__file__).with_name("page.js").read_text(encoding="utf-8")
"""Script of reports: shows values at the pointer, zooms, and opens what is folded while the page is printed."""


def document(title: str, body: str, script: str) -> str:
    """Return an HTML document in light and dark colors.

    A content security policy in it forbids to load anything, and to run anything but `script`, by its digest.

    Args:
        title: of the document, as plain text.
        body: HTML.
        script: JavaScript at the end of the body.
    """
    policy = (
        "default-src 'none'; img-src data:; style-src 'unsafe-inline'; "
        f"script-src 'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'; "
        "base-uri 'none'; form-action 'none'"
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{escape(policy)}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<title>{escape(title)}</title><style>{_css()}</style></head>\n"
        f"<body>{body}<script>{script}</script></body></html>\n"
    )


def heading(title: str, facts: Iterable[tuple[str, str]]) -> str:
    """Return a title, and below it terms with their texts, as HTML; a term with an empty text is left out."""
    terms = "".join(f"<div><dt>{escape(term)}</dt><dd>{escape(text)}</dd></div>" for term, text in facts if text)
    return f"<h1>{escape(title)}</h1><dl>{terms}</dl>"


def note_block(texts: Iterable[str]) -> str:
    """Return notes below a table as HTML, a paragraph for each."""
    return f'<div class="notes">{"".join(f"<p>{escape(text)}</p>" for text in texts)}</div>'


def _css() -> str:
    light, dark = ("".join(f"--{name}:{color};" for name, color in colors.items()) for colors in (LIGHT, DARK))
    return (
        f":root{{{light}}}@media screen and (prefers-color-scheme:dark){{:root{{{dark}}}}}"
        f"{_STYLE.read_text(encoding='utf-8')}"
    )
