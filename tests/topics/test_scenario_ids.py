"""The static tables of ids say what the wheel and the data pack really hold."""

from collections import Counter

from support.data_packs import sinergym

from zenostat.models import catalog
from zenostat.models.sinergym.scenarios import pack_scenarios
from zenostat.topics.keys import check_name
from zenostat.topics.scenario_ids import (
    BUILDINGS,
    DEMO,
    PACK_IDS,
    PAPER_IDS,
    WEATHERS,
    all_ids,
    bundled_ids,
    pack_ids,
    variants,
)


def test_scenario_ids__wheels_names_are_those_of_its_catalogue():
    assert tuple(entry.name for entry in catalog.bundled_buildings()) == BUILDINGS
    assert tuple(entry.name for entry in catalog.bundled_weathers()) == WEATHERS


def test_scenario_ids__each_building_has_four_scenarios_in_each_weather():
    ids = bundled_ids()
    assert len(ids) == len(set(ids)) == 32 * 16 * 4 == 2048
    assert ids[:4] == (
        "apartment-high-rise-USA_AZ_Phoenix-continuous-v1",
        "apartment-high-rise-USA_AZ_Phoenix-discrete-v1",
        "apartment-high-rise-USA_AZ_Phoenix-continuous-stochastic-v1",
        "apartment-high-rise-USA_AZ_Phoenix-discrete-stochastic-v1",
    )
    assert "office-medium-USA_CO_Denver-continuous-v1" in ids
    assert not set(ids) & set(pack_ids())


def test_scenario_ids__packs_ids_are_those_of_its_files():
    sinergym()
    assert pack_ids() == tuple(pack_scenarios())
    counts = Counter(name.split("-")[0] for name in pack_ids() if name != DEMO)
    assert counts == {
        "5zone": 12, "datacenter_dx": 16, "datacenter_cw": 16, "smalldatacenter": 8, "office": 12, "warehouse": 12,
        "officegrid": 12, "shop": 12, "radiant": 8,
    }  # fmt: skip
    assert len(pack_ids()) == 109
    assert pack_ids()[0] == DEMO
    assert list(counts) == list(PACK_IDS)


def test_scenario_ids__every_id_can_stand_in_a_topic():
    for name in all_ids():
        assert check_name(name, "the id") == name


def test_scenario_ids__all_ids_are_those_of_packs_paper_and_wheel_without_a_repetition():
    assert set(all_ids()) == {*pack_ids(), *PAPER_IDS, *bundled_ids()}
    assert len(all_ids()) == len(set(all_ids())) == 109 + 4 + 2048


def test_scenario_ids__noise_comes_after_the_forms():
    assert variants("a", "b", ("continuous",)) == ["a-b-continuous-v1", "a-b-continuous-stochastic-v1"]
    assert variants("a", "b") == [
        "a-b-continuous-v1",
        "a-b-discrete-v1",
        "a-b-continuous-stochastic-v1",
        "a-b-discrete-stochastic-v1",
    ]
