"""The environments' names in Gymnasium."""

from __future__ import annotations

from gymnasium.envs.registration import EnvSpec, registry

from topics.scenario_ids import bundled_ids, pack_ids

_ENTRY, _VECTOR = "agent_sdk.make:make", "agent_sdk.envs.vector_env:make"
_FAKE, _FAKE_VECTOR = "agent_sdk.testing.fake_env:FakeEnv", "agent_sdk.testing.fake_vector_env:FakeVectorEnv"
_OPEN = ("Building-v1", "Scenario-v1", "Sinergym-v1")


def register() -> None:
    """Registers all scenarios: those of the data packs whether they are there or not, and the bundled ones.

    They go into Gymnasium's registry directly: its `register` looks through all names for each new one, which
    would take a quarter of a second.
    """
    _put("Fake-v1", _FAKE, _FAKE_VECTOR)
    for name in _OPEN:
        _put(name, _ENTRY, _VECTOR)
    for name in (*pack_ids(), *bundled_ids()):
        _put(name, _ENTRY, _VECTOR, scenario=name)


def _put(name: str, entry: str, vector_entry: str, **given: str) -> None:
    full = f"zenostat/{name}"
    registry[full] = EnvSpec(
        full,
        entry_point=entry,
        vector_entry_point=vector_entry,
        kwargs=given,
        # The environments say by themselves what came in a wrong order, and are tested: no wrapper around each step.
        order_enforce=False,
        disable_env_checker=True,
    )
