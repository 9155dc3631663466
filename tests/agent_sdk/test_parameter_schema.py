"""Parameters of controllers as a schema: names, types, defaults and meanings of the class itself."""

import inspect
from typing import Any

import numpy as np
import pytest

from zenostat.agent_sdk.controllers import CONTROLLERS
from zenostat.agent_sdk.controllers.parameter_schema import check_values, parameters_model
from zenostat.agent_sdk.controllers.parameters import with_parameters
from zenostat.bridge.client.sample import SampleView
from zenostat.topics.errors import InvalidConfig


@pytest.mark.parametrize("name", CONTROLLERS)
def test_parameter_schema__has_each_parameter_with_its_default_and_meaning(name: str) -> None:
    factory = CONTROLLERS[name]
    schema = parameters_model(factory).model_json_schema()
    parameters = [*inspect.signature(factory).parameters.values()][1:]
    named = {each.name: each for each in parameters if each.kind is not each.VAR_KEYWORD}
    assert schema["properties"].keys() == named.keys()
    assert set(schema.get("required", [])) == {each.name for each in named.values() if each.default is each.empty}
    for field, parameter in named.items():
        entry = schema["properties"][field]
        assert entry["description"]
        assert entry.get("default", parameter.empty) == parameter.default
    assert bool(schema["additionalProperties"]) is (len(named) < len(parameters))


@pytest.mark.parametrize(
    ("name", "values", "text"),
    [
        ("rbc", {"margn": 1}, "did you mean 'margin'"),
        ("rbc", {"margin": "1"}, "margin: "),
        ("rbc", {"margin": True}, "margin: "),
        ("rbc", {"margin": float("nan")}, "margin: "),
        ("random", {"seed": 1.5}, "seed: "),
        ("setback", {"days": 3}, "days: "),
        ("pid", {}, "setpoint: it is missing"),
        ("fixed", {"pump": "x"}, "pump: "),
        ("fixed", {"pump": float("inf")}, "pump: "),
    ],
)
def test_parameter_schema__values_of_another_type_are_named(name: str, values: dict[str, Any], text: str) -> None:
    with pytest.raises(InvalidConfig, match=text):
        check_values(CONTROLLERS[name], values)


def test_parameter_schema__values_that_are_set_are_returned() -> None:
    assert check_values(CONTROLLERS["rbc"], {"margin": 1, "setback": None}) == {"margin": 1.0, "setback": None}
    assert check_values(CONTROLLERS["fixed"], {"pump": 3}) == {"pump": 3.0}


class _Own:
    """A user's class, as one may write it."""

    def __init__(self, manifest, gain=2, *, name="a", table=np.zeros(2), limit: "Unresolved | None" = None):  # type: ignore[no-untyped-def]  # noqa: F821, B008
        self.values = gain, name, table, limit

    def act(self, sample: SampleView) -> dict[str, float]:
        return {}


def test_parameter_schema__own_class_without_annotations_has_the_types_of_its_defaults() -> None:
    assert check_values(_Own, {"gain": 2.5, "name": "b"}) == {"gain": 2.5, "name": "b"}
    for wrong in ({"gain": "2"}, {"name": 1}, {"table": [1.0]}):
        with pytest.raises(InvalidConfig, match=next(iter(wrong))):
            check_values(_Own, wrong)


def test_parameter_schema__file_of_parameters_changes_the_defaults() -> None:
    schema = parameters_model(with_parameters(CONTROLLERS["rbc"], {"margin": 2.0})).model_json_schema()
    assert schema["properties"]["margin"]["default"] == 2.0
    assert schema["properties"]["setback"]["description"]
