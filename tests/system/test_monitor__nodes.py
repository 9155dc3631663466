"""The monitor beside several nodes, plants without geometry, and nodes of other versions."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import zenoh
from support.monitor import logged, static
from support.nodes import NodeProgram, free_port, until

from zenostat.bridge.transport.session import open_session
from zenostat.cli.monitor_stream import open_stream, reward_terms
from zenostat.metrics.reward_comfort import display_comfort
from zenostat.topics import codec, keys
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.messages import Sample
from zenostat.views.live.stream import RerunStream

TANK = """
class Tank:
    step_s = 60.0
    duration_s = 3600.0
    sensors = {"tank_temperature": ("degC", 0.0, 100.0)}
    actuators = {"heater": ("W", 0.0, 3000.0)}

    def reset(self, seed):
        self.temperature = 20.0
        return {"tank_temperature": self.temperature}

    def step(self, actuators):
        self.temperature += 0.1
        return {"tank_temperature": self.temperature}
"""


def _pump_until(stream: RerunStream, holds: Callable[[], object], what: str) -> None:
    def is_reached() -> object:
        stream.pump()
        return holds()

    until(is_reached, what)


@pytest.mark.slow
def test_monitor__zone_colors_and_overview_of_an_office_beside_a_tank(scratch, episode_bus, capsys):
    """The office has geometry, comfort band and reward of its scenario; the tank has none of them."""
    rr.set_strict_mode(True)
    path, plant = scratch / "run.rrd", scratch / "tank.py"
    plant.write_text(TANK)
    own = f"tcp/127.0.0.1:{free_port()}"
    manifest = episode_bus.manifest("office")
    with (
        NodeProgram(
            scratch / "tank",
            name="tank",
            plant=f"{plant}:Tank",
            mode="free",
            listen=[own],
            connect=[episode_bus.endpoint],
        ),
        open_session(connect=[episode_bus.endpoint]) as session,
        open_stream(session, "*", [rr.FileSink(str(path))], is_live=True) as stream,
    ):
        values = []
        with episode_bus.controller("office") as link:
            for sample in link:
                values.append(sample.values)
                if sample.step == 60:
                    break
        _pump_until(stream, lambda: stream.samples >= 2, "both nodes are shown")
    assert not capsys.readouterr().err  # a plant without geometry is nothing to warn of
    band, reward = display_comfort(manifest), reward_terms(manifest)
    colors = logged(path, "Mesh3D:albedo_factor")
    zones = {entity.rpartition("/")[2] for entity in colors if "/building/zones/" in entity}
    assert len(zones) == len(band.zones) == 5
    assert not any(entity.startswith("/tank") for entity in colors)
    (text,) = [rows[-1] if isinstance(rows, list) else rows for e, rows in static(path, "TextDocument:text").items()]
    assert "**office**" in text
    assert "**tank**" in text
    (rewards,) = [rows for entity, rows in logged(path, "Scalars:scalars").items() if entity.endswith("/reward")]
    assert rewards
    moments = {int(s): t for s, t in zip(range(97), _begins(manifest), strict=True)}
    for step, terms in rewards.items():
        expected = reward(np.asarray(values[step]), moments[step - 1])
        assert terms == pytest.approx([float(value) for value in expected.values()])


def _begins(manifest):
    begin = np.datetime64(manifest.begin)
    step = np.timedelta64(round(manifest.step_s), "s")
    return [(begin + n * step).astype("M8[s]").item() for n in range(97)]


@pytest.mark.slow
def test_monitor__a_node_that_is_started_again_has_entities_of_its_own(scratch):
    path, own = scratch / "run.rrd", f"tcp/127.0.0.1:{free_port()}"
    starts = (20.0, 50.0)
    with (
        open_session(listen=[own]) as session,
        RerunStream(session, "*", [rr.FileSink(str(path))], is_live=True) as stream,
    ):
        for count, start in enumerate(starts, 1):
            plant = scratch / f"tank_{count}.py"
            plant.write_text(TANK.replace("= 20.0", f"= {start}"))
            with NodeProgram(scratch / f"tank-{count}", name="tank", plant=f"{plant}:Tank", mode="free", connect=[own]):
                _pump_until(stream, lambda seen=61 * count: stream.samples >= seen, "the whole episode is shown")
    by_run = {e.split("/")[2]: rows for e, rows in logged(path, "Scalars:scalars").items() if "points" in e}
    assert set(by_run) == {"episode_0000", "run_2_episode_0000"}
    for rows, start in zip((by_run["episode_0000"], by_run["run_2_episode_0000"]), starts, strict=True):
        assert [rows[step][0] for step in range(61)] == pytest.approx([start + 0.1 * step for step in range(61)])


@pytest.mark.slow
def test_monitor__node_of_an_older_schema_is_named_and_not_shown(scratch, shared_node):
    notices: list[str] = []
    with (
        open_session(connect=[shared_node.endpoint]) as old,
        old.liveliness().declare_token("zenostat/v1/veteran/@live/node/1a"),
        open_session(connect=[shared_node.endpoint]) as session,
        RerunStream(session, "*", [rr.FileSink(str(scratch / "run.rrd"))], notify=notices.append) as stream,
    ):
        _pump_until(stream, lambda: notices, "the older node is noticed")
        _pump_until(stream, lambda: stream.samples, "the other node is shown")
    (notice,) = notices
    assert "'veteran'" in notice
    assert "v1" in notice
    assert f"v{codec.SCHEMA_VERSION}" in notice


@pytest.mark.slow
def test_monitor__node_stays_when_a_branch_or_its_previous_instance_goes(scratch, shared_node):
    with (
        open_session(connect=[shared_node.endpoint]) as session,
        RerunStream(session, "*", [rr.FileSink(str(scratch / "run.rrd"))]) as stream,
    ):
        _pump_until(stream, lambda: stream.samples, "the node is shown")
        for name, instance in (("office", "previous"), ("office.branch", "1a")):
            stream._on_node_token(keys.NODE_TOKEN.at(name, name=instance), is_gone=True)
        assert not stream.left
        assert stream._nodes["office"].is_connected
        instance = stream._nodes["office"].model.manifest.instance
        stream._on_node_token(keys.NODE_TOKEN.at("office", name=instance), is_gone=True)
        assert stream.left
        assert not stream._nodes["office"].is_connected


def test_monitor__wildcard_within_a_name_is_no_node():
    with pytest.raises(InvalidConfig, match=r"the node's name 'offic\*' is not valid"):
        RerunStream(None, "offic*", [])


@pytest.mark.slow
def test_monitor__node_whose_messages_cannot_be_read_is_named_once(scratch, shared_node):
    notices: list[str] = []
    with (
        open_session(connect=[shared_node.endpoint]) as odd,
        odd.declare_queryable(keys.MANIFEST.at("odd"), _garbage),
        odd.declare_queryable(keys.SAMPLE.at("odd"), _sample),
        odd.liveliness().declare_token(keys.NODE_TOKEN.at("odd", name="1a")),
        open_session(connect=[shared_node.endpoint]) as session,
        RerunStream(session, "odd", [rr.FileSink(str(scratch / "run.rrd"))], notify=notices.append) as stream,
    ):
        _pump_until(stream, lambda: notices, "the unreadable manifest is noticed")
        stream.pump()
        assert stream.samples == 0
    (notice,) = notices
    assert notice.startswith("node 'odd' sent a message that cannot be read")


def _garbage(query: zenoh.Query) -> None:
    query.reply(query.key_expr, b"\xc1", encoding="application/msgpack")


def _sample(query: zenoh.Query) -> None:
    sample = Sample(
        episode=[0], step=[0], time=["2017-07-01T00:00:00"], elapsed_s=[0.0], flags=[1], values=b"", effective=b"",
        source_index=b"", sources=[""],
    )  # fmt: skip
    query.reply(query.key_expr, codec.encode(sample), encoding=codec.encoding(Sample))


@pytest.mark.slow
def test_monitor__file_has_all_samples_though_they_are_gathered(scratch: Path, episode_bus):
    path = scratch / "run.rrd"
    with (
        open_session(connect=[episode_bus.endpoint]) as session,
        RerunStream(session, "office", [rr.FileSink(str(path))], is_live=False) as stream,
    ):
        with episode_bus.controller("office") as link:
            first = link.current().step
            for sample in link:
                last = sample.step
        _pump_until(stream, lambda: stream.samples >= last - first + 1, "all samples have come")
    for entity, rows in logged(path, "Scalars:scalars").items():
        if entity.endswith("/temperatures"):
            assert sorted(rows) == list(range(first, last + 1))
            break
    else:
        pytest.fail("no temperatures")
