"""Exported policies: NumPy gives the actions of stable-baselines3, and a file from a stranger is data."""

from __future__ import annotations

import dataclasses
import io
import json
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zenostat.agent_sdk.controllers import Agent, load_controller, make_controller
from zenostat.agent_sdk.controllers.network_policy import NetworkPolicy, load_network
from zenostat.agent_sdk.testing import FakeEnv
from zenostat.topics.errors import InvalidConfig, UnknownName

pytest.importorskip("stable_baselines3")

from zenostat.lab.evaluate import run_episode
from zenostat.lab.training import export_policy, load_policy, read_training, train

DAY: dict[str, Any] = {"zones": 2, "begin": "07-03", "end": "07-03", "steps_per_hour": 1}
OFF_POLICY = {"learning_starts": 24, "batch_size": 16, "buffer_size": 150, "policy_kwargs": {"net_arch": [8, 8]}}
PARAMETERS: dict[str, dict[str, Any]] = {
    "ppo": {"n_steps": 24, "batch_size": 24, "n_epochs": 2, "policy_kwargs": {"net_arch": [8, 8]}},
    "sac": OFF_POLICY,
    "a2c": {"n_steps": 24, "use_sde": True, "policy_kwargs": {"net_arch": [8, 8]}},
}


def trained(name: str, folder: Path, **changes: Any) -> Path:
    fields: dict[str, Any] = {
        "algorithm": name, "scenario": "Fake-v1", "arguments": DAY, "steps": 72, "threads": 1,
        "wrappers": [{"wrapper": "PreviousObservation", "names": ["zone_1_air_temperature"]}],
        "parameters": PARAMETERS.get(name), "evaluation": False, "output": str(folder),
    }  # fmt: skip
    train(read_training(fields | changes))
    return folder


def rewritten(path: Path, change: Callable[[str, bytes], bytes]) -> Path:
    """Write the members of an archive anew, each as `change` returns it for its name and content."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, change(name, content))
    return path


def with_shape(shape: tuple[int, ...]) -> bytes:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": shape})
    return header.getvalue() + bytes(100)


def test_network_policy__nothing_is_allocated_for_values_that_are_not_there(tmp_path: Path) -> None:
    small().save(path := tmp_path / "policy.npz")
    rewritten(path, lambda name, content: with_shape((10**13, 3)) if name == "weight_0.npy" else content)
    with pytest.raises(InvalidConfig, match=r"100 bytes of values; 120,000,000,000,000 expected"):
        load_network(path)


def test_network_policy__changed_byte_is_read_as_it_was_or_named(tmp_path: Path) -> None:
    """Nothing of zipfile, zlib or NumPy escapes, and no other weights are read."""
    small().save(path := tmp_path / "policy.npz")
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    for _ in range(500):
        changed = bytearray(whole)
        changed[rng.integers(len(whole))] = rng.integers(256)
        path.write_bytes(changed)
        try:
            policy = load_network(path)
        except InvalidConfig:
            continue
        assert policy.digest() == small().digest()


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("name", sorted(PARAMETERS, reverse=True))
def test_network_policy__acts_as_the_model_of_stable_baselines3(name: str, tmp_path: Path) -> None:
    folder = trained(name, tmp_path / "training")
    export_policy(folder, {"made": "here"}).save(tmp_path / "policy.npz")
    assert load_network(tmp_path / "policy.npz").record == {"made": "here"}
    actions: dict[str, list[Any]] = {}
    for kind, factory in (("torch", load_policy(folder)), ("numpy", load_controller(str(tmp_path / "policy.npz")))):
        with FakeEnv(**DAY) as env:
            agent = Agent(make_controller(factory, env.unwrapped.manifest, {}))

            def act(_: Any, env: Any = env, agent: Agent = agent, kind: str = kind) -> Any:
                actions.setdefault(kind, []).append(agent.action(env.unwrapped.sample))
                return actions[kind][-1]

            run_episode(env, act, seed=1)
    assert len(actions["numpy"]) == 24
    assert np.array(actions["numpy"]) == pytest.approx(np.array(actions["torch"]), abs=1e-4)
    assert np.ptp(actions["numpy"], axis=0).max() > 1e-3


@pytest.mark.slow
def test_network_policy__policy_of_stacked_frames_acts_as_the_model(tmp_path: Path) -> None:
    """Rewards alone are normalized, so that the observations are those of the wrapper."""
    wrappers = [{"wrapper": "FrameStackObservation", "stack_size": 2}]
    folder = trained("ppo", tmp_path / "training", wrappers=wrappers, normalization={"observations": False})
    policy, model = export_policy(folder), load_policy(folder)
    policy.save(tmp_path / "policy.npz")
    assert load_network(tmp_path / "policy.npz").digest() == policy.digest()
    rewards = []
    for factory in (model, load_controller(str(tmp_path / "policy.npz"))):
        with FakeEnv(**DAY) as env:
            agent = Agent(make_controller(factory, env.unwrapped.manifest, {}))

            def act(_: Any, env: Any = env, agent: Agent = agent) -> Any:
                return agent.action(env.unwrapped.sample)

            rewards.append(run_episode(env, act, seed=1)[0].reward)
    assert rewards[1] == pytest.approx(rewards[0], rel=1e-4)


@pytest.mark.slow
def test_network_policy__file_is_the_same_each_time_and_needs_no_torch(tmp_path: Path) -> None:
    policy = export_policy(trained("ppo", tmp_path / "training"))
    for name in ("a.npz", "b.npz"):
        policy.save(tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    loaded = load_network(tmp_path / "a.npz")
    assert loaded.digest() == policy.digest()
    program = (
        "import sys; from zenostat.controllers import load_controller; from zenostat.testing import FakeEnv\n"
        f"with FakeEnv(**{DAY!r}) as env: load_controller({str(tmp_path / 'a.npz')!r})(env.unwrapped.manifest)\n"
        "sys.exit('torch' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=300)
    other = dataclasses.replace(policy, arrays={**policy.arrays, "bias_0": policy.arrays["bias_0"] + 1})
    assert other.digest() != policy.digest()


def small(**changes: Any) -> NetworkPolicy:
    bounds = {f"{kind}_{end}": np.float32([value] * 2) for kind in ("observation", "action") for end, value in
              (("low", -1.0), ("high", 1.0))}  # fmt: skip
    arrays = {"weight_0": np.eye(2, dtype=np.float32), "bias_0": np.zeros(2, np.float32), **bounds}
    return NetworkPolicy(("linear",), False, arrays, **changes)


def test_network_policy__observation_of_two_dimensions_is_read_row_by_row() -> None:
    """The order is that of stable-baselines3's `FlattenExtractor`."""
    weights = np.arange(6, dtype=np.float32).reshape(1, 6)
    low, high = np.full((2, 3), -1.0, np.float32), np.full((2, 3), 1.0, np.float32)
    bounds = {"action_low": np.float32([-99.0]), "action_high": np.float32([99.0])}
    arrays = {"weight_0": weights, "bias_0": np.zeros(1, np.float32), "observation_low": low, "observation_high": high}
    policy = NetworkPolicy(("linear",), False, {**arrays, **bounds})
    assert policy.predict([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])[0] == [0.0 + 5.0]


def test_network_policy__scales_and_clips_as_documented() -> None:
    """By hand: an identity of (x - 1) / sqrt(4), clipped to 0.3; squashed, tanh scaled to the bounds."""
    policy = small(clip_observations=0.3, epsilon=0.0)
    policy.arrays.update(mean=np.array([1.0, 1.0]), variance=np.array([4.0, 4.0]), action_high=np.float32([3.0, 3.0]))
    assert policy.predict([1.2, 9.0])[0] == pytest.approx([0.1, 0.3])
    squashed = dataclasses.replace(policy, squashed=True)
    assert squashed.predict([1.2, 9.0])[0] == pytest.approx(-1.0 + 2.0 * (np.tanh([0.1, 0.3]) + 1.0))


def test_network_policy__other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    with pytest.raises(UnknownName, match="there is no file"):
        load_network(path)
    path.write_text("no archive")
    with pytest.raises(InvalidConfig, match="is not a policy that Zenostat exported"):
        load_network(path)
    np.savez(path, header=np.array([{"pickled": 1}], object))
    with pytest.raises(InvalidConfig, match=r"header\.npy has objects"):
        load_network(path)
    for change, text in (
        ({"layers": ("linear", "eval")}, "unknown layers eval"),
        ({"wrappers": ({"wrapper": "os.system"},)}, "os.system"),
        ({"arrays": {**small().arrays, "bias_0": np.zeros(3, np.float32)}}, "shape"),
        ({"arrays": {**small().arrays, "more": np.zeros(3, np.float32)}}, "got action_high"),
        ({"arrays": {**small().arrays, "bias_0": np.float32([np.nan, 0.0])}}, "no finite action"),
    ):
        dataclasses.replace(small(), **change).save(path)
        with pytest.raises(InvalidConfig, match=text):
            load_network(path)
    header = json.dumps({"format": 99}).encode()
    np.savez(path, header=np.frombuffer(header, np.uint8))
    with pytest.raises(InvalidConfig, match="format 99, expected 1"):
        load_network(path)
    np.savez(path, header=np.frombuffer(b"[" * 200_000, np.uint8))
    with pytest.raises(InvalidConfig, match="RecursionError"):
        load_network(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("algorithm", "parameters", "text"),
    [
        ("td3", OFF_POLICY, "only policies of PPO, A2C and SAC can be exported, not TD3Policy"),
        ("sac", {**OFF_POLICY, "use_sde": True}, r"state-dependent exploration \(use_sde\) cannot be exported"),
    ],
)
def test_network_policy__only_known_policies_are_exported(
    algorithm: str, parameters: dict[str, Any], text: str, tmp_path: Path
) -> None:
    folder = trained(algorithm, tmp_path / "training", parameters=parameters)
    with pytest.raises(InvalidConfig, match=text):
        export_policy(folder)


@pytest.mark.slow
def test_network_policy__recurrent_policy_is_not_exported_without_its_memory(tmp_path: Path) -> None:
    pytest.importorskip("sb3_contrib")
    parameters = {**PARAMETERS["ppo"], "policy_kwargs": {"net_arch": [8], "lstm_hidden_size": 8}}
    changes: dict[str, Any] = {"parameters": parameters, "policy": "MlpLstmPolicy", "wrappers": []}
    folder = tmp_path / "training"
    train(read_training({
        "algorithm": "recurrent-ppo", "scenario": "Fake-v1", "arguments": DAY, "steps": 24, "threads": 1,
        "evaluation": False, "output": str(folder), **changes,
    }))  # fmt: skip
    with pytest.raises(InvalidConfig, match="a recurrent policy cannot be exported"):
        export_policy(folder)
