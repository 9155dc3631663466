"""The command that installs an extra, as errors say it and as pages say it."""

import inspect
import json
import re
import shlex
import sys
import tomllib
from importlib.metadata import requires
from pathlib import Path
from typing import Any

import pytest
from gymnasium.wrappers import RecordVideo

from zenostat.topics.extras import install_command

ROOT = Path(__file__).resolve().parents[2]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]


def test_extras__command_works_in_any_folder() -> None:
    """It names this Python and this checkout by their whole paths."""
    python, *pip, requirement = shlex.split(install_command("plots"))
    assert (python, pip) == (sys.executable, ["-m", "pip", "install", "-e"])
    root, _, extra = requirement.rstrip("]").rpartition("[")
    assert (Path(root), extra) == (ROOT, "plots")


@pytest.mark.parametrize(
    ("origin", "requirement"),
    [
        (None, "'zenostat[plots]'"),
        ({"url": "file:///a%20b", "dir_info": {"editable": True}}, "-e '/a b[plots]'"),
        ({"url": "file:///a.whl", "archive_info": {}}, "'zenostat[plots] @ file:///a.whl'"),
    ],
)
def test_extras__command_names_where_zenostat_came_from(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, origin: dict[str, Any] | None, requirement: str
) -> None:
    """Without a `direct_url.json` (PEP 610) it was an index."""
    recorded = tmp_path / "zenostat-0.1.0.dist-info"
    recorded.mkdir()
    (recorded / "METADATA").write_text("Metadata-Version: 2.4\nName: zenostat\nVersion: 0.1.0\n")
    if origin is not None:
        (recorded / "direct_url.json").write_text(json.dumps(origin))
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    assert install_command("plots") == f"{sys.executable} -m pip install {requirement}"


def test_extras__no_page_or_error_has_the_index_install_it() -> None:
    """All extras that are named exist, and none is looked for on a package index."""
    folders = (*(link.name for link in (ROOT / "src" / "zenostat").iterdir() if link.is_symlink()), "docs", "examples")
    files = [p for name in folders for p in (ROOT / name).rglob("*") if p.suffix in (".py", ".md", ".c")]
    named = set()
    for path in (*files, ROOT / "README.md"):
        text = path.read_text(encoding="utf-8")
        assert "install 'zenostat[" not in text, path
        named |= set(re.findall(r"'\.\[([a-z-]+)\]'|install_command\(['\"]([a-z-]+)", text))
    assert {one or other for one, other in named} <= EXTRAS.keys()
    assert len(named) > 5


def test_extras__extra_for_videos_has_what_gymnasium_needs_for_them() -> None:
    """Gymnasium's error names an extra of its own, which installs much that a video does not need."""
    needed = [re.match(r"[\w-]+", line)[0] for line in requires("gymnasium") if 'extra == "other"' in line]
    (extra,) = EXTRAS["video"]
    assert re.match(r"[\w-]+", extra)[0] in needed
    assert "moviepy" in inspect.getsource(RecordVideo)
    assert "pip install -e '.[video]'" in (ROOT / "docs/environments.md").read_text()
