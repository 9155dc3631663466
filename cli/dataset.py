"""`zenostat dataset`: write episodes of controllers as a data set for offline learning."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

from zenostat.cli.console import out
from zenostat.cli.evaluate import watcher
from zenostat.cli.node_options import Begin, End
from zenostat.cli.pairs import read_parameters


def dataset(
    scenario: Annotated[str, typer.Argument(help="Scenario id (see `zenostat scenarios`) or scenario file.")],
    controllers: Annotated[
        list[str],
        typer.Option(
            "--controller",
            help="A controller as for `zenostat evaluate`: rbc, random, path/to/file.py:MyController, ppo:model.zip, "
            "...; repeatable.",
        ),
    ],
    dataset_id: Annotated[
        str, typer.Option("--id", metavar="NAMESPACE/NAME-vN", help="Id of the data set, as `minari` names it.")
    ],
    episodes: Annotated[int, typer.Option(min=1, help="Episodes per controller.")] = 1,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the first episode; each further episode of the data set adds 1.")
    ] = 0,
    epsilon: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="Probability of a random action in place of the controller's.")
    ] = 0.0,
    begin: Begin = None,
    end: End = None,
    parameters: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Parameter for each controller that has it; repeatable."),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option("--out", help="Folder of all data sets [default: $MINARI_DATASETS_PATH, or ~/.minari/datasets]."),
    ] = None,
    author: Annotated[str | None, typer.Option(help="Author, for the data set's metadata.")] = None,
    description: Annotated[str | None, typer.Option(help="Description, for the data set's metadata.")] = None,
) -> None:
    """Write episodes of controllers as a Minari data set, for offline learning and imitation.

    Example: `zenostat dataset office-small-USA_CO_Denver-continuous-stochastic-v1 --controller rbc --epsilon 0.2
    --episodes 3 --end 01-31 --id zenostat/office-small/rbc-v0`

    Observations, actions and rewards are those of the environment of the same scenario. The same command writes the
    same bytes.
    """
    import gymnasium as gym

    from zenostat.agent_sdk.envs.arguments import of_scenario
    from zenostat.lab.datasets import write_dataset
    from zenostat.lab.scenario_env import pop_env_id

    options = (("begin", begin), ("end", end))
    arguments: dict[str, Any] = {name: value for name, value in options if value is not None}

    def make() -> gym.Env[Any, Any]:
        chosen = of_scenario(scenario)
        return gym.make(pop_env_id(chosen), **chosen, **arguments)

    with ExitStack() as stack:
        path = write_dataset(
            make, controllers, dataset_id, episodes=episodes, seed=seed, epsilon=epsilon,
            parameters=read_parameters(parameters), folder=folder, author=author, description=description,
            progress=watcher(stack, episodes),
        )  # fmt: skip
    out.print(f"data set {dataset_id}: {path}")
    setting = f"MINARI_DATASETS_PATH={folder.absolute()} " if folder is not None else ""
    out.print(f"{setting}python -c \"import minari; print(minari.load_dataset('{dataset_id}'))\"")
