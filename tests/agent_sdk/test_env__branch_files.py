"""Output files of episodes that were forked: those of a run that never forked."""

import re
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from support import data_packs as packs
from support.engine_forks import KINDS, episode, go, make, plan, same

_TIMES = re.compile(r"\d{4}[.\-/]\d\d[.\-/]\d\d[\sT]+\d\d:\d\d(:\d\d)?|\d+hr +\d+min +[\d.]+sec|YMD=[\d. :]+")


OUTPUTS = {
    "Output:Variable": {
        "temperatures": {
            "key_value": "*", "variable_name": "Zone Mean Air Temperature", "reporting_frequency": "Timestep"
        },
    },
    "Output:Meter": {"electricity": {"key_name": "Electricity:Facility", "reporting_frequency": "Hourly"}},
    "OutputControl:Files": {"files": {"output_csv": "Yes", "output_mtr": "Yes", "output_eso": "Yes"}},
}  # fmt: skip


def _text(path: Path) -> str:
    return _TIMES.sub("", path.read_text(errors="replace"))


def _rows(path: Path) -> list[str]:
    with closing(sqlite3.connect(path)) as database:
        return [_TIMES.sub("", line) for line in database.iterdump()]


def _kept(folder: Path) -> dict[str, Any]:
    """All files below, by name: what they say, apart from times and the folder's own name."""
    contents = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        content = _rows(path) if path.suffix == ".sql" else _text(path).replace(str(folder), "")
        contents[str(path.relative_to(folder))] = content
    return contents


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["five zones", "medium office with EMS", "photovoltaics and battery"])
def test_env__files_that_are_kept_are_those_of_a_run_that_never_forked(kind: str, scratch: Path) -> None:
    """Branches end before and after it, one with the most that its actuators can be asked for."""
    packs.sinergym()
    sql = "*" if kind == "photovoltaics and battery" else "sql"  # it has one already
    edits = OUTPUTS | {"Output:SQLite": {sql: {"option_type": "SimpleAndTabular"}}}
    plain, env = (make(KINDS[kind], output_dir=scratch / name, edits=edits) for name in ("plain", "forked"))
    last, mine, its = plain.manifest.steps, plan(plain, 1), plan(plain, 2)
    straight = episode(plain, mine)
    plain.close()
    env.reset()
    got, branches = [], []
    for at in (0, last // 2, last - 1):
        got += go(env, mine[len(got) : at])
        env.snapshot()
        branches += [env.branch(), env.branch()]
        go(branches[0], its[: last // 4])
    go(branches[2], its[last // 2 :])
    got += go(env, mine[len(got) :])
    same(got, straight[1:])
    for branch in branches:
        go(branch, its[branch.sample.step :])
    env.close()
    expected, contents = _kept(scratch / "plain"), _kept(scratch / "forked")
    assert sorted(contents) == sorted(expected)
    assert {"eplusout.err", "eplusout.eso", "eplusout.sql", "eplusout.end"} <= {Path(name).name for name in contents}
    for name, content in contents.items():
        assert content == expected[name], name
