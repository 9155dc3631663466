"""The ends of a BOPTEST service and of a test period, over HTTP."""

import threading

import pytest

pytest.importorskip("fastapi", reason="fastapi is not installed")
pytest.importorskip("httptools", reason="httptools is not installed")

from support.boptest import DAY_S, Client, hold, serving

from zenostat.gateways.boptest import manager
from zenostat.gateways.boptest.simulation import Interruption, Simulation


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(
    ("case", "request_", "method"),
    [
        ("office-small", ("POST", "advance", {}), "step"),
        ("office-small-USA_FL_Miami", ("PUT", "scenario", {"time_period": "mix_day"}), "run_free"),
    ],
    ids=["a step of 300 days", "the year of test periods"],
)
def test_boptest__service_that_ends_answers_the_request_in_progress(monkeypatch, tmp_path, case, request_, method):
    monkeypatch.setenv("ZENOSTAT_CACHE", str(tmp_path))
    begun, answers = threading.Event(), []
    original = getattr(Simulation, method)

    def signaled(*args):
        begun.set()
        return original(*args)

    with serving() as client:
        client.select(case)
        client.put("step", step=300 * DAY_S)
        monkeypatch.setattr(Simulation, method, signaled)
        thread = threading.Thread(target=lambda: answers.append(client.answer(*request_)))
        thread.start()
        assert begun.wait(60)
    thread.join()
    assert (answers[0].status_code, answers[0].text.split(":")[0]) == (500, "NodeLost")


@pytest.mark.parametrize("end", ["stop", "service"])
def test_boptest__test_that_is_starting_can_be_ended(monkeypatch, capfd, end):
    is_starting, answers, original = threading.Event(), [], Interruption.watch

    def signaled(self, node):
        original(self, node)
        is_starting.set()

    monkeypatch.setattr(Interruption, "watch", signaled)
    with serving() as client:
        select = "/testcases/ref-large-office/select"
        thread = threading.Thread(target=lambda: answers.append(client.request("POST", select)))
        thread.start()
        assert is_starting.wait(60)
        (testid,) = client.service.manager.tests()
        if end == "stop":
            assert Client(client.url).request("PUT", f"/stop/{testid}").text == "OK"
            thread.join()
    thread.join()
    assert (answers[0].status_code, answers[0].text.split(":")[0]) == (500, "NodeLost")
    assert capfd.readouterr().err == ""


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("is_branch", [False, True], ids=["test", "branch"])
def test_boptest__stop_is_answered_while_a_request_is_in_progress_which_then_ends(monkeypatch, capfd, is_branch):
    """advance begins → stop is answered → advance goes on: ends with an error → the service ends quietly"""
    in_progress, may_go_on, answers = threading.Event(), threading.Event(), []
    with serving() as client:
        parent = client.select("office-small")
        if is_branch:
            client.testid = client.request("POST", f"/branch/{parent}").json()["testid"]
        client.put("step", step=300 * DAY_S)
        monkeypatch.setattr(Simulation, "step", hold(Simulation.step, in_progress, may_go_on))
        thread = threading.Thread(target=lambda: answers.append(client.answer("POST", "advance", {})))
        thread.start()
        assert in_progress.wait(60)
        stopped = Client(client.url).request("PUT", f"/stop/{client.testid}")
        assert (stopped.status_code, stopped.text, answers) == (200, "OK", [])
        may_go_on.set()
        thread.join()
        assert (answers[0].status_code, answers[0].text) == (500, "the test was stopped during /advance")
        assert client.answer("GET", "kpi").json()["errors"][0]["msg"] == f"Invalid testid: {client.testid}"
        if is_branch:
            client.testid = parent
            assert client.advance()["time"] == 3600
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_boptest__service_ends_while_a_stopped_test_is_still_advanced(monkeypatch, capfd):
    in_progress, answers = threading.Event(), []
    original = Simulation.step

    def signaled(self, *args):
        in_progress.set()
        return original(self, *args)

    with serving() as client:
        client.select("office-small")
        branch = client.request("POST", f"/branch/{client.testid}").json()["testid"]
        monkeypatch.setattr(Simulation, "step", signaled)
        monkeypatch.setattr(manager.ExtendedTest, "interrupt", lambda _: None)  # as if it had not come to that yet
        client.put("step", step=300 * DAY_S)
        thread = threading.Thread(target=lambda: answers.append(client.answer("POST", "advance", {})))
        thread.start()
        assert in_progress.wait(60)
        assert Client(client.url).request("PUT", f"/stop/{branch}").status_code == 200
        assert Client(client.url).request("PUT", f"/stop/{client.testid}").status_code == 200
    thread.join()
    assert answers[0].status_code == 500
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_boptest__period_is_advanced_in_steps_of_15_minutes_to_its_end():
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
