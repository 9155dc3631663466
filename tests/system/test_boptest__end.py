"""The ends of a BOPTEST service and of a test period, over HTTP."""

from __future__ import annotations

import threading

import pytest

pytest.importorskip("fastapi", reason="fastapi is not installed")
pytest.importorskip("httptools", reason="httptools is not installed")

from support.boptest import DAY_S, serving

from bridge.gateways.boptest import manager
from bridge.gateways.boptest.simulation import Simulation


@pytest.mark.variants
@pytest.mark.parametrize(
    ("case", "request_", "begins_in"),
    [
        ("office-small", ("POST", "advance", {}), Simulation),
        ("office-small-USA_FL_Miami", ("PUT", "scenario", {"time_period": "mix_day"}), manager.TestManager),
    ],
    ids=["a step of 300 days", "the year of test periods"],
)
def test_a_service_that_ends_answers_the_request_in_progress(monkeypatch, tmp_path, case, request_, begins_in):
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path))
    begun, answers = threading.Event(), []
    method = "step" if begins_in is Simulation else "_set_year"
    original = getattr(begins_in, method)

    def signaled(*args):
        result = original(*args)
        begun.set()
        return result

    with serving() as client:
        client.select(case)
        client.put("step", step=300 * DAY_S)
        monkeypatch.setattr(begins_in, method, signaled)
        thread = threading.Thread(target=lambda: answers.append(client.answer(*request_)))
        thread.start()
        assert begun.wait(60)
    thread.join()
    assert (answers[0].status_code, answers[0].text.split(":")[0]) == (500, "NodeLost")


@pytest.mark.slow
def test_a_period_is_advanced_in_steps_of_15_minutes_to_its_end():
    """1,344 steps; after the last one, `/advance` answers `{}` and everything remains readable."""
    with serving() as client:
        client.select("office-small")
        start_s = client.put("scenario", time_period="peak_heat_day")["time_period"]["time"]
        client.put("step", step=900)
        times = []
        while state := client.advance():
            times.append(state["time"])
        assert times == [start_s + 900 * count for count in range(1, 14 * 96 + 1)]
        kpis = client.get("kpi")
        for _ in range(2):
            over = client.answer("POST", "advance", {}).json()
            assert (over["status"], over["payload"]) == (200, {})
            assert over["message"] == "End of test case scenario time period reached."
        assert client.get("kpi") == kpis
        results = client.put("results", point_names=["outdoor_temperature_y"], start_time=start_s, final_time=1e9)
        assert results["time"] == [start_s, *times]
        assert client.put("forecast", point_names=["TDryBul"], horizon=0, interval=1)["time"] == [times[-1]]
        client.put("initialize", start_time=start_s, warmup_period=0)
        assert client.advance()["time"] == start_s + 900  # a new beginning ends the period
