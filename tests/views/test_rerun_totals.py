"""Energy and degree-hours so far, by hand."""

import numpy as np
import pytest
from support import builders
from support.monitor import office, rows, samples

from zenostat.metrics.comfort import default_comfort
from zenostat.metrics.roles import roles
from zenostat.views.live.samples import BlockReader
from zenostat.views.live.totals import TotalRows, Totals


def _add(totals: Totals, table: np.ndarray, *, first: int = 0, fault_free: np.ndarray | None = None) -> TotalRows:
    manifest = office()
    reader = BlockReader(manifest, default_comfort(manifest))
    return totals.add(reader.block(samples(manifest, table, first=first, fault_free=fault_free)))


def test_rerun_totals__degree_hours_are_deviations_times_hours_over_all_zones() -> None:
    table = rows(3, core_air_temperature=[30, 28, 22], perimeter_air_temperature=[22, 17, 19], core_occupants=[0, 1, 1])
    sums = _add(Totals(office(), roles(office())), table)
    # Sample 0 does not count; then 2 K above and 3 K below for a quarter of an hour, then 1 K below.
    assert sums.outside_kh == pytest.approx([0.0, 1.25, 1.5])
    assert sums.occupied_kh == pytest.approx([0.0, 0.5, 0.5])


def test_rerun_totals__energy_goes_on_in_the_next_block() -> None:
    totals = Totals(office(), roles(office()))
    first = _add(totals, rows(2, electricity=3.6e6))
    second = _add(totals, rows(2, electricity=7.2e6), first=2)
    assert first.facility_kwh == pytest.approx([0.0, 1.0])
    assert second.facility_kwh == pytest.approx([3.0, 5.0])
    assert second.facility_kw == pytest.approx([8.0, 8.0])
    assert np.isnan(second.hvac_kwh).all()


def test_rerun_totals__injected_faults_do_not_count() -> None:
    sums = _add(
        Totals(office(), roles(office())), rows(2, core_air_temperature=90.0), fault_free=rows(2)
    )  # a sensor that reads 90 degC in a zone at 22 degC
    assert sums.outside_kh.tolist() == [0.0, 0.0]


def test_rerun_totals__unknown_temperatures_are_not_outside() -> None:
    sums = _add(Totals(office(), roles(office())), rows(2, core_air_temperature=float("nan")))
    assert sums.outside_kh.tolist() == [0.0, 0.0]


def test_rerun_totals__peak_is_that_of_the_timesteps_so_far() -> None:
    totals = Totals(office(), roles(office()))
    first = _add(totals, rows(3, electricity=[9e6, 3.6e6, 1.8e6]))  # sample 0 does not count
    second = _add(totals, rows(2, electricity=[0.9e6, 5.4e6]), first=3)
    np.testing.assert_allclose(first.peak_kw, [np.nan, 4.0, 4.0])
    np.testing.assert_allclose(second.peak_kw, [4.0, 6.0])


def test_rerun_totals__fuels_besides_electricity_are_added_up() -> None:
    """900 kJ in a quarter of an hour are 1 kW, and a quarter of a kilowatt hour."""
    manifest = office(meters=[builders.meter("electricity"), builders.meter("gas", "NaturalGas:Facility")])
    table = rows(3)
    table[:, 6] = [1.8e6, 0.9e6, 0.9e6]
    reader = BlockReader(manifest, default_comfort(manifest))
    sums = Totals(manifest, roles(manifest)).add(reader.block(samples(manifest, table)))
    np.testing.assert_allclose(sums.fuels_kw, [[2.0], [1.0], [1.0]])
    np.testing.assert_allclose(sums.fuels_kwh, [[0.0], [0.25], [0.5]])
