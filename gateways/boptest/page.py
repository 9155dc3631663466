"""A page of the service's OpenAPI document, which loads nothing from elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; width: 100%; }
th, td { text-align: left; vertical-align: top; padding: .35rem .8rem .35rem 0; border-bottom: 1px solid #8885; }
code { font: 13px ui-monospace, monospace; }
"""


def page(document: Mapping[str, Any]) -> str:
    """Return an HTML page of an OpenAPI document: a table of operations for each tag."""
    sections: dict[str, list[str]] = {}
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            row = (
                f"<tr><td><code>{method.upper()} {escape(path)}</code></td><td>{escape(operation['summary'])}</td>"
                f"<td>{_fields(operation)}</td></tr>"
            )
            sections.setdefault(operation["tags"][0], []).append(row)
    tables = "".join(
        f"<h2>{escape(tag)}</h2><table><tr><th>request</th><th>meaning</th><th>body</th></tr>{''.join(rows)}</table>"
        for tag, rows in sections.items()
    )
    info = document["info"]
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{escape(info['title'])}</title>"
        f"<style>{_STYLE}</style><h1>{escape(info['title'])}</h1>"
        f"<p>{escape(info.get('description', ''))} The same as data: <a href=openapi.json>openapi.json</a>.</p>"
        f"{tables}</html>"
    )


def _fields(operation: Mapping[str, Any]) -> str:
    schema = operation.get("requestBody", {}).get("content", {}).get("application/json", {}).get("schema", {})
    required = schema.get("required", ())
    names = [f"<code>{escape(name)}</code>{'' if name in required else '?'}" for name in schema.get("properties", {})]
    return " ".join(names)
