"""A district on the bus as a Gymnasium environment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from zenostat.agent_sdk.envs import arguments
from zenostat.agent_sdk.envs.building_env import BuildingEnv
from zenostat.agent_sdk.envs.connection import Link
from zenostat.agent_sdk.rewards import AnyReward
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.topics.errors import InvalidConfig

NAME = "district"

RENDER_MODES = ("rerun",)


class DistrictEnv(BuildingEnv):
    """A district with one agent; `gym.make("zenostat/District-v1", file="district.yaml")`.

    Without `connect` it starts the district and all of its plants, and ends them on `close()`. It is a `BuildingEnv`,
    with the same spaces, infos, snapshots and branches: the observation has the time features of the first plant, then
    the observed points of all plants, and the action has those of all plants that no connection feeds.

    Args:
        file: Of the district (YAML); see docs/districts.md.
        reward: As for `BuildingEnv`; left out, the reward of the file.
        connect, node, priority, keys, link: As for `BuildingEnv`.
        affinity: As for `BuildingEnv`; the plants of a district are placed by the system.
        render_mode: `rerun` opens a live view.
        faults, alarms, record, record_on_full, branches: As for `BuildingEnv`, of the district's node.

    Raises:
        UsageError, BusError, SimulatorError: See `zenostat.topics.errors`; everything that was started is closed again.

    Warns:
        UserWarning: A plant or a connection may be wrong, or the district has no reward.
    """

    metadata = {"render_modes": [*RENDER_MODES], "render_fps": 4}  # noqa: RUF012  # Gymnasium's own form

    def __init__(
        self,
        file: str | Path | None = None,
        *,
        reward: AnyReward | None = arguments.FROM_SCENARIO,
        connect: str | None = None,
        node: str | None = None,
        priority: int = 10,
        affinity: Affinity | str = Affinity.OFF,
        render_mode: str | None = None,
        keys: str | Path | None = None,
        link: Link | None = None,
        faults: str | Path | None = None,
        alarms: str | Path | None = None,
        record: str | Path | None = None,
        record_on_full: str | None = None,
        branches: int | None = None,
    ) -> None:
        if file is None and connect is None and link is None:
            raise InvalidConfig(
                "name the file of a district, file='district.yaml', or the bus (connect=) and node of a running one"
            )
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise InvalidConfig(f"render_mode {render_mode!r}; a district has: {', '.join(RENDER_MODES)}")
        settings: dict[str, Any] = {"district": file, "faults": faults, "alarms": alarms, "record": record}
        settings |= {"record_on_full": record_on_full, "branches": branches}
        name = NAME if node is None and connect is None else node
        self._connect(
            settings, reward=reward, connect=connect, node=name, priority=priority, affinity=affinity,
            render_mode=render_mode, keys=keys, link=link,
        )  # fmt: skip
