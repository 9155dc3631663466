"""Figures as SVG for a page, and as SVG and PNG files for papers."""

from __future__ import annotations

import io
import re
from html import escape
from pathlib import Path
from typing import Any

from zenostat.topics.atomic_file import atomic_file
from zenostat.views.report.theme import LIGHT, style

PNG_DPI = 300
_NUMBER = re.compile(r"-?\d+\.\d+(?:e-?\d+)?")
_GEOMETRY = re.compile(r'(?<=[\s])(d|points|transform|x|y|x1|x2|y1|y2|width|height)="([^"]*)"')
_GROUP_ID = re.compile(r'<g id="([^"]*)"')
_UPRIGHT = re.compile(r' transform="rotate\(-0 [^"]*"')
_COLORS = {color: f"var(--{name})" for name, color in LIGHT.items()}
_COLOR = re.compile("|".join(map(re.escape, _COLORS)), re.IGNORECASE)


def inline_svg(figure: Any, name: str, title: str, description: str) -> str:
    """Return a Matplotlib figure as an SVG element for an HTML page.

    Colors become CSS variables, numbers have two decimals, and all ids begin with `name`, which is unique on the page.
    """
    text = _draw(figure, name)
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.DOTALL)
    text = _UPRIGHT.sub("", _GROUP_ID.sub(_group, text))
    text = re.sub(r'id="(?=[^"])', f'id="{name}-', text)
    text = re.sub(r'(xlink:href="#|url\(#)', rf"\g<1>{name}-", text)
    text = _GEOMETRY.sub(lambda match: f'{match[1]}="{_NUMBER.sub(_rounded, match[2])}"', text)
    text = re.sub(r'(style="[^"]*?)\bfont: ([\d.]+)px[^;"]*', r"\1font-size: \2px", text)
    text = _COLOR.sub(lambda match: _COLORS[match[0].lower()], text)
    text = re.sub(r">\s+<", "><", re.sub(r"[ \t]*\n\s*", " ", text))
    box = re.search(r'viewBox="([^"]*)"', text)
    assert box is not None
    head = (
        f'<svg viewBox="{box[1]}" role="img" aria-labelledby="{name}-title {name}-desc">'
        f'<title id="{name}-title">{escape(title)}</title><desc id="{name}-desc">{escape(description)}</desc>'
    )
    text = head + text[text.index(">") + 1 :]
    return text.replace("xlink:href", "href").strip()


def save(figure: Any, folder: Path, name: str) -> tuple[Path, Path]:
    """Write `NAME.svg` and `NAME.png` (300 dpi) with the light colors on white; return their paths."""
    vector, raster = folder / f"{name}.svg", folder / f"{name}.png"
    with atomic_file(vector) as temporary:
        temporary.write_text(_draw(figure, name, ground=LIGHT["page"]), encoding="utf-8")
    with atomic_file(raster) as temporary:
        figure.savefig(temporary, format="png", dpi=PNG_DPI, facecolor=LIGHT["page"], metadata={"Software": None})
    return vector, raster


def _draw(figure: Any, name: str, ground: str = "none") -> str:
    from matplotlib import rc_context

    file = io.StringIO()
    with rc_context(style(name)):
        figure.savefig(file, format="svg", facecolor=ground, metadata={"Date": None, "Creator": None})
    return file.getvalue()


def _group(match: re.Match[str]) -> str:
    """Return the start of a group: axes with values keep their id, ticks of the x axis have a class."""
    if match[1].startswith("reading-"):
        return match[0]
    return '<g class="tick"' if match[1].startswith("xtick") else "<g"


def _rounded(match: re.Match[str]) -> str:
    text = f"{float(match[0]):.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
