"""Functions of this service beyond BOPTEST: snapshots, branches, and the building under the baseline control."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from threading import RLock
from typing import Any
from weakref import WeakSet

from zenostat.gateways.boptest import parsing
from zenostat.gateways.boptest.cases import TestCase
from zenostat.gateways.boptest.episodes import Beginning
from zenostat.gateways.boptest.kpis import TestKpis
from zenostat.gateways.boptest.parsing import BadRequest
from zenostat.gateways.boptest.prices import Rates
from zenostat.gateways.boptest.session import Answer, BuildingTest
from zenostat.gateways.boptest.simulation import Interruption, Simulation
from zenostat.metrics.trajectory_recorder import TrajectoryRecorder
from zenostat.topics.errors import did_you_mean


@dataclass(frozen=True, slots=True, eq=False)
class _Saved:
    """The state of a test at a snapshot."""

    name: str
    beginning: Beginning
    recorder: TrajectoryRecorder
    first_row: int
    end_s: float
    is_over: bool
    step_s: float
    scenario: dict[str, Any]


class ExtendedTest(BuildingTest):
    """A test with snapshots, branches and the baseline's values; see `BuildingTest`."""

    def __init__(
        self,
        case: TestCase,
        rates: Rates,
        days: Callable[[], Mapping[str, int]],
        interruption: Interruption | None = None,
        client: str = "",
    ) -> None:
        self._saved: dict[str, _Saved] = {}
        self._branches: WeakSet[ExtendedTest] = WeakSet()
        super().__init__(case, rates, days, interruption, client)

    def _beginnings_in_use(self) -> list[Beginning]:
        """Return the beginning of each snapshot and branch."""
        branches = [branch.beginning for branch in self._branches if not branch.is_stopped]
        return [*branches, *(saved.beginning for saved in self._saved.values())]

    def _check_room(self) -> None:
        if not self.episodes.has_room([*self._beginnings_in_use(), self.beginning]):
            raise BadRequest(
                "The building has as many snapshots and branches as it can have beside its beginnings and baselines; "
                "drop some with DELETE /snapshot, or stop branches."
            )

    def take_snapshot(self) -> Answer:
        """Take a snapshot of the test."""
        self._check_no_branch("have snapshots; take them of the test that it came from")
        self._check_room()
        name = self.simulation.snapshot()
        self._saved[name] = _Saved(
            name, self.beginning, self.recorder.copy(), self.first_row, self.end_s, self.is_over, self.step_s,
            dict(self.scenario),
        )  # fmt: skip
        return "Snapshot taken successfully.", {"snapshot": name, "time": self.time_s}

    def restore(self, fields: Mapping[str, Any]) -> Answer:
        """Return to a snapshot; it can be used again."""
        saved = self._find(fields)
        self.simulation.reset(saved.name)
        self.beginning, self.recorder = saved.beginning, saved.recorder.copy()
        self.first_row, self.end_s, self.is_over = saved.first_row, saved.end_s, saved.is_over
        self.step_s, self.scenario = saved.step_s, dict(saved.scenario)
        self._restart_figures()
        return f"Test returned to the snapshot at {float(self.time_s)}s.", self.state()

    def drop_snapshot(self, fields: Mapping[str, Any]) -> Answer:
        """Drop a snapshot, which frees its memory."""
        saved = self._find(fields)
        del self._saved[saved.name]
        self.simulation.bus.drop(self.simulation.node, saved.name)
        return "Snapshot dropped successfully.", {"snapshot": saved.name}

    def _find(self, fields: Mapping[str, Any]) -> _Saved:
        # Snapshots end with the node, which another beginning of a test may have replaced.
        self._saved = {name: saved for name, saved in self._saved.items() if self.episodes.keeps(saved.beginning)}
        name = parsing.require(fields, "snapshot")
        if not isinstance(name, str) or name not in self._saved:
            raise BadRequest(f"No snapshot {str(name)[:80]!r}; {did_you_mean(str(name)[:80], self._saved)}")
        return self._saved[name]

    def branch(self, fields: Mapping[str, Any]) -> ExtendedTest:
        """Return another test that continues independently from here; it ends with this one's node at the latest."""
        self._check_no_branch("be branched; branch the test that it came from")
        self._check_room()
        relinquished = fields.get("baseline")
        is_relinquished = relinquished is not None and parsing.switch(relinquished, "baseline")
        branch = copy(self)
        branch.continue_on(self.simulation.branch(relinquished=is_relinquished))
        self._branches.add(branch)
        return branch

    def continue_on(self, simulation: Simulation) -> None:
        """Continue on a branch, independently of the test of which this is a copy."""
        self._branch, self.lock = simulation, RLock()
        self._saved, self._branches = {}, WeakSet()
        self.recorder, self.scenario = self.recorder.copy(), dict(self.scenario)
        self._restart_figures()

    def baseline(self) -> Answer:
        """Return measurements and KPIs of the building under the baseline control, at the test's time."""
        baseline = self.beginning.baseline
        row = baseline.reach(len(self.recorder) - 1 - self.first_row)
        values = self.table.si_values(baseline.trajectory.fault_free_values[row]).tolist()
        inputs = self.table.si_inputs(baseline.trajectory.effective[row]).tolist()
        return "Queried the baseline successfully.", {
            "time": self.time_s,
            "measurements": dict(zip(self.table.measured, values, strict=True)),
            "inputs": dict(zip(self.table.commanded, inputs, strict=True)),
            "kpi": self.baseline_kpis(row),
        }

    def baseline_kpis(self, row: int) -> dict[str, float | None]:
        """Return the KPIs of the baseline from the test's beginning to a row that it has reached."""
        baseline, price = self.beginning.baseline, self.scenario["electricity_price"]
        comfort = self.episodes.schedules.comfort(baseline)
        kpis = TestKpis(self.simulation.manifest, comfort, self._rates, price, 0)
        return kpis.read(baseline.trajectory, row + 1)
