"""The monitor against real nodes and real Rerun recordings."""

import signal
import subprocess
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest
import rerun as rr
import zenoh
from rerun.chunk import RrdReader
from support.nodes import SMALL, NodeProgram, free_port, until
from support.run_cli import ZENOSTAT
from zenoh.handlers import RingChannel

import zenostat
from zenostat.bridge.node.batching import BATCH_S
from zenostat.bridge.transport.session import open_session
from zenostat.metrics.roles import roles
from zenostat.topics import codec, keys
from zenostat.topics.messages import Batch, Event, EventKind
from zenostat.views.live.stream import RerunStream
from zenostat.views.live.viewer import serving, web_viewer


def _recorded(path: Path) -> dict[str, dict[int, list[float]]]:
    """Entity to step to vector, as the recording has it."""
    series: dict[str, dict[int, list[float]]] = defaultdict(dict)
    for chunk in RrdReader(str(path)).stream():
        if chunk.is_static or "Scalars:scalars" not in (batch := chunk.to_record_batch()).schema.names:
            continue
        rows = batch.to_pydict()
        for step, scalars in zip(rows["step"], rows["Scalars:scalars"], strict=True):
            series[str(chunk.entity_path)][step] = scalars
    return series


def _run(endpoint: str, *, reset: bool = False) -> list[np.ndarray]:
    """An episode under the building's own control: the values of each sample."""
    with zenostat.connect(endpoint, affinity="off") as bus, bus.controller("office") as link:
        if reset:
            link.reset()
        return [sample.values for sample in link]


@pytest.mark.slow
def test_monitor__recording_has_each_sample_of_each_episode_to_the_bit(scratch, episode_bus):
    rr.set_strict_mode(True)
    path = scratch / "run.rrd"
    manifest, (episode,) = episode_bus.manifest("office"), episode_bus.status("office").episode
    with open_session(connect=[episode_bus.endpoint]) as session:
        with RerunStream(session, "*", [rr.FileSink(str(path))]) as stream:
            first = _run(episode_bus.endpoint)
            stream.pump()
            second = _run(episode_bus.endpoint, reset=True)
            _pump_until(stream, 2 * 97)
        assert (stream.samples, stream.missed) == (2 * 97, 0)
    recorded = _recorded(path)
    temperatures = [zone.temperature for zone in roles(manifest).zones]
    assert len(temperatures) == 5
    for number, samples in enumerate((first, second), episode):
        plot = recorded[f"/office/episode_{number:04}/temperatures"]
        assert sorted(plot) == list(range(97))
        for step, values in enumerate(samples):
            assert plot[step] == values[temperatures].tolist()


def _to_the_stop(
    subscriber: zenoh.Subscriber, of: Callable[[zenoh.Sample], list[tuple[str, bytes]]]
) -> list[tuple[str, bytes]]:
    """Topics and payloads up to the event that the node has stopped, which may come after the node's end."""
    received: list[tuple[str, bytes]] = []

    def stopped() -> bool:
        for message in iter(subscriber.try_recv, None):
            received.extend(of(message))
        return (
            bool(received)
            and received[-1][0] == "event"
            and codec.decode(Event, received[-1][1]).kind is EventKind.STOPPED
        )

    until(stopped, "it is told that the node has stopped")
    return received


@pytest.mark.slow
def test_monitor__batches_have_all_that_was_streamed_in_the_order_sent(scratch):
    with NodeProgram(scratch / "node", **SMALL) as node, open_session(connect=[node.endpoint]) as session:
        one_by_one = session.declare_subscriber(keys.stream("office"), RingChannel(1000))
        batches = session.declare_subscriber(keys.BATCH.at("office"), RingChannel(1000))
        assert list(session.get(keys.SAMPLE.at("office")))  # the node has met both now
        begin = time.monotonic()
        _run(node.endpoint)
        _run(node.endpoint, reset=True)
        with zenostat.connect(node.endpoint, affinity="off") as bus:
            bus.stop("office")
        assert node.process.wait(30) == 0
        elapsed_s = time.monotonic() - begin
        streamed = _to_the_stop(one_by_one, lambda m: [(str(m.key_expr).rpartition("/")[2], m.payload.to_bytes())])
        arrived: list[Batch] = []

        def unpacked(message: zenoh.Sample) -> list[tuple[str, bytes]]:
            arrived.append(codec.decode(Batch, message.payload.to_bytes(), str(message.encoding)))
            return [(sent.topic, sent.payload) for sent in arrived[-1].messages]

        gathered = _to_the_stop(batches, unpacked)
    assert gathered == streamed
    assert [topic for topic, _ in streamed].count("sample") == 96 + 97  # the first one was there before
    assert len(arrived) <= elapsed_s / BATCH_S + 2  # each waits for its time, but for the first and the last one


@pytest.mark.slow
def test_monitor__late_monitor_has_the_episode_from_its_beginning(scratch, episode_bus):
    """From the node's history, to the bit."""
    path = scratch / "run.rrd"
    with episode_bus.controller("office") as link:
        sample = link.current()
        outdoor = {sample.step: [sample["outdoor_temperature"]]}
        for _ in range(10):
            sample.send()
            sample = link.receive()
            outdoor[sample.step] = [sample["outdoor_temperature"]]
        with (
            open_session(connect=[episode_bus.endpoint]) as session,
            RerunStream(session, "office", [rr.FileSink(str(path))]) as stream,
        ):
            until(lambda: stream.pump() or stream.samples, "the monitor met the node")
            assert (stream.samples, stream.missed) == (11, 0)
    (plot,) = [plot for entity, plot in _recorded(path).items() if entity.endswith("/outdoors")]
    assert sorted(outdoor) == list(range(11))
    assert plot == outdoor


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("fate", [signal.SIGSTOP, signal.SIGKILL])
def test_monitor__that_is_frozen_or_killed_changes_nothing(scratch, episode_bus, fate):
    quiet = _run(episode_bus.endpoint)
    command = [*ZENOSTAT, "monitor", "--connect", episode_bus.endpoint]
    command += ["--save", str(scratch / "run.rrd")]
    monitor = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert "connected" in monitor.stdout.readline()
        with episode_bus.controller("office") as link:
            disturbed = []
            link.reset()
            for sample in link:
                disturbed.append(sample.values)
                if sample.step == 20:
                    monitor.send_signal(fate)
    finally:
        monitor.kill()
        monitor.communicate()
    assert np.array_equal(quiet, disturbed)


def test_monitor__viewer_that_is_served_leaves_no_files(scratch):
    with web_viewer() as (page, url):
        assert page.startswith("http://127.0.0.1:")
        assert url.endswith("/proxy")
        assert url in page
        (own,) = scratch.iterdir()
        (own / "rerun-data-1").mkdir()  # what a viewer makes sometimes, and leaves
    assert list(scratch.iterdir()) == []


@pytest.mark.slow
def test_monitor__viewer_that_takes_nothing_is_noticed_and_the_file_is_whole(scratch, episode_bus):
    path = scratch / "run.rrd"
    with open_session(connect=[episode_bus.endpoint]) as session, serving("--serve-web") as server:
        sinks = [rr.FileSink(str(path)), rr.GrpcSink(server.url)]
        with RerunStream(session, "office", sinks) as stream:
            assert stream.is_shown(60.0)
            server.process.send_signal(signal.SIGSTOP)
            for number in range(40):  # more than the connection holds
                values = np.random.default_rng(number).integers(0, 256, 2**20, np.uint8)
                stream.recording.log("large", rr.Tensor(values), static=False)
            assert not stream.is_shown(1.0)
            server.process.kill()
    chunks = [chunk for chunk in RrdReader(str(path)).stream() if str(chunk.entity_path) == "/large"]
    assert sum(chunk.num_rows for chunk in chunks) == 40


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_monitor__reports_that_it_waits_for_its_bus_and_can_be_ended(scratch, number):
    command = [*ZENOSTAT, "monitor", "--save", "run.rrd"]
    command += ["--connect", f"tcp/127.0.0.1:{free_port()}"]
    monitor = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=scratch)
    try:
        assert "waiting for it, press Ctrl-C to stop" in monitor.stdout.readline()
        monitor.send_signal(number)
        rest, _ = monitor.communicate(timeout=60)
    finally:
        monitor.kill()
        monitor.wait()
    assert (monitor.returncode, rest) == (0, "")


@pytest.mark.slow
def test_monitor__monitor_may_come_before_its_node(scratch):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [
        *ZENOSTAT, "monitor", "--save", "run.rrd", "--once", "--connect",
        endpoint,
    ]  # fmt: skip
    monitor = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=scratch)
    try:
        assert "waiting for it" in monitor.stdout.readline()
        with NodeProgram(scratch / "node", **SMALL, listen=[endpoint]):
            assert "connected" in monitor.stdout.readline()
            assert len(_run(endpoint)) == 97
        output, _ = monitor.communicate(timeout=60)
    finally:
        monitor.kill()
        monitor.wait()
    assert "0 missed" in output


@pytest.mark.slow
def test_monitor__file_that_cannot_be_written_further_ends_it_with_the_reason(scratch, episode_bus):
    command = [
        *ZENOSTAT, "monitor", "--save", "run.rrd", "--once", "--connect",
        episode_bus.endpoint,
    ]  # fmt: skip
    monitor = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=scratch)
    try:
        assert "connected" in monitor.stdout.readline()
        psutil.Process(monitor.pid).rlimit(psutil.RLIMIT_FSIZE, (1000, 1000))  # like a full disk
        assert len(_run(episode_bus.endpoint, reset=True)) == 97
        monitor.send_signal(signal.SIGINT)
        output, _ = monitor.communicate(timeout=60)
    finally:
        monitor.kill()
        monitor.wait()
    assert monitor.returncode == 1
    assert "error: cannot write the recording: " in output
    assert "its disk may be full" in output
    assert "Traceback" not in output


@pytest.mark.slow
def test_monitor__node_that_starts_again_is_recorded_from_its_beginning(scratch):
    """Also with other points than it had before."""
    endpoint, path = f"tcp/127.0.0.1:{free_port()}", scratch / "run.rrd"
    core = {"core": ("Zone Air Temperature", "Core_ZN")}
    outdoors = {"outdoors": ("Site Outdoor Air DryBulb Temperature", "Environment")}
    with (
        NodeProgram(scratch / "bus", **(SMALL | {"name": "other"}), listen=[endpoint]),
        open_session(connect=[endpoint]) as session,
        RerunStream(session, "office", [rr.FileSink(str(path))]) as stream,
    ):
        for life, sensors in enumerate((outdoors, core | outdoors, core), 1):
            settings = SMALL | {"sensors": sensors, "meters": {}, "reward": None}
            own, before = f"tcp/127.0.0.1:{free_port()}", 97 * (life - 1)
            with NodeProgram(scratch / f"n{life}", **settings, listen=[own], connect=[endpoint]):
                _pump_until(stream, before + 1)  # it stands at sample 0 until somebody answers
                _run(own)
                _pump_until(stream, before + 97)
        assert (stream.samples, stream.missed) == (3 * 97, 0)


def _pump_until(stream: RerunStream, samples: int) -> None:
    def has_samples() -> bool:
        stream.pump()
        return stream.samples >= samples

    until(has_samples, f"{samples} samples have come")
