"""The control room's server with a plant without zones, as programs use it; no browser."""

import json
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.control_room import control_room
from support.nodes import NodeProgram, until
from support.tank_plant import TANK

import zenostat
from zenostat.topics import codec, keys
from zenostat.topics.messages import AlarmState, Event, EventKind

httpx = pytest.importorskip("httpx")
pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
pytestmark = pytest.mark.process


OWN = '''
import time

class Filling:
    """Fill the tank to a level."""
    def __init__(self, manifest, level=0.3, name="a", table=(1, 2)):
        if name != "a":
            raise RuntimeError("no b")
        self.level = level
        self.table = table

    def act(self, sample):
        return {"pump": 100.0 if sample["level"] < self.level else 0.0}

class Failing:
    def __init__(self, manifest):
        self.samples = 0

    def act(self, sample):
        self.samples += 1
        return {"pump": 1 / (3 - self.samples)}

class Hanging:
    def __init__(self, manifest):
        pass

    def act(self, sample):
        time.sleep(3600)
'''


@pytest.fixture(scope="module")
def own(module_folder: Path) -> str:
    """A file with controllers of the user's."""
    (module_folder / "own.py").write_text(OWN)
    return f"{module_folder}/own.py"


@pytest.fixture(scope="module")
def tank(module_folder: Path) -> Iterator[NodeProgram]:
    with NodeProgram(module_folder / "node", plant=TANK, name="tank") as node:
        yield node


@pytest.fixture(scope="module")
def client(tank: NodeProgram, own: str) -> Iterator[Any]:
    """A client that has signed in; the node is paused at the first sample."""
    from zenostat.views.room.app import RoomSettings
    from zenostat.views.room.trial_controllers import offered_controllers

    names = [f"{own}:{name}" for name in ("Filling", "Failing", "Hanging")]
    settings = RoomSettings(controllers=offered_controllers(names))
    with (
        zenostat.connect(tank.endpoint, affinity="off") as bus,
        control_room(tank.endpoint, settings=settings) as server,
    ):
        bus.pause("tank")
        bus.pace("tank", mode="free")
        with httpx.Client(base_url=server.url, headers={"origin": server.url}, timeout=60) as started:
            token = server.link.partition("#token=")[2]
            assert started.post("/api/session", json={"token": token}).json() == {"operator": "ada"}
            following(started, lambda state: state["online"])
            yield started


def following(client: Any, holds: Any) -> dict[str, Any]:
    """The first state of the tank, as pages receive it, for which `holds` is true."""
    with client.stream("GET", "/api/stream?node=tank") as stream:
        kind = ""
        for line in stream.iter_lines():
            name, _, text = line.partition(": ")
            kind = text if name == "event" else kind
            if name == "data" and kind == "node" and holds(state := json.loads(text)):
                return state
    raise AssertionError("the stream ended")


def change(client: Any, operation: str, **content: Any) -> Any:
    return client.post(f"/api/nodes/tank/{operation}", json=content)


@pytest.fixture(autouse=True)
def new_episode(client: Any) -> None:
    """Begin each test at a first sample, without the values, claims and timesteps of other tests."""
    assert change(client, "reset").status_code == 200
    following(client, lambda state: state.get("sample_step") == 0 and state["values"] == [0.0, 5.0])


def test_room__write_is_streamed_with_its_source_and_its_end(client: Any) -> None:
    assert change(client, "write", point="pump", value=20, duration_s=120).status_code == 200
    array = client.get("/api/nodes/tank/priorities", params={"point": "pump"}).json()["entries"]
    assert array[7] == {"value": 20.0, "source": "ada", "expires": "2026-01-12T00:02:00"}
    assert [entry["value"] for entry in array[:7] + array[8:]] == [None] * 15
    assert change(client, "step", steps=3).json() == {"text": "3 timesteps"}
    state = following(client, lambda state: state.get("sample_step") == 3)
    assert state["values"][0] == pytest.approx(0.2 + 0.2 + 0.05)  # two minutes of 20 W, then 5 W
    history = client.get("/api/nodes/tank/history", params={"point": "level"}).json()
    assert history["points"][0]["values"] == pytest.approx([0.0, 0.2, 0.4, 0.45])
    kinds = [event["kind"] for event in client.get("/api/nodes/tank/events").json()["events"]]
    assert [kind for kind in kinds if kind in ("written", "expired")][-2:] == ["written", "expired"]


@pytest.mark.parametrize("duration_s", [1e12, 1e300])
def test_room__value_that_expires_after_the_year_9999_has_no_expiry(client: Any, duration_s: float) -> None:
    assert change(client, "write", point="pump", value=20, priority=9, duration_s=duration_s).status_code == 200
    array = client.get("/api/nodes/tank/priorities", params={"point": "pump"})
    assert (array.status_code, array.json()["entries"][8]["expires"]) == (200, None)
    assert change(client, "write", point="pump", value=None, priority=9).status_code == 200


def test_room__event_of_a_step_after_the_year_9999_is_left_out(
    client: Any, tank: NodeProgram, capfd: pytest.CaptureFixture[str]
) -> None:
    def latest() -> list[tuple[str, int]]:
        events = client.get("/api/nodes/tank/events").json()["events"]
        return [(event["text"], event["number"]) for event in events[-2:]]

    with zenostat.connect(tank.endpoint, affinity="off") as bus:
        for text, step in (("before", 1), ("forged", 2**40), ("after", 1)):
            event = Event(kind=EventKind.WARNING, text=text, step=step)
            bus.session.put(keys.EVENT.at("tank"), codec.encode(event), encoding=codec.encoding(Event))
        until(lambda: latest()[-1][0] == "after", "the last event is kept")
    (before, first), (after, second) = latest()
    assert (before, after, second - first) == ("before", "after", 1)
    assert "OverflowError" not in capfd.readouterr().err


def test_room__streams_of_a_session_end_when_it_signs_out(client: Any) -> None:
    base = str(client.base_url)
    token = client.post("/api/invitation", json={"operator": "bob"}).json()["link"].partition("#token=")[2]
    with httpx.Client(base_url=base, headers={"origin": base.rstrip("/")}, timeout=30) as bob:
        assert bob.post("/api/session", json={"token": token}).json() == {"operator": "bob"}
        with bob.stream("GET", "/api/stream?node=tank") as answer:
            lines = answer.iter_lines()
            next(lines)
            assert httpx.delete(f"{base}/api/session", headers=dict(bob.headers), cookies=bob.cookies).is_success
            assert not [line for line in lines if line.startswith("event: audit")]  # it ends


def test_room__what_if_changes_a_copy_only(client: Any) -> None:
    before = client.get("/api/nodes/tank/history", params={"point": "level"}).json()["points"][0]["values"]
    answer = change(client, "what_if", values={"pump": 10}, hours=1).json()
    hours = answer["as_is"]["totals"]["hours"]
    assert (hours, len(answer["time"])) == (1.0, 60)
    state = following(client, lambda state: state["episode"] == answer["episode"])
    assert answer["begin"] == state["time"]
    level = before[-1]
    assert answer["as_is"]["series"][0] == pytest.approx([level + 0.05 * k for k in range(1, 61)])
    assert answer["changed"]["series"][0] == pytest.approx([level + 0.1 * k for k in range(1, 61)])
    after = client.get("/api/nodes/tank/history", params={"point": "level"}).json()["points"][0]["values"]
    assert after == before
    array = client.get("/api/nodes/tank/priorities", params={"point": "pump"}).json()["entries"]
    assert all(entry["value"] is None for entry in array)


def test_room__what_if_as_is_keeps_the_ends_of_values_at_the_lowest_priority(client: Any) -> None:
    """At 20 W the level rises by 0.2 in a minute, and under baseline control, after two minutes, by 0.05."""
    assert change(client, "write", point="pump", value=20, priority=16, duration_s=120).status_code == 200
    before = client.get("/api/nodes/tank/history", params={"point": "level"}).json()["points"][0]["values"][-1]
    answer = change(client, "what_if", values={"pump": None}, priority=16, hours=0.1).json()
    levels_of = {name: [level - before for level in answer[name]["series"][0]] for name in ("as_is", "changed")}
    assert levels_of["as_is"] == pytest.approx([0.2, 0.4, 0.45, 0.5, 0.55, 0.6])
    assert levels_of["changed"] == pytest.approx([0.05 * k for k in range(1, 7)])
    assert change(client, "write", point="pump", value=None, priority=16).status_code == 200


def test_room__alarms_of_slots_that_are_not_shown_stay(client: Any, tank: NodeProgram, scratch: Path) -> None:
    (scratch / "alarms.yaml").write_text("alarms: [{name: empty, points: [level], low: 5.0, unit: m}]\n")
    settings = {"plant": TANK, "name": "pair", "slots": 2, "alarms": str(scratch / "alarms.yaml")}
    with (
        NodeProgram(scratch / "pair", connect=[tank.endpoint], **settings) as node,
        zenostat.connect(node.endpoint, affinity="off") as bus,
    ):

        def states() -> list[AlarmState]:
            return [bus.alarms("pair", slot=slot).alarms[0].state for slot in (0, 1)]

        until(lambda: states() == ["active", "active"], "the first sample is there")
        until(lambda: client.get("/api/nodes/pair").status_code == 200, "the room follows it")
        for operation, more, state in (
            ("acknowledge", {}, AlarmState.ACKNOWLEDGED),
            ("shelve", {"duration_s": 600}, AlarmState.SHELVED),
            ("unshelve", {}, AlarmState.ACTIVE),
        ):
            answer = client.post(f"/api/nodes/pair/{operation}", json={"alarm": "empty", **more})
            assert answer.status_code == 200, answer.text
            assert states() == [state, AlarmState.ACTIVE]


def levels(client: Any, **question: Any) -> list[float]:
    """Levels of the next six minutes with another controller, above the present one."""
    before = client.get("/api/nodes/tank/history", params={"point": "level"}).json()["points"][0]["values"][-1]
    answer = change(client, "what_if", hours=0.1, **question)
    assert answer.status_code == 200, answer.text
    return [level - before for level in answer.json()["changed"]["series"][0]]


def test_room__what_if_controller_replaces_controllers_and_not_overrides(client: Any, tank: NodeProgram) -> None:
    fixed = {"name": "fixed", "parameters": {"pump": 10}}
    with zenostat.connect(tank.endpoint, affinity="off") as bus, bus.controller("tank", priority=4) as running:
        running.current().send({"pump": 50.0})
        until(lambda: bus.priorities("tank")["pump"][3].value == 50.0, "it has commanded")
        assert levels(client, controller=fixed, priority=10) == pytest.approx([0.1 * k for k in range(1, 7)])
        assert levels(client, controller={"name": "baseline"}) == pytest.approx([0.05 * k for k in range(1, 7)])
        assert bus.priorities("tank")["pump"][3].value == 50.0
    assert change(client, "write", point="pump", value=20, priority=8, duration_s=120).status_code == 200
    expected = [0.2, 0.4, 0.5, 0.6, 0.7, 0.8]  # until the override expires
    assert levels(client, controller=fixed, priority=10) == pytest.approx(expected)
    assert change(client, "write", point="pump", value=None, priority=8).status_code == 200


def test_room__what_if_controller_answers_each_sample(client: Any) -> None:
    listed = {each["name"]: each for each in client.get("/api/nodes/tank/controllers").json()["controllers"]}
    assert "oracle" not in listed
    assert listed["pid"]["schema"]["required"] == ["setpoint"]
    assert "needs an action" in listed["rbc"]["problem"]
    drawn = {"name": "random", "parameters": {"seed": 1}}
    rises = levels(client, controller=drawn)
    steps = [b - a for a, b in zip([0.0, *rises], rises, strict=False)]
    assert len({round(step, 9) for step in steps}) == len(steps)
    assert levels(client, controller=drawn) == rises
    answer = change(client, "what_if", controller=drawn, hours=0.1, priority=9)
    assert answer.json()["command"].startswith("zenostat run --node tank --controller random --set seed=1 --priority 9")


def test_room__what_if_controller_may_be_the_users_own(client: Any, own: str) -> None:
    listed = {each["name"]: each for each in client.get("/api/nodes/tank/controllers").json()["controllers"]}
    entry = listed[f"{own}:Filling"]
    assert (entry["summary"], entry["problem"]) == ("Fill the tank to a level.", "")
    assert {name: field["default"] for name, field in entry["schema"]["properties"].items()} == {
        "level": 0.3,
        "name": "a",
    }
    before = client.get("/api/nodes/tank/history", params={"point": "level"}).json()["points"][0]["values"][-1]
    filling = {"name": f"{own}:Filling", "parameters": {"level": before + 2.5}}
    assert levels(client, controller=filling) == pytest.approx([1.0, 2.0, 3.0, 3.0, 3.0, 3.0])
    command = change(client, "what_if", controller=filling, hours=0.1).json()["command"]
    assert command.startswith(f"zenostat run --node tank --controller {own}:Filling --set level=")


def test_room__what_if_controller_that_fails_is_one_error(
    client: Any, own: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zenostat.views.room.what_if.ANSWER_LIMIT_S", 0.5)
    refused = {
        "Failing": ({}, "own.py, line 21: ZeroDivisionError: division by zero"),
        "Hanging": ({}, "Hanging did not answer the sample of 2026-01-12"),
        "Filling": ({"name": "b"}, "own.py, line 8: RuntimeError: no b"),
    }
    for name, (parameters, text) in refused.items():
        answer = change(client, "what_if", controller={"name": f"{own}:{name}", "parameters": parameters}, hours=0.1)
        assert (answer.status_code, text in answer.json()["message"]) == (400, True), answer.text
    assert client.get("/api/nodes/tank").status_code == 200


@pytest.mark.parametrize(
    ("operation", "content", "status", "text"),
    [
        ("what_if", {"controller": {"name": "oracle"}}, 400, "there is no 'oracle'"),
        ("what_if", {"controller": {"name": "/tmp/tank.py:Tank"}}, 400, "there is no '/tmp"),
        ("what_if", {"controller": {"name": "rbc"}}, 400, "needs an action"),
        ("what_if", {"controller": {"name": "random", "parameters": {"sed": 1}}}, 400, "did you mean 'seed'"),
        ("what_if", {"controller": {"name": "random", "parameters": {"seed": "x"}}}, 400, "valid integer"),
        ("what_if", {"controller": {"name": "fixed", "parameters": {"pump": 101}}}, 400, "0 to 100 W"),
        ("what_if", {"controller": {"name": "fixed"}, "values": {"pump": 1}}, 400, "either values"),
        ("write", {"point": "pmp", "value": 1}, 400, "pump"),
        ("write", {"point": "pump", "value": 101}, 409, "0 to 100 W"),
        ("what_if", {"values": {"pump": 101}}, 400, "pump = 101; its bounds are 0 to 100 W"),
        (
            "what_if",
            {"values": {str(n): 1 for n in range(500)}},
            400,
            "at most 1 value expected, one for each actuator",
        ),
        ("what_if", {"values": {"pmp": 1}}, 400, "no actuator 'pmp'; did you mean 'pump'"),
        ("what_if", {"controller": {"name": "pid"}}, 400, "controller pid: setpoint: it is missing"),
        ("what_if", {"values": {}}, 400, "values"),
        ("what_if", {"values": {"pump": 1}, "hours": 24}, 400, "at most 16.8167 h expected, 1009 timesteps of 60 s"),
        ("acknowledge", {"alarm": "warm"}, 400, "no alarm 'warm'"),
        ("record", {"path": "run.mcap"}, 400, "absolute path"),
        ("stop_recording", {}, 409, "recording"),
        ("record", {"path": "/nonexistent/folder/run.mcap"}, 409, "no folder /nonexistent/folder"),
        ("reset", {"seed": 2**64}, 400, "seed"),
        ("faults", {"plan": {"faults": [{"kind": "bais"}]}}, 400, "bias"),
        (
            "faults",
            {"plan": {}, "replaces": {"faults": [{"kind": "freeze", "points": ["level"]}]}},
            400,
            "the faults have changed in the meantime",
        ),
        ("stop", {}, 404, "no operation 'stop'"),
    ],
)
def test_room__invalid_change_is_answered_with_the_reason(
    client: Any, operation: str, content: dict[str, Any], status: int, text: str
) -> None:
    answer = change(client, operation, **content)
    assert answer.status_code == status
    assert text in answer.json()["message"]
    if operation not in ("what_if", "stop"):
        entry = client.get("/api/audit").json()["entries"][-1]
        assert (entry["operation"], entry["accepted"], text in entry["outcome"]) == (operation, False, True)


def test_room__long_name_is_cut_in_an_error(client: Any) -> None:
    message = change(client, "write", point="x" * 100_000, value=1).json()["message"]
    assert message == f"no actuator '{'x' * 300}…'; there are: 'pump'"


@contextmanager
def frozen_node(tank: NodeProgram, folder: Path) -> Iterator[tuple[NodeProgram, Any, Any, Path]]:
    """A node that is frozen, the server and a client of a control room that follows it, and its audit log."""
    from zenostat.views.room.app import RoomSettings

    file = folder / "audit.jsonl"
    with (
        NodeProgram(folder / "second", connect=[tank.endpoint], plant=TANK, name="second") as node,
        control_room(tank.endpoint, settings=RoomSettings(audit_log=file)) as server,
        httpx.Client(base_url=server.url, headers={"origin": server.url}, timeout=120) as client,
    ):
        token = server.link.partition("#token=")[2]
        assert client.post("/api/session", json={"token": token}).is_success
        until(lambda: client.get("/api/nodes/second").status_code == 200, "the room follows it")
        node.process.send_signal(signal.SIGSTOP)
        try:
            yield node, server, client, file
        finally:
            node.process.send_signal(signal.SIGCONT)


def pauses(file: Path) -> list[dict[str, Any]]:
    """Lines of an audit log about pauses."""
    return [entry for line in file.read_text().splitlines() if (entry := json.loads(line))["operation"] == "pause"]


def test_room__change_that_is_not_answered_in_time_is_not_rejected(tank: NodeProgram, scratch: Path) -> None:
    with (
        zenostat.connect(tank.endpoint, affinity="off") as bus,
        frozen_node(tank, scratch) as (node, server, client, file),
    ):
        server.room._bus.timeout_s = 0.5
        answer = client.post("/api/nodes/second/pause", json={})
        text = "node 'second' has not answered within 0.5 s; it may be carried out all the same"
        assert (answer.status_code, answer.json()["message"]) == (504, text)
        assert [(each["accepted"], each["outcome"]) for each in pauses(file)] == [(None, "requested"), (None, text)]
        node.process.send_signal(signal.SIGCONT)
        until(lambda: bus.status("second").paused, "it is carried out")


def test_room__change_that_waits_when_the_room_ends_is_in_the_audit_log(
    tank: NodeProgram, scratch: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with frozen_node(tank, scratch) as (_, server, client, file), ThreadPoolExecutor() as threads:
        pending = threads.submit(client.post, "/api/nodes/second/pause", json={})
        until(lambda: pauses(file), "it is sent")
        server.stop()
        text = "the control room ended before node 'second' answered; it may be carried out all the same"
        assert (pending.result().status_code, pending.result().json()["message"]) == (504, text)
        assert [(each["accepted"], each["outcome"]) for each in pauses(file)] == [(None, "requested"), (None, text)]
    assert "Traceback" not in capfd.readouterr().err


def test_room__fault_plan_is_the_nodes_whoever_has_set_it(client: Any, tank: NodeProgram) -> None:
    faults = [{"kind": "bias", "points": ["level"], "offset": 0.5}]
    shown = {"seed": 3, "faults": faults}
    with zenostat.connect(tank.endpoint, affinity="off") as bus:
        bus.faults("tank", shown, source="bob")
        following(client, lambda state: state["fault_plan"] == shown)
        replaced = {"seed": 3, "faults": [*faults, {"kind": "freeze", "points": ["level"]}]}
        assert change(client, "faults", plan=replaced, replaces=shown).status_code == 200
        assert bus.fault_plan("tank").names == ("bias 1", "freeze 2")
        assert change(client, "faults", plan={}, replaces=shown).status_code == 400
        assert change(client, "faults", plan={}).status_code == 200
        assert bus.fault_plan("tank").names == ()


def test_room__unknown_node_and_point_are_named(client: Any) -> None:
    answer = client.get("/api/nodes/tnk")
    assert (answer.status_code, "'tank'" in answer.json()["message"]) == (404, True)
    answer = client.get("/api/nodes/tank/history", params={"point": "lvel"})
    assert (answer.status_code, "'level'" in answer.json()["message"]) == (400, True)
    for query in ({"max": "x"}, {"point": "level", "max": "1"}, {"point": ["level"] * 65}):
        assert client.get("/api/nodes/tank/history", params=query).status_code == 400
