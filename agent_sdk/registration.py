"""Register the environments in Gymnasium."""

from __future__ import annotations

from gymnasium.envs.registration import EnvSpec, registry

from zenostat.topics.scenario_ids import all_ids

_ENTRY, _VECTOR = "zenostat.agent_sdk.env_factory:make", "zenostat.agent_sdk.env_factory:make_vec"
_FAKE, _FAKE_VECTOR = (
    "zenostat.agent_sdk.testing.fake_env:FakeEnv",
    "zenostat.agent_sdk.testing.fake_vector_env:FakeVectorEnv",
)
_GENERAL = ("Building-v1", "Scenario-v1", "Sinergym-v1", "Plant-v1")


def register() -> None:
    """Register all scenarios: the bundled ones and those of the data packs, whether these are installed or not.

    They are put into Gymnasium's registry directly, because its `register` searches all names for each new one, which
    takes a quarter of a second.
    """
    _add("Fake-v1", _FAKE, _FAKE_VECTOR)
    for name in _GENERAL:
        _add(name, _ENTRY, _VECTOR)
    _add("District-v1", "zenostat.agent_sdk.env_factory:make_district")
    for name in all_ids():
        _add(name, _ENTRY, _VECTOR, scenario=name)


def _add(name: str, entry: str, vector_entry: str | None = None, **arguments: str) -> None:
    env_id = f"zenostat/{name}"
    registry[env_id] = EnvSpec(
        env_id,
        entry_point=entry,
        vector_entry_point=vector_entry,
        kwargs=arguments,
        # The environments check the order of calls themselves and are tested: no wrappers around each step.
        order_enforce=False,
        disable_env_checker=True,
    )
