"""The dashboard files for Grafana: each query in them is answered by the control room's endpoints."""

import json
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
from support.control_room import control_room
from support.nodes import NodeProgram, free_port, until

import zenostat

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

import httpx

from zenostat.views.room.dashboards import target_names

FOLDER = Path(__file__).parents[2] / "examples" / "dashboards"
TOKEN = "a-token-of-programs-of-the-tests-1"
ALARMS = "alarms: [{name: warm, points: [temperature], high: 10.0, unit: degC, priority: high}]\n"
ROOM = '''
class Room:
    """A room with points of each unit of the dashboards; its temperature is 1 K below its actuator's."""
    step_s = 60.0
    begin = "2026-01-12T00:00"
    duration_s = 86400.0
    sensors = {"temperature": ("degC", 0.0, 50.0), "heater": ("W", 0.0, 9e3)}
    meters = {"electricity": ("J", 0.0, None)}
    actuators = {"temperature": ("degC", 10.0, 30.0, 20.0)}

    def reset(self, seed):
        return {"temperature": 20.0, "heater": 0.0, "electricity": 0.0}

    def step(self, commands):
        return {"temperature": commands["temperature"] - 1.0, "heater": 500.0, "electricity": 3e4}
'''


def panels(name: str) -> list[dict[str, Any]]:
    return json.loads((FOLDER / name).read_text())["panels"]


@pytest.fixture(scope="module")
def node(module_folder: Path) -> Iterator[NodeProgram]:
    (module_folder / "room.py").write_text(ROOM)
    (module_folder / "alarms.yaml").write_text(ALARMS)
    settings = {"plant": f"{module_folder}/room.py:Room", "name": "room", "alarms": f"{module_folder}/alarms.yaml"}
    with NodeProgram(module_folder / "node", **settings) as started:
        yield started


@pytest.fixture(scope="module")
def client(node: NodeProgram) -> Iterator[httpx.Client]:
    """A program with the token; the node of a room has a controller, an alarm, a fault and ten timesteps."""
    with (
        zenostat.connect(node.endpoint, affinity="off") as bus,
        control_room(node.endpoint, api_token=TOKEN) as server,
        bus.controller("room", name="rule") as link,
        httpx.Client(base_url=server.url, headers={"authorization": f"Bearer {TOKEN}"}) as started,
    ):
        for sample in link:
            if sample.step == 10:
                break
            sample.send({"temperature": 21.0})
        until(lambda: 'zenostat_node_step{node="room"} 10' in started.get("/metrics").text, "it is polled")
        until(lambda: "zenostat_node_speed_ratio" in started.get("/metrics").text, "it has waited for a while")
        yield started


@pytest.mark.slow
@pytest.mark.process
def test_dashboards__each_prometheus_query_selects_series_that_are_exported(client: httpx.Client) -> None:
    series: dict[str, list[dict[str, str]]] = {}
    for line in client.get("/metrics").text.splitlines():
        if not line.startswith("#"):
            name, _, labels = line.rpartition(" ")[0].partition("{")
            series.setdefault(name, []).append(dict(re.findall(r'(\w+)="([^"]*)"', labels)))
    queries = [target["expr"] for panel in panels("grafana-prometheus.json") for target in panel["targets"]]
    assert len(queries) >= 16
    for query in queries:
        selectors = re.findall(r"(zenostat_\w+)(?:\{([^}]*)\})?", query)
        assert selectors
        for name, matchers in selectors:
            wanted = re.findall(r'(\w+)(=~|=)"([^"]*)"', matchers)
            matching = [
                labels
                for labels in series.get(name, [])
                if all(re.fullmatch(text.replace("$node", ".*"), labels.get(label, "")) for label, _, text in wanted)
            ]
            assert matching, query
            assert all(label in matching[0] for label, *_ in wanted)
    shown = {name for query in queries for name in re.findall(r"zenostat_\w+", query)}
    assert set(series) <= shown  # no metric is without a panel


@pytest.mark.slow
@pytest.mark.process
def test_metrics__have_each_state_of_alarms_at_all_times(client: httpx.Client) -> None:
    """A series that vanishes keeps its last value in Prometheus for minutes; `warm` is the only alarm."""
    states = dict(re.findall(r'zenostat_node_alarms\{node="room",state="(\w+)"\} (\d+)', client.get("/metrics").text))
    inactive = ("acknowledged", "returned", "suppressed", "shelved", "out_of_service")
    assert states == {"active": "1", **dict.fromkeys(inactive, "0")}


@pytest.mark.slow
@pytest.mark.process
def test_dashboards__legends_have_labels_of_their_series(client: httpx.Client) -> None:
    text = client.get("/metrics").text
    for panel in panels("grafana-prometheus.json"):
        for target in panel["targets"]:
            name = re.search(r"zenostat_\w+", target["expr"])
            assert name is not None
            labels = next(line for line in text.splitlines() if line.startswith(name[0]))
            assert all(f'{label}="' in labels for label in re.findall(r"\{\{(\w+)\}\}", target["legendFormat"]))


PROMETHEUS = shutil.which("prometheus")


@pytest.fixture
def prometheus(client: httpx.Client, tmp_path: Path) -> Iterator[httpx.Client]:
    """A client of a Prometheus server that scrapes the room each second."""
    if PROMETHEUS is None:
        pytest.skip("Prometheus is not installed")
    port = free_port()
    token = tmp_path / "token"
    token.write_text(TOKEN)
    scrape = {
        "job_name": "zenostat",
        "authorization": {"credentials_file": str(token)},
        "static_configs": [{"targets": [client.base_url.netloc.decode()]}],
    }
    configuration = tmp_path / "prometheus.yml"
    configuration.write_text(json.dumps({"global": {"scrape_interval": "1s"}, "scrape_configs": [scrape]}))
    arguments = [f"--config.file={configuration}", f"--storage.tsdb.path={tmp_path / 'data'}"]
    with (tmp_path / "prometheus.log").open("w") as log:
        process = subprocess.Popen([PROMETHEUS, *arguments, f"--web.listen-address=127.0.0.1:{port}"], stderr=log)
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}/api/v1", trust_env=False) as started:
            yield started
    finally:
        process.terminate()
        process.wait(30)


def answer_of(prometheus: httpx.Client, query: str) -> list[dict[str, Any]]:
    try:
        answer = prometheus.get("/query", params={"query": query})
    except httpx.TransportError:  # it is starting
        return []
    if answer.status_code == httpx.codes.SERVICE_UNAVAILABLE:
        return []
    content = answer.json()
    assert content["status"] == "success", content
    result: list[dict[str, Any]] = content["data"]["result"]
    return result


@pytest.mark.slow
@pytest.mark.process
def test_dashboards__a_prometheus_server_answers_each_query(prometheus: httpx.Client) -> None:
    until(lambda: answer_of(prometheus, "up")[:1] and answer_of(prometheus, "up")[0]["value"][1] == "1", "it scrapes")
    rates = "rate(zenostat_node_commands_total[1m])"  # needs two scrapes
    until(lambda: bool(answer_of(prometheus, rates)), "there are two samples")
    for panel in panels("grafana-prometheus.json"):
        for target in panel["targets"]:
            assert answer_of(prometheus, target["expr"].replace("$node", ".*")), target["expr"]
            nothing = answer_of(prometheus, target["expr"].replace("$node", "another"))
            assert not nothing or "$node" not in target["expr"], target["expr"]
    (step,) = answer_of(prometheus, 'zenostat_node_step{node="room"}')
    assert step["value"][1] == "10"
    (legends,) = answer_of(prometheus, "count(zenostat_node_alarms)")
    assert int(legends["value"][1]) > 0


def as_regular_expression(values: list[str]) -> str:
    """A variable's values as Grafana writes them into a target of the JSON data source."""
    escaped = [re.sub(r"[\\^$*+?.()|\[\]{}/-]", r"\\\g<0>", value) for value in values]
    return escaped[0] if len(escaped) == 1 else f"({'|'.join(escaped)})"


@pytest.mark.slow
@pytest.mark.process
def test_dashboards__each_query_of_the_history_is_answered_with_values(client: httpx.Client) -> None:
    dashboard = json.loads((FOLDER / "grafana-history.json").read_text())
    values: dict[str, list[str]] = {}
    for variable in dashboard["templating"]["list"][1:]:
        query = variable["query"]["query"].replace("${node:json}", json.dumps("room"))
        answer = client.post("/grafana/variable", json={"payload": json.loads(query)})
        values[variable["name"]] = [entry["__value"] for entry in answer.json()]
    assert values["node"] == ["room"]
    assert (values["temperatures"], values["setpoints"]) == (["room/temperature"], ["room/actuator/temperature"])
    assert values["points"] == ["room/temperature", "room/heater", "room/electricity", "room/actuator/temperature"]
    targets = client.post("/grafana/metrics", json={}).json()
    assert [target["value"] for target in targets] == values["points"]
    for panel in dashboard["panels"]:
        for target in panel["targets"]:
            names = values[target["target"].removeprefix("$")]
            content = {
                "range": {"from": "2026-01-12T00:00:00.000Z", "to": "2026-01-12T01:00:00.000Z"},
                "targets": [{"target": as_regular_expression(names), "refId": "A", "payload": {}}],
                "maxDataPoints": 500,
            }
            answer = client.post("/grafana/query", json=content).json()
            assert [series["target"] for series in answer] == names
            assert all(len(series["datapoints"]) == 11 for series in answer)
            if len(names) == 1 and names[0].endswith("temperature"):
                expected = 20.0 if names == values["temperatures"] else 21.0
                assert [value for value, _ in answer[0]["datapoints"][1:]] == [expected] * 10


@pytest.mark.parametrize("values", [["office/zone.a_1"], ["a/b", "c-d/e"], ["a.b/c"]])
def test_target_names__variables_of_grafana_are_names(values: list[str]) -> None:
    assert target_names(as_regular_expression(values)) == values
    assert target_names(values[0]) == values[:1]


@pytest.mark.slow
@pytest.mark.process
def test_grafana_variable__unknown_target_is_an_error(client: httpx.Client) -> None:
    answer = client.post("/grafana/variable", json={"payload": {"target": "zones"}})
    assert (answer.status_code, "nodes or points" in answer.json()["message"]) == (400, True)
    assert client.post("/grafana/variable", json={"payload": {"target": "points", "node": "none"}}).json() == []


def query(client: httpx.Client, *targets: str | None, **fields: Any) -> httpx.Response:
    span = {"from": "2026-01-12T00:00:00.000Z", "to": "2026-01-12T01:00:00.000Z"}
    content = {"range": span, "targets": [{"target": target} for target in targets], **fields}
    return client.post("/grafana/query", json=content)


@pytest.mark.slow
@pytest.mark.process
def test_grafana_query__targets_that_cannot_be_read_are_left_out_if_others_can(client: httpx.Client) -> None:
    bad = ("room/nope", "gone/x", "room", None, "")
    answer = query(client, *bad, "room/heater", "room/temperature")
    assert [series["target"] for series in answer.json()] == ["room/heater", "room/temperature"]
    assert query(client, None, "").json() == []
    for target, status, text in (
        ("room/nope", 400, "nope"),
        ("gone/x", 404, "no node 'gone'"),
        ("room", 400, "NODE/POINT expected"),
    ):
        answer = query(client, target)
        assert (answer.status_code, text in answer.json()["message"]) == (status, True)
    late = {"from": "2027-01-12T00:00:00.000Z", "to": "2027-01-12T01:00:00.000Z"}
    assert query(client, "room/nope", "room/heater", range=late).json() == []


@pytest.mark.slow
@pytest.mark.process
@pytest.mark.parametrize(("number", "samples"), [(1, 2), (812.5, 11), (1e9, 11), (None, 11)])
def test_grafana_query__number_of_samples_is_clamped(client: httpx.Client, number: float | None, samples: int) -> None:
    (series,) = query(client, "room/heater", maxDataPoints=number).json()
    assert len(series["datapoints"]) == samples


@pytest.mark.slow
@pytest.mark.process
def test_grafana_query__range_of_the_whole_calendar_has_all_samples(client: httpx.Client) -> None:
    span = {"from": "0001-01-01T00:00:00+14:00", "to": "9999-12-31T23:59:59-12:00"}
    (series,) = query(client, "room/heater", range=span).json()
    assert len(series["datapoints"]) == 11


@pytest.mark.slow
@pytest.mark.process
def test_grafana_query__those_of_a_frozen_node_do_not_take_all_threads(client: httpx.Client, node: NodeProgram) -> None:
    answers: SimpleQueue[httpx.Response] = SimpleQueue()
    with ThreadPoolExecutor(70) as threads, httpx.Client(limits=httpx.Limits(), timeout=60) as many:
        many.base_url, many.headers = client.base_url, client.headers
        os.kill(node.pid, signal.SIGSTOP)
        try:
            for _ in range(70):
                threads.submit(lambda: answers.put(query(many, "room/heater", maxDataPoints=5)))
            rejected = [answers.get(timeout=30) for _ in range(62)]
        finally:
            os.kill(node.pid, signal.SIGCONT)
        assert {answer.status_code for answer in rejected} == {409}
        assert all("8 requests to node 'room' wait" in answer.json()["message"] for answer in rejected)
        assert {answers.get(timeout=30).status_code for _ in range(8)} == {200}


@pytest.mark.parametrize("name", ["grafana-prometheus.json", "grafana-history.json"])
def test_dashboards__panels_have_ids_of_their_own_and_do_not_overlap(name: str) -> None:
    places = [panel["gridPos"] for panel in panels(name)]
    assert len({panel["id"] for panel in panels(name)}) == len(places)
    cells = [(x, y) for p in places for x in range(p["x"], p["x"] + p["w"]) for y in range(p["y"], p["y"] + p["h"])]
    assert len(set(cells)) == len(cells)
    assert max(x for x, _ in cells) < 24
