"""A user's script works although its folder has modules with the names of our folders."""

from pathlib import Path

import pytest
from support.run_cli import run_python

SOURCE = Path(__file__).parents[2] / "src" / "zenostat"
FOLDERS = [link.name for link in SOURCE.iterdir() if link.is_symlink()]

SCRIPT = """
import gymnasium as gym

import zenostat

env = gym.make(
    "zenostat/Building-v1",
    building="ref-small-office",
    weather="USA_CO_Denver",
    begin="07-03",
    end="07-03",
    affinity="off",
)
env.reset(seed=1)
_, _, _, _, info = env.step(env.action_space.low)
env.close()
print("stepped to", info["step"])
"""


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("from_its_folder", [True, False])
def test_isolation__script_beside_a_models_file_of_its_own(scratch: Path, from_its_folder: bool) -> None:
    home = scratch / "home"
    home.mkdir()
    for name in FOLDERS:
        (home / f"{name}.py").write_text("raise RuntimeError('a file of the user was imported')\n")
    (home / "script.py").write_text(SCRIPT)
    done = run_python(str(home / "script.py"), cwd=home if from_its_folder else scratch)
    assert (done.returncode, done.stdout, done.stderr) == (0, "stepped to 1\n", "")
