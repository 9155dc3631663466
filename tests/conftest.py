"""Fixtures of all tests: short private folders, and a count of what is left behind."""

from __future__ import annotations

import asyncio
import inspect
import os
import shutil
import signal
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import settings
from support.certificates import house_keys
from support.examples import ALL, FAST, QUICK
from support.mqtt_broker import BROKER, missing_broker
from support.nodes import SMALL, NodeProgram, begin_new_episode, node_on_bus, nothing_left
from support.process_starts import starts_processes

import zenostat

# No deadlines: beside running simulations an example may take any time.
settings.register_profile("all", deadline=None, max_examples=ALL)
settings.register_profile("quick", deadline=None, max_examples=QUICK)
settings.register_profile("fast", deadline=None, max_examples=FAST)
settings.load_profile("all")

# A shell without job control has what it starts in the background ignore Ctrl-C, and so would all that tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Tests start hundreds of programs; without stored bytecode each of them compiles all modules, most of its start.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


SYSTEM = ("system", "chaos")
"""Folders whose tests all start other processes."""

COROUTINE_LIMIT_S = 120.0


def pytest_configure(config: pytest.Config) -> None:
    """Try fewer examples of each property in `make test`, and fewest in `make test-fast`."""
    if "not process" in config.option.markexpr:
        settings.load_profile("fast")
    elif "not slow" in config.option.markexpr:
        settings.load_profile("quick")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests that start other processes, and all but the first variant of a test marked `variants` as slow.

    A test starts processes if it is in one of the `SYSTEM` folders, uses a scratch folder, or refers to what starts
    them; see `support.process_starts`. Tests marked `long` come first, so that none of them runs alone in the end while
    the other workers are idle.
    """
    root, first = Path(__file__).parent, set[tuple[Path, str]]()
    is_selected = "process" in config.option.markexpr  # to search all tests takes a second of each worker
    for item in items:
        is_system = item.path.relative_to(root).parts[0] in SYSTEM
        if is_selected and (is_system or "scratch" in getattr(item, "fixturenames", ()) or starts_processes(item)):
            item.add_marker(pytest.mark.process)
        if item.get_closest_marker("variants"):
            test = (item.path, getattr(item, "originalname", item.name))
            if test in first:
                item.add_marker(pytest.mark.slow)
            first.add(test)
    items.sort(key=lambda item: item.get_closest_marker("long") is None)


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a coroutine function in an event loop of its own, for at most `COROUTINE_LIMIT_S`."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    arguments = {name: pyfuncitem.funcargs[name] for name in inspect.signature(pyfuncitem.obj).parameters}
    asyncio.run(asyncio.wait_for(pyfuncitem.obj(**arguments), COROUTINE_LIMIT_S))
    return True


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Write each reason for which tests were skipped once, with their number and the command that helps."""
    counts = Counter[str]()
    for report in terminalreporter.getreports("skipped"):
        counts[str(report.longrepr[2]).removeprefix("Skipped: ")] += 1
    if counts:
        terminalreporter.section("what was skipped, and how to have it")
    for reason, count in counts.most_common():
        remedy = "; pip install -c constraints.txt -e '.[dev]'" if reason.startswith("could not import") else ""
        terminalreporter.write_line(f"{count:5}  {reason}{remedy}")


@pytest.fixture(scope="session", autouse=True)
def _temporary_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Create pytest's own folder before a test changes TMPDIR: `scratch` would take it away with its folder."""
    tmp_path_factory.getbasetemp()


@pytest.fixture(autouse=True)
def _own_cores() -> Iterator[None]:
    """Let each test begin on all cores: environments and commands place the thread that uses them."""
    cores = os.sched_getaffinity(0)
    yield
    os.sched_setaffinity(0, cores)


@pytest.fixture
def one_torch_thread() -> Iterator[None]:
    """Let torch use one thread: small nets are slower on two, and the other core is the simulation's."""
    torch = pytest.importorskip("torch")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session", params=[BROKER])
def mqtt_broker() -> None:
    """Skip the test where its MQTT broker, the one of its id, is not installed."""
    if reason := missing_broker():
        pytest.skip(reason)


@contextmanager
def _short_folder() -> Iterator[Path]:
    # Not pytest's own: the path of a unix socket has 108 bytes at most.
    folder = Path(tempfile.mkdtemp(prefix="zt-", dir="/tmp")).resolve()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder of the test's own whose path is short enough for sockets."""
    with _short_folder() as short:
        yield short


@pytest.fixture(scope="module")
def module_folder() -> Iterator[Path]:
    """Short private folder for the tests of a module."""
    with _short_folder() as short:
        yield short


@pytest.fixture(scope="module")
def pki(module_folder: Path) -> Path:
    """A folder of keys for all roles; see `house_keys`."""
    return house_keys(module_folder / "keys")


@pytest.fixture
def node(scratch: Path) -> Iterator[NodeProgram]:
    """A node `office` with the small building, as a program."""
    with NodeProgram(scratch / "node", **SMALL) as program:
        yield program


@pytest.fixture
def bus(node: NodeProgram) -> Iterator[zenostat.Bus]:
    """The bus of `node`; with keys, as the trainer."""
    certificate = "trainer" if node.keys else None
    with zenostat.connect(node.endpoint, keys=node.keys, certificate=certificate, affinity="off") as connected:
        yield connected


@pytest.fixture(scope="module")
def shared_node(module_folder: Path) -> Iterator[NodeProgram]:
    """A node `office` with the small building for all tests of a module; in the end nothing of it may be left."""
    folder = module_folder / "shared"
    folder.mkdir()
    with nothing_left(folder):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("TMPDIR", str(folder))
            program = NodeProgram(folder / "node", **SMALL)
        with program:
            yield program


@pytest.fixture
def episode_bus(shared_node: NodeProgram) -> Iterator[zenostat.Bus]:
    """The bus of `shared_node`, which waits at the first sample of a new episode."""
    with zenostat.connect(shared_node.endpoint, affinity="off") as connected:
        begin_new_episode(connected)
        yield connected


@pytest.fixture
def stepping_bus(episode_bus: zenostat.Bus) -> Iterator[zenostat.Bus]:
    """The bus of `shared_node`, which is paused at the first sample of an episode and steps on command."""
    episode_bus.pause("office")
    episode_bus.pace("office", mode="free")
    yield episode_bus
    episode_bus.pace("office", mode="lockstep")


@pytest.fixture(scope="module")
def shared_bus(module_folder: Path) -> Iterator[zenostat.Bus]:
    """The bus of a node `office` that the tests of a module share; see `support.nodes.new_episode`."""
    with nothing_left(module_folder), node_on_bus(module_folder / "node", **SMALL) as (_, connected):
        yield connected


@pytest.fixture(scope="module")
def module_scratch(module_folder: Path) -> Iterator[Path]:
    """Folder like `scratch`, for the tests of a module."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setenv("TMPDIR", str(module_folder))
        monkeypatch.setattr(tempfile, "tempdir", None)
        with nothing_left(module_folder):
            yield module_folder


@pytest.fixture
def scratch(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The place of temporary files of this test and its programs; in the end nothing of ours may be left."""
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)
    with nothing_left(folder):
        yield folder
