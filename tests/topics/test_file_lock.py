"""Locks between processes: one holder, no file that stays behind, and an end with the process."""

import multiprocessing
import os
import signal
from multiprocessing.synchronize import Event
from pathlib import Path

import pytest

from zenostat.topics.errors import InvalidConfig
from zenostat.topics.file_lock import locked


def hold(path: Path, held: Event) -> None:
    with locked(path, "held"):
        held.set()
        signal.pause()


@pytest.mark.process
def test_file_lock__lock_ends_with_the_process_that_holds_it(tmp_path: Path) -> None:
    path, context = tmp_path / "lock", multiprocessing.get_context("spawn")
    held = context.Event()
    holder = context.Process(target=hold, args=(path, held))
    holder.start()
    try:
        assert held.wait(60.0)
        with pytest.raises(InvalidConfig, match="held elsewhere"), locked(path, "held elsewhere"):
            pass
        assert path.exists()  # it is the holder's
        assert holder.pid is not None
        os.kill(holder.pid, signal.SIGKILL)
        holder.join(60.0)
        with locked(path, "held elsewhere"):
            pass
    finally:
        holder.kill()
    assert list(tmp_path.iterdir()) == []


def test_file_lock__place_that_cannot_have_a_lock(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with (
        pytest.raises(InvalidConfig, match=r"cannot create .*file/lock: "),
        locked(tmp_path / "file" / "lock", "held elsewhere"),
    ):
        pass
