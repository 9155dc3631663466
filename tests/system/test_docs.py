"""The documentation: its programs run, its scenarios are valid, its commands parse, its links lead somewhere."""

import importlib
import inspect
import json
import os
import re
import shlex
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import typer.main
import yaml
from click.testing import CliRunner
from support import data_packs as packs
from support.nodes import NodeProgram
from support.run_cli import run_python

import zenostat
from zenostat.agent_sdk.rewards import read_reward
from zenostat.cli.commands import app
from zenostat.models.scenario.schema import Scenario, read_scenario

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = {page.relative_to(ROOT).as_posix(): page for page in (ROOT / "README.md", *sorted(DOCS.rglob("*.md")))}
SLOW = tuple(
    f"docs/{page}.md"
    for page in (
        "branching", "controllers", "datasets", "environments", "geometry", "metrics", "own-plants", "recordings",
        "report", "from-sinergym", "mpc", "scenarios", "training", "tuning", "vector", "wrappers",
    )
)  # fmt: skip
"""Pages whose programs are run only in `make test-all`."""


COMMAND: Any = typer.main.get_command(app)
ENDPOINT = "tcp/127.0.0.1:7447"

RUNNER = """
import ast, json, sys

for page, line, text in json.load(open(sys.argv[1])):
    tree = ast.increment_lineno(ast.parse(text, page), line)
    exec(compile(tree, page, "exec"), globals())
"""


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes:
        language: what stands behind the fence.
        text: what is in it.
        line: of the fence that opens it, from 1.
        excerpt: why it is not run; empty if it is.
    """

    language: str
    text: str
    line: int
    excerpt: str = ""


def blocks(text: str) -> Iterator[Block]:
    """All fenced blocks of a page, in order."""
    lines = text.splitlines()
    number = 0
    while number < len(lines):
        opened = re.fullmatch(r"```(\w*) *(.*)", lines[number])
        if opened:
            end = lines.index("```", number + 1)
            before = next((line for line in reversed(lines[:number]) if line.strip()), "")
            reason = re.fullmatch(r"<!-- not run: (.+) -->", before)
            excerpt = reason[1] if reason else "an excerpt" if ".excerpt" in opened[2] else ""
            yield Block(opened[1], "\n".join(lines[number + 1 : end]) + "\n", number + 1, excerpt)
            number = end
        number += 1


def of_language(page: str, *languages: str) -> list[Block]:
    return [block for block in blocks(PAGES[page].read_text(encoding="utf-8")) if block.language in languages]


def pages_with(*languages: str) -> list[Any]:
    pages = [page for page in PAGES if of_language(page, *languages)]
    return [pytest.param(page, marks=pytest.mark.slow) if page in SLOW else page for page in pages]


# Programs


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("page", pages_with("python"))
def test_docs__programs_run(page: str, scratch: Path) -> None:
    program = [block for block in of_language(page, "python") if not block.excerpt]
    home = scratch / "home"
    home.mkdir()
    _put_files(home)
    with ExitStack() as stack:
        endpoint = ENDPOINT
        if any(ENDPOINT in block.text for block in program):
            endpoint = stack.enter_context(NodeProgram(scratch / "node", **_node_of(page))).endpoint
        steps = [(str(PAGES[page]), block.line, block.text.replace(ENDPOINT, endpoint)) for block in program]
        (scratch / "steps.json").write_text(json.dumps(steps))
        done = run_python("-P", "-c", RUNNER, str(scratch / "steps.json"), cwd=home, timeout=200)
    assert done.returncode == 0, done.stderr


def _put_files(home: Path) -> None:
    """The files that the pages name: a scenario and a plant of one's own, a Sinergym configuration, a signal."""
    (home / "mine.yaml").write_text(of_language("docs/scenarios.md", "yaml")[0].text)
    (home / "tank.py").write_text(of_language("docs/own-plants.md", "python")[0].text)
    configuration = packs.sinergym() / "sinergym/data/default_configuration/5ZoneAutoDXVAV.yaml"
    (home / "sinergym.yaml").write_text(configuration.read_text())
    (home / "grid.csv").write_text("intensity\n" + "380\n" * 8760)


def _node_of(page: str) -> dict[str, Any]:
    """The node that the page starts in a terminal, for a day."""
    line = next(command for command in commands(page) if command.startswith("zenostat node"))
    words = shlex.split(line)[2:]
    options = dict(zip(words[::2], words[1::2], strict=True))
    settings = {name.removeprefix("--").replace("-", "_"): value for name, value in options.items()}
    for seconds in ("grace", "deadline"):
        if seconds in settings:
            settings[f"{seconds}_s"] = settings.pop(seconds)
    return settings | {"end": settings["begin"]}


# Scenarios


@pytest.mark.parametrize("page", pages_with("yaml"))
def test_docs__scenarios_are_valid(page: str) -> None:
    for block in of_language(page, "yaml"):
        scenario_fields = yaml.safe_load(block.text)
        fields = set(scenario_fields) if isinstance(scenario_fields, dict) else set()
        if "building" not in fields and not fields <= set(Scenario.model_fields):
            continue  # of something else than a scenario
        scenario = read_scenario(
            {"building": "office-small", "weather": "USA_CO_Denver"} | scenario_fields, f"{page}:{block.line}"
        )
        if scenario.reward is not None:
            read_reward(scenario.reward)


# Commands


def commands(page: str) -> list[str]:
    """All `zenostat` command lines of a page, in blocks and in the text, without what the shell does with them."""
    text = PAGES[page].read_text(encoding="utf-8")
    shells = of_language(page, "", "console", "bash", "sh")
    lines = [line.strip() for block in shells for line in block.text.splitlines()]
    lines += re.findall(r"`(zenostat(?: [^`]+)?)`", re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE))
    calls = [re.split(r"\s+[#>|]", line.removeprefix("$ "))[0] for line in lines]
    return [line for line in calls if re.match(r"zenostat( |$)", line) and "…" not in line]


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)])
def test_docs__commands_parse(page: str) -> None:
    for line in commands(page):
        words = shlex.split(line)[1:]
        asked = CliRunner().invoke(COMMAND, [*words, "--help"])
        assert asked.exit_code == 0, f"{page}: {line}: {asked.output}"
        if len(words) > 1:  # one alone is named, not called
            _parse(words)


def test_docs__command_that_the_control_room_names_parses() -> None:
    text = (ROOT / "views" / "room" / "static" / "overview.js").read_text(encoding="utf-8")
    (line,) = re.findall(r'"(zenostat [^"]+)"', text)
    _parse(shlex.split(line)[1:])


def _parse(words: list[str]) -> None:
    """Values and what is required, too; nothing is run."""
    assert words[0] != "node" or "--building" not in words or "--weather" in words, f"{words}: no weather"
    command = COMMAND
    context = command.make_context("zenostat", list(words))
    while rest := [*context._protected_args, *context.args]:
        name, command, rest = command.resolve_command(context, rest)
        context = command.make_context(name, rest, parent=context)


# Links, and the whole


@pytest.mark.parametrize("page", PAGES)
def test_docs__links_lead_somewhere(page: str) -> None:
    text = PAGES[page].read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)):
        if not re.match(r"https?:|#", target):
            assert (PAGES[page].parent / target.partition("#")[0]).is_file(), f"{page}: {target}"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All pages as HTML."""
    folder = tmp_path_factory.mktemp("site")
    words = ["-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    done = run_python(*words, cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, timeout=200)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_docs__site_is_built_without_a_warning(site: Path) -> None:
    assert (site / "index.html").is_file()


@pytest.mark.slow
def test_docs__landing_page_leads_to_each_guide_under_the_heading_of_its_section() -> None:
    sections = {
        name: pages for part in yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"] for name, pages in part.items()
    }
    guides = {name: pages for name, pages in sections.items() if name not in ("Start", "Concepts", "Reference")}
    text = (DOCS / "index.md").read_text()
    headings = re.findall(r"^### (.+)$", text, re.M)
    assert [name for name in headings if name in guides] == [*guides]
    for pages in guides.values():
        assert len(pages) <= 10
        assert all(f"]({page})" in text for part in pages for page in part.values())


@pytest.mark.slow
def test_docs__site_fetches_nothing_from_elsewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        fetched = re.findall(r"<(?:script|img|iframe)\b[^>]*\bsrc=\"([^\"]+)\"", page.read_text(encoding="utf-8"))
        fetched += re.findall(r"<link\b[^>]*\bhref=\"([^\"]+)\"", page.read_text(encoding="utf-8"))
        assert [place for place in fetched if re.match(r"(https?:)?//", place)] == [], page
    for style in site.rglob("*.css"):
        assert not re.search(r"(url\(|@import )[\"']?(https?:)?//", style.read_text(encoding="utf-8")), style


@pytest.mark.slow
def test_docs__api_has_all_public_names(site: Path) -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in (site / "api").glob("*.html"))
    documented = {name.rpartition(".")[2] for name in re.findall(r"id=\"(zenostat\.[\w.]+)\"", text)}
    modules = [path.stem for path in (ROOT / "src" / "zenostat").glob("[a-z]*.py")]
    assert len(modules) > 10
    missing = {
        f"{module.__name__}.{name}"
        for module in (zenostat, *(importlib.import_module(f"zenostat.{name}") for name in modules))
        for name in module.__all__
        if name not in documented and not inspect.ismodule(getattr(module, name))
    }
    assert missing == set()
