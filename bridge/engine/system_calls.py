"""The operating-system side of an engine: fork it, end it, set its parent-death signal, scratch folder and cores."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import json
import os
import shutil
import signal
import socket
import stat
import struct
import termios
from contextlib import suppress
from typing import Any, NoReturn

from zenostat.bridge.engine.protocol import PROCESS_ID

_scratch_folder = ""


def receive_spec(orders: socket.socket, parent: int) -> dict[str, Any]:
    """Set up an engine's process; return the fields of its `EngineSpec`, which the node sends first.

    Args:
        orders: the socket on which the node's orders arrive.
        parent: the node's process id.
    """
    die_with_parent(parent)
    length = struct.unpack("<I", orders.recv(4, socket.MSG_WAITALL))[0]
    spec: dict[str, Any] = json.loads(orders.recv(length, socket.MSG_WAITALL))
    for number in (signal.SIGINT, signal.SIGHUP):  # the node handles Ctrl-C and a closed terminal
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: leave(0))
    set_up_process(spec)
    return spec


def leave(code: int) -> NoReturn:
    """Remove the scratch folder and exit without exit handlers, as a forked child must."""
    if _scratch_folder:
        shutil.rmtree(_scratch_folder, ignore_errors=True)
    os._exit(code)


def die_with_parent(parent: int) -> None:
    """Make the kernel kill this process when the node ends, in whatever way.

    SIGKILL is the only signal that also ends a process that is stopped or deep in EnergyPlus. A forked child does not
    inherit the setting.
    """
    set_parent_death_signal = 1
    ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)
    if os.getppid() != parent:
        leave(0)


def lead_session() -> None:
    """Make this process the leader of a session whose other processes end with it, in whatever way it ends.

    The kernel sends SIGHUP to the foreground processes of a terminal when the leader of its session exits, so the
    session gets a terminal that nobody uses. The children of a forked process are in a session of their own. They
    would inherit that the signal is ignored, as `nohup` makes it.
    """
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    if os.getsid(0) != os.getpid():
        os.setsid()
    with suppress(OSError):  # without terminals (/dev/ptmx), only the node ends the session
        _, terminal = os.openpty()  # open as long as the process runs; not inherited by programs that it starts
        fcntl.ioctl(terminal, termios.TIOCSCTTY, 0)


_SYS_CLONE = {"x86_64": 56, "aarch64": 220}.get(os.uname().machine)
_CLONE_PARENT = 0x00008000


def clone() -> int:
    """Fork the process and return the child's process id; 0 in the child.

    The node becomes the parent of the child, so that it can wait for the child's exit code.
    """
    if _SYS_CLONE is None:
        raise OSError(errno.ENOSYS, "the engine cannot be forked on this processor")
    child = ctypes.CDLL(None, use_errno=True).syscall(_SYS_CLONE, _CLONE_PARENT | signal.SIGCHLD, 0, 0, 0, 0)
    if child < 0:
        raise OSError(ctypes.get_errno(), "the engine cannot be forked")
    return int(child)


def fork_with_sockets(
    orders: socket.socket, frames: socket.socket, length: int, *, refusal: int = 0
) -> tuple[dict[str, Any], socket.socket, socket.socket] | None:
    """Carry out a `FORK` order with a text of `length` bytes, or answer it with the error number `refusal`.

    Return, in the child, the fields of its `EngineSpec`, and its sockets; the parent's are closed there.
    """
    raw, descriptors, _, _ = socket.recv_fds(orders, length, 2)
    fields, sockets = json.loads(raw), [socket.socket(fileno=descriptor) for descriptor in descriptors]
    try:
        child = -refusal or clone()
    except OSError as error:
        child = -(error.errno or 1)
    for unused in sockets if child else (orders, frames):
        unused.close()
    if child:
        frames.sendall(PROCESS_ID.pack(child))
        return None
    die_with_parent(fields["parent"])
    return fields, sockets[0], sockets[1]


_NOT_AGAIN = os.O_CREAT | os.O_EXCL | os.O_TRUNC | getattr(os, "O_TMPFILE", 0)
"""Flags with which a file is created, of no use to open it again."""
_COPIED_FILES = ("eplusout.err", "engine.log")
"""Written files that explain why an engine failed."""


def reopen_files(folder: str) -> None:
    """Reopen all open files of a forked child, which would otherwise share file offsets with its parent.

    Files open for reading are reopened at the same offset, even if they have been removed. Files open for writing are
    copied into `folder` if they explain why an engine failed or are also read; all others are replaced by /dev/null.
    Standard output is the node's, and stays.
    """
    for name in os.listdir("/proc/self/fd"):
        descriptor, link = int(name), f"/proc/self/fd/{name}"
        try:
            if descriptor == 1 or not stat.S_ISREG(os.fstat(descriptor).st_mode):
                continue
            flags = fcntl.fcntl(descriptor, fcntl.F_GETFL)
            offset = os.lseek(descriptor, 0, os.SEEK_CUR)
            base = os.path.basename(os.readlink(link)).removesuffix(" (deleted)")
        except OSError:
            continue  # the descriptor of this listing
        path, access = link, flags & os.O_ACCMODE
        if access != os.O_RDONLY:
            path = os.path.join(folder, base) if access == os.O_RDWR or base in _COPIED_FILES else os.devnull
        if path not in (link, os.devnull):
            shutil.copyfile(link, path)
        _reopen(descriptor, path, flags & ~_NOT_AGAIN, offset)


def _reopen(descriptor: int, path: str, flags: int, offset: int) -> None:
    """Let a descriptor be of another file, at this offset."""
    reopened = os.open(path, flags)
    os.lseek(reopened, offset, os.SEEK_SET)
    os.dup2(reopened, descriptor)
    os.close(reopened)


def replace_file(path: str, other: str, limit: int) -> None:
    """Continue to read another file at the same offset, in place of one that is open for reading.

    Args:
        path: the file that is open.
        other: a file that has the same content up to `limit`.
        limit: offset in bytes up to which the file may have been read.

    Raises:
        RuntimeError: the file is not open, or has been read beyond `limit`.
    """
    opened = os.stat(path)  # noqa: PTH116  # engines do not import pathlib
    for name in os.listdir("/proc/self/fd"):
        descriptor = int(name)
        try:
            if not os.path.samestat(os.fstat(descriptor), opened):
                continue
        except OSError:
            continue  # the descriptor of this listing
        offset = os.lseek(descriptor, 0, os.SEEK_CUR)
        if offset > limit:
            raise RuntimeError(f"{path} has been read up to byte {offset}, but may differ from byte {limit} on")
        _reopen(descriptor, other, os.O_RDONLY, offset)
        return
    raise RuntimeError(f"{path} is not open")


def set_up_process(spec: dict[str, Any]) -> None:
    """Set the scratch folder, which `leave` removes, and the CPU affinity."""
    global _scratch_folder
    _scratch_folder = "" if spec["keep"] else spec["folder"]
    if spec["cpus"]:
        os.sched_setaffinity(0, spec["cpus"])
