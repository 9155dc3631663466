"""Data sets of controllers: what Minari, h5py and a loader of transitions read is what the environment did."""

import hashlib
import tomllib
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from support.run_cli import run_python

import zenostat  # noqa: F401  # registers the environments
from zenostat import wrappers as w
from zenostat.agent_sdk.controllers import Agent, load_controller, make_controller
from zenostat.lab.datasets import datasets_folder, write_dataset
from zenostat.lab.datasets.episode import run_episode
from zenostat.topics.errors import InvalidConfig, UnknownName

minari = pytest.importorskip("minari")
h5py = pytest.importorskip("h5py")

ID = "zenostat/fake/rbc-v0"
FAKE: dict[str, Any] = {"zones": 2, "steps_per_hour": 1}


def fake(**arguments: Any) -> gym.Env[Any, Any]:
    return gym.make("zenostat/Fake-v1", **FAKE, **arguments)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return tmp_path


@pytest.mark.usefixtures("folder")
def test_write_dataset__observations_that_are_no_arrays_are_refused_before_anything_is_simulated() -> None:
    env = fake()
    space = gym.spaces.Dict({"all": env.observation_space})
    named = gym.wrappers.TransformObservation(env, lambda observation: {"all": observation}, space)
    with pytest.raises(
        InvalidConfig, match="a data set has observations that are arrays, not of Dict: leave out the wra"
    ):
        write_dataset(named, ["rbc"], ID)


@pytest.mark.filterwarnings("ignore:Minari will not recover")
def test_write_dataset__term_that_would_be_a_group_is_named(folder: Path) -> None:
    env = fake(reward=lambda values, begin: {"energy": -1.0, "energy/hvac": -0.5})
    with pytest.raises(InvalidConfig, match="reward_terms: 'energy/hvac' has a '/', which names in a data set cannot"):
        write_dataset(env, ["rbc"], ID)
    with pytest.raises(InvalidConfig, match=r"episodes=1.5, .*: expected at least one episode"):
        write_dataset(env, ["rbc"], ID, episodes=1.5)  # type: ignore[arg-type]
    assert not [*folder.iterdir()]


def hashes(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def test_datasets__minari_reads_the_episodes_that_the_controller_makes_in_the_environment(folder: Path) -> None:
    env = fake()
    path = write_dataset(env, ["rbc"], ID, episodes=2, seed=5, author="somebody")
    assert path == folder / ID
    dataset = minari.load_dataset(ID)
    assert (dataset.total_episodes, dataset.total_steps) == (2, 48)
    assert ID in minari.list_local_datasets()
    agent = Agent(load_controller("rbc")(env.unwrapped.manifest))
    for number, episode in enumerate(dataset.iterate_episodes()):
        observation, _ = env.reset(seed=5 + number)
        np.testing.assert_array_equal(episode.observations[0], observation)
        for t in range(24):
            action = agent.action(env.unwrapped.sample)
            observation, reward, terminated, truncated, info = env.step(action)
            np.testing.assert_array_equal(episode.actions[t], action)
            np.testing.assert_array_equal(episode.observations[t + 1], observation)
            assert (episode.rewards[t], episode.terminations[t], episode.truncations[t]) == (
                reward,
                terminated,
                truncated,
            )
            assert episode.infos["time"][t + 1].decode() == info["time"]
            assert episode.infos["step"][t + 1] == info["step"] == t + 1
            for name, value in info["reward_terms"].items():
                assert episode.infos["reward_terms"][name][t + 1] == value
        assert episode.truncations[-1]
        assert not episode.infos["is_random"].any()
        assert all(np.isnan(terms[0]) for terms in episode.infos["reward_terms"].values())
    described = dataset.storage.metadata
    assert described["author"] == {"somebody"}
    assert described["algorithm_name"] == "rbc"
    assert described["zenostat"]["observations"] == list(env.unwrapped.observation_names)
    episodes = list(dataset.storage.get_episode_metadata([0, 1]))
    assert [(about["seed"], about["controller"]) for about in episodes] == [(5, "rbc"), (6, "rbc")]


@pytest.mark.slow
def test_datasets__oracle_plans_in_branches_of_the_environment(folder: Path) -> None:
    arguments = {"begin": "07-03", "end": "07-03", "steps_per_hour": 1, "affinity": "off"}
    with closing(gym.make("zenostat/ref-small-office-USA_CO_Denver-continuous-v1", **arguments)) as env:
        parameters = {"horizon": 1.0, "samples": 4, "iterations": 1}
        write_dataset(env, ["oracle"], "zenostat/office/oracle-v0", parameters=parameters)
    (episode,) = minari.load_dataset("zenostat/office/oracle-v0")
    assert len(episode.rewards) == 24


def test_datasets__reader_without_minari_finds_the_same_arrays(folder: Path) -> None:
    path = write_dataset(fake(), ["random"], ID, seed=1)
    (episode,) = minari.load_dataset(ID).iterate_episodes()
    with h5py.File(path / "data" / "main_data.hdf5") as file:
        group = file["episode_0"]
        assert group["observations"].shape == (25, *episode.observations.shape[1:])
        assert group["actions"].shape == (24, 4)
        assert group["rewards"].shape == group["terminations"].shape == group["truncations"].shape == (24,)
        for name in ("observations", "actions", "rewards", "terminations", "truncations"):
            np.testing.assert_array_equal(group[name][()], getattr(episode, name))
        assert group.attrs["return"] == pytest.approx(episode.rewards.sum())


def test_datasets__loader_of_transitions_gets_the_recovered_environments_own_steps(folder: Path) -> None:
    """Observations without the last, actions, rewards, ends; then the environment."""
    assert folder.is_dir()
    write_dataset(fake(), ["rbc", "random"], ID, episodes=2, seed=3, epsilon=0.3)
    dataset = minari.load_dataset(ID)
    env = dataset.recover_environment()
    assert (env.observation_space, env.action_space) == (dataset.observation_space, dataset.action_space)
    seeds = [about["seed"] for about in dataset.storage.get_episode_metadata(range(4))]
    assert seeds == [3, 4, 5, 6]
    for seed, episode in zip(seeds, dataset.iterate_episodes(), strict=True):
        states, followers = episode.observations[:-1], episode.observations[1:]
        assert len(states) == len(episode.actions) == len(episode.rewards) == len(followers)
        observation, _ = env.reset(seed=seed)
        for state, action, reward, follower in zip(states, episode.actions, episode.rewards, followers, strict=True):
            np.testing.assert_array_equal(observation, state)
            observation, actual, *_ = env.step(action)
            np.testing.assert_array_equal(observation, follower)
            assert actual == reward


def test_datasets__same_call_writes_the_same_bytes(tmp_path: Path) -> None:
    for run in ("one", "other"):
        write_dataset(fake(), ["rbc", "random"], ID, seed=2, epsilon=0.5, folder=tmp_path / run)
    write_dataset(fake(), ["rbc", "random"], ID, seed=3, epsilon=0.5, folder=tmp_path / "third")
    first = hashes(tmp_path / "one")
    assert first == hashes(tmp_path / "other")
    assert f"{ID}/data/main_data.hdf5" in first
    assert first != hashes(tmp_path / "third")


def test_datasets__epsilon_is_the_share_of_random_actions(folder: Path) -> None:
    assert folder.is_dir()
    write_dataset(fake(), ["fixed"], ID, episodes=40, epsilon=0.25)
    episodes = list(minari.load_dataset(ID).iterate_episodes())
    fixed = episodes[0].actions[~episodes[0].infos["is_random"][1:]][0]
    chosen = np.concatenate([episode.actions for episode in episodes])
    is_random = np.concatenate([episode.infos["is_random"][1:] for episode in episodes])
    np.testing.assert_array_equal((chosen != fixed).any(axis=1), is_random)
    # 960 draws of probability 1/4: a mean of 240 with a standard deviation of 13.4.
    assert 180 < is_random.sum() < 300


def test_datasets__random_actions_and_their_moments_are_independent() -> None:
    """Random first actions of 400 episodes fill their range, and say nothing of the next moment."""
    with closing(fake()) as env:
        low, high = env.action_space.low, env.action_space.high
        agent = Agent(make_controller(load_controller("fixed"), env.unwrapped.manifest, {}))
        episodes = [run_episode(env, agent, seed=seed, epsilon=0.4) for seed in range(400)]
    first = [episode for episode in episodes if episode.is_random[0]]
    shares = np.array([(episode.trajectory.actions[0] - low) / (high - low) for episode in first])
    # 160 uniform numbers: a mean of 0.5 with a standard deviation of 0.023, and 0.07 for half of them.
    assert np.abs(shares.mean(axis=0) - 0.5).max() < 0.1
    follows = np.array([episode.is_random[1] for episode in first])
    assert abs(shares[follows].mean() - shares[~follows].mean()) < 0.2


@pytest.mark.slow
def test_datasets__wrappers_within_and_around_the_scenario_are_recovered(folder: Path) -> None:
    file = folder / "mine.yaml"
    file.write_text(
        "building: ref-small-office\nweather: USA_CO_Denver\nbegin: 07-03\nend: 07-03\nsteps_per_hour: 1\n"
        "wrappers: [{wrapper: CyclicTime}]\n"
    )
    building = gym.make("zenostat/Scenario-v1", file=file, affinity="off")
    with_previous = w.PreviousObservation(building, ["core_zn_air_temperature"])
    with closing(gym.wrappers.ClipReward(with_previous, -0.1, 0.0)) as env:
        write_dataset(env, ["rbc"], ID)
        text, space = str(env), env.observation_space
    with closing(minari.load_dataset(ID).recover_environment()) as recovered:
        assert (str(recovered), recovered.observation_space) == (text, space)


@pytest.mark.slow
def test_datasets__scenario_file_is_not_needed_to_recover_the_environment(folder: Path) -> None:
    file = folder / "mine.yaml"
    file.write_text("building: ref-small-office\nweather: USA_CO_Denver\nbegin: 07-03\nend: 07-03\nsteps_per_hour: 1\n")
    with closing(gym.make("zenostat/Building-v1", scenario=file, affinity="off")) as env:
        write_dataset(env, ["rbc"], ID)
        space = env.observation_space
    file.unlink()
    with closing(minari.load_dataset(ID).recover_environment()) as recovered:
        assert recovered.observation_space == space


def test_datasets__discrete_actions_are_integers(folder: Path) -> None:
    assert folder.is_dir()
    env = fake(discrete=6)
    write_dataset(env, ["rbc"], ID)
    (episode,) = minari.load_dataset(ID).iterate_episodes()
    assert episode.actions.dtype == np.int64
    assert all(env.action_space.contains(action) for action in episode.actions)


def test_datasets__wrapped_observations_are_written_as_the_wrappers_give_them(folder: Path) -> None:
    assert folder.is_dir()
    env = gym.wrappers.TransformObservation(fake(), lambda o: o / 2, fake().observation_space)
    with pytest.warns(UserWarning, match="Minari will not recover .*: TransformObservation is code"):
        write_dataset(env, ["rbc"], ID, seed=1)
    (episode,) = minari.load_dataset(ID).iterate_episodes()
    plain, _ = fake().reset(seed=1)
    np.testing.assert_array_equal(episode.observations[0], plain / 2)


class Unrecorded(gym.Wrapper[Any, Any, Any, Any]):
    """A wrapper that does not record its arguments."""


@pytest.mark.usefixtures("folder")
def test_datasets__environment_that_cannot_be_recovered_is_named_with_the_reason() -> None:
    def mine(values: Any, begin: Any) -> dict[str, float]:
        return {"energy": -1.0}

    text = "Minari will not recover .*: reward is code .*; Unrecorded does not record its arguments"
    with pytest.warns(UserWarning, match=text):
        write_dataset(Unrecorded(fake(reward=mine)), ["rbc"], ID)


@pytest.mark.slow
def test_datasets__reward_of_ones_own_beside_a_scenario_file_is_named(folder: Path) -> None:
    file = folder / "mine.yaml"
    file.write_text("building: ref-small-office\nweather: USA_CO_Denver\nbegin: 07-03\nend: 07-03\nsteps_per_hour: 1\n")
    reward = {"reward": lambda values, begin: {"energy": -1.0}}
    text = "Minari will not recover .*: reward is code"
    env = gym.make("zenostat/Scenario-v1", file=file, affinity="off", **reward)
    with closing(env), pytest.warns(UserWarning, match=text):
        write_dataset(env, ["rbc"], ID)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"dataset_id": "rbc"}, r"the id 'rbc': expected NAMESPACE/NAME-vNUMBER"),
        ({"dataset_id": "../rbc-v0"}, r"expected NAMESPACE/NAME-vNUMBER"),
        ({"controllers": ["baseline"]}, r"'baseline' sends no actions"),
        ({"controllers": []}, r"expected a list of names"),
        ({"epsilon": 1.5}, r"epsilon=1.5: expected .* a probability of 0 to 1"),
        ({"episodes": 0}, r"episodes=0.*at least one episode"),
        ({"seed": -1}, r"seed=-1"),
        ({"parameters": {"margn": 1}}, r"'margn'; did you mean 'margin'"),
    ],
)
def test_datasets__errors_name_what_is_wrong_before_the_environment_is_made(
    folder: Path, changes: dict[str, Any], text: str
) -> None:
    arguments = {"controllers": ["rbc"], "dataset_id": ID} | changes
    with pytest.raises(InvalidConfig, match=text):
        write_dataset(lambda: pytest.fail("made"), **arguments)
    assert list(folder.iterdir()) == []


def test_datasets__unknown_controllers_and_existing_data_sets_are_reported(folder: Path) -> None:
    with pytest.raises(UnknownName, match="no controller 'rbx'"):
        write_dataset(fake, ["rbx"], ID)
    write_dataset(fake, ["rbc"], ID)
    before = hashes(folder)
    with pytest.raises(InvalidConfig, match=r"exists already: .*rbc-v0; choose another version"):
        write_dataset(lambda: pytest.fail("made"), ["rbc"], ID)
    assert hashes(folder) == before


def test_datasets__arguments_of_numpy_are_recovered(folder: Path) -> None:
    env = gym.make("zenostat/Fake-v1", **FAKE, discrete=np.int64(3))
    write_dataset(env, ["rbc"], ID)
    with closing(minari.load_dataset(ID).recover_environment()) as recovered:
        assert recovered.action_space == env.action_space
    assert folder.is_dir()


def test_datasets__reward_is_a_number(folder: Path) -> None:
    env = w.RewardVector(fake(), ["energy", "comfort"])
    with pytest.raises(InvalidConfig, match="a data set has a number as reward; leave RewardVector out"):
        write_dataset(env, ["rbc"], ID)
    assert list(folder.iterdir()) == []


def test_datasets__wrappers_that_change_actions_are_refused(folder: Path) -> None:
    assert folder.is_dir()
    env = gym.wrappers.RescaleAction(fake(), np.float32(-1), np.float32(1))
    with pytest.raises(InvalidConfig, match="change the actions from Box"):
        write_dataset(env, ["rbc"], ID)
    with pytest.raises(InvalidConfig, match="is not a zenostat/ environment"):
        write_dataset(gym.make("CartPole-v1"), ["rbc"], ID)


def test_datasets__nothing_is_left_of_a_data_set_that_was_not_completed(folder: Path) -> None:
    def stop(controller: str, episode: int, step: int, steps: int) -> None:
        assert (controller, steps) == ("rbc", 24)
        if episode == 1 and step == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_dataset(fake(), ["rbc"], ID, episodes=2, progress=stop)
    assert list(folder.rglob("*")) == []
    with pytest.raises(KeyboardInterrupt):
        write_dataset(fake(), ["rbc"], ID, episodes=2, progress=stop, folder=folder / "new")
    assert list(folder.rglob("*")) == []


@pytest.mark.filterwarnings("ignore:Minari will not recover")
def test_datasets__environment_that_a_function_makes_is_closed_and_a_given_one_is_not(folder: Path) -> None:
    assert folder.is_dir()
    closed: list[str] = []

    class Watched(gym.Wrapper):  # type: ignore[type-arg]
        def close(self) -> None:
            closed.append("closed")
            super().close()

    write_dataset(Watched(fake()), ["rbc"], ID)
    assert closed == []
    write_dataset(lambda: Watched(fake()), ["rbc"], "zenostat/fake/rbc-v1")
    assert closed == ["closed"]


def test_datasets__jax_is_neither_required_nor_imported(tmp_path: Path) -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    extra = project["optional-dependencies"]["dataset"]
    assert not any("jax" in text or "create" in text for text in extra)
    program = (
        "import sys\nsys.modules['jax'] = None  # an import of it would fail\n"
        "import gymnasium as gym\nimport zenostat\nfrom zenostat.datasets import write_dataset\n"
        f"write_dataset(gym.make('zenostat/Fake-v1'), ['rbc'], {ID!r}, folder={str(tmp_path)!r})\n"
        "import os\n"
        f"os.environ['MINARI_DATASETS_PATH'] = {str(tmp_path)!r}\n"
        f"import minari\nprint(len(minari.load_dataset({ID!r})[0].rewards))\n"
    )
    done = run_python("-c", program, timeout=120)
    assert (done.returncode, done.stdout.strip()) == (0, "96"), done.stderr


def test_datasets__folder_is_minaris_own_unless_one_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("MINARI_DATASETS_PATH", raising=False)
    assert datasets_folder() == Path.home() / ".minari" / "datasets"
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    assert datasets_folder() == minari.storage.get_dataset_path() == tmp_path
    assert datasets_folder(tmp_path / "mine") == tmp_path / "mine"
