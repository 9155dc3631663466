"""Bundled controllers for the question "what if".

A page names one of them with its parameters, which are numbers, texts and Booleans: it chooses neither code nor files.
"""

from __future__ import annotations

import inspect
import shlex
from collections.abc import Callable, Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from zenostat.agent_sdk.controllers import CONTROLLERS, Agent, Controller, make_controller
from zenostat.agent_sdk.controllers.base import Finder
from zenostat.agent_sdk.controllers.controller_file import ControllerFile
from zenostat.agent_sdk.controllers.parameter_schema import check_values, parameters_model
from zenostat.bridge.client.connection import Connection
from zenostat.bridge.transport.session import DEFAULT_ENDPOINT
from zenostat.topics.errors import InvalidConfig, UnknownName, UsageError, did_you_mean
from zenostat.topics.messages import Manifest

_NOT_OFFERED = ("oracle",)
"""It plans in branches of an environment, and one of its parameters can name a class."""

OFFERED: Mapping[str, type[Controller]] = {
    name: factory for name, factory in CONTROLLERS.items() if name not in _NOT_OFFERED
}
"""Controllers that a page may name."""

Name = Annotated[str, StringConstraints(max_length=128)]
Text = Annotated[str, StringConstraints(max_length=200)]


class TrialController(BaseModel):
    """A bundled controller, and those of its parameters that differ from their defaults."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    name: Name
    parameters: Annotated[dict[Name, bool | int | float | Text], Field(max_length=200)] = Field(default_factory=dict)

    def factory(self) -> type[Controller]:
        """Return its class.

        Raises:
            UnknownName: there is no bundled controller of that name.
            InvalidConfig: an unknown parameter, or one of another type.
        """
        if self.name not in OFFERED:
            raise UnknownName(
                f"controller: there is no bundled controller {self.name!r}; {did_you_mean(self.name, OFFERED)}"
            )
        factory = OFFERED[self.name]
        check_values(factory, self.parameters)
        return factory

    def agent(self, manifest: Manifest, semantic: Callable[[], Finder]) -> Agent:
        """Return the controller of a node; `semantic` reads the model that some ask for their points.

        Raises:
            UnknownName, InvalidConfig: see `factory`; or the node lacks what the controller needs.
        """
        factory = self.factory()
        values = check_values(factory, self.parameters)
        return Agent(make_controller(factory, manifest, values), semantic=semantic)

    def command(self, node: str, priority: int, endpoint: str, *, has_keys: bool) -> str:
        """Return the command that starts it on a node, for a terminal on the control room's machine."""
        parts = ["zenostat", "run", "--node", node, "--controller", self.name]
        for name, value in self.parameters.items():
            parts += ["--set", f"{name}={value}"]
        parts += ["--priority", str(priority)]
        parts += ["--connect", endpoint] if endpoint != DEFAULT_ENDPOINT else []
        parts += ["--keys", "FOLDER"] if has_keys else []
        return shlex.join(parts)


def semantic_model(bus: Connection, node: str) -> Finder:
    """Return the semantic model of a node's building; needs rdflib."""
    from zenostat.agent_sdk import semantic

    return semantic.read(bus, node)


def controllers_content(manifest: Manifest, tuned: Mapping[str, ControllerFile]) -> dict[str, Any]:
    """Return the controllers that a page may try on a node.

    Args:
        manifest: the node's.
        tuned: controllers with parameters, by the name of the study that has found them.

    Returns:
        `controllers`: summary and schema of each, and why it does not suit the node. `tuned`: those of `tuned` that may
        be tried, with their parameters.
    """
    return {
        "controllers": [_entry(name, factory, manifest) for name, factory in OFFERED.items()],
        "tuned": [
            {"study": study, "name": file.controller, "parameters": file.parameters}
            for study, file in tuned.items()
            if _may_try(file)
        ],
    }


def _may_try(file: ControllerFile) -> bool:
    try:
        TrialController(name=file.controller, parameters=file.parameters).factory()
    except (ValidationError, UsageError):
        return False
    return True


def _entry(name: str, factory: type[Controller], manifest: Manifest) -> dict[str, Any]:
    summary = (inspect.getdoc(factory) or "").partition("\n\n")[0].replace("\n", " ")
    schema = parameters_model(factory).model_json_schema()
    problem = ""
    if not schema.get("required"):
        try:
            make_controller(factory, manifest, {})
        except InvalidConfig as error:
            problem = str(error)
    return {"name": name, "summary": summary, "schema": schema, "problem": problem}
