"""Options shared by several commands."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zenostat.bridge.transport.access_control import RESETTING
from zenostat.bridge.transport.session import (
    DEFAULT_ENDPOINT,
    OpenSession,
    default_endpoint,
    names_certificate,
    open_session,
)
from zenostat.cli.console import err
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.keys import Role

if TYPE_CHECKING:
    from zenostat import Bus

Connect = Annotated[str | None, typer.Option(help="Endpoint of the bus.", show_default=DEFAULT_ENDPOINT)]
Keys = Annotated[
    Path | None, typer.Option(help="Folder created by `zenostat keys init`: use TLS, with access rules per name.")
]
CertificateName = Annotated[str | None, typer.Option(help="Name of the certificate. [default: that of the role]")]
Node = Annotated[str, typer.Argument(help="Name of the node.")]
Slot = Annotated[int, typer.Option(min=0, help="Slot of a node with several engines.")]
Expose = Annotated[bool, typer.Option("--expose", help="Allow connections from other machines.")]
Wait = Annotated[
    bool, typer.Option("--wait", help="Wait for the bus and the node if they are not there yet, instead of ending.")
]

Price = Annotated[
    list[str] | None,
    typer.Option(
        "--price",
        metavar="FUEL=PRICE",
        help="Price of a fuel per kWh, for the KPI of cost: electricity=0.25, or a file with a year of hours "
        "(gas=gas.csv); repeatable.",
    ),
]
Emissions = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FUEL=FACTOR",
        help="Emission factor of a fuel in kg CO2 per kWh, for the KPI of emissions; as for --price.",
    ),
]


class Loops(StrEnum):
    """Treatment of loops, of which SSP does not say anything: solved within the step, or delayed by a step."""

    SOLVE = "solve"
    DELAY = "delay"


def only_node(names: list[str] | None) -> str:
    """Return the node that `--node` names, `*` if it names none; `InvalidConfig` if it names several."""
    if names is not None and len(names) > 1:
        raise InvalidConfig(f"--node: one node expected, or none for all, not {', '.join(names)}")
    return names[0] if names else "*"


@dataclass(frozen=True, slots=True)
class BusOptions:
    """The options of a command that connects to a bus."""

    connect: Connect = None
    keys: Keys = None
    certificate: CertificateName = None

    @property
    def endpoint(self) -> str:
        """The endpoint of the bus: the default one if none is named."""
        return self.connect or default_endpoint(self.keys)

    def open_bus(self, role: Role = Role.CONTROLLER, *, resets: bool = False) -> Bus:
        """Connect to the bus; with keys, by the certificate of this role.

        Args:
            role: Role that the certificate must have; all may read, so a named certificate may have any for `MONITOR`.
            resets: Whether the command also resets the node: the certificate must be that of a controller and operator,
                and is by default an environment's.

        Raises:
            NodeNotFound: No process listens at the endpoint.
            InvalidConfig: The endpoint is malformed, or the keys cannot be used.
        """
        from zenostat import connect

        required = RESETTING if resets else self._required(role)
        return connect(self.endpoint, keys=self.keys, role=required, certificate=self.certificate, warn=_warn_once)

    def open_session(self, role: Role = Role.CONTROLLER, *, wait: bool = False) -> OpenSession:
        """Open a Zenoh session instead, for programs without requests; arguments and errors as of `open_bus`."""
        required = self._required(role)
        return open_session(
            connect=[self.endpoint],
            wait=wait,
            keys=self.keys,
            role=required,
            certificate=self.certificate,
            warn=_warn_once,
        )

    def _required(self, role: Role) -> Role | None:
        return None if role is Role.MONITOR and names_certificate(self.keys, self.certificate) else role


@cache
def _warn_once(text: str) -> None:
    """Print a warning, however often the command connects."""
    err.warning(text)


DEFAULTS = BusOptions()
_FIELDS = tuple(inspect.signature(BusOptions, eval_str=True).parameters.values())


def on_bus(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of a bus, in place of its parameter `options`, which receives them."""
    signature = inspect.signature(command, eval_str=True)
    parameters: list[inspect.Parameter] = []
    for parameter in signature.parameters.values():
        parameters += _FIELDS if parameter.name == "options" else (parameter,)

    @wraps(command)
    def run(**arguments: Any) -> None:
        options = BusOptions(*(arguments.pop(field.name) for field in _FIELDS))
        command(options=options, **arguments)

    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return run


def is_explicit(context: typer.Context, name: str) -> bool:
    """Return whether an option is on the command line."""
    return getattr(context.get_parameter_source(name), "name", "") == "COMMANDLINE"
