"""The ids of all scenarios, as constants: available without a data pack, EnergyPlus or I/O."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

Form = str
"""`continuous` or `discrete`."""

CONTINUOUS, DISCRETE = "continuous", "discrete"
_BOTH = (CONTINUOUS, DISCRETE)
_CLIMATES = ("hot", "mixed", "cool")

PACK_IDS: dict[str, tuple[tuple[str, ...], tuple[Form, ...]]] = {
    "5zone": (_CLIMATES, _BOTH),
    "datacenter_dx": (("chicago", *_CLIMATES), _BOTH),
    "datacenter_cw": (("chicago", *_CLIMATES), _BOTH),
    "smalldatacenter": (("aurora", *_CLIMATES), (CONTINUOUS,)),
    "office": (_CLIMATES, _BOTH),
    "warehouse": (_CLIMATES, _BOTH),
    "officegrid": (_CLIMATES, _BOTH),
    "shop": (_CLIMATES, _BOTH),
    "radiant": ((*_CLIMATES, "stockholm"), (DISCRETE,)),
}
"""Scenarios of the data pack `sinergym`: name, weathers and forms; each also as `-stochastic`, with weather noise."""

PAPER_IDS = (
    "paper-datacenter-mixed-continuous-v1",
    "paper-datacenter-mixed-continuous-stochastic-v1",
    "paper-datacenter_dx-mixed-continuous-v1",
    "paper-datacenter_dx-mixed-continuous-stochastic-v1",
)
"""Scenarios of the experiments in the Sinergym paper: on its own model of the data center, and on the corrected one."""

DEMO = "demo-v1"
"""The smallest scenario of the pack; its id contains neither a weather nor a form."""

BUILDINGS = (
    "apartment-high-rise",
    "apartment-mid-rise",
    "hospital",
    "hotel-large",
    "hotel-small",
    "office-large",
    "office-medium",
    "office-small",
    "outpatient",
    "ref-full-service-restaurant",
    "ref-hospital",
    "ref-large-hotel",
    "ref-large-office",
    "ref-medium-office",
    "ref-midrise-apartment",
    "ref-outpatient",
    "ref-primary-school",
    "ref-quick-service-restaurant",
    "ref-secondary-school",
    "ref-small-hotel",
    "ref-small-office",
    "ref-stand-alone-retail",
    "ref-strip-mall",
    "ref-super-market",
    "ref-warehouse",
    "restaurant-fast-food",
    "restaurant-sit-down",
    "retail-standalone",
    "retail-stripmall",
    "school-primary",
    "school-secondary",
    "warehouse",
)
"""Short names of the building models in the EnergyPlus wheel."""

WEATHERS = (
    "USA_AZ_Phoenix",
    "USA_CA_Fresno",
    "USA_CA_San.Francisco",
    "USA_CO_Boulder",
    "USA_CO_Colorado.Springs",
    "USA_CO_Denver",
    "USA_CO_Golden",
    "USA_FL_Miami",
    "USA_FL_Orlando",
    "USA_FL_Tampa",
    "USA_IL_Chicago",
    "USA_IL_University.of.Illinois",
    "USA_NJ_Newark",
    "USA_NV_Las.Vegas",
    "USA_OK_Oklahoma.City",
    "USA_VA_Sterling",
)
"""Short names of the weather files in the EnergyPlus wheel."""


def variants(building: str, weather: str, forms: Iterable[Form] = _BOTH) -> list[str]:
    """Return the ids for a building and a weather: all forms, then all forms with weather noise."""
    forms = list(forms)
    return [f"{building}-{weather}-{form}{noise}-v1" for noise in ("", "-stochastic") for form in forms]


@cache
def pack_ids() -> tuple[str, ...]:
    """Return the 109 ids of the data pack `sinergym`, in its order."""
    return (
        DEMO,
        *(
            scenario
            for building, (weathers, forms) in PACK_IDS.items()
            for weather in weathers
            for scenario in variants(building, weather, forms)
        ),
    )


@cache
def bundled_ids() -> tuple[str, ...]:
    """Return the 2048 ids of the EnergyPlus wheel: each model with each weather file."""
    return tuple(scenario for building in BUILDINGS for weather in WEATHERS for scenario in variants(building, weather))


@cache
def all_ids() -> tuple[str, ...]:
    """Return all ids: those of data packs first."""
    return (*pack_ids(), *PAPER_IDS, *bundled_ids())
