"""`zenostat engine`: which EnergyPlus runs, and where it is from."""

from __future__ import annotations

from zenostat.cli.tables import AsJson, show, show_json


def engine(as_json: AsJson = False) -> None:
    """Show the EnergyPlus that runs: its version, its library and where that is from.

    Example: `zenostat engine`
    """
    from zenostat.models.engine_library import VARIABLE, WHEEL, engine_library

    library = engine_library()
    is_wheel = library.origin == WHEEL
    origin = "the wheel pyenergyplus-lbnl" if is_wheel else f"{VARIABLE}={library.origin}"
    values = {"version": library.version, "library": str(library.path), "from": origin}
    if as_json:
        show_json(values)
    else:
        show("", ("EnergyPlus", ""), list(values.items()), wrap=("",))
