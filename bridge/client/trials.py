"""Trials of a client: alternative commands as a request, and the samples of its reply."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zenostat.bridge.client.command_publisher import CommandArrays
from zenostat.bridge.client.connection import build
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.transport.request import PendingReply
from zenostat.topics import codec
from zenostat.topics.arrays import Floats
from zenostat.topics.errors import InvalidAction, InvalidConfig
from zenostat.topics.messages import CommandOp, Manifest, Sample, StepsTried, TrySteps
from zenostat.topics.points import value_index


@dataclass(frozen=True, slots=True)
class PendingTrial:
    """A trial that a node was asked for: its reply, and the number of alternatives."""

    reply: PendingReply[StepsTried]
    alternatives: int


CommandValues = Mapping[str, float | None] | Floats | None
"""The values of one command; see `ControllerLink.send`."""

_ALL = bytes([CommandOp.SET])


def trial_request(
    manifest: Manifest, sequences: Sequence[Sequence[CommandValues]], *, at: Sample | None = None, priority: int = 10
) -> TrySteps:
    """Return the request for a trial.

    Args:
        manifest: Of the node.
        sequences: For each alternative, the commands of its timesteps; all are equally long.
        at: The sample from which to try; None is the present one.
        priority: Of a sender without a claim.

    Raises:
        InvalidAction: An actuator that does not exist, a value that is not finite, or an array of another shape; the
            text names alternative and timestep.
        InvalidConfig: No alternative or no timestep, too many of them, or sequences of different lengths.
    """
    lengths = {len(sequence) for sequence in sequences}
    if len(lengths) > 1:
        raise InvalidConfig(
            f"alternatives of {min(lengths)} to {max(lengths)} timesteps; all of the same length expected"
        )
    arrays, values, codes = CommandArrays(manifest), [], []
    for number, sequence in enumerate(sequences):
        for timestep, command in enumerate(sequence):
            try:
                row, operations = arrays.of(command, None)
                if not np.isfinite(np.frombuffer(row)).all():
                    raise InvalidAction("a value that is not finite; a number for each actuator expected")
            except InvalidAction as error:
                raise InvalidAction(f"alternative {number}, timestep {timestep}: {error}") from None
            values.append(row)
            codes.append(_ALL * (len(row) // 8) if operations is None else operations)
    is_all_set = all(code == _ALL * len(code) for code in codes)
    return trial_message(
        len(sequences), next(iter(lengths), 0), b"".join(values), None if is_all_set else b"".join(codes),
        at=at, priority=priority,
    )  # fmt: skip


def trial_message(
    alternatives: int, timesteps: int, values: bytes, operations: bytes | None, *, at: Sample | None, priority: int = 10
) -> TrySteps:
    """Return the request for a trial of encoded commands; `InvalidConfig` if there are too few or too many."""
    return build(
        TrySteps,
        episode=at.episode if at is not None else None,
        step=at.step if at is not None else None,
        alternatives=alternatives,
        timesteps=timesteps,
        priority=priority,
        values=values,
        operations=operations,
    )


def tried_samples(reply: StepsTried, alternatives: int, manifest: Manifest) -> list[list[SampleView]]:
    """Return the samples of each alternative."""
    index = value_index(manifest)
    samples = [SampleView(codec.decode(Sample, raw), manifest, index) for raw in reply.samples]
    length = len(samples) // alternatives
    return [samples[first : first + length] for first in range(0, len(samples), length)]
