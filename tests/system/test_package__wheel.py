"""The distributions: complete, and usable beside a user's own modules with the names of our folders."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = tuple(link.name for link in (ROOT / "src" / "zenostat").iterdir() if link.is_symlink())
BUILD = [sys.executable, "-m", "build", "--no-isolation"]

EPISODE = """
import multiprocessing

import gymnasium as gym


def temperature() -> float:
    arguments = dict(building="office-small", weather="USA_CO_Denver", begin="01-01", end="01-01", steps_per_hour=4)
    env = gym.make("zenostat:zenostat/Building-v1", **arguments)
    try:
        env.reset(seed=0)
        truncated = False
        while not truncated:
            _, _, _, truncated, info = env.step(env.action_space.low)
        return info["step"]
    finally:
        env.close()


if __name__ == "__main__":
    import zenostat

    with multiprocessing.get_context("spawn").Pool(1) as pool:
        print(zenostat.__file__, temperature(), pool.apply(temperature))
"""


@pytest.fixture(scope="module")
def checkout(module_folder: Path) -> Path:
    """The files that git has, with a text in place of each link, as a zip of the repository may have them."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.py", "*.typed", "*.css", "*.js", "*.yaml",
         "pyproject.toml", "README.md", "LICENSE", "src"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout.splitlines()  # fmt: skip
    folder = module_folder / "checkout"
    for name in listed:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_symlink():
            (folder / name).write_text(os.readlink(ROOT / name))
        elif (ROOT / name).exists():
            shutil.copy(ROOT / name, folder / name)
    return folder


@pytest.fixture(scope="module")
def wheel(module_folder: Path, checkout: Path) -> Path:
    done = subprocess.run([*BUILD, "--outdir", module_folder / "dist", checkout], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    (path,) = (module_folder / "dist").glob("*.whl")
    return path


def test_pyproject__lists_each_package() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    present = {
        ".".join(("zenostat", *path.parent.relative_to(ROOT).parts))
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("__init__.py")
    }
    assert present - {*settings["packages"]} == set()


@pytest.mark.slow
def test_wheel__has_all_files_of_the_packages(wheel: Path, checkout: Path) -> None:
    packaged = {
        f"zenostat/{path.relative_to(checkout)}"
        for name in FOLDERS
        for path in (checkout / name).rglob("*")
        if path.suffix in (".py", ".typed", ".css", ".js", ".yaml")
    }
    packaged |= {f"zenostat/{path.name}" for path in (checkout / "src" / "zenostat").glob("*.py")}
    packaged |= {"zenostat/py.typed"}
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert names == packaged


@pytest.mark.long
def test_wheel__runs_beside_the_users_own_modules(wheel: Path, module_folder: Path) -> None:
    """An episode, the same in a spawned process, and the command, in a new environment without the checkout."""
    environment = module_folder / "environment"
    venv.create(environment, symlinks=True)
    python = environment / "bin" / "python"
    install = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index", wheel]
    subprocess.run(install, check=True)
    # What the wheel needs is already here; an editable install of the checkout is not found through a .pth file.
    (packages,) = environment.glob("lib/python*/site-packages")
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    home = module_folder / "home"
    home.mkdir()
    for name in FOLDERS:
        (home / f"{name}.py").write_text("raise RuntimeError('a file of the user was imported')\n")
    (home / "script.py").write_text(EPISODE)
    done = subprocess.run([python, "script.py"], cwd=home, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(packages / "zenostat" / "__init__.py"), "96", "96"]
    command = [environment / "bin" / "zenostat", "points", "office-small", "--default"]
    listed = subprocess.run(command, cwd=home, capture_output=True, text=True)
    assert listed.returncode == 0, listed.stderr
    assert "Traceback" not in listed.stderr
