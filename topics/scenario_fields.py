"""The arguments of a scenario: their names, types and meaning, each defined once.

They are arguments of `gym.make`, fields of scenario files, settings of a node and options of `zenostat node`. The
signatures of the environments, their errors, the help of the command line, the JSON schema of scenario files and the
table in `docs/environments.md` follow from the classes in this module. `zenostat.models.scenario.schema` validates the
values.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Annotated, Any, TypedDict, TypeVar, get_type_hints

from typing_extensions import Doc

_Init = TypeVar("_Init", bound=Callable[..., None])


class ModelArguments(TypedDict, total=False):
    """The building and its weather."""

    building: Annotated[str | Path | None, Doc("Short name, IDF or epJSON file, or any unique part of a listed name.")]
    weather: Annotated[
        str | Path | Sequence[str | Path] | None,
        Doc("Short name, EPW file, or any unique part of a listed name; of several, one is drawn for each episode."),
    ]


class ScenarioArguments(TypedDict, total=False):
    """All other arguments; None is the same as leaving one out."""

    scenario: Annotated[str | None, Doc("Scenario id, or scenario file (YAML); the other arguments override it.")]
    file: Annotated[str | Path | None, Doc("Scenario file (YAML); the other arguments override it.")]
    config: Annotated[str | Path | None, Doc("Sinergym configuration (YAML); the other arguments override it.")]
    variant: Annotated[
        str | None,
        Doc("Weather and form of the Sinergym configuration, such as `hot-continuous`; by default its first one."),
    ]
    sensors: Annotated[
        Mapping[str, Sequence[str | float | None]] | None,
        Doc(
            "Name to (variable, key), (variable, key, aggregation: mean, sum or instant) or, of a schedule, "
            "(variable, key, aggregation, lead_h), which is its value so many hours later; by default a set of the "
            "model's sensors."
        ),
    ]
    meters: Annotated[
        Mapping[str, str] | None, Doc("Name to EnergyPlus meter; by default a set of the model's meters.")
    ]
    actuators: Annotated[
        Mapping[str, Sequence[str | float]] | None,
        Doc(
            "Name to (component type, control type, key), optionally followed by low and high in the actuator's unit; "
            "by default a set of the model's actuators; empty: baseline control only."
        ),
    ]
    begin: Annotated[
        str | date | None,
        Doc("First day, MM-DD or YYYY-MM-DD; by default that of the scenario or of the model's run period."),
    ]
    end: Annotated[
        str | date | None,
        Doc("Last day, MM-DD or YYYY-MM-DD; by default that of the scenario or of the model's run period."),
    ]
    steps_per_hour: Annotated[
        int | None, Doc("Timesteps per hour, a divisor of 60 from 1 to 60; by default as in the model.")
    ]
    weather_order: Annotated[
        str | None, Doc("Order of several weather files: random, or sequence (they take turns, one per episode).")
    ]
    weather_noise: Annotated[
        Mapping[str, Any] | None,
        Doc("Noise by column of the weather file: sigma and mu in the column's unit, tau_h in hours."),
    ]
    noise_start: Annotated[
        str | None,
        Doc(
            "Where the noise begins: episode, or third_day (the first two days have none, and a reset is a fork, which "
            "takes milliseconds)."
        ),
    ]
    sizing: Annotated[
        str | None, Doc("Location and design days: weather (those of the weather file), or model (the model's own).")
    ]
    edits: Annotated[
        Mapping[str, Any] | None, Doc("Changes to objects of the model: type to object to field to value.")
    ]
    time: Annotated[
        Sequence[str] | None, Doc("Time features in the observation, before the sensors, such as month and hour.")
    ]
    aggregation: Annotated[
        str | None,
        Doc(
            "Aggregation of sensors without their own, mean or instant; by default mean for rates and energies, "
            "instant for states."
        ),
    ]
    actions: Annotated[
        Mapping[str, Any] | None,
        Doc("Dimensions of the action: name to the actuators that each sets; by default chosen by `control`."),
    ]
    control: Annotated[
        str | None,
        Doc(
            "Default actions: point (one for each actuator), zone (the same, with a separate choice for each zone if "
            "discrete), or building (one pair of setpoints for all thermostats)."
        ),
    ]
    relative: Annotated[
        float | Sequence[float] | Mapping[str, float | Sequence[float]] | None,
        Doc(
            "Actions are offsets to the building's own control, which 0 leaves as it is: their bounds, in K for "
            "temperatures, as a number (3 is -3 to 3) or (low, high), for all actions or by action; by default "
            "actions are absolute."
        ),
    ]
    discrete: Annotated[
        int | Sequence[Any] | None,
        Doc(
            "Discrete actions: tables of values, or the number (2 to 1000) of equal steps from the widest to the "
            "tightest setpoints; by default the actions are continuous."
        ),
    ]
    terminate: Annotated[
        Sequence[Mapping[str, Any]] | None,
        Doc("Limits that end an episode early: points, low and high in their unit, and duration_h (0 or more hours)."),
    ]
    output_dir: Annotated[
        str | Path | None, Doc("Keep EnergyPlus's output files in this folder, in one folder per episode.")
    ]
    keep_last: Annotated[
        int | None,
        Doc("Keep output files only for the running episode and this many before it (1 or more)."),
    ]
    unobserved: Annotated[
        Sequence[str] | None,
        Doc("Names of sensors and meters that are not part of the observation; a reward that names them reads them."),
    ]
    monitoring: Annotated[
        bool | None,
        Doc(
            "Also measure what pictures and reports need, without adding it to the observation: temperature, occupants "
            "and setpoints of each conditioned zone, outdoor temperature, the energy of each end use, and the "
            "electricity that a building with generators produces, buys and sells."
        ),
    ]
    systems: Annotated[
        bool | None,
        Doc(
            "Also measure what a schematic of the air and plant loops shows, without adding it to the observation: "
            "temperature, flow and setpoint at the components' outlets, and their powers."
        ),
    ]
    baseline: Annotated[bool | None, Doc("Also run each episode under baseline control, for comparison.")]
    branches: Annotated[int | None, Doc("Maximum number of snapshots and slots of branches at a time, 0 to 4096.")]
    unresponsive_s: Annotated[
        float | None, Doc("Kill an engine that neither answers nor computes for this long, in seconds, above 0.")
    ]
    shrink_caches: Annotated[
        bool | None,
        Doc(
            "Experimental: shrink one of EnergyPlus's caches in its memory, because a step then takes about 9 % less "
            "time and a branch 16 MB less memory, with equal results."
        ),
    ]
    record: Annotated[
        str | Path | None,
        Doc(
            "Record everything to this file (`.mcap`), or to a file of its own in this folder; see docs/recordings.md."
        ),
    ]
    record_on_full: Annotated[
        str | None, Doc("If the disk is slower than the node: `wait` for it, or `stop` the recording; by default wait.")
    ]
    faults: Annotated[str | Path | None, Doc("Plan of faults to inject (YAML); see docs/faults.md.")]
    alarms: Annotated[str | Path | None, Doc("Alarm rules of sensors and meters (YAML); see docs/alarms.md.")]


class PlantArguments(TypedDict, total=False):
    """A plant in place of a building: a Python class, an FMU or an electric grid."""

    plant: Annotated[
        str | None,
        Doc("Python class in place of a building, `FILE.py:CLASS` or `MODULE:CLASS`; see docs/own-plants.md."),
    ]
    fmu: Annotated[str | Path | None, Doc("FMU in place of a building (FMI 2.0 or 3.0); see docs/fmi.md.")]
    grid: Annotated[
        str | Path | None,
        Doc("Electric grid in place of a building, a file (YAML) or `pandapower:NAME`; see docs/grid.md."),
    ]
    plant_arguments: Annotated[Mapping[str, Any] | None, Doc("Arguments of the plant's class, by name.")]


class OtherArguments(ScenarioArguments, PlantArguments, total=False):
    """All arguments but building and weather."""


class NodeArguments(ModelArguments, OtherArguments, total=False):
    """The arguments of an environment that become settings of its node."""


class FileFields(TypedDict, total=False):
    """The fields of a scenario file that a node does not need."""

    id: Annotated[str, Doc("Name of the scenario, without `zenostat/`.")]
    about: Annotated[str, Doc("Description for users.")]
    reward: Annotated[Mapping[str, Any] | None, Doc("Kind of the reward and its parameters; null: always 0.")]
    wrappers: Annotated[
        Sequence[Mapping[str, Any]], Doc("Wrappers of the environment, by name with their arguments, innermost first.")
    ]


def _meanings(fields: type) -> dict[str, str]:
    hints = get_type_hints(fields, include_extras=True)
    return {name: hint.__metadata__[0].documentation for name, hint in hints.items()}


NODE_ARGUMENTS: tuple[str, ...] = tuple(_meanings(NodeArguments))
"""The arguments of an environment that become settings of a node."""

MEANING: Mapping[str, str] = _meanings(NodeArguments) | _meanings(FileFields)
"""The meaning of each argument and field, in a sentence."""


def expand_arguments(init: _Init) -> _Init:
    """List the arguments in the signature of a function in place of its `**arguments`, for `help` and completion."""
    signature = inspect.signature(init)
    own = [p for p in signature.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
    names = [name for name in NODE_ARGUMENTS if name not in signature.parameters]
    kind, hints = inspect.Parameter.KEYWORD_ONLY, get_type_hints(NodeArguments)
    shared = [inspect.Parameter(name, kind, default=None, annotation=hints[name]) for name in names]
    init.__signature__ = signature.replace(parameters=[*own, *shared])  # type: ignore[attr-defined]
    return init
