"""Each output variable and meter of each building equals EnergyPlus's own report."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.data_packs import sinergym
from support.every_variable import PAGE, compare, page

from zenostat.models.catalog import building_name, bundled_buildings
from zenostat.models.data_packs import PACKS

BUNDLED = [entry.name for entry in bundled_buildings()]
PACKED = [f"sinergym/{building_name(stem)}" for stem in PACKS["sinergym"].buildings]


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("building", [*BUNDLED, *PACKED])
def test_fidelity__every_variable_of_the_building_equals_the_report(building: str, folder: Path) -> None:
    """First, middle and last key of each variable as mean or sum and as state, and each meter."""
    if building in PACKED:
        sinergym()
    row = compare(building, folder)
    assert row.points > 100
    assert row.differing == ()


def test_fidelity__page_has_a_table_whose_rows_are_kept() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert page(text, []) == text
