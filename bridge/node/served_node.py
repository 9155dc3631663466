"""Interface of a node server to its parts: they read its state, and change it only through its methods."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from zenostat.bridge.alarms.monitor import AlarmMonitor
from zenostat.bridge.exchange.step_exchange import StepExchange
from zenostat.bridge.node.fault_injection import FaultInjection
from zenostat.bridge.node.history import History
from zenostat.bridge.node.plant import RunningPlant
from zenostat.bridge.node.publications import Publications
from zenostat.bridge.node.sample_encoding import SampleEncoder
from zenostat.bridge.node.subscriptions import Subscriptions
from zenostat.bridge.runtime.timer import Timer
from zenostat.topics.fault_plan import FaultPlan
from zenostat.topics.messages import Event, Manifest, Mode, Statistics


class PaceStatus(Protocol):
    """Pace of a node server; see `Pacing`."""

    @property
    def paused(self) -> bool:
        """Whether it is paused."""

    @property
    def unfinished_steps(self) -> int:
        """Timesteps that are not simulated yet."""

    @property
    def speed(self) -> float:
        """Simulated time per wall-clock time."""

    def wait(self, now_s: float) -> None:
        """Set the deadline of the present sample."""


class ServedNode(Protocol):
    """A node server as its parts see it; see `NodeServer`."""

    on_stop: Callable[[], None]
    stopped_by: str

    @property
    def plant(self) -> RunningPlant:
        """Plant that it simulates."""

    @property
    def exchange(self) -> StepExchange:
        """Rules of the step."""

    @property
    def manifest(self) -> Manifest:
        """The published description."""

    @property
    def pacing(self) -> PaceStatus:
        """Pacing of its timesteps."""

    @property
    def subscriptions(self) -> Subscriptions:
        """Its queryables, and the queue of its thread."""

    @property
    def publications(self) -> Publications:
        """Its publishers."""

    @property
    def timer(self) -> Timer:
        """Calls at a time of the wall clock."""

    @property
    def injection(self) -> FaultInjection | None:
        """Injected faults; None without any."""

    @property
    def history(self) -> History | None:
        """Published samples; None for a branch."""

    @property
    def alarms(self) -> AlarmMonitor | None:
        """Its alarms; None without any."""

    @property
    def samples(self) -> SampleEncoder:
        """Encodes samples."""

    @property
    def latest_sample(self) -> bytes:
        """The encoded latest sample."""

    @property
    def failure(self) -> str:
        """Why the episode failed; "" if it did not."""

    @property
    def failure_error(self) -> str:
        """Name of the error's class."""

    @property
    def waiting(self) -> str:
        """Why the running timestep waits for others; empty if it does not."""

    @property
    def elapsed_s(self) -> float:
        """Simulated time since all slots began."""

    def set_mode(self, mode: Mode, speed: float) -> None:
        """Change when timesteps begin."""

    def step(self) -> None:
        """Simulate a timestep and publish the sample."""

    def finish_steps(self, commands: bytes) -> None:
        """Publish the present sample after several timesteps, of which these were the last commands."""

    def event(self, event: Event) -> None:
        """Publish an event."""

    def publish_events(self, events: list[Event]) -> None:
        """Publish several events."""

    def fail(self, error: Exception) -> None:
        """End the episode."""

    def receive_commands(self) -> None:
        """Receive the commands that have arrived, before the tasks that are pending."""

    def deliver(self, controller: str, receive: Callable[[], None]) -> bool:
        """Receive a command as injected faults of the link allow."""

    def inject(self, faults: FaultPlan, previous: FaultInjection | None = None) -> None:
        """Inject these faults in place of the present ones; those equal to one of `previous` keep their state."""

    def check_slot(self, slot: int) -> None:
        """Raise `RequestRejected` if there is no such slot."""

    def stop_serving(self) -> None:
        """End the loop of the server."""

    def statistics(self) -> Statistics:
        """Return durations of steps, overruns and message counts."""
