"""The loop as a mosaik scenario of two simulators: `python -m bench.peers.mosaik_loop OPTIONS`.

With the scheme `delay`, the law's setpoint goes to the next step of the office by a time-shifted connection. With
`iterate`, it goes to the same step by a weak connection, a same-time loop: it triggers the office once more, which
triggers the law. The law has no output once its setpoint is within the tolerance, which ends the loop. With
`place: apart`, the law is a program of its own, which mosaik starts.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import mosaik
import mosaik_api_v3

from bench.peers import model


class Office(mosaik_api_v3.Simulator):
    """The office; a step at the same time is the same step once more."""

    def __init__(self) -> None:
        super().__init__({"models": {"Office": {"public": True, "params": [], "attrs": ["power", "setpoint"]}}})
        self.day, self.setpoint, self.now, self.next = model.Day(), model.MIDDLE_DEGC, -1, model.START_DEGC

    def init(self, sid: str, time_resolution: float = 1.0, *, scheme: str = "", output: str = "") -> Any:
        self.output = output
        self.meta["type"] = "hybrid" if scheme == "iterate" else "time-based"
        if scheme == "iterate":
            self.meta["models"]["Office"] |= {"trigger": ["setpoint"], "non-persistent": ["power"]}
        return self.meta

    def create(self, num: int, model: str, **_: Any) -> list[dict[str, Any]]:
        return [{"eid": "office", "type": model}]

    def step(self, time: int, inputs: Any, max_advance: int) -> int:
        if time != self.now:
            self.take()
            self.now, self.temperature = time, self.next
        for value in inputs.get("office", {}).get("setpoint", {}).values():
            self.setpoint = value
        self.power, self.next = model.office(self.temperature, time + 1, self.setpoint)
        self.day.evaluations += 1
        return time + 1

    def get_data(self, outputs: Any) -> Any:
        return {"office": {"power": self.power}, "time": self.now}

    def take(self) -> None:
        """Take the step as it was computed last."""
        if self.now >= 0:
            self.day.add(self.setpoint, self.power)

    def finalize(self) -> None:
        self.take()
        self.day.write(self.output)


class Law(mosaik_api_v3.Simulator):
    """The setpoint's law."""

    def __init__(self) -> None:
        super().__init__({"models": {"Law": {"public": True, "params": [], "attrs": ["power", "setpoint"]}}})
        self.setpoint, self.now, self.count = model.MIDDLE_DEGC, -1, 0

    def init(self, sid: str, time_resolution: float = 1.0, *, gain: float = 0.0, damping: float = 0.0) -> Any:
        self.meta["type"] = "event-based" if damping else "time-based"
        self.gain, self.damping = gain, damping
        return self.meta

    def create(self, num: int, model: str, **_: Any) -> list[dict[str, Any]]:
        return [{"eid": "law", "type": model}]

    def step(self, time: int, inputs: Any, max_advance: int) -> int | None:
        (power,) = inputs["law"]["power"].values()
        self.count = self.count + 1 if time == self.now else 1
        self.now, change = time, model.law(power, self.gain) - self.setpoint
        self.is_open = abs(change) > model.TOLERANCE_K and self.count < model.LIMIT
        if not self.damping:
            self.setpoint += change
            return time + 1
        self.setpoint += self.damping * change if self.is_open else 0.0
        return None

    def get_data(self, outputs: Any) -> Any:
        if self.damping and not self.is_open:
            return {}
        return {"law": {"setpoint": self.setpoint}, "time": self.now}


def run(options: dict[str, Any]) -> None:
    """Simulate the scenario, and write what the office did."""
    is_iterated = options["scheme"] == "iterate"
    law = {"python": "bench.peers.mosaik_loop:Law"}
    if options["place"] == "apart":
        law = {"cmd": f"{sys.executable} -m bench.peers.mosaik_loop %(addr)s"}
    simulators = {"Office": {"python": "bench.peers.mosaik_loop:Office"}, "Law": law}
    world = mosaik.World(simulators, max_loop_iterations=4 * model.LIMIT, skip_greetings=True)
    damping = options["damping"] if is_iterated else 0.0
    with world.group():
        a = world.start("Office", scheme=options["scheme"], output=options["output"]).Office()
        b = world.start("Law", gain=options["gain"], damping=damping).Law()
    world.connect(a, b, "power")
    if is_iterated:
        world.connect(b, a, "setpoint", weak=True)
    else:
        world.connect(b, a, "setpoint", time_shifted=True, initial_data={"setpoint": model.MIDDLE_DEGC})
    world.run(until=options["steps"], print_progress=False)


if __name__ == "__main__":
    if sys.argv[1].startswith("{"):
        run(json.loads(sys.argv[1]))
    else:
        mosaik_api_v3.start_simulation(Law())
