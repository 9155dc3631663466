"""Train PPO, SAC or TD3 on the data center of the Sinergym paper, and evaluate the best model over the same period.

    python examples/paper/train.py ppo --episodes 40 --out runs/ppo

The folder gets `best.zip` with its normalization, `curve.csv` with a row for each evaluation, `settings.json`, and a
recording of the best model's episode. Shorter tries: `--begin 07-01 --end 07-31 --episodes 3`.
"""

from __future__ import annotations

import argparse
import csv
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

import zenostat  # noqa: F401  # registers the environments
from zenostat.envs import as_sb3
from zenostat.training import EvaluationCallback, evaluate_model

SCENARIO = "paper-datacenter-mixed-continuous-stochastic-v1"
ALGORITHMS = {"ppo": PPO, "sac": SAC, "td3": TD3}
EVALUATION_SEED = 1000
LAMBDA_ENERGY = 5e-5
LOW, HIGH = np.float32(-1.0), np.float32(1.0)
"""Bounds of the rescaled actions."""


@dataclass
class Settings:
    """All that determines a training; the parameters are those of stable-baselines3's class."""

    algorithm: str = "ppo"
    scenario: str = SCENARIO
    period: dict[str, str] = field(default_factory=dict)
    parameters: dict[str, Any] = field(default_factory=dict)
    episodes: int = 40
    evaluate_every: int = 5
    slots: int = 1
    seed: int = 0


def make_env(settings: Settings, **arguments: Any) -> gym.Env[Any, Any]:
    """Make the environment with actions of -1 to 1, which PPO needs."""
    env = gym.make(f"zenostat/{settings.scenario}", **settings.period, **arguments)
    return gym.wrappers.RescaleAction(env, LOW, HIGH)


def make_training_env(settings: Settings) -> VecNormalize:
    """Make the slots of the training, with normalized observations."""
    env = gym.make_vec(
        f"zenostat/{settings.scenario}", num_envs=settings.slots, autoreset_mode="SameStep", **settings.period
    )
    scaled = gym.wrappers.vector.RescaleAction(env, LOW, HIGH)
    return VecNormalize(VecMonitor(as_sb3(scaled)), norm_reward=False)


class Curve(BaseCallback):
    """Write the rows of all evaluations so far to a file, after each one."""

    def __init__(self, evaluation: EvaluationCallback, steps: int, path: Path) -> None:
        super().__init__()
        self.evaluation, self.steps, self.path = evaluation, steps, path
        self.rows: list[dict[str, float]] = []

    def _on_step(self) -> bool:
        results = self.evaluation.results
        if len(results) > len(self.rows):
            self.rows = [row(step, self.steps, result) for step, (result,) in results.items()]
            write_rows(self.rows, self.path)
        return True


def train(settings: Settings, folder: Path) -> list[dict[str, float]]:
    """Train, and return a row for each evaluation; files are written to `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "settings.json").write_text(json.dumps(asdict(settings), indent=2) + "\n")
    env = make_training_env(settings)
    try:
        steps = env.unwrapped.env.unwrapped.manifest.steps
        algorithm = ALGORITHMS[settings.algorithm]
        model = algorithm("MlpPolicy", env, seed=settings.seed, device="cpu", **settings.parameters)
        evaluation = EvaluationCallback(
            lambda: make_env(settings),
            every=settings.evaluate_every * steps,
            seed=EVALUATION_SEED,
            best_model_path=folder / "best.zip",
        )
        curve = Curve(evaluation, steps, folder / "curve.csv")
        with evaluation:
            model.learn(settings.episodes * steps, callback=[evaluation, curve])
    finally:
        env.close()
    return curve.rows


def row(step: int, steps: int, result: Any) -> dict[str, float]:
    """Return the paper's quantities of an episode: reward and its parts per timestep."""
    metrics = result.metrics()
    return {
        "step": step,
        "episode": step / steps,
        "mean_reward": metrics["mean_reward"],
        "power_w": -metrics["mean_reward.energy"] / (0.5 * LAMBDA_ENERGY),
        "deviation_k": -metrics["mean_reward.comfort"] / 0.5,
        "outside_percent": metrics["outside_percent"],
    }


def write_rows(rows: list[dict[str, Any]], path: Path) -> None:
    """Write rows with equal keys as CSV."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def record_best(settings: Settings, folder: Path, evaluations: list[dict[str, float]]) -> dict[str, float]:
    """Record an episode of the best model, and return its row, with the episode of training of its evaluation."""
    with make_env(settings, record=folder, node=settings.algorithm) as env:
        normalization = VecNormalize.load(str(folder / "best.vecnormalize.pkl"), DummyVecEnv([lambda: env]))
        model = ALGORITHMS[settings.algorithm].load(folder / "best.zip", env=normalization, device="cpu")
        (result,) = evaluate_model(model, env, seed=EVALUATION_SEED)
    best = max(evaluations, key=lambda evaluation: evaluation["mean_reward"])
    return row(int(best["step"]), result.steps, result)


def describe(result: dict[str, float]) -> str:
    """Return a row as text."""
    return "  ".join(f"{name} {value:,.4f}" for name, value in result.items() if name != "step")


def number(text: str) -> Any:
    """Read NAME=VALUE of `--set`; the value is JSON."""
    name, _, value = text.partition("=")
    return name, json.loads(value)


def main() -> None:
    """Read the command line, train, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("algorithm", choices=list(ALGORITHMS))
    parser.add_argument("--episodes", type=int, default=40)
    parser.add_argument("--evaluate-every", type=int, default=5, metavar="EPISODES")
    parser.add_argument("--slots", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scenario", default=SCENARIO)
    parser.add_argument("--begin", metavar="MM-DD")
    parser.add_argument("--end", metavar="MM-DD")
    parser.add_argument("--set", type=number, action="append", default=[], metavar="NAME=VALUE", dest="parameters")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    options = parser.parse_args()
    if options.episodes < options.evaluate_every:
        parser.error(f"--evaluate-every {options.evaluate_every} is never reached in --episodes {options.episodes}")
    period = {name: value for name in ("begin", "end") if (value := getattr(options, name))}
    settings = Settings(
        options.algorithm, options.scenario, period, dict(options.parameters), options.episodes,
        options.evaluate_every, options.slots, options.seed,
    )  # fmt: skip
    evaluations = train(settings, options.out)
    for result in evaluations:
        print(describe(result))
    print("best:", describe(record_best(settings, options.out, evaluations)))


if __name__ == "__main__":
    main()
