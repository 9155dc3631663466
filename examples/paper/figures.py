"""Draw five figures and the table of the data center's experiments from the files of the other commands.

    python examples/paper/figures.py runs --out figures

Needs `runs/year.csv` and the recordings in `runs/year`; trainings (`runs/ppo`, further seeds `runs/ppo-1`, …) and the
search (`runs/search`) are drawn if their folders are there.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import MaxNLocator

from zenostat.recording import load
from zenostat.views.report import theme

PUBLISHED = {"best PPO": (-0.4310, 17_221.0, 0.0009), "baseline": (-0.4377, 17_423.0, 0.0043)}
"""Mean reward, mean power in W and mean deviation in K, as the paper reports them."""
LABELS = {"baseline": "baseline", "examples": "rule", "incremental": "incremental"}
ZONES = (("west_zone_air_temperature", "west zone", "series-2"), ("east_zone_air_temperature", "east zone", "series-3"))
MONTHS = "JFMAMJJASOND"
TRAINED = ("ppo", "sac", "td3")
YEAR = 35_040
"""Timesteps of an episode."""
SEARCHED = ("learning_rate", "n_steps", "batch_size", "gamma")
"""Parameters of the search."""


def episodes(folder: Path) -> dict[str, Any]:
    """Return the recorded episode of each controller by its label."""
    runs = {}
    for path in sorted(folder.glob("*.mcap")):
        label = next((text for start, text in LABELS.items() if path.name.startswith(start)), path.name.split("-")[0])
        runs[label] = max(load(path).episodes, key=len)
    return runs


def daily(values: Any) -> Any:
    """Return means of whole days of 15-minute values, without the first sample."""
    return values[1 : len(values) // 96 * 96 + 1].reshape(-1, 96).mean(axis=1)


def draw_zones(runs: dict[str, Any], titles: dict[str, str], path: Path) -> None:
    """Draw daily means of outdoor air, both zones and the cooling setpoint, a panel per controller."""
    figure, panels = plt.subplots(
        len(titles), figsize=(theme.FULL_IN, 2.4 * len(titles) + 0.6), sharex=True, squeeze=False, layout="constrained"
    )
    for axes, (name, title) in zip(panels[:, 0], titles.items(), strict=True):
        episode = runs[name]
        axes.axhspan(18, 27, color=theme.LIGHT["occupied"], zorder=0, label="recommended band")
        outdoor = daily(episode["outdoor_temperature"])
        axes.plot(outdoor, color=theme.LIGHT["line"], label="outdoor air")
        for point, label, color in ZONES:
            axes.plot(daily(episode[point]), color=theme.LIGHT[color], label=label)
        setpoint = daily(episode["west_zone_clg_setpoint"])
        axes.plot(setpoint, color=theme.LIGHT["ink"], linestyle="--", linewidth=1, label="cooling setpoint")
        axes.set(title=title, ylabel="°C, daily mean", xlim=(0, max(len(outdoor) - 1, 1)))
    panels[-1, 0].set_xlabel("day of the period")
    panels[0, 0].legend(loc="lower center", ncols=5)
    save(figure, path)


def evaluations(folder: Path) -> tuple[list[float], list[float]]:
    """Return the years of training and the mean reward of each evaluation of a training."""
    rows = read_rows(folder / "evaluations.csv")
    return [row["step"] / YEAR for row in rows], [row["mean_reward"] for row in rows]


def trainings(folder: Path) -> list[Path]:
    """Return the folders of trainings that have been evaluated, by algorithm and seed."""
    return [
        training
        for algorithm in TRAINED
        for training in sorted(folder.glob(f"{algorithm}*"))
        if (training / "evaluations.csv").is_file() and read_rows(training / "evaluations.csv")
    ]


def draw_training(folders: list[Path], path: Path) -> None:
    """Draw the reward of each evaluation during the trainings, with the baseline in the same year and the paper's."""
    figure, axes = plt.subplots(figsize=(theme.FULL_IN, 2.8), layout="constrained")
    labeled = set()
    for folder in folders:
        algorithm = folder.name.partition("-")[0]
        label = None if algorithm in labeled else algorithm.upper()
        labeled.add(algorithm)
        color = theme.series_color(TRAINED.index(algorithm) + 1)
        axes.plot(*evaluations(folder), marker="o", color=color, label=label)
    baseline = read_rows(folders[0] / "references.csv")[0]["mean_reward"]
    lines = {"baseline": baseline, "paper's best PPO": PUBLISHED["best PPO"][0]}
    for place, (name, value) in enumerate(lines.items()):
        axes.axhline(value, color=theme.LIGHT["muted"], linestyle=theme.series_dashes(place + 2), label=name)
    axes.set(title="Evaluations during training", xlabel="years of training", ylabel="mean reward")
    axes.legend(ncols=5, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)
    save(figure, path)


def combinations(trials: Path) -> list[dict[str, float]]:
    """Return the completed combinations of a search, with the mean reward per step of the last evaluation of each."""
    return [
        {name.removeprefix("parameters."): value for name, value in row.items()} | {"mean_reward": row["reward"] / YEAR}
        for row in read_rows(trials)
        if row["state"] == "COMPLETE"
    ]


def draw_search(rows: list[dict[str, float]], path: Path) -> None:
    """Draw parallel coordinates: a line for each combination, darker for a higher reward."""
    names = [*SEARCHED, "mean_reward"]
    figure, axes = plt.subplots(figsize=(theme.FULL_IN, 3.0), layout="constrained")
    columns = {name: np.array([row[name] for row in rows]) for name in names}
    rank = np.argsort(np.argsort(columns["mean_reward"])) / max(len(rows) - 1, 1)
    scaled = {}
    for place, name in enumerate(names):
        values = np.unique(columns[name])
        if name == "mean_reward":
            spread = np.ptp(values) or 1.0
            scaled[name] = (columns[name] - values[0]) / spread
            ends = ((0.0, f"{values[0]:.4f}"), (1.0, f"{values[-1]:.4f}"))
        else:
            places = np.linspace(0, 1, len(values)) if len(values) > 1 else np.array([0.5])
            scaled[name] = places[np.searchsorted(values, columns[name])]
            ends = tuple(zip(places, (f"{value:g}" for value in values), strict=True))
        for height, text in ends:
            label = {"facecolor": theme.LIGHT["page"], "edgecolor": "none", "pad": 1.0}
            axes.annotate(
                text, (place, height), (4, 0), textcoords="offset points", va="center", fontsize=7, bbox=label
            )
    for number in np.argsort(columns["mean_reward"]):
        color = mpl.colormaps["viridis"](1.0 - rank[number])
        axes.plot(range(len(names)), [scaled[name][number] for name in names], color=color, alpha=0.8)
    axes.set_xticks(range(len(names)), [name.replace("_", " ") for name in names])
    axes.set(title=f"PPO: {len(rows)} combinations, last evaluation of each", yticks=[], xlim=(-0.1, len(names) - 0.7))
    axes.grid(visible=True, axis="x")
    save(figure, path)


def draw_continued(trained: list[list[dict[str, Any]]], baseline: float, path: Path) -> None:
    """Draw the evaluations of the combinations that were continued, the best after two years first."""
    figure, axes = plt.subplots(figsize=(theme.FULL_IN, 3.2), layout="constrained")
    for place, evaluated in enumerate(trained):
        label = ", ".join(f"{evaluated[0][name]:g}" for name in SEARCHED)
        years, rewards = zip(*((row["step"] / YEAR, row["mean_reward"]) for row in evaluated), strict=True)
        axes.plot(years, rewards, color=mpl.colormaps["tab10"](place % 10), label=label)
    axes.axhline(baseline, color=theme.LIGHT["muted"], linestyle=theme.series_dashes(2), label="baseline")
    axes.set(title="The best combinations, continued", xlabel="years of training", ylabel="mean reward")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(title=", ".join(SEARCHED).replace("_", " "), loc="center left", bbox_to_anchor=(1, 0.5))
    save(figure, path)


def draw_months(runs: dict[str, Any], path: Path) -> None:
    """Draw the mean power of each month, and its change against the baseline."""
    power = {}
    for name, episode in runs.items():
        month = episode.time[:-1].astype("datetime64[M]").astype(int) % 12  # of the begin of each timestep
        values = episode["HVAC_electricity_demand_rate"][1:]
        present = np.unique(month)  # all months of a year, or those of a shorter period
        power[name] = np.full(12, np.nan)
        power[name][present] = [values[month == number].mean() for number in present]
    figure, (above, below) = plt.subplots(2, figsize=(theme.FULL_IN, 4.0), sharex=True, layout="constrained")
    width = 0.8 / len(power)
    for place, (name, values) in enumerate(power.items()):
        shift = np.arange(12) + (place - (len(power) - 1) / 2) * width
        above.bar(shift, values / 1e3, width, color=theme.series_color(place), label=name)
        if name != "baseline":
            below.bar(
                shift, (values / power["baseline"] - 1.0) * 100, width, color=theme.series_color(place), label=name
            )
    above.set(title="HVAC electricity by month", ylabel="mean power, kW")
    above.legend(ncols=len(power))
    below.set(ylabel="against baseline, %", xlabel="month")
    below.axhline(0, color=theme.LIGHT["ink"], linewidth=0.8)
    below.set_xticks(range(12), MONTHS)
    save(figure, path)


def save(figure: Any, path: Path) -> None:
    """Write a figure as PNG."""
    figure.savefig(path, dpi=110)
    plt.close(figure)
    print(path)


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Read a CSV file; numbers become floats."""

    def value(text: str) -> Any:
        try:
            return float(text)
        except ValueError:
            return text

    with path.open(newline="") as file:
        return [{name: value(text) for name, text in row.items()} for row in csv.DictReader(file)]


def power_w(row: dict[str, Any]) -> float:
    """Return the mean HVAC power that the reward contains: the demand rate at the end of each timestep."""
    return float(-row["mean_reward.energy"] / (0.5 * 5e-5))


def metered_w(row: dict[str, Any]) -> float:
    """Return the mean HVAC power by the meters, in a year of 8,760 hours."""
    return float(row["hvac_electricity_kwh"]) / 8.76


def identity(power: float, deviation_k: float) -> float:
    """Return the reward that follows from the mean power in W and the mean deviation in K."""
    return -(0.5 * 5e-5 * power + 0.5 * deviation_k)


def print_table(rows: list[dict[str, Any]]) -> None:
    """Print reward, power and deviation, and what the reward's identity makes of power and deviation."""
    ours = {row["controller"]: (row["mean_reward"], power_w(row), row["mean_deviation_k"]) for row in rows}
    print("| controller | reward | power, W | deviation, K | -(0.5·5e-5·W + 0.5·K) |\n|---|---|---|---|---|")
    for source, table in (("paper", PUBLISHED), ("here", ours)):
        for name, (reward, power, deviation_k) in table.items():
            follows = identity(power, deviation_k)
            print(f"| {source}: {name} | {reward:.4f} | {power:,.0f} | {deviation_k:.4f} | {follows:.4f} |")


def main() -> None:
    """Read the command line and draw what there is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    runs, year = episodes(options.runs / "year"), read_rows(options.runs / "year.csv")
    with mpl.rc_context(theme.style("paper")):
        draw_zones(runs, {"baseline": "Default control: 20 and 23 °C"}, options.out / "paper-default.png")
        rules = {"rule": "The rule of the paper", "incremental": "The controller incremental"}
        draw_zones(runs, rules, options.out / "paper-rule.png")
        if folders := trainings(options.runs):
            draw_training(folders, options.out / "paper-training.png")
        if (trials := options.runs / "search" / "trials.csv").exists():
            draw_search(combinations(trials), options.out / "paper-search.png")
        draw_months(runs, options.out / "paper-months.png")
    print_table(year)


if __name__ == "__main__":
    main()
