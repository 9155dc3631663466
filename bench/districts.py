"""The cost of a district of 1 to 32 buildings: processor time of its parts for each step.

A district of N small offices and a hub that adds their electricity is simulated for some steps. Processor time does not
depend on what else runs on the machine, so it is what is measured: of the orchestrator, of the buildings' nodes, and of
their engines. Wall time is given beside it.

    python -m bench.districts --buildings 1 2 4 8 16 32 --plot docs/images/perf-district.png
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import psutil

import zenostat
from zenostat.bridge.client.local_node import LocalNode
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.bridge.runtime.processor_time import tree_processor_s

HUB = '''
class Hub:
    """Adds what its inputs are."""

    step_s, duration_s, forkable = 900.0, 86400.0, True
    sensors = {"total": ("W", 0.0, None)}

    def __init__(self, count):
        self.actuators = {f"u{n}": ("W", 0.0, 1e7, 0.0) for n in range(count)}

    def reset(self, seed):
        return {"total": 0.0}

    def step(self, commands):
        return {"total": sum(commands.values())}

    def save(self):
        return None

    def restore(self, state):
        pass
'''


@dataclass(frozen=True)
class Cost:
    """Costs of a step of a district.

    Attributes:
        buildings: number of them.
        start_s: wall time until the district was ready.
        wall_ms: of a step.
        orchestrator_ms, nodes_ms, engines_ms: processor time of a step, of all buildings together.
        memory_mb: of all processes, without what they share.
        trial_ms, least_trial_ms: wall time of a trial of the whole district: median, and the least one.
        trial_processor_ms: mean processor time of a trial, of all processes together.
    """

    buildings: int
    start_s: float
    wall_ms: float
    orchestrator_ms: float
    nodes_ms: float
    engines_ms: float
    memory_mb: float
    trial_ms: float
    least_trial_ms: float
    trial_processor_ms: float


def write_district(folder: Path, buildings: int) -> Path:
    """Write a district of so many small offices and a hub."""
    (folder / "hub.py").write_text(HUB)
    lines = ["name: district", "timestep: 15min", "start: 07-03", "duration: 1d", "plants:"]
    lines.append(f'  hub: {{plant: "hub.py:Hub", plant_arguments: {{count: {buildings}}}}}')
    lines += [
        f"  b{n}: {{building: ref-small-office, weather: USA_CO_Denver, steps_per_hour: 4}}" for n in range(buildings)
    ]
    lines.append("connections:")
    lines += [f"  - {{from: b{n}.electricity_facility, to: hub.u{n}, name: b{n}}}" for n in range(buildings)]
    (folder / "district.yaml").write_text("\n".join(lines) + "\n")
    return folder / "district.yaml"


def _processor_s(root: psutil.Process) -> tuple[dict[str, float], float]:
    """Return the processor time of the orchestrator, of the nodes and of the engines so far; and their memory in MB."""
    times, memory = {"orchestrator": 0.0, "nodes": 0.0, "engines": 0.0}, 0.0
    for process in (root, *root.children(recursive=True)):
        kind = "orchestrator" if process.pid == root.pid else "engines"
        if kind == "engines" and any("zenostat.eplus_node" in w or "python_plant" in w for w in process.cmdline()):
            kind = "nodes" if process.ppid() == root.pid else "engines"
        used = process.cpu_times()
        times[kind] += used.user + used.system
        memory += process.memory_full_info().uss / 1e6
    return times, memory


def measure(buildings: int, steps: int, trials: int) -> Cost:
    """Simulate some steps of a district, and return their mean costs."""
    with TemporaryDirectory() as folder:
        file = write_district(Path(folder), buildings)
        begin_s = time.monotonic()
        node = LocalNode({"district": str(file), "name": "district"}, Affinity.OFF)
        try:
            with zenostat.connect(node.endpoint, affinity="off") as bus, bus.controller("district") as link:
                link.reset(seed=1)
                start_s = time.monotonic() - begin_s
                for _ in range(4):
                    link.send({})
                    link.receive()
                root = psutil.Process(node.pid)
                before, _ = _processor_s(root)
                begin_s = time.monotonic()
                for _ in range(steps):
                    link.send({})
                    link.receive()
                wall_s = time.monotonic() - begin_s
                after, memory = _processor_s(root)
                _trial_s(link)  # the first one starts what the later ones use again
                begin_s = tree_processor_s(root)
                trials_s = [_trial_s(link) for _ in range(trials)]
                trial_processor_s = (tree_processor_s(root) - begin_s) / trials
        finally:
            node.close()
    ms = {name: 1e3 * (after[name] - before[name]) / steps for name in after}
    return Cost(
        buildings, start_s, 1e3 * wall_s / steps, ms["orchestrator"], ms["nodes"], ms["engines"], memory,
        1e3 * median(trials_s), 1e3 * min(trials_s), 1e3 * trial_processor_s,
    )  # fmt: skip


def _trial_s(link: zenostat.ControllerLink) -> float:
    """Try a step in which nothing is commanded, and return how long it took."""
    begin_s = time.monotonic()
    link.try_step([{}])
    return time.monotonic() - begin_s


def draw(costs: Sequence[Cost], path: Path) -> None:
    """Draw the processor time of a step over the number of buildings."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.8), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    x = [cost.buildings for cost in costs]
    for name, label in (("engines_ms", "EnergyPlus"), ("nodes_ms", "nodes"), ("orchestrator_ms", "orchestrator")):
        axes.plot(x, [getattr(cost, name) for cost in costs], marker="o", label=label)
    axes.set(xscale="log", yscale="log", xlabel="buildings", ylabel="processor time of a step, ms")
    axes.set_xticks(x, [str(n) for n in x])
    axes.minorticks_off()
    axes.grid(color="#e6eaee")
    axes.legend(frameon=False)
    figure.savefig(path)


def main() -> None:
    """Measure, print a table, and write JSON and a picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--buildings", type=int, nargs="+", default=[1, 2, 4, 8, 16, 32])
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--trials", type=int, default=20, help="trials of a step of the whole district")
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    costs = []
    for buildings in options.buildings:
        cost = measure(buildings, options.steps, options.trials)
        costs.append(cost)
        total = cost.orchestrator_ms + cost.nodes_ms + cost.engines_ms
        print(
            f"{buildings:3d} buildings: start {cost.start_s:6.1f} s, step {cost.wall_ms:7.1f} ms wall; processor time "
            f"{cost.engines_ms:7.1f} engines, {cost.nodes_ms:6.1f} nodes, {cost.orchestrator_ms:6.1f} orchestrator "
            f"({100 * cost.orchestrator_ms / total:.1f} %); {cost.memory_mb:6.0f} MB; "
            f"a trial {cost.trial_ms:.0f} ms, at least {cost.least_trial_ms:.0f}, "
            f"{cost.trial_processor_ms:.0f} of processor time",
            flush=True,
        )
    if options.json:
        options.json.write_text(json.dumps([asdict(cost) for cost in costs], indent=1) + "\n")
    if options.plot:
        draw(costs, options.plot)


if __name__ == "__main__":
    main()
