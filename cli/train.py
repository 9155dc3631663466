"""`zenostat train`: train an agent from a file."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.bridge.runtime.signals import TERMINATION_SIGNALS, override_signals
from zenostat.cli.console import err, out, progress
from zenostat.cli.pairs import read_pairs
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.plurals import counted

if TYPE_CHECKING:
    from zenostat.lab.training import TrainingConfig, TrainingStatus
    from zenostat.metrics.episode_metrics import EpisodeMetrics


def set_option(examples: str) -> Any:
    """Return the option that sets fields of a file, with examples of these."""
    return typer.Option("--set", metavar="FIELD=VALUE", help=f"A field of the file, as {examples}; repeatable.")


def train(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE.yaml]", help="Training file; with --resume also a training's folder."),
    ] = None,
    algorithm: Annotated[
        str | None,
        typer.Option(help="ppo, sac, td3, dqn, a2c or ddpg of stable-baselines3, or recurrent-ppo of sb3-contrib."),
    ] = None,
    scenario: Annotated[str | None, typer.Option(help="Scenario id or scenario file.")] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Training steps, over all slots.")] = None,
    slots: Annotated[int | None, typer.Option(min=1, max=256, help="Buildings simulated side by side.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of algorithm and episodes.")] = None,
    output: Annotated[Path | None, typer.Option(help="Folder of the results.")] = None,
    fields: Annotated[list[str] | None, set_option("parameters.learning_rate=1e-3 or evaluation=false")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue from the folder's last checkpoint.")] = False,
) -> None:
    """Train an agent with stable-baselines3, from a file, from options, or both: options override the file.

    Example: `zenostat train examples/train.yaml --seed 1 --output training/office-1`

    Ctrl-C, SIGTERM and SIGHUP write a checkpoint, with which `--resume` continues. `zenostat evaluate` and
    `zenostat run` accept the folder of a training as a controller.
    """
    options = {"algorithm": algorithm, "scenario": scenario, "steps": steps, "slots": slots, "seed": seed}
    options["output"] = None if output is None else str(output)
    config = _read(file, {name: value for name, value in options.items() if value is not None}, fields or (), resume)
    from zenostat.lab.training import folder as training_folder
    from zenostat.lab.training import train as run

    if resume and (changes := training_folder.changed_versions(config.folder)):
        err.print(f"resumed with other versions, so not equal to the bit: {'; '.join(changes)}")
    with stop_signals() as (stop, received), progress() as bars:
        watch = None if not out.is_interactive else _watcher(bars)
        result = run(
            config,
            resume=resume,
            progress=watch,
            on_evaluation=_print_evaluation,
            on_references=_print_references,
            stop=stop,
        )
    if not result.finished:
        again = f"zenostat train {result.folder} --resume"
        out.print(f"stopped; checkpoint at step {result.step:,}; continue with: {again}")
        raise typer.Exit(128 + received[0])
    best = "" if result.best_reward is None else f", best evaluation {result.best_reward:,.2f}"
    if result.best_reward is None and config.evaluation:
        best = ", without an evaluation: the training ended before the first"
    out.print(f"{result.folder}: {counted(result.step, 'step', ',')}{best}")


def _read(file: Path | None, options: dict[str, Any], texts: Sequence[str], resume: bool) -> TrainingConfig:
    """Read the training file or folder, and override its fields."""
    from zenostat.agent_sdk.controllers.training_folder import is_training
    from zenostat.lab.config_file import read_file
    from zenostat.lab.training.config import read_training
    from zenostat.lab.training.run import resume_training

    if resume and file is None and "output" not in options:
        raise InvalidConfig("--resume: name the folder of a training, or its file: zenostat train FOLDER --resume")
    if resume and file is not None and file.is_dir():
        fields: dict[str, Any] = resume_training(file).plain()
    else:
        if file is not None and is_training(file):
            raise InvalidConfig(f"{file} is the folder of a training: --resume continues it")
        fields = {} if file is None else read_file(file)
    return read_training(override_fields(fields, options, texts), "the training" if file is None else str(file))


def override_fields(fields: dict[str, Any], options: dict[str, Any], texts: Sequence[str]) -> dict[str, Any]:
    """Return the fields of a file, overridden by options and by texts of the form `field.field=value`.

    Raises:
        InvalidConfig: a text has another form, or a field occurs twice.
    """
    from zenostat.lab.config_file import with_field

    fields = {**fields, **options}
    for path, value in read_pairs("--set", texts, "a field and a value", "parameters.learning_rate=1e-3").items():
        fields = with_field(fields, path, value)
    return fields


@contextmanager
def stop_signals() -> Iterator[tuple[threading.Event, list[int]]]:
    """An event that `TERMINATION_SIGNALS` set, and the signals received; a second Ctrl-C interrupts at once."""
    stop, received = threading.Event(), list[int]()

    def handle(number: int, _: Any) -> None:
        if received and number == signal.SIGINT:
            raise KeyboardInterrupt
        received.append(number)
        stop.set()

    with override_signals(handle, *TERMINATION_SIGNALS):
        yield stop, received


def _watcher(bars: Any) -> Callable[[TrainingStatus], None]:
    """Show a progress bar with rewards and speed, updated some times a second."""
    import time

    task, shown = bars.add_task("training", total=None, rate=""), [0.0]

    def watch(status: TrainingStatus) -> None:
        now = time.monotonic()
        if now - shown[0] < 0.2 and status.step < status.steps:
            return
        shown[0] = now
        if bars.tasks[task].total is None:
            bars.reset(task, total=status.steps, completed=status.step)
        speed = bars.tasks[task].speed
        texts = [f"reward {status.reward:,.1f}" if status.reward is not None else ""]
        texts += [f"evaluation {status.evaluation:,.1f}" if status.evaluation is not None else ""]
        texts += [f"{speed:,.0f} steps/s" if speed else ""]
        bars.update(task, completed=min(status.step, status.steps), rate=", ".join(filter(None, texts)))

    return watch


def _print_evaluation(step: int, results: tuple[EpisodeMetrics, ...]) -> None:
    rewards = [result.reward for result in results if result.reward is not None]
    if rewards:
        out.print(f"step {step:,}: evaluation {sum(rewards) / len(rewards):,.2f}")


def _print_references(rewards: dict[str, float]) -> None:
    for name, reward in rewards.items():
        out.print(f"{name}: {reward:,.2f} in the evaluation episodes")
