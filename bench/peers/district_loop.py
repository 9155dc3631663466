"""The loop as a district: `python -m bench.peers.district_loop OPTIONS`.

The office is a Python class as a plant. With `law: connection`, the law is the connection from its power to its
setpoint; with `law: plant`, it is a plant of its own, as a federate or simulator is for the other tools. The scheme
`delay` brings the setpoint a step late, `solve` finds the one that belongs to the power of the same step.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import zenostat
from bench.peers import model
from zenostat.bridge.client.local_node import LocalNode
from zenostat.bridge.runtime.affinity import Affinity

FILE = """\
name: loop
duration: {duration}
solver: {{trials: {limit}}}
plants:
  office: {{plant: "bench.peers.district_loop:Office", plant_arguments: {{duration_s: {duration}}}}}
"""
CONNECTION = """\
connections:
  - {{from: office.power, to: office.setpoint, unit: kW, factor: {gain}, offset: {offset}, {scheme}}}
"""
PLANT = """\
  law: {{plant: "bench.peers.district_loop:Law", plant_arguments: {{gain: {gain}, duration_s: {duration}}}}}
connections:
  - {{from: office.power, to: law.power}}
  - {{from: law.setpoint, to: office.setpoint, {scheme}}}
"""


class Office:
    """The office as a plant."""

    step_s, forkable = model.STEP_S, True
    sensors = {"power": ("kW", 0.0, None), "setpoint": ("degC", None, None)}
    actuators = {"setpoint": ("degC", model.LOW_DEGC, model.HIGH_DEGC, model.MIDDLE_DEGC)}

    def __init__(self, duration_s: float) -> None:
        self.duration_s = duration_s

    def reset(self, seed: int) -> dict[str, float]:
        self.number, self.temperature = 0, model.START_DEGC
        return {"power": model.MIDDLE_KW, "setpoint": model.MIDDLE_DEGC}

    def step(self, commands: dict[str, float]) -> dict[str, float]:
        self.number += 1
        power, self.temperature = model.office(self.temperature, self.number, commands["setpoint"])
        return {"power": power, "setpoint": commands["setpoint"]}

    def save(self) -> tuple[int, float]:
        return self.number, self.temperature

    def restore(self, state: tuple[int, float]) -> None:
        self.number, self.temperature = state


class Law:
    """The setpoint's law as a plant."""

    step_s, forkable = model.STEP_S, True
    sensors = {"setpoint": ("degC", None, None)}
    actuators = {"power": ("kW", 0.0, None, model.MIDDLE_KW)}

    def __init__(self, gain: float, duration_s: float) -> None:
        self.gain, self.duration_s = gain, duration_s

    def reset(self, seed: int) -> dict[str, float]:
        return {"setpoint": model.MIDDLE_DEGC}

    def step(self, commands: dict[str, float]) -> dict[str, float]:
        return {"setpoint": model.law(commands["power"], self.gain)}

    def save(self) -> None:
        """Return nothing: there is no state."""

    def restore(self, state: None) -> None:
        """Do nothing."""


def run(options: dict[str, Any]) -> None:
    """Simulate the district, and write what the office did."""
    day, gain, solve = model.Day(), options["gain"], options["scheme"] == "solve"
    fields = {
        "duration": options["steps"] * model.STEP_S, "limit": model.LIMIT, "gain": gain,
        "offset": model.MIDDLE_DEGC - gain * model.MIDDLE_KW,
        "scheme": f"solve: true, tolerance: {model.TOLERANCE_K}" if solve else "delay: 1",
    }  # fmt: skip
    with TemporaryDirectory() as folder:
        file = Path(folder, "loop.yaml")
        file.write_text((FILE + (PLANT if options["law"] == "plant" else CONNECTION)).format(**fields))
        node = LocalNode({"district": str(file)}, Affinity.OFF)
        try:
            with zenostat.connect(node.endpoint, affinity="off") as bus, bus.controller("loop") as link:
                link.reset(seed=0)
                trials = next((name for name in link.manifest.names if name.endswith(".trials")), "")
                for _ in range(options["steps"]):
                    link.send({})
                    sample = link.receive()
                    day.add(sample["office.setpoint"], sample["office.power"])
                    day.evaluations += 1 + int(sample[trials]) if solve else 1
        finally:
            node.close()
    day.write(options["output"])


if __name__ == "__main__":
    run(json.loads(sys.argv[1]))
