"""The environments' names in Gymnasium."""

from __future__ import annotations

from gymnasium.envs.registration import EnvSpec, registry

from topics.scenario_ids import bundled_ids, pack_ids

_ENTRY = "agent_sdk.environment_file:make"
_OPEN = ("Building-v1", "Scenario-v1", "Sinergym-v1")


def register() -> None:
    """Registers all scenarios: those of the data packs whether they are there or not, and the bundled ones.

    They go into Gymnasium's registry directly: its `register` looks through all names for each new one, which
    would take a quarter of a second.
    """
    fake = "zenostat/Fake-v1"
    registry[fake] = EnvSpec(fake, entry_point="agent_sdk.testing.environment:FakeEnv")
    for name in _OPEN:
        registry[f"zenostat/{name}"] = EnvSpec(f"zenostat/{name}", entry_point=_ENTRY)
    for name in (*pack_ids(), *bundled_ids()):
        registry[f"zenostat/{name}"] = EnvSpec(f"zenostat/{name}", entry_point=_ENTRY, kwargs={"scenario": name})
