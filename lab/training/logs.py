"""Logs of a training beside its curve: stable-baselines3's values as CSV, in TensorBoard and in Weights & Biases."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import CSVOutputFormat, KVWriter, Logger

from zenostat.lab.training.config import TrainingConfig
from zenostat.topics.extras import import_extra

_EXTRAS = {"tensorboard": ("tensorboardX", "tensorboard"), "wandb": ("wandb", "wandb")}


def check_logs(config: TrainingConfig) -> None:
    """Import what the logs need.

    Raises:
        InvalidConfig: a library is missing; the text has the command that installs it.
    """
    for log in config.log:
        import_extra(*_EXTRAS[log], f"log: {log}")


def make_logger(config: TrainingConfig, folder: Path, step: int) -> Logger:
    """Return a logger that writes `progress.csv` and the logs of the training.

    Args:
        config: the training.
        folder: its folder.
        step: training step at which it begins; a resumed training has a file of its own, `progress-STEP.csv`.
    """
    writers: list[KVWriter] = [CSVOutputFormat(str(folder / f"progress{f'-{step}' if step else ''}.csv"))]
    if "tensorboard" in config.log:
        writers.append(_TensorBoard(folder / "tensorboard", step))
    if "wandb" in config.log:
        writers.append(_WeightsAndBiases(config, folder))
    return Logger(str(folder), writers)


def _numbers(values: Mapping[str, Any], excluded: Mapping[str, Any], log: str) -> dict[str, float]:
    return {
        name: float(value)
        for name, value in values.items()
        if isinstance(value, int | float) or getattr(value, "shape", None) == ()
        if log not in (excluded.get(name) or ())
    }


class _TensorBoard(KVWriter):  # type: ignore[misc,unused-ignore]  # without types where it is not installed
    def __init__(self, folder: Path, step: int) -> None:
        writer = import_extra("tensorboardX", "tensorboard", "log: tensorboard").SummaryWriter
        self._writer = writer(str(folder), purge_step=step or None)

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, Any], step: int = 0) -> None:
        for name, value in _numbers(key_values, key_excluded, "tensorboard").items():
            self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        self._writer.close()


class _WeightsAndBiases(KVWriter):  # type: ignore[misc,unused-ignore]  # without types where it is not installed
    def __init__(self, config: TrainingConfig, folder: Path) -> None:
        wandb = import_extra("wandb", "wandb", "log: wandb")
        run_id = folder / "wandb-run"  # a resumed training continues its run
        arguments: dict[str, Any] = {"project": "zenostat", "name": folder.name, **config.wandb}
        if run_id.is_file():
            arguments |= {"id": run_id.read_text(encoding="utf-8").strip(), "resume": "allow"}
        self._run = wandb.init(dir=str(folder), config=config.plain(), **arguments)
        run_id.write_text(self._run.id + "\n", encoding="utf-8")

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, Any], step: int = 0) -> None:
        self._run.log(_numbers(key_values, key_excluded, "wandb"), step=step)

    def close(self) -> None:
        self._run.finish()
