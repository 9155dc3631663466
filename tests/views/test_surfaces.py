"""Polygons of a geometry: triangles, areas, directions, and the sun; against hand calculation and properties."""

from datetime import datetime
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.examples import examples

from zenostat.topics import codec
from zenostat.topics.errors import BadMessage
from zenostat.topics.messages import Geometry, SurfaceKind, ZoneGeometry
from zenostat.views.display.surfaces import (
    area,
    azimuth_deg,
    sun_direction,
    surfaces,
    tilt_deg,
    triangulate,
    unit_normal,
)

SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], float)
# A frame whose hole is joined to its outside by a cut, as EnergyPlus's polygons with holes are.
FRAME = np.array(
    [[0, 0, 0], [6, 0, 0], [6, 6, 0], [0, 6, 0], [0, 0, 0], [2, 2, 0], [2, 4, 0], [4, 4, 0], [4, 2, 0], [2, 2, 0]],
    float,
)
COMB = np.array(
    [[0, 0, 0], [7, 0, 0], [7, 3, 0], [6, 1, 0], [5, 3, 0], [4, 1, 0], [3, 3, 0], [2, 1, 0], [0, 3, 0]], float
)


@st.composite
def placed_polygons(draw: st.DrawFn) -> np.ndarray:
    """A star-shaped polygon, mostly concave, turned and moved in space."""
    angles = np.cumsum(draw(st.lists(st.floats(0.4, 1), min_size=4, max_size=24)))
    angles *= 2 * pi / angles[-1]  # each gap is below a half turn, so that the origin is inside
    radii = draw(st.lists(st.floats(0.2, 20), min_size=len(angles), max_size=len(angles)))
    flat = np.array([[r * cos(a), r * sin(a), 0] for r, a in zip(radii, angles, strict=True)])
    a, b, c = (draw(st.floats(0, 2 * pi)) for _ in range(3))
    turn = np.array([[cos(a), -sin(a), 0], [sin(a), cos(a), 0], [0, 0, 1]]) @ np.array(
        [[1, 0, 0], [0, cos(b), -sin(b)], [0, sin(b), cos(b)]]
    )
    spin = np.array([[cos(c), -sin(c), 0], [sin(c), cos(c), 0], [0, 0, 1]])
    return flat @ (turn @ spin).T + np.array([draw(st.floats(-500, 500)) for _ in range(3)])


def check_triangles(corners: np.ndarray) -> None:
    """The triangles cover the polygon once: they have its orientation, and their areas sum to its own."""
    triangles = triangulate(corners)
    assert triangles.shape == (len(corners) - 2, 3)
    assert sum(area(corners[t]) for t in triangles) == pytest.approx(area(corners), rel=1e-9)
    for triangle in triangles:
        if area(corners[triangle]) > 1e-6 * area(corners):
            assert unit_normal(corners[triangle]) @ unit_normal(corners) > 0.99


@pytest.mark.slow
@settings(max_examples=examples(200), deadline=None)
@given(placed_polygons())
def test_surfaces__triangles_cover_a_concave_polygon_once(corners: np.ndarray) -> None:
    check_triangles(corners)
    check_triangles(corners[::-1])


@pytest.mark.parametrize("corners", [SQUARE, COMB, FRAME, np.insert(SQUARE, 1, [[1, 0, 0]] * 2, axis=0)])
@pytest.mark.parametrize("axes", [(0, 1, 2), (1, 2, 0), (2, 0, 1), (1, 0, 2)])
def test_surfaces__triangles_cover_polygons_with_holes_and_repeated_corners(
    corners: np.ndarray, axes: tuple[int, ...]
) -> None:
    check_triangles(corners[:, axes])


def test_surfaces__polygon_has_three_corners() -> None:
    with pytest.raises(ValueError, match="at least 3 corners, not 2"):
        triangulate(SQUARE[:2])


@pytest.mark.parametrize(
    ("corners", "azimuth", "tilt"),
    [
        ([(0, 0, 3), (0, 0, 0), (4, 0, 0), (4, 0, 3)], 180, 90),  # seen from the south: down, to the right, up
        ([(4, 2, 3), (4, 2, 0), (0, 2, 0), (0, 2, 3)], 0, 90),
        ([(4, 0, 3), (4, 0, 0), (4, 3, 0), (4, 3, 3)], 90, 90),
        ([(0, 3, 3), (0, 3, 0), (0, 0, 0), (0, 0, 3)], 270, 90),
        ([(0, 0, 0), (3, 0, 0), (3, 4, 0), (0, 4, 0)], 0, 0),
        ([(0, 4, 0), (3, 4, 0), (3, 0, 0), (0, 0, 0)], 0, 180),
        ([(0, 0, 0), (3, 0, 0), (3, 4, 3), (0, 4, 3)], 180, 36.8699),  # a roof that rises 3 on 4 to the north
    ],
)
def test_surfaces__directions_follow_from_the_corners(
    corners: list[tuple[float, ...]], azimuth: float, tilt: float
) -> None:
    polygon = np.array(corners, float)
    assert azimuth_deg(polygon) == pytest.approx(azimuth, abs=1e-6)
    assert tilt_deg(polygon) == pytest.approx(tilt, abs=1e-4)


def test_surfaces__area_is_exact_far_from_the_origin() -> None:
    assert area(SQUARE + np.array([1e6, -1e6, 3e3])) == pytest.approx(4, rel=1e-9)


def geometry(**fields: object) -> Geometry:
    corners = np.concatenate([SQUARE, SQUARE[:3] + 1]).astype("<f4")
    usual = {
        "zones": (ZoneGeometry(name="A", storey=0, floor_area_m2=4, is_conditioned=True),),
        "storeys": (0.0,),
        "latitude_deg": 40.0,
        "longitude_deg": -105.0,
        "time_zone_h": -7.0,
        "kinds": bytes([SurfaceKind.ROOF, SurfaceKind.SHADING]),
        "zone_index": np.array([0, -1], "<i2").tobytes(),
        "exposed": bytes([1, 0]),
        "corner_counts": np.array([4, 3], "<u2").tobytes(),
        "corners": corners.tobytes(),
    }
    return Geometry(**usual | fields)  # type: ignore[arg-type]


def test_surfaces__are_decoded_in_order() -> None:
    roof, shade = surfaces(codec.decode(Geometry, codec.encode(geometry())))
    assert (roof.kind, roof.zone, roof.is_exposed) == (SurfaceKind.ROOF, 0, True)
    assert (shade.kind, shade.zone, shade.is_exposed) == (SurfaceKind.SHADING, None, False)
    assert np.array_equal(roof.corners, SQUARE)
    assert np.array_equal(shade.corners, SQUARE[:3] + 1)
    assert (roof.area_m2, roof.tilt_deg, tuple(roof.normal)) == (4.0, 0.0, (0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"kinds": bytes([0, 99])}, "its kinds contain 99"),
        ({"zone_index": np.array([0, 1], "<i2").tobytes()}, "zone_index has values from 0 to 1; there are 1 zones"),
        ({"zone_index": np.array([-2, 0], "<i2").tobytes()}, "zone_index has values from -2 to 0"),
        ({"exposed": b"\x01"}, "exposed has 1 bytes; 2 expected"),
        ({"corner_counts": np.array([5, 2], "<u2").tobytes()}, "a surface has fewer than 3 corners"),
        ({"corner_counts": np.array([4, 4], "<u2").tobytes()}, "corners has 84 bytes; 96 expected"),
        ({"corners": np.full(21, np.nan, "<f4").tobytes()}, "corners contains NaN"),
    ],
)
def test_surfaces__arrays_that_do_not_fit_are_named(fields: dict[str, bytes], text: str) -> None:
    with pytest.raises(BadMessage, match=text):
        surfaces(geometry(**fields))


def test_surfaces__geometry_without_surfaces_is_empty() -> None:
    empty = dict.fromkeys(("kinds", "zone_index", "exposed", "corner_counts", "corners"), b"")
    assert surfaces(geometry(**empty)) == []


@pytest.mark.parametrize(
    ("latitude", "month", "day", "elevation", "azimuth"),
    [
        (40.0, 6, 21, 90 - 40 + 23.44, 180),
        (40.0, 12, 21, 90 - 40 - 23.44, 180),
        (-35.0, 12, 21, 90 - 35 + 23.44, 0),
        (60.0, 3, 20, 30, 180),
    ],
)
def test_surfaces__noon_sun_of_solstices_and_equinox(
    latitude: float, month: int, day: int, elevation: float, azimuth: float
) -> None:
    # At the meridian of the time zone, the sun culminates within 17 minutes of noon.
    minutes = [sun_direction(latitude, 30.0, 2.0, datetime(2017, month, day, 11, m)) for m in range(60)]
    minutes += [sun_direction(latitude, 30.0, 2.0, datetime(2017, month, day, 12, m)) for m in range(60)]
    noon = max(minutes, key=lambda direction: direction[1])
    assert noon[1] == pytest.approx(elevation, abs=0.6)
    assert (noon[0] - azimuth + 180) % 360 - 180 == pytest.approx(0, abs=0.5)


def test_surfaces__sun_rises_in_the_east_and_is_below_the_horizon_at_night() -> None:
    morning, night = (sun_direction(0.0, 0.0, 0.0, datetime(2017, 3, 20, hour)) for hour in (7, 0))
    assert morning[0] == pytest.approx(90, abs=1)
    assert 10 < morning[1] < 20
    assert night[1] < -80
