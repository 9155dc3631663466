"""The table of arguments in docs/environments.md; `python tests/support/arguments_page.py` writes it again."""

import re
from pathlib import Path
from typing import Any, get_type_hints

from typer.main import get_command

from zenostat.cli.commands import app
from zenostat.eplus_node.config import NodeConfig
from zenostat.models.scenario.schema import Scenario
from zenostat.topics.scenario_fields import MEANING, FileFields, NodeArguments

PAGE = Path(__file__).parents[2] / "docs" / "environments.md"
BEGIN, END = "<!-- made: arguments -->", "<!-- end -->"


def page(text: str) -> str:
    """A page with its table made anew."""
    before, _, rest = text.partition(BEGIN)
    return f"{before}{BEGIN}\n{table()}\n{END}{rest.partition(END)[2]}"


def table() -> str:
    """A row for each argument of an environment and each field of a scenario file."""
    hints = get_type_hints(NodeArguments) | get_type_hints(FileFields)
    rows = [
        "| argument | type | default | meaning | in files | option of `zenostat node` |",
        "|---|---|---|---|---|---|",
    ]
    for name, meaning in MEANING.items():
        in_file = "yes" if name in Scenario.model_fields else ""
        option = options().get(name, "")
        cells = (f"`{name}`", _type(hints[name]), _default(name), meaning, in_file, f"`{option}`" if option else "")
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows)


def options() -> dict[str, str]:
    """The options of `zenostat node`, by the names of the arguments that they set."""
    node = get_command(app).commands["node"]  # type: ignore[attr-defined]
    return {parameter.name.removeprefix("no_"): parameter.opts[0] for parameter in node.params}


def default(name: str) -> Any:
    """Value that is used if neither the argument nor a scenario names another value; None: see the meaning."""
    field = Scenario.model_fields.get(name) or NodeConfig.model_fields.get(name)
    if field is None or field.is_required():
        return None
    return field.get_default(call_default_factory=True)


def _default(name: str) -> str:
    value = default(name)
    return "" if value is None or value in ("", (), {}) else f"`{value}`"


def _type(hint: Any) -> str:
    text = re.sub(r"(\w+\.)+|<class '|'>", "", str(hint))
    return text.removesuffix(" | None").replace(" | ", " or ")


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
