"""Tables at any width: every cell whole, no line too long."""

import io
import json
import math
import re

import pytest
from rich.console import Console
from support.run_cli import run_in_process, run_program

from zenostat.cli.commands import GROUPS, command_name
from zenostat.cli.tables import fitted, show_json

COLUMNS = ("kind", "name", "key", "unit", "low", "high")
ROWS = [
    ("sensor", "Zone People Occupant Count", "PERIMETER_BOT_ZN_1", "degC", "-100", "200"),
    ("actuator", "core_bottom_cooling_setpoint", "a-controller-of-mine-1234-0", "1", "0", "1"),
]


def drawn(width: int, wrap: tuple[str, ...]) -> str:
    console = Console(width=width, file=io.StringIO(), color_system=None)
    console.print(fitted(COLUMNS, ROWS, width, title="[points]", right=("low", "high"), wrap=wrap))
    return console.file.getvalue()


@pytest.mark.parametrize("width", [20, 40, 60, 80, 120, 200])
@pytest.mark.parametrize("wrap", [(), ("name",), ("name", "key")], ids=str)
def test_cli_tables__every_cell_is_whole(width: int, wrap: tuple[str, ...]) -> None:
    text = drawn(width, wrap)
    assert "…" not in text
    assert max(len(line.rstrip()) for line in text.splitlines()) <= width
    letters = re.sub(r"\s", "", text)
    if "──" not in text:  # paragraphs: each cell stands in one piece
        assert all(re.sub(r"\s", "", cell) in letters for row in ROWS for cell in row)
    else:
        whole = "".join(["[points]", *COLUMNS, *map("".join, ROWS)]).replace(" ", "")
        assert sorted(re.sub(r"[\s─]", "", text)) == sorted(whole)


def test_cli_tables__json_has_null_in_place_of_numbers_that_are_not_finite(capsys: pytest.CaptureFixture[str]) -> None:
    show_json({"rows": [{"value": math.inf}, (-math.inf, math.nan, 1.5, 2, None, "inf", True)]})
    shown = json.loads(capsys.readouterr().out, parse_constant=lambda text: pytest.fail(f"{text} is no JSON"))
    assert shown == {"rows": [{"value": None}, [None, None, 1.5, 2, None, "inf", True]]}


def test_cli_tables__wide_terminal_has_a_line_a_row_and_a_narrow_one_paragraphs() -> None:
    assert len(drawn(120, ("name",)).splitlines()) == 2 + 1 + len(ROWS)
    narrow = drawn(30, ("name",)).splitlines()
    assert narrow[1].rstrip() == ROWS[0][1]
    assert narrow[2].startswith("  kind: sensor; key:")


def test_cli_tables__no_help_cuts_anything_at_80_columns_and_each_command_is_in_a_group() -> None:
    groups = run_program("--help").stdout
    names = re.findall(r"^│ ([\w-]+) ", groups.split("Simulate and control")[1], re.M)
    registered = {command_name(place) for places in GROUPS.values() for place in places}
    assert (len(names), set(names)) == (len(registered), registered)
    assert "╭─ Commands" not in groups
    assert names[:3] == ["demo", "node", "run"]
    assert names[names.index("scenarios") + 1] == "buildings"
    for name in ("run", "node", "evaluate", "probe"):  # those with the longest texts
        shown = run_in_process(name, "--help").stdout
        assert "…" not in shown
        assert max(map(len, shown.splitlines())) <= 80


def test_cli_tables__scenarios_have_a_row_for_each_family_and_their_numbers_add_up() -> None:
    done = run_program("scenarios")
    head, *rows = done.stdout.splitlines()
    assert head.split() == ["building", "weathers", "actions", "ids", "from"]
    counts = [int(re.search(r"([\d,]+)  (?:pack|bundled)", row)[1].replace(",", "")) for row in rows]
    assert (len(rows), sum(counts)) == (13, 2161)
