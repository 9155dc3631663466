"""Texts in the terminal on a recording that stopped, never began, or is damaged."""

import io
from typing import Any

import pytest
from rich.console import Console
from rich.progress import Progress

from zenostat.bridge.recording.verification import Verification
from zenostat.cli.node import ProgressBar
from zenostat.cli.record import describe_recording
from zenostat.topics.messages import RecordingState, RecordingStatus

STOPPED = RecordingStatus(path="/x/run.mcap", state=RecordingState.STOPPED, reason="No space left on device")


class _Exchange:
    state = None
    episode = step = (0,)

    def awaiting(self) -> list[str]:
        return ["rbc"]


class _Server:
    exchange = _Exchange()
    manifest = type("Manifest", (), {"steps": 96})
    plant_warnings: dict[str, None] = {}  # noqa: RUF012


def test_recording__node_reports_once_that_its_recording_stopped(capsys: pytest.CaptureFixture[str]) -> None:
    server: Any = _Server()
    bar = ProgressBar(Progress(console=Console(file=io.StringIO())), "office")
    bar(server)
    bar.recording = lambda: RecordingStatus(path=STOPPED.path, state=RecordingState.RECORDING)
    bar(server)
    assert not capsys.readouterr().out
    bar.recording = lambda: STOPPED
    bar(server)
    bar(server)
    warning = "warning: office: the recording to /x/run.mcap stopped: No space left on device\n"
    assert capsys.readouterr().out == warning


@pytest.mark.parametrize(
    ("status", "expected"),
    [
        (RecordingStatus(path="/x", state=RecordingState.ENDED), "nothing was recorded to /x"),
        (RecordingStatus(path="/x", state=RecordingState.ENDED, messages=7, bytes=9000), "recorded 7 messages"),
        (STOPPED.model_copy(update={"bytes": 9000}), "stopped early: No space left on device"),
        (STOPPED, "there is no recording at /x/run.mcap: No space left on device"),
    ],
)
def test_recording__ended_recording_is_described(status: RecordingStatus, expected: str) -> None:
    assert expected in describe_recording(status)


def test_verify_text__does_not_call_a_damaged_file_identical() -> None:
    result = Verification(steps=477, episodes=1, points=40, actuators=10)
    assert str(result) == "identical: 477 steps, 40 points, 10 actuators"
    result.is_damaged = True
    assert str(result) == "identical up to the damage: 477 steps, 40 points, 10 actuators"
    assert not result.passed
    result.end = "messages are missing before byte 900; what is before it is read"
    assert str(result).endswith("10 actuators; the recording ends early: " + result.end)
    result.is_complete, result.end = True, "6 bytes after its end at byte 900, not part of it"
    assert str(result) == "identical: 477 steps, 40 points, 10 actuators; the file is damaged: " + result.end
    assert not result.passed


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"end": "cut"}, "identical: the first sample of 2 episodes, after which there is no timestep"),
        ({"end": "cut", "is_damaged": True}, "identical up to the damage: the first sample of 2 episodes, after which"),
        ({"end": "cut", "episodes": 0}, "nothing could be verified"),
        ({"end": "cut", "tolerance": 0.5}, "compared: 0 steps, 4 points, 1 actuator; all are within 0.5"),
    ],
)
def test_recording__end_of_a_file_is_part_of_the_one_sentence_on_it(fields: dict[str, Any], expected: str) -> None:
    text = str(Verification(**({"episodes": 2, "points": 4, "actuators": 1} | fields)))
    assert text.startswith(expected)
    assert text.endswith("; the recording ends early: cut")
