"""Approximate bids against true ones: the same district and market twice, and a figure.

python examples/market_bids.py examples/district_market.yaml market.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np

import zenostat
from zenostat.bridge.client.local_node import LocalNode
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.evaluation import Trajectory, TrajectoryRecorder

mpl.use("Agg")
TITLES = {"linear": "Approximate bids: lines through the last demand", "trials": "True bids: trials"}


def simulate(file: Path) -> Trajectory:
    """Simulate an episode in which nobody commands anything but the market."""
    node = LocalNode({"district": str(file), "name": "traders"}, Affinity.OFF)
    try:
        with zenostat.connect(node.endpoint, affinity="off") as bus, bus.controller("traders") as link:
            recorder = TrajectoryRecorder(link.manifest)
            sample = link.reset(seed=1)
            recorder.add(sample)
            while not sample.truncated:
                sample.send({})
                sample = link.receive()
                recorder.add(sample)
            return recorder.trajectory({})
    finally:
        node.close()


def main() -> None:
    """Simulate with both kinds of bids, print how far the limit was missed, and draw the figure."""
    file, picture = Path(sys.argv[1]).absolute(), Path(sys.argv[2])
    text, runs = file.read_text(encoding="utf-8"), {}
    for bids in TITLES:
        changed = file.with_name(f"{file.stem}_{bids}.yaml")  # paths in it are relative to its folder
        changed.write_text(text.replace("      low: 0.2\n", f"      low: 0.2\n      bids: {bids}\n"), encoding="utf-8")
        try:
            runs[bids] = simulate(changed)
        finally:
            changed.unlink()
    figure, axes = plt.subplots(2, 2, sharex=True, sharey="row", figsize=(11, 5.5), layout="constrained")
    for column, (bids, run) in enumerate(runs.items()):
        time, limit_kw = run.time[1:], run["market.limit"][1:] / 1e3
        demand_kw, expected_kw = run["market.demand"][1:] / 1e3, run["market.cleared_demand"][1:] / 1e3
        above = np.maximum(demand_kw - limit_kw, 0.0)
        hours = (above > 1e-9).sum() * run.manifest.step_s / 3600.0
        missed = np.abs(demand_kw - expected_kw)[expected_kw > 0].mean()
        print(
            f"{bids}: above the limit for {hours:g} h, by at most {above.max():.1f} kW; bids missed the demand by "
            f"{missed:.2f} kW on average; {run['market.trials'][1:].mean():.1f} prices per step"
        )
        top, bottom = axes[0][column], axes[1][column]
        top.set_title(f"{TITLES[bids]}\n{hours:g} h above the limit, by at most {above.max():.1f} kW", loc="left")
        top.step(time, expected_kw, where="pre", color="#c2500a", linewidth=1.0, label="bids at the price")
        top.step(time, demand_kw, where="pre", color="#0b6bcb", linewidth=1.4, label="demand")
        top.plot(time, limit_kw, color="#1b2430", linewidth=1.0, linestyle="dashed", label="limit")
        top.fill_between(time, limit_kw, limit_kw + above, step="pre", color="#c8470f", alpha=0.4, linewidth=0)
        bottom.step(time, run["market.price"][1:], where="pre", color="#1b7f4d")
        bottom.xaxis.set_major_formatter(mpl.dates.DateFormatter("%H:%M"))
    axes[0][0].set_ylabel("Sum of three buildings, kW")
    axes[0][0].legend(loc="upper left", frameon=False)
    axes[1][0].set_ylabel("Price, EUR/kWh")
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    main()
