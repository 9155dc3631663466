"""The source check, which this source passes: names, docstrings, and imports against the layers."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest
from support.run_cli import run_python

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def check() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / ".ci" / "check_source.py"))


@pytest.mark.slow
def test_layers__this_source_passes(check: dict[str, Any]) -> None:
    assert check["main"]() == 0


@pytest.mark.parametrize(
    ("path", "text", "fault"),
    [
        ("bridge/a.py", "import zenostat.models\n", "1: bridge must not import zenostat.models"),
        ("bridge/a.py", "from zenostat.models.x import y\n", "1: bridge must not import zenostat.models.x.y"),
        ("bridge/a.py", "def f():\n    from zenostat.lab import x\n", "2: bridge must not import zenostat.lab.x"),
        ("bridge/b/c.py", "def f():\n    import pyenergyplus.api\n", "2: bridge must not import pyenergyplus.api"),
        ("bridge/a.py", "import zenostat.gateways.x\n", "1: bridge must not import zenostat.gateways.x"),
        ("bridge/a.py", "import zenostat\n", "1: bridge must not import zenostat"),
        ("gateways/x.py", "import zenostat.models\n", "1: gateways must not import zenostat.models"),
        ("gateways/x.py", "import zenostat.views.live\n", "1: gateways must not import zenostat.views.live"),
        ("agent_sdk/a.py", "from zenostat.gateways import x\n", "1: agent_sdk must not import zenostat.gateways.x"),
        ("agent_sdk/a.py", "class A:\n    import zenostat.models\n", "2: agent_sdk must not import zenostat.models"),
        ("agent_sdk/a.py", "from pyenergyplus.api import API\n", "1: agent_sdk must not import pyenergyplus.api.API"),
        (
            "metrics/a.py",
            "if TYPE_CHECKING:\n    import zenostat.views.x\n",
            "2: metrics must not import zenostat.views.x",
        ),
        ("views/a.py", "import zenostat.lab.evaluate\n", "1: views must not import zenostat.lab.evaluate"),
        (
            "topics/a.py",
            "if True:\n    import zenostat.bridge.node\n",
            "2: topics must not import zenostat.bridge.node",
        ),
        ("tests/a.py", "from zenostat.topics import x\n", "1: there is no zenostat.topics"),
        ("bench/a.py", "import zenostat.topics.x\n", "1: there is no zenostat.topics.x"),
        ("tests/a.py", "def f(told):\n    pass\n", "1: 'told' says nothing; name the thing"),
        ("bench/a.py", "x = [\n    y for _found in z]\n", "2: '_found' says nothing; name the thing"),
        ("examples/a.py", "class A:\n    SAID: int\n", "2: 'SAID' says nothing; name the thing"),
        (
            "tests/a.py",
            'def f():\n    """The same."""\n',
            "2: docstring opens with 'The same'; open with an imperative verb or a noun phrase",
        ),
    ],
)
def test_source_check__prints_file_and_line_of_an_error(
    check: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str], path: str, text: str, fault: str
) -> None:
    (tmp_path / path).parent.mkdir(parents=True)
    (tmp_path / path).write_text(text)
    assert check["main"](tmp_path) == 1
    assert f"{path}:{fault}" in capsys.readouterr().out.splitlines()


def test_source_check__test_files_have_names_of_their_own(
    check: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for folder in ("tests/models", "tests/system"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "test_a.py").write_text("")
    assert check["main"](tmp_path) == 1
    assert "tests/system/test_a.py:1: tests/models/test_a.py has the same name" in capsys.readouterr().out


def test_layers__allowed_imports_are_no_faults(check: dict[str, Any], tmp_path: Path) -> None:
    for path, text in (
        ("bridge/a.py", "import zenostat.topics\nimport zenostat.bridge.node\nimport json\n"),
        (
            "eplus_node/a.py",
            "from zenostat.bridge import node\nfrom zenostat.models import catalog\nimport pyenergyplus.api\n",
        ),
        ("gateways/x/a.py", "import zenostat.bridge.client\nfrom zenostat.gateways import bus_side\n"),
        ("cli/a.py", "def f():\n    import zenostat\n    import zenostat.gateways.x\n"),
    ):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    assert check["main"](tmp_path) == 0


@pytest.mark.parametrize(
    "later",
    [
        "import zenostat.bridge.a\n",
        "def f():\n    import zenostat.bridge.a\n",
        "if TYPE_CHECKING:\n    from zenostat.bridge.a import A\n",
        "from importlib import import_module\na = import_module('zenostat.bridge.a')\n",
    ],
)
def test_layers__cycle_is_a_fault_wherever_the_import_is(
    check: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str], later: str
) -> None:
    (tmp_path / "bridge").mkdir()
    (tmp_path / "bridge/a.py").write_text("import zenostat.bridge.b\n")
    (tmp_path / "bridge/b.py").write_text(later)
    assert check["main"](tmp_path) == 1
    assert "import cycle: zenostat.bridge." in capsys.readouterr().out


def test_layers__import_from_the_own_package_is_a_cycle_if_that_gathers_the_module(
    check: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bridge/b").mkdir(parents=True)
    (tmp_path / "bridge/b/__init__.py").write_text("from zenostat.bridge.b.c import C\n")
    (tmp_path / "bridge/b/c.py").write_text("from zenostat.bridge.b import d\n")
    (tmp_path / "bridge/b/d.py").write_text("")
    assert check["main"](tmp_path) == 0
    (tmp_path / "bridge/b/d.py").write_text("def f():\n    from zenostat.bridge.b import C\n")
    assert check["main"](tmp_path) == 1
    assert "import cycle: zenostat.bridge.b" in capsys.readouterr().out


@pytest.mark.process
def test_layers__all_modules_of_bridge_load_without_what_is_above(check: dict[str, Any]) -> None:
    program = """
import importlib, pathlib, sys
paths = sorted(pathlib.Path("bridge").rglob("*.py"))
names = ["zenostat." + ".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in paths]
for name in names:
    if not name.endswith("__main__"):
        importlib.import_module(name)
print([name for name in sys.argv[1:] if "zenostat." + name in sys.modules], "pyenergyplus" in sys.modules)
"""
    done = run_python("-c", program, *(check["LAYERS"].keys() - check["LAYERS"]["bridge"] - {"bridge"}), cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "[] False\n"
