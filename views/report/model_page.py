"""The HTML page of a model: its 3D view, zones, systems, controls, schedules and diagnostics in one file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any, Protocol

from zenostat.topics.messages import Geometry
from zenostat.views.display.surfaces import surfaces
from zenostat.views.report.document import document, heading

_SCRIPT = Path(__file__).with_name("model_page.js").read_text(encoding="utf-8")
_HINT = "Drag to turn, turn the wheel to zoom, point at a zone to see its name. With the keyboard: arrow keys, + and -."
_ALIKE = 4
"""More components of one type on one level are folded."""


class TreeNode(Protocol):
    """A component of a system with its parts."""

    @property
    def kind(self) -> str:
        """Object type; empty for a group."""

    @property
    def name(self) -> str:
        """Name of the object or the group."""

    @property
    def parts(self) -> Sequence[TreeNode]:
        """Its own components."""


Table = tuple[str, Sequence[str], Sequence[Sequence[str]]]
"""Title, headings, and rows of a table."""


def model_page(
    name: str,
    facts: Sequence[tuple[str, str]],
    geometry: Geometry | None,
    notes: Sequence[str],
    trees: Sequence[tuple[str, Sequence[TreeNode]]],
    tables: Sequence[Table],
) -> str:
    """Return the page of a model; the same input gives the same text.

    Args:
        name: of the model.
        facts: terms and texts below the heading.
        geometry: None if there is nothing to draw.
        notes: sentences, such as errors and warnings, in their order.
        trees: titles and systems.
        tables: tables after the systems; an empty one is left out.
    """
    body = [f"<header>{heading(name, facts)}</header><main>"]
    if geometry is not None:
        body.append(_view(geometry))
    if notes:
        items = "".join(f"<li>{escape(note)}</li>" for note in notes)
        body.append(f'<section id="notes"><h2>Errors and warnings</h2><ul>{items}</ul></section>')
    for title, systems in trees:
        if systems:
            body.append(f"<section><h2>{escape(title)}</h2><ul>{''.join(map(_tree, systems))}</ul></section>")
    body += [_table(*table) for table in tables if table[2]]
    return document(name, "".join([*body, "</main>"]), _SCRIPT)


def _view(geometry: Geometry) -> str:
    data = {
        "surfaces": [
            {
                "kind": int(surface.kind),
                "zone": -1 if surface.zone is None else surface.zone,
                "exposed": surface.is_exposed,
                "corners": [[round(value, 2) for value in corner] for corner in surface.corners.tolist()],
            }
            for surface in surfaces(geometry)
        ],
        "zones": [
            {"name": zone.name, "storey": zone.storey, "area": f"{zone.floor_area_m2:,.0f}"} for zone in geometry.zones
        ],
        "storeys": list(geometry.storeys),
    }
    options = "".join(
        f'<option value="{index}">storeys up to {index + 1} ({height:.4g} m)</option>'
        for index, height in enumerate(geometry.storeys[:-1])
    )
    return (
        f'<section><h2>Building</h2><script type="application/json" id="surfaces">{_embedded(data)}</script>'
        f'<p><label>Show <select id="storey"><option value="{len(geometry.storeys)}">the whole building</option>'
        f'{options}</select></label> <span id="label" class="note" aria-live="polite"></span></p>'
        '<canvas id="view" tabindex="0" role="img" aria-label="The building in three dimensions" '
        'style="width:100%;height:440px;touch-action:none;cursor:grab"></canvas>'
        f'<p class="note">{escape(_HINT)}</p></section>'
    )


def _embedded(data: Any) -> str:
    """Return JSON that cannot end the script element that it is in."""
    return json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")


def _tree(node: TreeNode) -> str:
    title = f"{escape(node.name)} <span class='note'>{escape(node.kind)}</span>" if node.kind else escape(node.name)
    if not node.parts:
        return f"<li>{title}</li>"
    inner = "".join(_groups(node.parts))
    return f"<li><details><summary>{title}</summary><ul>{inner}</ul></details></li>"


def _groups(parts: Iterable[TreeNode]) -> Iterator[str]:
    by_kind: dict[str, list[TreeNode]] = {}
    for part in parts:
        by_kind.setdefault(part.kind, []).append(part)
    for kind, members in by_kind.items():
        items = "".join(map(_tree, members))
        if kind and len(members) > _ALIKE:
            items = f"<li><details><summary>{len(members)} {escape(kind)}</summary><ul>{items}</ul></details></li>"
        yield items


def _table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f'<th scope="col">{escape(column)}</th>' for column in columns)
    lines = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return (
        f'<section><h2>{escape(title)}</h2><div class="scroll" role="group" tabindex="0" aria-label="{escape(title)}">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table></div></section>"
    )
