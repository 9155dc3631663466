"""The quiet run: a fresh node, one controller that commands what ruled each timestep, and every value compared."""

from pathlib import Path

import numpy as np
from support.nodes import NodeProgram

import zenostat
from chaos.account import Episode
from chaos.run import BUILDING
from zenostat.bridge.client.controller_link import ControllerLink
from zenostat.bridge.runtime.affinity import Affinity
from zenostat.topics.errors import ZenostatError
from zenostat.topics.messages import CommandOp, Flag, Sample

QUIET = BUILDING | {"policy": "abort", "deadline_s": 60.0}
"""Without a policy, a sample that did not come would be waited for without end."""


def differences(folder: Path, episodes: list[Episode]) -> list[str]:
    """Return the first differences of the quiet run to the bit; one line for an episode at most."""
    with NodeProgram(folder, **QUIET) as node, zenostat.connect(node.endpoint, affinity=Affinity.OFF) as bus:
        with bus.controller(node.name, name="quiet") as link:
            try:
                texts = [_compared(link, episode) for episode in episodes if episode.samples]
            except ZenostatError as error:
                texts = [f"the quiet run ended with {type(error).__name__}: {error}"]
        bus.stop(node.name)
        node.process.wait()
    return [text for text in texts if text]


def _compared(link: ControllerLink, episode: Episode) -> str:
    again, shape = link.reset(), (len(link.manifest.actuators),)
    for sample, ruling in zip(episode.samples, [*episode.rulings, None], strict=False):
        if _seen(sample) != _seen(again.message):
            return f"episode {episode.number}, sample {sample.step[0]} is not that of the quiet run"
        if ruling is None:
            break
        values = np.array([np.nan if value is None else value for value in ruling]).reshape(shape)
        relinquished = np.isnan(values)
        mask = np.where(relinquished, np.uint8(CommandOp.RELINQUISH), np.uint8(CommandOp.SET)).tobytes()
        link.send(np.where(relinquished, 0.0, values), mask)
        again = link.receive()
    return ""


def _seen(sample: Sample) -> tuple[object, ...]:
    """All that the building says in a sample, as bytes."""
    flags = [flag & ~Flag.FALLBACK for flag in sample.flags]
    return (sample.step, sample.time, sample.elapsed_s, flags, sample.values, sample.effective)
