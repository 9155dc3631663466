"""Value of foresight: the `oracle` controller with a perfect and with an erroneous weather forecast, beside rules.

Each task has a reward that asks for something different: a time-of-use tariff, a demand charge, comfort of occupied
zones. The oracle simulates its plans in branches of the building itself, so the only difference between its two runs is
the forecast of the outdoor temperature.

Run it: `python examples/foresight.py [--begin 07-03] [--end 07-03] [--task tariff]`
"""

import argparse
import time
from functools import partial

from zenostat.controllers import OracleController, RuleBasedController
from zenostat.evaluation import evaluate

SCENARIO = "zenostat/ref-small-office-USA_CO_Denver-continuous-v1"
"""Five zones with people; its action is (heating setpoint, cooling setpoint), degC."""
TARIFF = {"table": [{"value": 0.60, "hours": [13, 18]}], "otherwise": 0.12, "unit": "EUR/kWh"}
REWARDS = {
    "tariff": {"kind": "energy_cost", "price": TARIFF, "weight": 0.0, "weight_temperature": 0.1, "lambda_cost": 1.0},
    "demand": {"kind": "peak", "lambda_energy": 1e-4, "lambda_temperature": 0.2, "lambda_peak": 5.0},
    "occupied": {"kind": "occupied"},
}

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--begin", default="07-03")
parser.add_argument("--end", default="07-03")
parser.add_argument("--task", choices=REWARDS, action="append", help="default: all")
parser.add_argument("--horizon", type=float, default=6.0, help="prediction horizon in hours")
parser.add_argument("--samples", type=int, default=16, help="plans per iteration")
parser.add_argument("--iterations", type=int, default=1)
parser.add_argument("--error", type=float, default=4.0, help="standard deviation of the forecast after 24 h, K")
arguments = parser.parse_args()

close_rule = partial(RuleBasedController, setback=0.0, margin=0.3)
"""The rule that the oracle improves on: setpoints 0.3 K within the comfort band, day and night."""
search = {"horizon": arguments.horizon, "samples": arguments.samples, "iterations": arguments.iterations}
search |= {"rule": close_rule}
controllers = {
    "rbc": "rbc",
    "rbc, margin=0.3": close_rule,
    "fixed": "fixed",
    "oracle": partial(OracleController, **search),
    f"oracle, {arguments.error:g} K": partial(OracleController, forecast_error=arguments.error, **search),
}
for task in arguments.task or REWARDS:
    started = time.perf_counter()
    results = evaluate(
        SCENARIO, controllers, reward=REWARDS[task], begin=arguments.begin, end=arguments.end, steps_per_hour=4
    )
    print(f"\n{task}: {REWARDS[task]} ({time.perf_counter() - started:.0f} s)")
    for name, metrics in results.summary().items():
        terms = {key.split(".")[-1]: f"{metrics[key].mean:.2f}" for key in metrics if key.startswith("reward")}
        energy = f"{metrics['hvac_kwh'].mean:.1f} kWh" if "hvac_kwh" in metrics else ""
        print(f"  {name:18} {terms} {energy}", flush=True)
