"""The layers: `bridge` imports neither models nor a simulator, and the source check would notice."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def check() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / ".ci" / "check_source.py"))


def test_this_source_passes(check: dict[str, Any]) -> None:
    assert check["main"]() == 0


@pytest.mark.parametrize(
    ("path", "text", "fault"),
    [
        ("bridge/a.py", "import zenostat.models\n", "1: bridge must not import zenostat.models"),
        (
            "bridge/a.py",
            "from zenostat.models.scenario import schema\n",
            "1: bridge must not import zenostat.models.scenario",
        ),
        (
            "bridge/a.py",
            "def f():\n    from zenostat.eplus_node import node\n",
            "2: bridge must not import zenostat.eplus_node",
        ),
        ("bridge/b/c.py", "def f():\n    import pyenergyplus.api\n", "2: bridge must not import pyenergyplus.api"),
        ("bridge/a.py", "import zenostat.bridge.gateways.x\n", "1: bridge must not import zenostat.bridge.gateways.x"),
        ("bridge/gateways/x.py", "import zenostat.models\n", "1: bridge.gateways must not import zenostat.models"),
        (
            "agent_sdk/a.py",
            "from zenostat.bridge.gateways import x\n",
            "1: agent_sdk must not import zenostat.bridge.gateways",
        ),
        ("agent_sdk/a.py", "class A:\n    import zenostat.models\n", "2: agent_sdk must not import zenostat.models"),
        ("agent_sdk/a.py", "from pyenergyplus.api import API\n", "1: agent_sdk must not import pyenergyplus.api"),
        (
            "topics/a.py",
            "if True:\n    import zenostat.bridge.node\n",
            "2: topics must not import zenostat.bridge.node",
        ),
    ],
)
def test_an_import_against_the_layers_is_a_fault(
    check: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str], path: str, text: str, fault: str
) -> None:
    (tmp_path / path).parent.mkdir(parents=True)
    (tmp_path / path).write_text(text)
    assert check["main"](tmp_path) == 1
    assert f"{path}:{fault}" in capsys.readouterr().out.splitlines()


def test_allowed_imports_are_no_faults(check: dict[str, Any], tmp_path: Path) -> None:
    for path, text in (
        ("bridge/a.py", "import zenostat.topics\nimport zenostat.bridge.node\nimport json\n"),
        (
            "eplus_node/a.py",
            "from zenostat.bridge import node\nfrom zenostat.models import cache\nimport pyenergyplus.api\n",
        ),
        (
            "bridge/gateways/x/a.py",
            "import zenostat\nimport zenostat.bridge.node\nfrom zenostat.bridge.gateways import bus_side\n",
        ),
        ("cli/a.py", "def f():\n    import zenostat\n    import zenostat.bridge.gateways.x\n"),
    ):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    assert check["main"](tmp_path) == 0


@pytest.mark.process
def test_all_modules_of_bridge_load_without_models_and_energyplus() -> None:
    program = """
import importlib, pathlib, sys
paths = sorted(pathlib.Path("bridge").rglob("*.py"))  # pkgutil would import the packages of gateways too early
names = ["zenostat." + ".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in paths]
for are_gateways in (False, True):
    for name in names:
        if name.startswith("zenostat.bridge.gateways.") is are_gateways and not name.endswith("__main__"):
            importlib.import_module(name)
    others = ("zenostat.models", "pyenergyplus", "zenostat.eplus_node", "zenostat.agent_sdk")
    print([name for name in others if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "[]\n['zenostat.agent_sdk']\n"  # gateways are clients of the bus
