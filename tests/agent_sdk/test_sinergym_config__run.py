"""A Sinergym configuration in a real run: what it says is applied, and arguments replace what cannot be read."""

from pathlib import Path

import gymnasium as gym
import pytest
import yaml
from support.data_packs import sinergym

import zenostat  # noqa: F401  # registers the environments
from zenostat.topics.errors import InvalidConfig

DAY = {"begin": "07-03", "end": "07-03", "affinity": "off"}
OCCUPANCY = {
    "OCCUPY-1": {"variable_name": "people", "element_type": "Schedule:Compact", "value_type": "Schedule Value"}
}


def of_the_five_zones(folder: Path, **changed: object) -> Path:
    """The pack's configuration of the five-zone building with some settings changed."""
    own = sinergym() / "sinergym" / "data" / "default_configuration" / "5ZoneAutoDXVAV.yaml"
    path = folder / "own.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(own.read_text()) | {"id_base": "own"} | changed, sort_keys=False))
    return path


@pytest.mark.slow
def test_sinergym_config__initial_context_rules_from_the_first_timestep(scratch: Path) -> None:
    path = of_the_five_zones(scratch, context=OCCUPANCY, initial_context=[0.25])
    with gym.make("zenostat/Sinergym-v1", config=path, variant="hot-continuous", **DAY) as env:
        names = [actuator.name for actuator in env.unwrapped.manifest.actuators]
        for _ in range(2):  # in each episode
            env.reset(seed=1)
            for _ in range(3):
                info = env.step(env.action_space.sample())[4]
                assert info["effective"][names.index("people")] == 0.25


@pytest.mark.slow
def test_sinergym_config__arguments_replace_a_reward_and_choices_in_code(scratch: Path) -> None:
    path = of_the_five_zones(scratch, reward="mymod:MyReward", action_space_discrete="Discrete(7)")
    with pytest.raises(InvalidConfig, match="reward: unknown reward 'mymod:MyReward'"):
        gym.make("zenostat/Sinergym-v1", config=path, variant="hot-discrete", discrete=5, **DAY)
    with pytest.raises(InvalidConfig, match="is defined in code"):
        gym.make("zenostat/Sinergym-v1", config=path, variant="hot-discrete", reward=None, **DAY)
    with gym.make(
        "zenostat/Sinergym-v1",
        config=path,
        variant="hot-discrete",
        reward=lambda values, _: {"power": -values["HVAC_electricity_demand_rate"]},
        discrete=5,
        **DAY,
    ) as env:
        assert env.action_space == gym.spaces.MultiDiscrete([5, 5])
        env.reset(seed=1)
        observation, reward, _, _, _ = env.step(env.action_space.sample())
        power = env.unwrapped.observation_dict(observation)["HVAC_electricity_demand_rate"]
        assert reward == pytest.approx(-power)


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "kept"), [({}, 4), ({"keep_last": 1}, 2)])
def test_sinergym_config__files_of_the_last_episodes_are_kept(
    arguments: dict[str, int], kept: int, scratch: Path
) -> None:
    """The configuration (`max_ep_store: 3`) or the argument gives their number, beside the running episode's."""
    path = of_the_five_zones(scratch)
    with gym.make("zenostat/Sinergym-v1", config=path, output_dir=scratch / "runs", **arguments, **DAY) as env:
        for _ in range(6):
            env.reset()
            env.step(env.action_space.sample())
    left = sorted(folder.name for folder in (scratch / "runs").iterdir())
    assert left == [f"episode-{number:04}" for number in range(7 - kept, 7)]
