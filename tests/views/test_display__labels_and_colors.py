"""Names that a person reads, and colors that are told apart on light and dark ground."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.builders import sensor

from zenostat.metrics.labels import label, point_unit, unit_label, zone_label, zone_labels
from zenostat.topics.energyplus_names import END_USES
from zenostat.views.display.colors import (
    COMFORT_RANGE_K,
    OUTDOOR,
    UNKNOWN,
    WITHIN,
    comfort_color,
    comfort_colors,
    contrast,
    end_use_color,
    hex_color,
    zone_color,
)
from zenostat.views.live import series

WHITE, DARK = (255, 255, 255), (13, 17, 23)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("core_bottom_cooling_setpoint", "Core bottom cooling setpoint"),
        ("HVAC_electricity_demand_rate", "HVAC electricity demand rate"),
        ("perimeter_bot_zn_1_air_temperature", "Perimeter bottom zone 1 air temperature"),
        ("co2_emission", "CO2 emission"),
        ("cop", "COP"),
        ("compressor", "Compressor"),
        ("__", "__"),
    ],
)
def test_display__labels_of_points(name: str, text: str) -> None:
    assert label(name) == text


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("CORE_BOTTOM", "Core bottom"),
        ("Core_bottom", "Core bottom"),
        ("PERIMETER_BOT_ZN_1", "Perimeter bottom 1"),
        ("CORE_ZN", "Core"),
        ("ZN_1_FLR_1_SEC_5", "Zone 1 floor 1 section 5"),
        ("Zone1 Office", "Zone 1 office"),
        ("Büro Straße", "Büro straße"),
        ("East Zone", "East zone"),
        ("SPACE5-1", "Space 5-1"),
        ("GroundFloor_Plenum", "Ground floor plenum"),
        ("FirstFloor:LivingRoom", "First floor living room"),
        ("G SW APARTMENT", "G SW apartment"),
        ("F2 N1 APARTMENT", "F2 N1 apartment"),
        ("Thermal Zone: Attic", "Thermal zone attic"),
        ("ZN", "Zone"),
        ("", ""),
    ],
)
def test_display__labels_of_zones(key: str, text: str) -> None:
    assert zone_label(key) == text


@given(st.lists(st.text(), unique=True))
def test_display__labels_of_a_building_are_distinct(keys: list[str]) -> None:
    labels = zone_labels(keys)
    assert len(labels) == len(keys)
    duplicates = [(a, b) for (a, x), (b, y) in combinations(zip(keys, labels, strict=True), 2) if x == y]
    assert duplicates == []


def test_display__units_are_those_of_engineers() -> None:
    units = {"degC": "°C", "percent": "%", "W": "W", "delta_degC": "K", "1": "", "W/m2": "W/m²", "furlong": "furlong"}
    assert {unit: unit_label(unit) for unit in units} == units
    assert point_unit(sensor("n", "Zone People Occupant Count", "core", "1")) == "people"
    assert point_unit(sensor("n", "Zone Air Temperature", "core", "degC")) == "°C"


def lab(color: tuple[int, ...]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """OKLab of a color (B. Ottosson), where a distance of 0.02 is just noticeable."""
    channels = np.array(color) / 255.0
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    cones = np.array(
        [[0.4122214708, 0.5363325363, 0.0514459929],
         [0.2119034982, 0.6806995451, 0.1073969566],
         [0.0883024619, 0.2817188376, 0.6299787005]]
    ) @ linear  # fmt: skip
    result: np.ndarray[tuple[int], np.dtype[np.float64]] = np.array(
        [[0.2104542553, 0.7936177850, -0.0040720468],
         [1.9779984951, -2.4285922050, 0.4505937099],
         [0.0259040371, 0.7827717662, -0.8086757660]]
    ) @ np.cbrt(cones)  # fmt: skip
    return result


def distance(first: tuple[int, ...], second: tuple[int, ...]) -> float:
    return float(np.linalg.norm(lab(first) - lab(second)))


_LINEAR_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_DEUTERANOPIA = np.array(
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
)
"""Severity 1.0 of G. Machado, M. Oliveira, L. Fernandes, 2009, for linear sRGB."""


def deuteranopic_distance(first: tuple[int, ...], second: tuple[int, ...]) -> float:
    """CIE 1976 color difference as a reader with deuteranopia sees it."""
    return float(np.linalg.norm(_deuteranopic_lab(first) - _deuteranopic_lab(second)))


def _deuteranopic_lab(color: tuple[int, ...]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    channels = np.array(color) / 255.0
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    xyz = _LINEAR_TO_XYZ @ np.clip(_DEUTERANOPIA @ linear, 0.0, 1.0) / _LINEAR_TO_XYZ.sum(axis=1)
    x, y, z = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def test_display__distance_of_deuteranopes_is_that_of_colors_which_they_confuse() -> None:
    assert deuteranopic_distance(WHITE, (0, 0, 0)) == pytest.approx(100.0, abs=0.1)
    # Orange red and olive: 67 apart for other readers.
    assert deuteranopic_distance((224, 86, 51), (142, 143, 25)) == pytest.approx(2.7, abs=0.05)


def test_zone_colors__differ_for_thirty_zones_on_both_backgrounds() -> None:
    colors = [zone_color(place) for place in range(30)]
    assert min(distance(a, b) for a, b in combinations(colors, 2)) > 0.04
    assert min(deuteranopic_distance(a, b) for a, b in combinations(colors[:24], 2)) >= 10.0
    for ground in (WHITE, DARK):
        assert min(contrast(color, ground) for color in (*colors, OUTDOOR, UNKNOWN)) >= 3.0
    assert all(contrast(zone_color(place), WHITE) >= 3.0 for place in range(30, 200))  # of any number


def test_display__end_uses_have_colors_of_their_own() -> None:
    labels = {"humidifier": "humidification"}
    names = ["".join(f" {c.lower()}" if c.isupper() else c for c in use).strip() for use in END_USES]
    uses = [labels.get(name, name) for name in names]
    colors = [end_use_color(use, fuel) for use in uses for fuel in ("electricity", "natural gas")]
    colors.append(end_use_color("facility", "natural gas"))  # a fuel without end uses
    assert UNKNOWN not in colors
    assert min(distance(a, b) for a, b in combinations(colors, 2)) > 0.04
    assert min(deuteranopic_distance(a, b) for a, b in combinations(colors, 2)) >= 10.0
    for ground in (WHITE, DARK):
        assert min(contrast(color, ground) for color in colors) >= 3.0
    assert end_use_color("nonsense") == UNKNOWN


@pytest.mark.parametrize(
    "colors",
    [
        (series.COLDEST, series.MEDIAN, series.WARMEST, series.BAND),
        (series.FACILITY, series.HVAC, end_use_color("facility", "natural gas")),
        (series.ZONE, series.HEATING, series.COOLING),
    ],
    ids=["temperatures", "power", "zone"],
)
def test_line_colors__differ_on_both_backgrounds(colors: tuple[tuple[int, int, int], ...]) -> None:
    assert min(deuteranopic_distance(a, b) for a, b in combinations(colors, 2)) >= 10.0
    assert min(contrast(color, ground) for color in colors for ground in (WHITE, DARK)) >= 3.0


def test_display__comfort_scale_is_read_with_deuteranopia() -> None:
    steps = [comfort_color(k) for k in (-4.0, -2.0, -0.05, 0.0, 0.05, 2.0, 4.0)]
    assert min(deuteranopic_distance(a, b) for a, b in combinations(steps, 2)) >= 10.0


def test_display__contrast_is_that_of_wcag() -> None:
    assert contrast(WHITE, (0, 0, 0)) == pytest.approx(21.0)
    assert contrast((119, 119, 119), WHITE) == pytest.approx(4.48, abs=0.01)  # the known limit of gray on white: #777
    assert hex_color((31, 119, 180)) == "#1f77b4"


def test_display__comfort_scale_is_blue_below_pale_within_orange_above_and_gray_if_unknown() -> None:
    cold, within, warm, unknown = (comfort_color(k) for k in (-2.0, 0.0, 2.0, float("nan")))
    assert cold[2] > cold[1] > cold[0]
    assert warm[0] > warm[1] > warm[2]
    assert (within, unknown) == (WITHIN, UNKNOWN)
    assert comfort_color(-9.0) == comfort_color(-COMFORT_RANGE_K)
    assert comfort_color(float("inf")) == comfort_color(COMFORT_RANGE_K)
    assert distance(comfort_color(0.05), within) > 0.04  # just outside is seen
    assert distance(comfort_color(-0.05), within) > 0.04
    assert comfort_colors([[1.0, 2.0, 3.0]]).shape == (1, 3, 3)


@given(st.floats(0.05, 3.9), st.floats(0.05, 0.1))
def test_display__farther_outside_the_darker(deviation_k: float, more_k: float) -> None:
    """So the scale is read without seeing hues."""
    for sign in (-1.0, 1.0):
        near, far = comfort_color(sign * deviation_k), comfort_color(sign * (deviation_k + more_k))
        assert lab(far)[0] < lab(near)[0]
