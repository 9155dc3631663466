"""The operations of a test: paths, methods, fields of their bodies, and what they call."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from zenostat.gateways.boptest.extensions import ExtendedTest
from zenostat.gateways.boptest.session import Answer

_BEYOND = "Beyond BOPTEST"
_NUMBER = {"type": "number"}
_TEXT = {"type": "string"}
_READING = ("/results", "/forecast")
_NAMES = {"type": "array", "items": _TEXT}


@dataclass(frozen=True, slots=True)
class Operation:
    """A request of a test.

    Attributes:
        method, path: of the request; the path without the test id.
        summary: for the OpenAPI page.
        call: carries it out.
        fields: JSON schema of each field of the body; None where there is no body.
        tag: section of the OpenAPI page.
    """

    method: str
    path: str
    summary: str
    call: Callable[[ExtendedTest, Mapping[str, Any]], Answer]
    fields: Mapping[str, Any] | None = None
    tag: str = "A test"
    required: tuple[str, ...] = field(default=())

    @property
    def takes_fields(self) -> bool:
        """Whether it has a body."""
        return self.fields is not None

    @property
    def is_reading(self) -> bool:
        """Whether it leaves the test as it is."""
        return self.method == "GET" or self.path in _READING

    def schema(self) -> dict[str, Any]:
        """Return its part of an OpenAPI document."""
        parameters = [{"name": "testid", "in": "path", "required": True, "schema": _TEXT}]
        document: dict[str, Any] = {"parameters": parameters}
        if self.fields is not None:
            body: dict[str, Any] = {"type": "object", "properties": dict(self.fields)}
            if self.required:
                body["required"] = list(self.required)
            document["requestBody"] = {"content": {"application/json": {"schema": body}}}
        return document


def _times(*names: str) -> dict[str, Any]:
    return {name: {**_NUMBER, "description": "seconds"} for name in names}


OPERATIONS: tuple[Operation, ...] = (
    Operation("GET", "/name", "Name of the test case", lambda test, _: test.name()),
    Operation("GET", "/inputs", "Inputs with units and bounds", lambda test, _: test.inputs()),
    Operation("GET", "/measurements", "Measurements with units", lambda test, _: test.measurements()),
    Operation("GET", "/forecast_points", "Points of forecasts with units", lambda test, _: test.forecast_points()),
    Operation("GET", "/step", "The control step in seconds", lambda test, _: test.get_step()),
    Operation("PUT", "/step", "Set the control step", ExtendedTest.set_step, _times("step"), required=("step",)),
    Operation(
        "PUT",
        "/initialize",
        "Begin at a time, after a warm-up under the baseline control",
        ExtendedTest.initialize,
        _times("start_time", "warmup_period", "final_time"),
        required=("start_time", "warmup_period"),
    ),
    Operation(
        "POST", "/advance", "Simulate a control step with inputs `x_u` and `x_activate`", ExtendedTest.advance, {}
    ),
    Operation("GET", "/scenario", "The scenario", lambda test, _: test.get_scenario()),
    Operation(
        "PUT",
        "/scenario",
        "Set prices, test period and uncertainty of forecasts",
        ExtendedTest.set_scenario,
        {
            "electricity_price": _TEXT,
            "time_period": _TEXT,
            "temperature_uncertainty": _TEXT,
            "solar_uncertainty": _TEXT,
            "seed": {"type": "integer"},
        },
    ),
    Operation(
        "PUT",
        "/results",
        "Stored values of points in a range of times",
        ExtendedTest.results,
        {"point_names": _NAMES, **_times("start_time", "final_time")},
        required=("point_names", "start_time", "final_time"),
    ),
    Operation("GET", "/kpi", "Key performance indicators since the beginning", lambda test, _: test.kpis()),
    Operation(
        "PUT",
        "/forecast",
        "Forecasts from now to a horizon",
        ExtendedTest.forecast,
        {"point_names": _NAMES, **_times("horizon", "interval")},
        required=("point_names", "horizon", "interval"),
    ),
    Operation(
        "POST",
        "/submit",
        "The record for a dashboard",
        ExtendedTest.submit,
        {"api_key": _TEXT, "unit_test": _TEXT, **{f"tag{number}": _TEXT for number in range(1, 11)}},
        required=("api_key",),
    ),
    Operation("POST", "/snapshot", "Take a snapshot", lambda test, _: test.take_snapshot(), tag=_BEYOND),
    Operation(
        "PUT",
        "/snapshot",
        "Return to a snapshot",
        ExtendedTest.restore,
        {"snapshot": _TEXT},
        tag=_BEYOND,
        required=("snapshot",),
    ),
    Operation(
        "DELETE",
        "/snapshot",
        "Drop a snapshot",
        ExtendedTest.drop_snapshot,
        {"snapshot": _TEXT},
        tag=_BEYOND,
        required=("snapshot",),
    ),
    Operation(
        "GET",
        "/baseline",
        "Measurements, inputs and KPIs under the baseline control, at the test's time",
        lambda test, _: test.baseline(),
        tag=_BEYOND,
    ),
)
