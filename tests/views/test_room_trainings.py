"""Trainings and studies in the control room: curves that grow, states, references, and what of a folder is shown."""

import fcntl
import json
from pathlib import Path

import pytest
from support.builders import manifest
from support.control_room import control_room
from support.nodes import NodeProgram, nothing_left, until
from support.tank_plant import TANK

import zenostat

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

import httpx

from zenostat.lab.training.curve import reference_rewards
from zenostat.topics.errors import RequestRejected, UnknownName
from zenostat.views.room.app import RoomSettings
from zenostat.views.room.csv_table import CsvTable
from zenostat.views.room.training_pages import REPORT_POLICY
from zenostat.views.room.trainings import MAX_POINTS, Trainings, _thinned
from zenostat.views.room.trial_controllers import BUNDLED, controllers_content

TRAINING = "algorithm: ppo\nscenario: office\nsteps: 400\nseed: 3\n"


def training(folder: Path) -> Path:
    """A training of 300 of 400 steps, with two evaluations of two episodes and a reference."""
    folder.mkdir(parents=True)
    (folder / "training.yaml").write_text(TRAINING)
    (folder / "versions.json").write_text('{"format": 1, "zenostat": "0.1"}')
    (folder / "curve.csv").write_text("step,slot,reward,steps\n100,0,-4.0,100\n200,0,-2.0,100\n300,0,-3.0,100\n")
    (folder / "evaluations.csv").write_text(
        "step,seed,reward,energy\n150,1,-5.0,7\n150,2,-3.0,9\n300,1,-2.0,6\n300,2,-1.0,\n"
    )
    (folder / "references.csv").write_text("controller,seed,reward\nbaseline,1,-6.0\nbaseline,2,-4.0\nrbc,1,-2.5\n")
    (folder / "progress.csv").write_text("train/loss,time/total_timesteps\n0.5,100\n0.25,200\n")
    (folder / "progress-200.csv").write_text("train/loss,time/total_timesteps\n0.125,310\n")
    return folder


def test_csv_table__reads_what_is_added_and_a_replaced_file_again(tmp_path: Path) -> None:
    path = tmp_path / "curve.csv"
    table = CsvTable(path)
    assert not table.update()
    path.write_text("step,reward\n1,2.5\n2,na")
    assert table.update()
    assert table.columns == {"step": [1.0], "reward": [2.5]}  # the last line is not complete
    with path.open("a") as file:
        file.write("n\n3,inf\n4\n5,-1e3\n")
    assert table.update()
    assert table.columns == {"step": [1.0, 2.0, 3.0, 5.0], "reward": [2.5, None, None, -1000.0]}
    assert not table.update()
    other = tmp_path / "other.csv"
    other.write_text("step,reward\n9,1\n")
    other.replace(path)
    assert table.update()
    assert table.columns == {"step": [9.0], "reward": [1.0]}


def test_trainings__summary_has_progress_and_means(tmp_path: Path) -> None:
    training(tmp_path / "office" / "ppo")
    (run,) = Trainings(tmp_path).content()["runs"]
    assert (run["name"], run["algorithm"], run["seed"], run["state"]) == ("office/ppo", "ppo", 3, "stopped")
    assert (run["step"], run["steps"], run["episodes"]) == (310, 400, 3)
    assert run["reward"] == pytest.approx(-3.0)
    assert (run["evaluation"], run["best"]) == (-1.5, -1.5)
    assert run["references"] == {"baseline": -5.0, "rbc": -2.5}
    assert run["metrics"] == ["episode", "evaluation:reward", "evaluation:energy", "progress:train/loss"]


@pytest.mark.parametrize(
    ("metric", "steps", "means", "lows"),
    [
        ("episode", [100, 200, 300], [-4.0, -3.0, -3.0], None),
        ("evaluation:reward", [150, 300], [-4.0, -1.5], [-5.0, -2.0]),
        ("evaluation:energy", [150, 300], [8.0, 6.0], [7.0, 6.0]),
        ("progress:train/loss", [100, 200, 310], [0.5, 0.25, 0.125], None),
    ],
)
def test_trainings__curve_of_each_metric(
    tmp_path: Path, metric: str, steps: list[int], means: list[float], lows: list[float] | None
) -> None:
    training(tmp_path / "ppo")
    curve = Trainings(tmp_path).curve("ppo", metric)
    assert (curve["step"], curve["mean"], curve["low"]) == (steps, means, lows)
    assert curve["references"] == ({"baseline": -5.0, "rbc": -2.5} if metric.endswith(("episode", "reward")) else {})


@pytest.mark.parametrize("metric", ["episode", "evaluation:energy"])
def test_trainings__references_have_commas_and_unknown_values(tmp_path: Path, metric: str) -> None:
    folder = training(tmp_path / "ppo")
    (folder / "references.csv").write_text(
        'controller,weather,seed,energy,reward\nbaseline,"Denver, CO",1,,-6.0\nrbc,"Denver, CO",1,4.0,-2.0\n'
        'rbc,"Denver, CO",2,6.0,-3.0\nrbc,"Denver'
    )
    expected = {"episode": {"baseline": -6.0, "rbc": -2.5}, "evaluation:energy": {"rbc": 5.0}}
    assert Trainings(tmp_path).curve("ppo", metric)["references"] == expected[metric]
    assert reference_rewards(folder) == expected["episode"]


def test_trainings__state_follows_lock_and_model(tmp_path: Path) -> None:
    folder = training(tmp_path / "ppo")
    with (folder / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert Trainings(tmp_path).content()["runs"][0]["state"] == "training"
    (folder / "model.zip").write_bytes(b"")
    assert Trainings(tmp_path).content()["runs"][0]["state"] == "finished"  # the lock's file alone locks nothing


def test_trainings__damaged_folder_is_listed_with_the_reason_beside_others(tmp_path: Path) -> None:
    training(tmp_path / "good")
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "training.yaml").write_text("a: 1\n")
    runs = {run["name"]: run["problem"] for run in Trainings(tmp_path).content()["runs"]}
    assert runs["good"] == ""
    assert "in format None" in runs["old"]


def test_trainings__thinned_curve_keeps_the_last_point_and_the_extremes() -> None:
    rows = [(float(step), float(step % 7), float(step % 7), float(step % 7)) for step in range(10 * MAX_POINTS + 3)]
    thinned = _thinned(rows)
    assert len(thinned) <= MAX_POINTS
    assert thinned[-1][0] == rows[-1][0]
    assert (min(row[2] for row in thinned), max(row[3] for row in thinned)) == (0.0, 6.0)


def test_trainings__study_shows_values_and_varied_parameters_and_no_address_of_its_database(tmp_path: Path) -> None:
    for number, value in enumerate((-3.0, -1.0, None)):
        folder = tmp_path / "study" / "trials" / f"{number:04d}"
        training(folder / "training")
        fields = {"algorithm": "ppo", "parameters": {"gamma": 0.9 + number / 100}, "output": str(folder)}
        request = {"url": "postgresql://me:secret@host/db", "metric": "reward", "training": fields}
        (folder / "trial.json").write_text(json.dumps(request))
        if value is not None:
            (folder / "result.json").write_text(json.dumps({"state": "complete", "value": value}))
    content = Trainings(tmp_path).content()
    (study,) = content["studies"]
    assert (study["name"], study["metric"], study["varied"]) == ("study", "reward", ["parameters.gamma"])
    assert [trial["state"] for trial in study["trials"]] == ["complete", "complete", "running"]
    assert study["trials"][1]["parameters"] == {"parameters.gamma": 0.91}
    assert study["trials"][1]["run"] == content["runs"][1]["name"] == "study/trials/0001/training"
    assert "secret" not in json.dumps(content)


def test_trainings__tuned_controllers_of_studies_are_offered_if_they_are_bundled(tmp_path: Path) -> None:
    texts = {
        "rules": "controller: rbc\nparameters: {margin: 0.5, preconditioning: 2}\n",
        "own": "controller: rules.py:Own\nparameters: {}\n",
        "plans": "controller: oracle\nparameters: {rule: rules.py:Own}\n",
        "wrong": "controller: rbc\nparameters: {margn: 0.5}\n",
        "training": "algorithm: ppo\nscenario: office\n",
        "damaged": "controller: [\n",
    }
    for name, text in texts.items():
        (tmp_path / name / "trials").mkdir(parents=True)
        (tmp_path / name / "best.yaml").write_text(text)
    (tmp_path / "link" / "trials").mkdir(parents=True)
    (tmp_path / "link" / "best.yaml").symlink_to(tmp_path / "rules" / "best.yaml")
    tuned = controllers_content(manifest(), BUNDLED, Trainings(tmp_path).tuned())["tuned"]
    assert tuned == [{"study": "rules", "name": "rbc", "parameters": {"margin": 0.5, "preconditioning": 2}}]


def test_trainings__folders_elsewhere_are_not_read(tmp_path: Path) -> None:
    training(tmp_path / "other" / "ppo")
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "link").symlink_to(tmp_path / "other")
    trainings = Trainings(tmp_path / "runs")
    assert trainings.content()["runs"] == []
    for name in ("../other/ppo", "link/ppo", str(tmp_path / "other" / "ppo"), ""):
        with pytest.raises(UnknownName):
            trainings.run(name)


def test_trainings__recordings_of_the_folder_are_listed_and_no_others(tmp_path: Path) -> None:
    training(tmp_path / "runs" / "ppo")
    (tmp_path / "other.mcap").write_bytes(b"1")
    (tmp_path / "runs" / "day.mcap").write_bytes(b"12345")
    (tmp_path / "runs" / "ppo" / "best").mkdir()
    (tmp_path / "runs" / "ppo" / "best" / "run.mcap").write_bytes(b"1")
    (tmp_path / "runs" / "link.mcap").symlink_to(tmp_path / "other.mcap")
    (tmp_path / "runs" / ".hidden").mkdir()
    (tmp_path / "runs" / ".hidden" / "run.mcap").write_bytes(b"1")
    (tmp_path / "runs" / "folder.mcap").mkdir()
    trainings = Trainings(tmp_path / "runs")
    assert trainings.content()["recordings"] == [
        {"name": "day.mcap", "bytes": 5, "run": None},
        {"name": "ppo/best/run.mcap", "bytes": 1, "run": "ppo"},
    ]
    assert trainings.recording("ppo/best/run.mcap") == tmp_path / "runs" / "ppo" / "best" / "run.mcap"
    (tmp_path / "runs" / "day.mcap").unlink()
    (tmp_path / "runs" / "day.mcap").symlink_to(tmp_path / "other.mcap")  # since it was listed
    for name in ("day.mcap", "link.mcap", "../other.mcap", str(tmp_path / "other.mcap"), "ppo/training.yaml", ""):
        with pytest.raises(UnknownName, match="no recording"):
            trainings.recording(name)


@pytest.mark.slow
@pytest.mark.process
def test_room__recording_is_replayed_as_a_node_and_ends_with_the_room(scratch: Path) -> None:
    pytest.importorskip("mcap")
    runs = scratch / "runs"
    training(runs / "ppo")
    (runs / "damaged.mcap").write_bytes(b"no recording")
    with (
        nothing_left(scratch),
        NodeProgram(scratch / "node", plant=TANK, name="tank") as node,
        zenostat.connect(node.endpoint, affinity="off") as bus,
    ):
        bus.pause("tank")
        bus.pace("tank", mode="free")
        bus.record("tank", runs / "ppo" / "run.mcap", now=True)
        bus.step("tank", 600)
        until(lambda: bus.status("tank").step == [600], "it is simulated")
        bus.stop_recording("tank")
        settings = RoomSettings(trainings=runs, node_settings={"connect": [node.endpoint], "affinity": "off"})
        with (
            control_room(node.endpoint, settings=settings) as server,
            httpx.Client(base_url=server.url, headers={"origin": server.url}, timeout=60) as client,
        ):
            client.post("/api/session", json={"token": server.link.partition("#token=")[2]})
            until(lambda: client.get("/api/nodes/tank").status_code == 200, "the tank is followed")
            for asked, status, text in (
                ({"name": "../tank.py", "node": "again"}, 400, "no recording"),
                ({"name": "ppo/run.mcap", "node": "tank"}, 409, "on the bus already"),
                ({"name": "ppo/run.mcap", "node": "a b"}, 400, "a_b"),
                ({"name": "ppo/run.mcap", "node": "again", "file": "/etc/passwd"}, 400, "file"),
            ):
                answer = client.post("/api/trainings/replay", json=asked)
                assert (answer.status_code, text in answer.json()["message"]) == (status, True), answer.text
            for name, node_name in (("damaged.mcap", "damaged"), ("ppo/run.mcap", "again")):
                asked = {"name": name, "node": node_name, "speed": 60.0}
                assert client.post("/api/trainings/replay", json=asked).status_code == 200
            until(lambda: client.get("/api/nodes/again").status_code == 200, "the replay is followed")
            states = {each["name"]: each for each in server.room.nodes.content()}
            until(lambda: server.room.nodes.content()[0]["state"] == "failed", "the other cannot be read")
            assert "not an MCAP file" in server.room.nodes.content()[0]["text"]
            assert states["again"]["scenario"] == "ppo/run.mcap"
            samples = bus.listen("again")
            with samples as following:
                sample = next(following)
                assert sample["level"] == pytest.approx(0.05 * sample.step)
            until(lambda: server.room.watch.is_online("again"), "its status is read")
            answer = client.post("/api/nodes/again/pause", json={})
            assert (answer.status_code, "is the replay of a recording" in answer.json()["message"]) == (409, True)
            with pytest.raises(RequestRejected, match="recorded a Python class, which has no semantic model"):
                bus.semantic("again")
            assert "again" in bus.nodes()
        until(lambda: "again" not in bus.nodes(), "it has ended with the room")


@pytest.mark.slow
@pytest.mark.process
def test_room__report_of_a_training_is_apart_from_the_page_and_audited(scratch: Path) -> None:
    folder = training(scratch / "runs" / "ppo")
    (folder / "report.html").write_text("<script>alert(1)</script>")
    settings = RoomSettings(trainings=scratch / "runs")
    with (
        NodeProgram(scratch / "node", plant=TANK, name="tank") as node,
        control_room(node.endpoint, settings=settings) as server,
        httpx.Client(base_url=server.url, headers={"origin": server.url}, timeout=60) as client,
    ):
        assert client.get("/api/trainings").status_code == 401
        client.post("/api/session", json={"token": server.link.partition("#token=")[2]})
        assert [run["name"] for run in client.get("/api/trainings").json()["runs"]] == ["ppo"]
        curve = client.get("/api/trainings/curve", params={"name": "ppo", "metric": "episode"}).json()
        assert curve["mean"] == [-4.0, -3.0, -3.0]
        assert client.get("/api/trainings/curve", params={"name": "p", "metric": "episode"}).status_code == 400
        report = client.get("/api/trainings/report", params={"name": "ppo"})
        assert report.headers["content-security-policy"] == REPORT_POLICY
        assert REPORT_POLICY.startswith("sandbox allow-scripts")
        assert "allow-same-origin" not in REPORT_POLICY
        assert "script-src 'sha256-" in REPORT_POLICY
        answer = client.post("/api/trainings/report", json={"name": "ppo"})
        assert (answer.status_code, "no model yet" in answer.json()["message"]) == (400, True)
        (folder / "model.zip").write_bytes(b"not a model")
        assert client.post("/api/trainings/report", json={"name": "ppo"}).status_code == 200
        until(lambda: client.get("/api/trainings").json()["reports"]["ppo"]["state"] == "failed", "its end")
        answer = client.post("/api/trainings/watch", json={"name": "ppo", "node": "watched"})
        assert (answer.status_code, "scenario.yaml" in answer.json()["message"]) == (400, True)
        entries = [(each["operation"], each["accepted"]) for each in client.get("/api/audit").json()["entries"]]
        assert entries == [
            ("sign in", True), ("make report", False), ("make report", True), ("watch training", False),
        ]  # fmt: skip
