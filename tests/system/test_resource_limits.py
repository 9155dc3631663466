"""A system without memory or threads for a node: one sentence, and nothing is left behind."""

import resource
import threading
from pathlib import Path

import pytest
import zenoh
from support.run_cli import DAY, plain, run_in_process

from zenostat.bridge.node.subscriptions import Subscriptions
from zenostat.bridge.runtime.exhaustion import describe_exhaustion
from zenostat.bridge.transport.session import open_session
from zenostat.topics.errors import BusError


class PanicException(BaseException):
    """Error of pyo3, which is no `Exception`."""


@pytest.fixture
def without_thread(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """No thread of the name that the test gives can be started."""
    start = threading.Thread.start

    def refuse(thread: threading.Thread) -> None:
        if thread.name == request.param:
            raise RuntimeError("can't start new thread")
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", refuse)


@pytest.mark.parametrize("without_thread", ["shutdown"], indirect=True)
@pytest.mark.usefixtures("without_thread")
def test_resource_limits__node_without_threads_is_one_sentence_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("zenostat.cli.failures.user_frames", lambda _: [])  # the frame of `refuse`
    done = run_in_process("node", *DAY, "--listen", f"unixsock-stream/{tmp_path}/node.sock")
    assert (done.returncode, done.stdout) == (1, "")
    assert plain(done.stderr).startswith("error: the system cannot start another thread for this process: its limits")
    assert len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("without_thread", ["drain"], indirect=True)
@pytest.mark.usefixtures("without_thread")
def test_resource_limits__subscriptions_close_where_no_thread_can_be_started(tmp_path: Path) -> None:
    with open_session(listen=[f"unixsock-stream/{tmp_path}/bus.sock"]) as session:
        with Subscriptions(session, "office") as subscriptions:
            subscriptions.notify()
        with pytest.raises(zenoh.ZError):  # undeclared
            subscriptions.receive(wait=False)


def test_resource_limits__panic_of_zenoh_without_threads_is_an_error_of_the_bus(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def panic(_: zenoh.Config) -> None:
        raise PanicException("OS can't spawn worker thread: Resource temporarily unavailable (os error 11)")

    monkeypatch.setattr(zenoh, "open", panic)
    with pytest.raises(BusError, match=r"cannot start another thread .*ulimit -v.*ulimit -u"):
        open_session(connect=["tcp/127.0.0.1:1"])


def test_resource_limits__any_other_panic_stays_what_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    def panic(_: zenoh.Config) -> None:
        raise PanicException("index out of range")

    monkeypatch.setattr(zenoh, "open", panic)
    with pytest.raises(PanicException, match="index"):
        open_session(connect=["tcp/127.0.0.1:1"])


def test_resource_limits__sentence_names_the_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    limits = {resource.RLIMIT_AS: (400_000_000, -1), resource.RLIMIT_NPROC: (resource.RLIM_INFINITY, -1)}
    monkeypatch.setattr(resource, "getrlimit", limits.__getitem__)
    text = describe_exhaustion(MemoryError())
    assert text is not None
    assert "no memory" in text
    assert "address space 400 MB (ulimit -v) and threads unlimited (ulimit -u)" in text
    assert describe_exhaustion(RuntimeError("something else")) is None
