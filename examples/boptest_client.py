"""Control a building through the BOPTEST gateway for a day, and compare its KPIs with the baseline control.

`zenostat gateway boptest`, then `python examples/boptest_client.py [URL]`. It needs only requests.
"""

import sys

import requests

URL = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:8000"
DAY = 86400


def main() -> None:
    """Run the test."""
    session = requests.Session()
    testid = session.post(f"{URL}/testcases/office-small/select").json()["testid"]

    def call(method: str, operation: str, **body: object) -> dict:
        answer = session.request(method, f"{URL}/{operation}/{testid}", json=body).json()
        if answer["status"] != 200:
            raise SystemExit(f"{operation}: {answer['payload']}")
        return answer["payload"]

    setpoints = [name for name in call("GET", "inputs") if name.endswith("_cooling_setpoint_u")]
    call("PUT", "initialize", start_time=199 * DAY, warmup_period=DAY)
    call("PUT", "step", step=900)
    for _ in range(96):
        forecast = call("PUT", "forecast", point_names=["Occupancy[core_zn]"], horizon=3600, interval=900)
        occupied = max(forecast["Occupancy[core_zn]"]) > 0
        inputs = dict.fromkeys(setpoints, 297.15 if occupied else 302.15)
        inputs |= {name.removesuffix("_u") + "_activate": 1 for name in setpoints}
        state = call("POST", "advance", **inputs)
    print(f"core zone: {state['core_zn_air_temperature_y'] - 273.15:.1f} degC at time {state['time']}")
    kpis, baseline = call("GET", "kpi"), call("GET", "baseline")["kpi"]
    for name in ("ener_tot", "cost_tot", "tdis_tot"):
        print(f"{name}: {kpis[name]:.4f}, baseline control {baseline[name]:.4f}")
    session.put(f"{URL}/stop/{testid}")


if __name__ == "__main__":
    main()
