"""Gymnasium's wrappers by name, with what they do to observations, actions and rewards."""

from __future__ import annotations

from enum import Flag, auto


class Trait(Flag):
    """Properties of a wrapper."""

    DATA = auto()  # it can be written as data
    KEEPS_ORDER = auto()  # an observation has the same values in the same order
    OBSERVATION_UNITS = auto()  # it changes the units of observations
    ACTION_UNITS = auto()  # it changes the units of actions
    SCALAR_REWARD = auto()  # it needs a reward that is one number
    SKIPS_STEPS = auto()  # it takes several timesteps in a step, and returns the info of the last one
    KEEPS_POLICY = auto()  # it changes neither observations nor actions


_ANY = Trait.DATA | Trait.KEEPS_ORDER
_NEUTRAL = Trait.KEEPS_ORDER | Trait.KEEPS_POLICY
_TRAITS = {
    "Autoreset": _NEUTRAL,
    "ClipAction": _ANY,
    "ClipReward": _ANY | Trait.KEEPS_POLICY | Trait.SCALAR_REWARD,
    "DelayObservation": _ANY,
    "DictInfoToList": _NEUTRAL,
    "DiscretizeAction": _ANY | Trait.ACTION_UNITS,
    "DiscretizeObservation": Trait.DATA | Trait.OBSERVATION_UNITS,
    "DtypeObservation": _ANY,
    "FlattenObservation": Trait.DATA,
    "FrameStackObservation": Trait.DATA,
    "HumanRendering": _NEUTRAL,
    "MaxAndSkipObservation": _ANY | Trait.SCALAR_REWARD | Trait.SKIPS_STEPS,
    "NormalizeObservation": _ANY | Trait.OBSERVATION_UNITS,
    "NormalizeReward": _ANY | Trait.KEEPS_POLICY | Trait.SCALAR_REWARD,
    "OrderEnforcing": _NEUTRAL,
    "PassiveEnvChecker": _NEUTRAL,
    "RecordEpisodeStatistics": _ANY | Trait.KEEPS_POLICY | Trait.SCALAR_REWARD,
    "RecordVideo": _NEUTRAL,
    "RenderCollection": _NEUTRAL,
    "RepeatAction": _ANY | Trait.SCALAR_REWARD | Trait.SKIPS_STEPS,
    "RescaleAction": _ANY | Trait.ACTION_UNITS,
    "RescaleObservation": _ANY | Trait.OBSERVATION_UNITS,
    "StickyAction": _ANY,
    "TimeAwareObservation": Trait.DATA,
    "TimeLimit": _ANY | Trait.KEEPS_POLICY,
    "TransformAction": Trait.KEEPS_ORDER | Trait.ACTION_UNITS,
    "TransformReward": _NEUTRAL,
}


def wrappers_with(trait: Trait) -> tuple[str, ...]:
    """Return the names of the wrappers with a property."""
    return tuple(name for name, traits in _TRAITS.items() if trait in traits)


GYMNASIUMS = wrappers_with(Trait.DATA)
"""Names of Gymnasium's wrappers that can be written as data."""
