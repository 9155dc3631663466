"""The scenario builder of the control room: its program, what a scenario of a page may name, and nodes from it."""

import asyncio
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import pytest
from support.clock import Clock
from support.control_room import control_room
from support.nodes import NodeProgram, nothing_left, until
from support.tank_plant import TANK
from typer.testing import CliRunner

import zenostat
from zenostat.cli.commands import app
from zenostat.cli.scenario_answers import ScenarioAnswers
from zenostat.models.catalog import find_building
from zenostat.topics import yaml12
from zenostat.topics.errors import InvalidConfig, PeerError, RequestRejected, UnknownName, UsageError

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

import httpx

from zenostat.views.room.app import RoomSettings
from zenostat.views.room.audit import AuditLog, Unanswered
from zenostat.views.room.scenario_program import ScenarioProgram
from zenostat.views.room.started_nodes import StartedNodes
from zenostat.views.room.updates import Updates

FIELDS: dict[str, Any] = {
    "building": "ref-small-office",
    "weather": ["USA_CO_Denver"],
    "begin": "07-03",
    "end": "07-03",
    "steps_per_hour": 4,
}


@pytest.fixture
def answers(tmp_path: Path) -> ScenarioAnswers:
    return ScenarioAnswers(tmp_path)


def errors_of_command(folder: Path, name: str, fields: dict[str, Any]) -> list[str]:
    """The errors of `zenostat scenarios check` for a file in a folder, in that folder."""
    (folder / f"{name}.yaml").write_text(yaml12.dump(fields))
    done = CliRunner().invoke(app, ["scenarios", "check", f"{name}.yaml"])
    assert isinstance(done.exception, UsageError), done.output
    return str(done.exception).split("\n")


@pytest.mark.process
@pytest.mark.parametrize(
    "wrong",
    [
        {"begin": "02-30", "steps_per_hour": 7},
        {"weather": ["USA_CO_Denvr"], "reward": {"kind": "lineer"}},
        {"sensors": {"a": ["Zone Air Temperatur", "Core_ZN"]}, "reward": {"kind": "linear", "temperatures": ["b"]}},
        {"buildin": "x", "time": ["houer"]},
        {"edits": {"Material:NoMas": {}}},
        {"building": "tower.idf"},
    ],
    ids="_".join,
)
def test_scenario_answers__errors_are_those_of_the_command_line(
    answers: ScenarioAnswers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrong: dict[str, Any]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tower.idf").write_text("Version,25.2;\nZone,A,,,,,,,;\nZone,A;\n")
    fields = FIELDS | wrong
    answer = answers.check(fields, "mine")
    assert answer["errors"] == errors_of_command(tmp_path, "mine", fields)
    assert yaml12.parse(answer["yaml"], "the answer") == fields


@pytest.mark.process
def test_scenario_answers__valid_scenario_is_summarized(answers: ScenarioAnswers) -> None:
    answer = answers.check(FIELDS)
    assert answer["errors"] == []
    assert "USA_CO_Denver, 96 timesteps; " in answer["summary"]
    assert yaml12.parse(answer["yaml"], "the answer") == FIELDS


def test_scenario_answers__empty_scenario_is_not_saved(answers: ScenarioAnswers) -> None:
    """A page could not open it again."""
    answer = answers.check({})
    assert answer["is_refused"]
    assert answer["errors"] == ["scenario.yaml: building: it is missing; weather: it is missing"]
    assert not answers.check({"building": "nowhere"})["is_refused"], "what has errors can be finished later"


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"building": "/etc/passwd.idf"}, "building: /etc/passwd.idf is not in the folder of scenarios"),
        ({"building": "../tower.idf"}, "building: ../tower.idf is not in the folder"),
        ({"building": "/etc"}, "building: /etc is not in the folder"),
        ({"building": "~/tower.idf"}, "building: ~/tower.idf is not in the folder"),
        ({"building": "link.idf"}, "building: link.idf is not in the folder"),
        ({"weather": ["USA_CO_Denver", "/root/a.epw"]}, "weather: /root/a.epw is not in the folder"),
        ({"reward": {"kind": "energy_cost", "price": {"csv": "../p.csv"}}}, "reward: ../p.csv is not in the folder"),
        ({"wrappers": [{"wrapper": "ResidualAction", "controller": "evil.py:Evil"}]}, "wrappers: not from a browser"),
        ({"edits": {"schedule:file": {"A": {"file_name": "/etc/passwd"}}}}, "edits: schedule:file: not from a browser"),
        ({"edits": {"PythonPlugin:Instance": {"A": {}}}}, "edits: PythonPlugin:Instance: not from a browser"),
        ({"edits": {"ExternalInterface": {"A": {}}}}, "edits: ExternalInterface: not from a browser"),
        ({"steps_per_hour": float("nan")}, "steps_per_hour: a finite number expected, not nan"),
        ({"actuators": {"a": ["T", "C", "K", 1, float("inf")]}}, "actuators.a.4: a finite number expected, not inf"),
    ],
)
def test_scenario_answers__scenario_of_a_page_names_no_code_and_no_file_elsewhere(
    tmp_path: Path, fields: dict[str, Any], text: str
) -> None:
    folder = tmp_path / "scenarios"
    folder.mkdir()
    (tmp_path / "tower.idf").write_text("Version,25.2;\n")
    (folder / "link.idf").symlink_to(tmp_path / "tower.idf")
    answer = ScenarioAnswers(folder).check(FIELDS | fields)
    assert len(answer["errors"]) == 1
    assert answer["errors"][0].startswith(text)
    assert ScenarioAnswers(None).check(FIELDS | fields)["errors"]
    assert ScenarioAnswers(folder).form()["own_buildings"] == []
    if "building" in fields:
        with pytest.raises(InvalidConfig, match="not in the folder"):
            ScenarioAnswers(folder).points(fields["building"])


def test_scenario_answers__scenario_elsewhere_is_not_read(tmp_path: Path) -> None:
    folder = tmp_path / "scenarios"
    folder.mkdir()
    (tmp_path / "other.yaml").write_text("building: x\n")
    (folder / "link.yaml").symlink_to(tmp_path / "other.yaml")
    (folder / "own.yaml").write_text("building: y\n")
    for name in ("../other", "link", "none", "/etc/hosts", ""):
        with pytest.raises(UnknownName):
            ScenarioAnswers(folder).read(name)
    assert ScenarioAnswers(folder).read("own")["fields"] == {"building": "y"}
    assert ScenarioAnswers(folder).form()["scenarios"] == ["own"]


def test_scenario_answers__form_lists_the_scenarios_that_can_be_read(answers: ScenarioAnswers, tmp_path: Path) -> None:
    (tmp_path / "sub.yaml").mkdir()
    for name in ("mine", "a.b-1", "-x", "büro heat", "sub.yaml/below"):
        (tmp_path / f"{name}.yaml").write_text("building: y\n")
    (tmp_path / "OTHER.YAML").write_text("building: y\n")
    listed = answers.form()["scenarios"]
    assert listed == ["a.b-1", "mine"]
    for name in listed:
        assert answers.read(name)["fields"] == {"building": "y"}


def test_scenario_answers__scenario_with_numbers_that_are_not_finite_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(
        "building: y\nreward: {kind: linear, weight: .nan}\nactions: {a: {high: -.inf}}\n"
    )
    with pytest.raises(InvalidConfig) as raised:
        ScenarioAnswers(tmp_path).read("own")
    assert str(raised.value).split("\n") == [
        "own.yaml: reward.weight: a finite number expected, not nan",
        "own.yaml: actions.a.high: a finite number expected, not -inf",
    ]


def test_scenario_answers__form_has_all_fields_but_wrappers(answers: ScenarioAnswers) -> None:
    form = answers.form()
    assert {"building", "weather", "sensors", "actions", "reward"} <= form["schema"]["properties"].keys()
    assert "wrappers" not in form["schema"]["properties"]
    assert "ref-small-office" in form["buildings"]
    assert "USA_CO_Denver" in form["weathers"]


@pytest.mark.process
def test_scenario_answers__points_are_searched_by_all_words(answers: ScenarioAnswers) -> None:
    answer = answers.points("ref-small-office", "zone temperature core", "sensor")
    assert 0 < answer["count"] < answer["total"]
    assert all("core" in f"{each['key']}{each['where']}".casefold() for each in answer["points"])
    assert {each["kind"] for each in answer["points"]} == {"sensor"}
    defaults = answers.points("ref-small-office", kind="actuator", default=True)["points"]
    assert "core_zn_cooling_setpoint" in {each["bus_name"] for each in defaults}


@pytest.mark.slow
@pytest.mark.process
def test_scenario_program__answers_after_errors_and_after_its_end() -> None:
    program = ScenarioProgram(None)
    try:
        assert "schema" in program.ask("form")
        with pytest.raises(UnknownName, match="no building 'ref-smal-office'"):
            program.ask("points", building="ref-smal-office")
        assert program._process is not None
        program._process.kill()
        program._process.wait()
        assert program.ask("check", fields={"building": "/etc"})["errors"]
    finally:
        program.close()
    with pytest.raises(PeerError, match="ending"):
        program.ask("form")


def test_audit_log__each_entry_is_a_line_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "audit.jsonl"
    for number in range(2):  # it goes on with the file
        log = AuditLog(Updates(), file)
        log.add("ada", "write", "office", f"{number}\nsecond line", accepted=bool(number))
        assert [entry["outcome"] for entry in log.entries()] == [f"{number}\nsecond line"]
        log.close()
    entries = [json.loads(line) for line in file.read_text().splitlines()]
    assert [(entry["operator"], entry["accepted"]) for entry in entries] == [("ada", False), ("ada", True)]
    assert file.stat().st_mode & 0o777 == 0o600
    with pytest.raises(InvalidConfig, match="audit-log"):
        AuditLog(Updates(), tmp_path)


def test_audit_log__attempts_of_one_user_without_the_role_displace_no_others(clock: Clock) -> None:
    log = AuditLog(Updates(), clock=clock)
    log.add("ada", "pause", "office", "paused", accepted=True)
    for clock.now_s in (0.0, 60.0):
        for _ in range(1000):
            log.add_denied("wall", "w" * 10_000, "office", "wall may only read")
        log.add_denied("eve", "write", "office", "eve may only read")
    operators = [entry["operator"] for entry in log.entries()]
    assert operators == ["ada", *2 * ([*20 * ["wall"], "eve"])]
    assert not any(entry["accepted"] for entry in log.entries()[1:])
    outcomes = {entry["outcome"] for entry in log.entries() if entry["operator"] == "wall"}
    assert outcomes == {"wall may only read", "wall may only read; further attempts within this minute are not listed"}
    assert max(len(entry["operation"]) for entry in log.entries()) <= 200


def test_audit_log__no_change_is_made_while_entries_cannot_be_written() -> None:
    log, changed = AuditLog(Updates(), Path("/dev/full")), []

    async def change() -> str:
        changed.append(1)
        return "done"

    async def changes() -> None:
        for _ in range(2):
            with pytest.raises(RequestRejected, match="nothing was changed, since the audit log cannot be written"):
                await log.attempt("ada", "write", "office", change)

    asyncio.run(changes())
    assert changed == []
    assert [entry["accepted"] for entry in log.entries()] == [False, False]
    log.close()


@pytest.mark.parametrize(
    ("error", "accepted", "text"),
    [
        (None, True, "pump = 20 W"),
        (RequestRejected("it is locked"), False, "it is locked"),
        (ValueError("a mistake"), False, "ValueError: a mistake"),
        (Unanswered("no answer within 30 s; it may be carried out all the same"), None, "no answer within 30 s"),
        (asyncio.CancelledError(), None, "the control room ended before the answer; it may be carried out"),
    ],
)
async def test_audit_log__change_has_an_entry_before_it_is_made_and_then_its_outcome(
    tmp_path: Path, error: BaseException | None, text: str, *, accepted: bool | None
) -> None:
    file = tmp_path / "audit.jsonl"
    log, request = AuditLog(Updates(), file), b'{"point":"pump","value":20.123456789,"duration_s":61}'

    def lines() -> list[dict[str, Any]]:
        return [json.loads(line) for line in file.read_text().splitlines()]

    async def change() -> str:
        (entry,) = lines()
        assert (entry["accepted"], entry["outcome"], entry["request"]) == (None, "requested", request.decode())
        if error is not None:
            raise error
        return text

    with nullcontext() if error is None else pytest.raises(type(error)):
        assert await log.attempt("ada", "write", "office", change, request) == text
    log.add("eve", "sign in", "", "signed in", accepted=True)
    requested, outcome, _ = lines()
    assert (outcome["accepted"], text in outcome["outcome"]) == (accepted, True)
    assert all(outcome[name] == requested[name] for name in ("id", "operator", "operation", "target", "request"))
    assert [each["outcome"] for each in log.entries()] == [outcome["outcome"], "signed in"]
    log.close()


@pytest.fixture(scope="module")
def tank(module_folder: Path) -> Iterator[NodeProgram]:
    with NodeProgram(module_folder / "node", plant=TANK, name="tank") as node:
        yield node


@pytest.mark.slow
@pytest.mark.process
def test_builder__node_is_started_from_a_page_audited_and_ends_with_the_room(tank: NodeProgram, scratch: Path) -> None:
    folder = scratch / "scenarios"
    folder.mkdir()
    settings = RoomSettings(scenarios=folder, node_settings={"connect": [tank.endpoint], "affinity": "off"})
    with nothing_left(scratch), zenostat.connect(tank.endpoint, affinity="off") as bus:
        with control_room(tank.endpoint, settings=settings) as server, signed_in(server) as client:
            (folder / "mine.yaml").write_text("building: another\n")
            started = {"fields": FIELDS, "name": "mine", "node": "branch office", "mode": "free"}
            answer = client.post("/api/builder/start", json=started)
            assert (answer.status_code, "'branch_office'" in answer.json()["message"]) == (400, True)
            answer = client.post("/api/builder/start", json=started | {"node": "tank", "overwrite": True})
            assert (answer.status_code, "on the bus already" in answer.json()["message"]) == (409, True)
            answer = client.post("/api/builder/start", json=started | {"node": "second"})
            assert answer.status_code == 409  # the file is there from the first request
            wrong = {"fields": FIELDS | {"begin": "x"}, "name": "wrong", "node": "second"}
            assert client.post("/api/builder/start", json=wrong).status_code == 400
            assert not (folder / "wrong.yaml").exists()
            answer = client.post("/api/builder/start", json=started | {"node": "second", "overwrite": True})
            assert answer.json()["text"] == "saved as mine.yaml; node second is starting"
            until(lambda: client.get("/api/builder").json()["started"][-1]["state"] == "running", "it runs")
            until(lambda: "second" in bus.nodes(), "it is on the bus")
            assert client.post("/api/builder/stop", json={"node": "tank"}).status_code == 404
            entries = client.get("/api/audit").json()["entries"]
            kinds = [(entry["operation"], entry["target"], entry["accepted"]) for entry in entries]
            assert kinds[0] == ("sign in", "", True)
            assert kinds[-2:] == [("start node", "second", True), ("end node", "tank", False)]
            assert {entry["operator"] for entry in entries} == {"ada"}
            assert yaml12.read_mapping(folder / "mine.yaml") == FIELDS
        until(lambda: "second" not in bus.nodes(), "it has ended with the room")


@pytest.mark.slow
@pytest.mark.process
def test_builder__scenario_that_somebody_else_has_saved_is_not_replaced(tank: NodeProgram, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("# by hand\n" + yaml12.dump(FIELDS))
    with control_room(tank.endpoint, settings=RoomSettings(scenarios=tmp_path)) as server, signed_in(server) as client:

        def save(end: str, **more: Any) -> Any:
            return client.post("/api/builder/save", json={"name": "mine", "fields": FIELDS | {"end": end}, **more})

        opened = client.get("/api/builder/scenario", params={"name": "mine"}).json()
        assert opened["fields"] == FIELDS
        first = save("07-04", replaces=opened["digest"])
        assert first.status_code == 200, first.text
        second = save("07-05", replaces=opened["digest"])
        assert (second.status_code, "has changed since it was opened" in second.json()["message"]) == (409, True)
        assert yaml12.read_mapping(file) == FIELDS | {"end": "07-04"}
        assert save("07-06", replaces=first.json()["digest"]).status_code == 200
        assert save("07-07", replaces=opened["digest"], overwrite=True).status_code == 200
        file.unlink()
        assert save("07-08", replaces=opened["digest"]).status_code == 200


@pytest.mark.slow
@pytest.mark.process
def test_started_nodes__tell_that_their_controller_has_ended(tank: NodeProgram, scratch: Path) -> None:
    file = scratch / "mine.yaml"
    file.write_text(yaml12.dump(FIELDS))
    with nothing_left(scratch):
        nodes = StartedNodes({"connect": [tank.endpoint], "affinity": "off"}, Updates())
        try:
            nodes.start(file, "third", "ada", {}, controller="nothing")
            until(lambda: "its controller ended with code" in nodes.content()[-1]["text"], "its text says so")
            assert nodes.content()[-1]["state"] == "running"
        finally:
            nodes.close()


@contextmanager
def signed_in(server: Any) -> Iterator[Any]:
    with httpx.Client(base_url=server.url, headers={"origin": server.url}, timeout=120) as client:
        assert client.post("/api/session", json={"token": server.link.partition("#token=")[2]}).status_code == 200
        yield client


@pytest.mark.slow
@pytest.mark.process
def test_builder__without_a_folder_it_checks_and_neither_saves_nor_starts(tank: NodeProgram) -> None:
    with control_room(tank.endpoint) as server:
        with httpx.Client(base_url=server.url, headers={"origin": server.url}) as stranger:
            assert stranger.post("/api/builder/check", json={"fields": {}}).status_code == 401
            assert stranger.get("/api/builder").status_code == 401
        with signed_in(server) as client:
            answer = client.post("/api/builder/check", json={"fields": {"building": "office-smoll"}, "name": "mine"})
            assert any("office-small" in error for error in answer.json()["errors"])
            for operation, more in (("save", {}), ("start", {"node": "second"})):
                answer = client.post(f"/api/builder/{operation}", json={"fields": FIELDS, "name": "mine", **more})
                assert (answer.status_code, "--scenarios FOLDER" in answer.json()["message"]) == (409, True)
            for body in ({"fields": [], "name": "a"}, {"fields": {}, "name": "../a"}, {"fields": {}, "path": "a"}):
                assert client.post("/api/builder/check", json=body).status_code == 400


def test_started_nodes__failure_to_start_is_shown(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The program is replaced by one that fails as a node does."""
    import zenostat.views.room.started_nodes as module

    script = tmp_path / "node.py"
    script.write_text('import sys; sys.stdin.readline(); print(\'{"error": "InvalidConfig", "message": "no"}\')')
    start = subprocess.Popen
    monkeypatch.setattr(module.subprocess, "Popen", lambda _, **options: start([sys.executable, script], **options))
    nodes = StartedNodes({"connect": ["tcp/127.0.0.1:1"]}, Updates())
    nodes.start(tmp_path / "mine.yaml", "second", "ada", {"mode": "free"})
    until(lambda: nodes.content()[0]["state"] == "failed", "it has failed")
    assert nodes.content() == [
        {"name": "second", "scenario": "mine", "operator": "ada", "state": "failed", "text": "no"}
    ]
    nodes.close()
    with pytest.raises(RequestRejected):
        nodes.start(tmp_path / "mine.yaml", "second", "ada", {"mode": "free"})


def test_scenario_answers__own_building_is_listed_and_read(answers: ScenarioAnswers, tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    source = find_building("ref-small-office").path
    (tmp_path / "models" / source.name).write_bytes(source.read_bytes())
    (tmp_path / ".hidden.idf").write_text("")
    assert answers.form()["own_buildings"] == [f"models/{source.name}"]
