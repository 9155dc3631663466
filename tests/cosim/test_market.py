"""Markets: the price that clears, against hand calculations and properties; in a district, on trials."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.coupled_plants import FakeCoupled, district_file, free, manifest_of, orchestrated

from zenostat.cosim.market import Clearing, LinearBids, MarketSpec, clear
from zenostat.cosim.market_plant import SENSORS, MarketPlant, market_manifest
from zenostat.topics.errors import InvalidConfig

BIDDER = {"demand": "a.x"}


def spec(**fields: Any) -> MarketSpec:
    return MarketSpec.model_validate({"low": 0.0, "high": 1.0, "limit_w": 1000.0, "bidders": [BIDDER], **fields})


def line(prices: np.ndarray) -> np.ndarray:
    """3000 W without a price, 2000 W less for each unit."""
    return 3000.0 - 2000.0 * prices


# The clearing


def test_clear__without_congestion_is_one_trial_at_the_lowest_price() -> None:
    assert clear(line, spec(limit_w=3000.0), 3000.0) == Clearing(0.0, 3000.0, is_cleared=True, trials=1)


def test_clear__price_is_where_a_line_meets_the_limit() -> None:
    """2000 W are asked for at 0.5."""
    clearing = clear(line, spec(tolerance_w=1.0, rounds=10), 2000.0)
    assert clearing.is_cleared
    assert clearing.price == pytest.approx(0.5, abs=1e-3)
    assert 1999.0 <= clearing.demand_w <= 2000.0


def test_clear__limit_below_all_bids_ends_at_the_highest_price() -> None:
    assert clear(line, spec(), 900.0) == Clearing(1.0, 1000.0, is_cleared=False, trials=6)


def test_clear__step_of_the_demand_clears_at_its_upper_side() -> None:
    """An on-off device of 2 kW that gives way at 0.37: no price gives more than 1000 W and less than 3000 W."""
    clearing = clear(lambda p: np.where(p < 0.37, 3000.0, 1000.0), spec(rounds=6), 2000.0)
    assert clearing.demand_w == 1000.0
    assert 0.37 <= clearing.price < 0.371


def test_clear__supply_is_a_negative_demand_of_a_double_auction() -> None:
    """Buyers of 1000 W up to 0.6; sellers of 400 W from 0.2 and of 800 W from 0.5: the last unit is traded at 0.5."""

    def net(prices: np.ndarray) -> np.ndarray:
        bought = np.where(prices <= 0.6, 1000.0, 0.0)
        return bought - np.where(prices >= 0.2, 400.0, 0.0) - np.where(prices >= 0.5, 800.0, 0.0)

    clearing = clear(net, spec(rounds=8), 0.0)
    assert clearing.is_cleared
    assert clearing.price == pytest.approx(0.5, abs=1e-4)
    assert clearing.demand_w == -200.0


@given(
    st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8), st.lists(st.floats(1.0, 500.0), min_size=8, max_size=8),
    st.floats(0.0, 4000.0), st.integers(2, 9),
)  # fmt: skip
def test_clear__cleared_demand_is_a_bid_and_within_the_limit(
    gives_way: list[float], powers: list[float], limit_w: float, prices: int
) -> None:
    """Devices that each give way at a price: the limit is kept if it can be, with a demand that was tried."""
    tried: dict[float, float] = {}

    def demand(at: np.ndarray) -> np.ndarray:
        sums = np.array([sum(p for g, p in zip(gives_way, powers, strict=False) if price < g) for price in at])
        tried.update(zip(at.tolist(), sums.tolist(), strict=True))
        return sums

    clearing = clear(demand, spec(prices=prices), limit_w)
    assert tried[clearing.price] == clearing.demand_w
    assert len(tried) == clearing.trials
    assert clearing.is_cleared  # all have given way at the highest price
    assert clearing.demand_w <= limit_w


def test_linear_bids__are_lines_that_do_not_change_their_sign() -> None:
    bids = LinearBids(np.array([-1000.0, -4000.0, -500.0]), 0.2, np.array([900.0, 1000.0, -100.0]))
    assert bids(np.array([0.2, 0.6])).tolist() == pytest.approx([1800.0, 900.0 - 400.0 + 0.0 - 300.0])


# In a district

FILE = """
plants:
  market:
    market: {{high: 1.0, limit_w: {limit}, bids: {bids}, prices: 4, rounds: 8, tolerance_w: 0.5, bidders: [
      {{demand: a.x, slope_w: -500}}, {{demand: b.x, slope_w: -500}}]}}
  a: {{plant: "p.py:P"}}
  b: {{plant: "p.py:P"}}
connections:
  - {{from: market.price, to: a.price}}
  - {{from: market.price, to: b.price}}
"""
SENSOR: Any = {"x": "W"}
ACTUATOR: Any = {"price": ("EUR/kWh", 0.0, 1.0), "need": ("W", 0.0, 1e6)}


def house(share: float) -> FakeCoupled:
    """A house whose need rises by 100 W a step, and gives way in proportion to the price and its share."""

    def step(state: list[float], row: list[float]) -> tuple[list[float], list[float]]:
        need = state[0] + 100.0
        return [need], [need * (1.0 - share * row[0])]

    return FakeCoupled(manifest_of(SENSOR, ACTUATOR), step, first=[1000.0], values=[1000.0])


def opened(folder: Path, text: str) -> Any:
    file = district_file(folder, text)
    plants: dict[str, Any] = {"a": house(0.5), "b": house(1.0)}
    market = file.spec.plants["market"].market
    manifest = market_manifest("market", market, {name: plant.manifest for name, plant in plants.items()}, None)
    plants = {"market": MarketPlant(manifest, market), **plants}
    orchestrator, _, _ = orchestrated(file, plants)
    return orchestrator, plants


def district(folder: Path, *, limit: float = 1800.0, bids: str = "trials") -> Any:
    return opened(folder, FILE.format(limit=limit, bids=bids))


def market_row(orchestrator: Any) -> dict[str, float]:
    return dict(zip(SENSORS, orchestrator.rows["market"].values[0].tolist(), strict=True))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path


def test_market__true_bids_keep_the_limit_to_the_bit(folder: Path) -> None:
    """In step k, 2 (1000 + 100 k) - (1000 + 100 k) 1.5 p = 1800 has the solution p."""
    orchestrator, plants = district(folder)
    for k in range(1, 6):
        orchestrator.step(free(plants))
        row, need = market_row(orchestrator), 1000.0 + 100.0 * k
        assert row["price"] == pytest.approx((2.0 * need - 1800.0) / (1.5 * need), abs=1e-3)
        assert row["demand"] == row["cleared_demand"] <= 1800.0
        assert row["demand"] == sum(orchestrator.rows[name].values[0, 0] for name in "ab")
        assert plants["a"].commands[-1][0] == row["price"] == plants["b"].commands[-1][0]
    assert not orchestrator.drain_warnings()


def test_market__linear_bids_miss_what_they_do_not_know(folder: Path) -> None:
    """They expect the needs of the step before, and too little flexibility: the limit is not kept to the bit."""
    orchestrator, plants = district(folder, bids="linear")
    orchestrator.step(free(plants))
    row = market_row(orchestrator)
    assert row["cleared_demand"] == pytest.approx(1800.0, abs=0.5)
    assert row["price"] == pytest.approx(0.2, abs=1e-3)  # 2000 W less 1000 W for each unit of price
    assert row["demand"] == pytest.approx(2.0 * 1100.0 - 1100.0 * 1.5 * row["price"])
    assert plants["a"].tries == plants["b"].tries == 0


def test_market__one_request_has_all_prices_and_none_without_congestion(folder: Path) -> None:
    orchestrator, plants = district(folder, limit=1e6)
    orchestrator.step(free(plants))
    assert market_row(orchestrator)["trials"] == plants["a"].tries == 1
    assert market_row(orchestrator)["price"] == 0.0


@pytest.mark.parametrize("bids", ["trials", "linear"])
def test_market__bidder_without_a_value_has_the_last_one(folder: Path, bids: str) -> None:
    """The sensor of the second loses its value after 1100 W, and the first goes on to 1300 W."""
    orchestrator, plants = district(folder, limit=1e6, bids=bids)
    orchestrator.step(free(plants))
    plants["b"]._step = lambda state, _: (state, [math.nan])
    for _ in range(2):
        orchestrator.step(free(plants))
    row = market_row(orchestrator)
    assert (row["price"], row["cleared"]) == (0.0, 1.0)
    assert row["demand"] == 1300.0 + 1100.0
    texts = [text for text in orchestrator.drain_warnings() if text.startswith("market")]
    assert texts == ["market 'market': its bidder 'b.x' has no value in step 2; the last one holds until it has one"]
    orchestrator.start(dict.fromkeys(plants, 1))
    assert orchestrator._demands["market"].tolist() == [1000.0, 1000.0]


def test_market__limit_is_an_actuator_and_a_market_that_does_not_clear_says_so(folder: Path) -> None:
    orchestrator, plants = district(folder)
    orchestrator.step(free(plants, market=[100.0]))
    row = market_row(orchestrator)
    assert (row["price"], row["cleared"], row["limit"]) == (1.0, 0.0, 100.0)
    (warning,) = orchestrator.drain_warnings()
    assert warning == (
        "market 'market' does not clear in step 1: at the highest price 1, 550 W are asked for, and 100 W are the limit"
    )


def test_market__each_input_without_a_delay_of_a_bidder_is_named(folder: Path) -> None:
    entries = "to: b.price}\n  - {from: a.x, to: b.need, sum: true}\n  - {from: a.x, to: b.need, sum: true, name: c}"
    with pytest.raises(InvalidConfig) as caught:
        opened(folder, FILE.format(limit=1800, bids="trials").replace("to: b.price}", entries))
    assert [line for line in (11, 12) if f"yaml:{line}: 'b' bids before 'a'" in str(caught.value)] == [11, 12]


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("demand: b.x", "demand: c.x", r"district.yaml:5: c.x: no plant 'c'; there are: 'a', 'b'"),
        ("demand: b.x", "demand: b.y", r"b.y: plant 'b' has no sensor or meter 'y'"),
        ("to: b.price", "to: a.need, unit: EUR/kWh", r"the price does not reach 'b': a connection from market.price"),
        ("to: b.price}", "to: b.price}\n  - {from: a.x, to: b.need}", r":11: 'b' bids before 'a' is simulated"),
        ("high: 1.0", "high: -1.0", r"the lowest price 0 is not below the highest -1"),
        ("market.price, to: b.price", "market.prize, to: b.price", r"did you mean 'price'"),
    ],
)
def test_market__error_has_its_line(folder: Path, old: str, new: str, text: str) -> None:
    changed = FILE.format(limit=1800, bids="trials").replace(old, new)
    with pytest.raises(InvalidConfig, match=text):
        opened(folder, changed)
