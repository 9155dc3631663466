"""Controllers for the question "what if": the bundled ones, and those that the command line names.

A page names one of them with its parameters, which are numbers, texts and Booleans: it chooses neither code nor files.
"""

from __future__ import annotations

import inspect
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Annotated, Any

from pydantic import Field, StringConstraints, ValidationError

from zenostat.agent_sdk.controllers import CONTROLLERS, ControllerProtocol, load_controller, make_controller
from zenostat.agent_sdk.controllers.base import Finder
from zenostat.agent_sdk.controllers.controller_file import ControllerFile
from zenostat.agent_sdk.controllers.parameter_schema import check_values, parameters_model
from zenostat.bridge.client.connection import Connection
from zenostat.bridge.runtime.user_code import describe_user_error
from zenostat.bridge.transport.session import DEFAULT_ENDPOINT
from zenostat.topics.errors import InvalidConfig, UnknownName, UsageError, ZenostatError, did_you_mean
from zenostat.topics.messages import Manifest
from zenostat.views.room.requests import RoomRequest

_NOT_OFFERED = ("oracle",)
"""It plans in branches of an environment, and one of its parameters can name a class."""

Factory = Callable[..., ControllerProtocol]

BUNDLED: Mapping[str, Factory] = {name: factory for name, factory in CONTROLLERS.items() if name not in _NOT_OFFERED}
"""Bundled controllers that a page may name."""

Name = Annotated[str, StringConstraints(max_length=128)]
Text = Annotated[str, StringConstraints(max_length=200)]


def offered_controllers(own: Iterable[str]) -> Mapping[str, Factory]:
    """Return the controllers that a page may name, with those of the command line, as `load_controller` expects them.

    Raises:
        UnknownName, InvalidConfig: one cannot be loaded.
    """
    return {**BUNDLED, **{text: load_controller(text) for text in own}}


class TrialController(RoomRequest):
    """A controller by its name, and those of its parameters that differ from their defaults."""

    name: Annotated[str, StringConstraints(max_length=4096)]
    parameters: Annotated[dict[Name, bool | int | float | Text], Field(max_length=200)] = Field(default_factory=dict)

    def creator(self, offered: Mapping[str, Factory]) -> Callable[[Manifest], ControllerProtocol]:
        """Return what creates the controller of a node from its manifest; it raises `InvalidConfig` if that fails.

        Args:
            offered: controllers by name.

        Raises:
            UnknownName: there is no controller of that name.
            InvalidConfig: an unknown parameter, or one of another type.
        """
        if self.name not in offered:
            raise UnknownName(f"controller: there is no {self.name!r}; {did_you_mean(self.name, offered)}")
        factory = offered[self.name]
        try:
            values = check_values(factory, self.parameters)
        except InvalidConfig as error:
            raise InvalidConfig(f"controller {self.name}: {error}") from None

        def create(manifest: Manifest) -> ControllerProtocol:
            with self.described_errors():
                return make_controller(factory, manifest, values)

        return create

    @contextmanager
    def described_errors(self) -> Iterator[None]:
        """Raise what the controller itself raises as `InvalidConfig`, with the line of its file."""
        try:
            yield
        except ZenostatError:
            raise
        except Exception as error:
            raise InvalidConfig(f"controller {self.name}: {describe_user_error(error)}") from error

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


def controllers_content(
    manifest: Manifest, offered: Mapping[str, Factory], tuned: Mapping[str, ControllerFile]
) -> dict[str, Any]:
    """Return the controllers that a page may try on a node.

    Args:
        manifest: the node's.
        offered: controllers by name.
        tuned: controllers with parameters, by the name of the study that has found them.

    Returns:
        `controllers`: summary and schema of each, and why it does not suit the node. `tuned`: those of `tuned` that may
        be tried, with their parameters.
    """
    return {
        "controllers": [_entry(name, factory, manifest) for name, factory in offered.items()],
        "tuned": [
            {"study": study, "name": file.controller, "parameters": file.parameters}
            for study, file in tuned.items()
            if _may_try(file, offered)
        ],
    }


def _may_try(file: ControllerFile, offered: Mapping[str, Factory]) -> bool:
    try:
        trial = TrialController(name=file.controller, parameters=file.parameters)
        check_values(offered[trial.name], trial.parameters)
    except (ValidationError, UsageError, KeyError):
        return False
    return True


def _entry(name: str, factory: Factory, manifest: Manifest) -> dict[str, Any]:
    described = factory if isinstance(factory, type) else None  # a policy's factory says nothing of the policy
    summary = (inspect.getdoc(described) or "").partition("\n\n")[0].replace("\n", " ") if described else ""
    schema = parameters_model(factory).model_json_schema()
    problem = ""
    if not schema.get("required"):
        try:
            TrialController(name=name).creator({name: factory})(manifest)
        except InvalidConfig as error:
            problem = str(error)
    return {"name": name, "summary": summary, "schema": schema, "problem": problem}
