"""The settings of a node that do not depend on its plant."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from zenostat.bridge.engine.registry import UNRESPONSIVE_S
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.bridge.transport.session import DEFAULT_ENDPOINT
from zenostat.topics.messages import Mode, OnFull, Policy, Task


class NodeSettings(BaseModel):
    """The settings of a node.

    Attributes:
        check: only check the settings; start nothing.
        alarms: a file with alarm rules.
        faults: a file with a fault plan.
        listen: endpoints; empty for a node that only connects to a router or another node.
        keys: a folder created by `zenostat keys init`; `certificate` names another certificate than `node`.
        environment_reward: the reward that the environment pays in place of the scenario's, for the manifest; None:
            it pays none.
        monitoring: also measure what pictures and reports need; a Python plant measures all its points anyway.
        resume: a recording with which the node goes on, and to which it goes on recording.
        systems: also measure what a schematic of the loops shows; only of EnergyPlus.
        record: a file (`.mcap`) or a folder for recordings; `record_on_full` and `record_overwrite` are options of it.
        history_mb: memory for the history of the present episode, in MB; 0 keeps none.
        unresponsive_s: time after which an engine that neither answers nor uses processor time is killed.
        folder: for temporary files; None uses the system's.
        cpu: the core of the node, and `engine_cpu` that of its engine; None lets `affinity` choose.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    check: bool = False
    name: str = "building"
    mode: Mode = Mode.LOCKSTEP
    speed: Annotated[float, Field(ge=1e-6, le=1e9)] = 1.0
    policy: Policy = Policy.WAIT
    grace_s: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    deadline_s: Annotated[float, Field(gt=0, le=1e9)] | None = None
    faults: Path | None = None
    alarms: Path | None = None
    listen: list[str] = Field(default_factory=lambda: [DEFAULT_ENDPOINT])
    connect: list[str] = Field(default_factory=list)
    expose: bool = False
    keys: Path | None = None
    certificate: str | None = None
    slots: Annotated[int, Field(ge=1, le=256)] = 1
    baseline: bool = False
    environment_reward: dict[str, Any] | Literal["scenario"] | None = "scenario"
    monitoring: bool = False
    systems: bool = False
    branches: Annotated[int, Field(ge=0, le=4096)] = 256
    resume: Path | None = None
    record: Path | None = None
    record_on_full: OnFull = OnFull.WAIT
    record_overwrite: bool = False
    history_mb: Annotated[float, Field(ge=0, le=4096)] = 16.0
    unresponsive_s: Annotated[float, Field(gt=0, le=1e9)] = UNRESPONSIVE_S
    folder: Path | None = None
    affinity: Affinity = Affinity.SEPARATE_CORES
    cpu: int | None = None
    engine_cpu: int | None = None

    @model_validator(mode="after")
    def _has_a_bus(self) -> Self:
        if not self.listen and not self.connect:
            raise ValueError("name an endpoint to listen on, or one to connect to")
        if self.resume is not None and self.record is not None:
            raise ValueError("a node that goes on with a recording goes on recording to it; leave record out")
        return self

    def task(self, described: Task) -> Task:
        """Return the task of the plant's description with the reward that the environment pays."""
        reward = self.environment_reward
        return described if isinstance(reward, str) else described.with_reward(reward)
