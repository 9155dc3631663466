"""Archive of a node's FMU: model description, sources, and binaries compiled from them."""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from zenostat.gateways.fmi.description import Interface
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig, MissingExtra
from zenostat.topics.extras import install_command

SOURCE = Path(__file__).parent / "node_fmu.c"
_HEADER = "interface.h"
_ZIG_TARGETS = {
    "linux64": ("x86_64-linux-gnu.2.17", ".so"),
    "win64": ("x86_64-windows-gnu", ".dll"),
    "darwin64": ("x86_64-macos", ".dylib"),
}
"""Platforms of FMI 2.0 with the target of zig and the suffix of the binary."""
_FLAGS = ("-std=c99", "-O2", "-g0", "-shared", "-Wall")


def write_fmu(interface: Interface, file: Path, address: str) -> list[str]:
    """Write the FMU of a node; return the platforms for which it has binaries.

    With the package ziglang these are Linux, Windows and macOS (x86-64, which macOS also runs on its own processors);
    else this platform alone, for which a C compiler (`cc`, `gcc` or `clang`) compiles it.

    Args:
        interface: of the node.
        file: what is written; see `atomic_file`.
        address: start value of the parameter `address`.

    Raises:
        MissingExtra: there is neither ziglang nor a C compiler.
        InvalidConfig: the compiler fails, with what it says, or the file cannot be written.
    """
    commands = _compilers()
    with TemporaryDirectory() as folder:
        sources = Path(folder)
        shutil.copy(SOURCE, sources)
        (sources / _HEADER).write_text(interface.header(address), encoding="utf-8")
        binaries = {
            f"binaries/{name}/{interface.model_identifier}{suffix}": _compile(command, sources)
            for name, (command, suffix) in commands.items()
        }
        with atomic_file(file) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("modelDescription.xml", interface.model_description(address))
            for name, content in binaries.items():
                archive.writestr(name, content)
            for name in (SOURCE.name, _HEADER):
                archive.write(sources / name, f"sources/{name}")
    return list(commands)


def _compilers() -> dict[str, tuple[Sequence[str], str]]:
    """Return the command of a compiler and the suffix of the binary, for each platform that can be had."""
    if importlib.util.find_spec("ziglang") is not None:
        zig = (sys.executable, "-m", "ziglang", "cc", "-target")
        return {name: ((*zig, target), suffix) for name, (target, suffix) in _ZIG_TARGETS.items()}
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        raise MissingExtra(f"an FMU needs a C compiler, or the package ziglang: {install_command('fmu')}")
    system, suffix = {"win32": ("win", ".dll"), "darwin": ("darwin", ".dylib")}.get(sys.platform, ("linux", ".so"))
    machine = "64" if platform.machine() in ("x86_64", "AMD64") or system == "darwin" else f"-{platform.machine()}"
    return {system + machine: ((compiler,), suffix)}


def _compile(command: Sequence[str], folder: Path) -> bytes:
    libraries = ("-lws2_32",) if any("windows" in part for part in command) or os.name == "nt" else ()
    position = () if libraries else ("-fPIC", "-fvisibility=hidden")
    done = subprocess.run(
        [*command, *_FLAGS, *position, "-o", "binary", SOURCE.name, *libraries],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise InvalidConfig(f"the C compiler {command[0]} failed: {done.stderr.strip()[-1000:]}")
    return (folder / "binary").read_bytes()
