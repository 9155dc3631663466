"""Warnings that arrive before a sample of an engine."""

import struct
import subprocess
import sys
from pathlib import Path

from zenostat.bridge.engine.client import EngineClient
from zenostat.bridge.engine.protocol import FrameKind
from zenostat.bridge.engine.sockets import socket_pairs
from zenostat.bridge.engine.spec import EngineProgram, EngineSpec
from zenostat.topics.errors import SimulatorError


def test_engine_client__number_of_warnings_before_a_sample_is_not_limited(tmp_path: Path) -> None:
    texts = [f"warning {number}" for number in range(2 * sys.getrecursionlimit())]
    frames = [struct.pack("=ddd", FrameKind.WARNING, len(text), 0.0) + text.encode() for text in texts]
    frames.append(struct.pack("=ddd", FrameKind.SAMPLE, 7.0, 21.5))
    program = EngineProgram((), lambda text, _: SimulatorError(text))
    ours, theirs = socket_pairs()
    waiting = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    with waiting, theirs:
        client = EngineClient(
            EngineSpec(program=program, folder=tmp_path / "run", values=1, actuators=0), (ours, waiting)
        )
        try:
            theirs.frames.sendall(b"".join(frames))
            client.receive()
            assert client.warnings == texts
            assert (client.frame.number, struct.unpack("=d", client.frame.values())) == (7, (21.5,))
        finally:
            client.close()
