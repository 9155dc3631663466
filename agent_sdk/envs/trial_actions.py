"""Alternative actions of an environment as the request for a trial."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from zenostat.agent_sdk.envs.action_values import Actions, as_array
from zenostat.bridge.client.sample import SampleView
from zenostat.bridge.client.trials import trial_message
from zenostat.topics import codec
from zenostat.topics.errors import InvalidAction, InvalidConfig
from zenostat.topics.messages import CommandOp, TrySteps


def trial_of_actions(
    actions: Actions, alternatives: ArrayLike, sample: SampleView, context_at: Callable[[int], dict[int, float | None]]
) -> TrySteps:
    """Return the request for a trial of actions.

    Args:
        actions: Of the environment.
        alternatives: Elements of the action space, shape (alternatives, timesteps, *action shape).
        sample: The present sample.
        context_at: Returns the values of further actuators in a timestep, by position; called for each in order.

    Raises:
        InvalidAction: Wrong shape, out of bounds, not finite, or no such choice; the text names alternative and
            timestep.
        InvalidConfig: Several timesteps of relative actions, whose offsets need the samples in between.
    """
    sequences, single = as_array(alternatives, None), actions.space.shape or ()
    if sequences.shape[2:] != single or sequences.ndim != 2 + len(single) or 0 in sequences.shape[:2]:
        expected = ", ".join(["alternatives", "timesteps", *map(str, single)])
        raise InvalidAction(f"actions of shape {sequences.shape}; ({expected}) expected, at least 1 of each")
    count, timesteps = sequences.shape[:2]
    if actions.is_relative and timesteps > 1:
        raise InvalidConfig(
            "relative actions can be tried for one timestep at a time; branch(slots=...).rollout() simulates several"
        )
    contexts = [context_at(timestep) for timestep in range(timesteps)]
    values, codes = [], []
    for number, sequence in enumerate(sequences):
        for timestep, (action, context) in enumerate(zip(sequence, contexts, strict=True)):
            try:
                row, operations = actions.command(action, sample.fault_free_values, dict(context))
            except InvalidAction as error:
                raise InvalidAction(f"alternative {number}, timestep {timestep}: {error}") from None
            values.append(row)
            codes.append(bytes([CommandOp.SET]) * row.size if operations is None else operations)
    is_all_set = all(code.count(CommandOp.SET) == len(code) for code in codes)
    return trial_message(
        count,
        timesteps,
        np.ascontiguousarray(values, codec.FLOAT).tobytes(),
        None if is_all_set else b"".join(codes),
        at=sample.message,
    )
