"""The building as it is drawn: cut, apart, without plena."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.monitor import ZONES, geometry, two_storeys

from zenostat.topics.errors import BadMessage
from zenostat.views.display.surfaces import area
from zenostat.views.live.meshes import CUT_M, MAX_STACKED, building_model, clip_above, storey_names, storey_offsets

WALL = np.array([[0.0, 0.0, 3.0], [0.0, 0.0, 0.0], [8.0, 0.0, 0.0], [8.0, 0.0, 3.0]])


@given(st.floats(0.01, 2.99))
def test_rerun_meshes__cut_wall_has_its_share_of_the_area(height: float) -> None:
    cut = clip_above(WALL, height)
    assert area(cut) == pytest.approx(8.0 * height)
    assert cut[:, 2].max() == pytest.approx(height)


def test_cut__keeps_what_is_below_and_removes_what_is_above() -> None:
    np.testing.assert_array_equal(clip_above(WALL, 3.0), WALL)
    assert clip_above(WALL, -0.1).shape == (0, 3)


def test_rerun_meshes__zones_are_cut_above_their_floor_and_plena_are_left_out() -> None:
    model = building_model(two_storeys(), ZONES)
    assert sorted(model.zones) == sorted([ZONES[0], ZONES[1].upper()])
    for mesh in model.zones.values():
        assert np.ptp(mesh.positions[:, 2]) == pytest.approx(CUT_M)
        walls = mesh.positions[mesh.brightness < 1.0].reshape(4, 4, 3)
        # Each wall is moved into its zone, so that both sides of an interior wall are seen.
        planes = sorted((axis, wall[0, axis]) for wall in walls for axis in (0, 1) if np.ptp(wall[:, axis]) == 0)
        np.testing.assert_allclose(planes, [(0, 0.05), (0, 19.95), (1, 0.05), (1, 9.95)])
    lower, upper = (model.zones[name].positions[:, 2].min() for name in (ZONES[0], ZONES[1].upper()))
    assert upper - lower > 4.0  # apart


def test_rerun_meshes__triangles_of_a_zone_cover_its_floor() -> None:
    mesh = building_model(two_storeys(), ZONES).zones[ZONES[0]]
    corners = mesh.positions[mesh.triangles]
    is_floor = np.ptp(corners[:, :, 2], axis=1) == 0
    assert sum(area(triangle) for triangle in corners[is_floor]) == pytest.approx(200.0)


def test_rerun_meshes__unconditioned_room_beside_others_is_drawn() -> None:
    rooms = [("Office", 0, (0, 0, 0), (9, 9, 3), True), ("Stairs", 0, (9, 0, 0), (12, 9, 3), False)]
    assert set(building_model(geometry(rooms, [0.0]), ["Office"]).zones) == {"Office", "Stairs"}


def test_rerun_meshes__no_zone_no_building() -> None:
    assert building_model(geometry([], [0.0]), []) is None
    assert building_model(geometry([("Plenum", 0, (0, 0, 3), (9, 9, 4), False)], [3.0]), []) is None


@pytest.mark.parametrize("count", [1, 2, MAX_STACKED])
def test_rerun_meshes__few_storeys_are_apart_vertically(count: int) -> None:
    offsets = storey_offsets(np.array([30.0, 20.0]), [3.0 * place for place in range(count)])
    assert (offsets[:, :2] == 0).all()
    assert (np.diff(offsets[:, 2]) > 5.0).all()


@pytest.mark.parametrize("count", [5, 6, 10, 30])
def test_rerun_meshes__many_storeys_lie_side_by_side_on_one_level(count: int) -> None:
    floors = np.array([3.0 * place for place in range(count)])
    offsets = storey_offsets(np.array([30.0, 20.0]), floors.tolist())
    assert (floors + offsets[:, 2] == 0).all()
    low = offsets[:, None, :2]
    apart = np.abs(low - offsets[None, :, :2]) >= [30.0, 20.0]
    assert (apart.any(axis=2) | np.eye(count, dtype=bool)).all()


def test_rerun_meshes__storeys_side_by_side_have_labels() -> None:
    rooms = [(f"Zone {n}", n, (0, 0, 3 * n), (20, 10, 3 * n + 3), True) for n in range(5)]
    model = building_model(geometry(rooms, [3.0 * n for n in range(5)]), [])
    assert [text for text, _ in model.storey_labels] == [f"Storey {n}" for n in range(1, 6)]


@pytest.mark.parametrize(
    ("floors_m", "multipliers", "names"),
    [
        ([-2.4, 0.0, 4.3], [1, 1, 1], ["Basement", "Storey 1", "Storey 2"]),  # the hospital's, whose zones say so
        ([-6.0, -3.0, 0.0], [1, 1, 1], ["Basement 2", "Basement 1", "Storey 1"]),
        ([0.0, 4.0, 50.0], [1, 10, 1], ["Storey 1", "Storeys 2 to 11", "Storey 12"]),
    ],
)
def test_rerun_meshes__storeys_are_numbered_from_the_ground(
    floors_m: list[float], multipliers: list[int], names: list[str]
) -> None:
    rooms = [(f"Zone {n}", n, (0, 0, floor), (20, 10, floor + 3), True) for n, floor in enumerate(floors_m)]
    building = geometry(rooms, floors_m)
    zones = tuple(
        zone.model_copy(update={"multiplier": float(times)})
        for zone, times in zip(building.zones, multipliers, strict=True)
    )
    assert storey_names(building.model_copy(update={"zones": zones})) == names


def test_rerun_meshes__zones_name_is_above_its_floor() -> None:
    model = building_model(two_storeys(), ZONES)
    for name, mesh in model.zones.items():
        east, north, up = model.zone_places[name]
        assert (east, north) == pytest.approx((10.0, 5.0))
        assert up == pytest.approx(mesh.positions[:, 2].max())


def test_rerun_meshes__geometry_whose_zone_is_in_no_storey_is_unreadable() -> None:
    broken = two_storeys().model_copy(update={"storeys": (0.0,)})
    with pytest.raises(BadMessage, match="its zones are in storeys up to 1"):
        building_model(broken, ZONES)
