"""Options shared by several commands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from zenostat.bridge.transport.session import DEFAULT_ENDPOINT
from zenostat.topics.errors import InvalidConfig

Connect = Annotated[str | None, typer.Option(help="Endpoint of the bus.", show_default=DEFAULT_ENDPOINT)]
Keys = Annotated[
    Path | None, typer.Option(help="Folder created by `zenostat keys init`: use TLS, with access rules per role.")
]
CertificateName = Annotated[str | None, typer.Option(help="Certificate name, if it differs from the role's.")]
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


def read_rates(option: str, texts: Sequence[str] | None) -> dict[str, float | str]:
    """Parse texts of the form `fuel=number` or `fuel=file`.

    Raises:
        InvalidConfig: another form, or a fuel occurs twice.
    """
    rates: dict[str, float | str] = {}
    for text in texts or ():
        fuel, _, value = text.partition("=")
        if not fuel or not value:
            raise InvalidConfig(f"{option} {text}: expected a fuel and a number or file: {option} electricity=0.25")
        if fuel in rates:
            raise InvalidConfig(f"{option} {fuel} occurs twice: {rates[fuel]} and {value}")
        try:
            rates[fuel] = float(value)
        except ValueError:
            rates[fuel] = value
    return rates
