"""An engine's process: its parent, scratch folder and cores, and how it is forked."""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
import signal
import stat
import sys
from typing import Any, NoReturn

_own_folder = ""


def leave(code: int) -> NoReturn:
    """Ends the process as a forked child may: no exit handlers; its scratch folder goes with it."""
    if _own_folder:
        shutil.rmtree(_own_folder, ignore_errors=True)
    os._exit(code)


def die_with_parent(parent: int) -> None:
    """Has the kernel kill this process when the node ends, however it ends (Linux only).

    SIGKILL, as a process that is stopped, or deep in EnergyPlus, acts on nothing else. A forked child has to ask anew.
    """
    if sys.platform.startswith("linux"):
        set_parent_death_signal = 1
        ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)
        if os.getppid() != parent:
            leave(0)


_SYS_CLONE = 56  # x86-64, as the wheel's EnergyPlus
_CLONE_PARENT = 0x00008000


def clone() -> int:
    """Forks: 0 in the child. The child's parent is the parent's own, the node, which so learns how it ends."""
    child = ctypes.CDLL(None, use_errno=True).syscall(_SYS_CLONE, _CLONE_PARENT | signal.SIGCHLD, 0, 0, 0, 0)
    if child < 0:
        raise OSError(ctypes.get_errno(), "the engine cannot be forked")
    return int(child)


_TELLING = ("eplusout.err", "engine.log")


def own_files(folder: str) -> None:
    """Gives a forked child its own open files: parent and child would move each other's place in them.

    Files that are read are opened anew at the same place, also if they have been removed meanwhile. Of those that
    are written, the ones that tell why an engine failed, and those that are read again, are copied into `folder`; the
    rest is nobody's any more.
    """
    for name in os.listdir("/proc/self/fd"):
        descriptor, link = int(name), f"/proc/self/fd/{name}"
        try:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                continue
            flags = fcntl.fcntl(descriptor, fcntl.F_GETFL)
            place = os.lseek(descriptor, 0, os.SEEK_CUR)
            base = os.path.basename(os.readlink(link)).removesuffix(" (deleted)")
        except OSError:
            continue  # the descriptor of the listing itself
        path, access = link, flags & os.O_ACCMODE
        if access != os.O_RDONLY:
            path = os.path.join(folder, base) if access == os.O_RDWR or base in _TELLING else os.devnull
        if path not in (link, os.devnull):
            shutil.copyfile(link, path)
        again = os.open(path, flags & ~(os.O_CREAT | os.O_EXCL | os.O_TRUNC))
        os.lseek(again, place, os.SEEK_SET)
        os.dup2(again, descriptor)
        os.close(again)


def begin(spec: dict[str, Any]) -> None:
    """Sets the scratch folder that goes with this process, and the cores on which it runs."""
    global _own_folder
    _own_folder = "" if spec["keep"] else spec["folder"]
    if spec["cpus"]:
        os.sched_setaffinity(0, spec["cpus"])
