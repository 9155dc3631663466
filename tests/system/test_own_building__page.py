"""The page "Your own building": its commands, in order, on a copy of a bundled model."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import pytest
from support.nodes import NodeProgram
from support.run_cli import ZENOSTAT

PAGE = Path(__file__).parents[2] / "docs" / "own-building.md"


def fenced(language: str) -> list[str]:
    """The fenced blocks of a language on the page."""
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def run(words: list[str], folder: Path) -> str:
    """Run a command of the page; what it prints."""
    finished = subprocess.run([*ZENOSTAT, *words], capture_output=True, text=True, cwd=folder, timeout=300)
    assert finished.returncode == 0, finished.stderr
    return finished.stdout


@pytest.mark.slow
def test_own_building__each_command_of_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(fenced("python")[0], "own-building.md", "exec"), {})  # the page's own program
    (scenario,) = fenced("yaml")
    Path("mine.yaml").write_text(scenario)
    commands = [shlex.split(line, comments=True) for block in fenced("bash") for line in block.splitlines() if line]
    shown = []
    for _, *words in commands:
        if words[0] == "node":
            options = dict(zip(words[1::2], words[2::2], strict=True))
            continue
        if words[0] == "monitor":
            continue  # it opens a window; its own tests run it
        if words[0] == "run":
            settings = {name.removeprefix("--"): value for name, value in options.items()}
            with NodeProgram(tmp_path / "node", **settings) as node:
                shown.append(run([*words, "--connect", node.endpoint], tmp_path))
            continue
        shown.append(run(words if ">" not in words else words[: words.index(">")], tmp_path))
    text = "\n".join(shown)
    for words in ("Zones: 6, 5 conditioned", "core_zn_heating_setpoint", "perimeter_zn_1_cooling_setpoint"):
        assert words in text, words
    for page in ("office.html", "run.html", "days.html"):
        assert Path(page).stat().st_size > 10_000, page
