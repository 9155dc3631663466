"""Write the test periods of the bundled buildings, and their KPIs under the baseline control.

`PYTHONPATH=.:tests .venv/bin/python tests/support/boptest_table.py [BUILDING ...]` simulates the year of each building
whose periods are not known and each of its periods, and updates `test_periods.yaml` of the gateway and the table in
docs/boptest.md. Without names it does this for all buildings that the table lacks; a building takes from two minutes to
half an hour.
"""

import re
import sys
from pathlib import Path

from zenostat.cli.boptest_cases import BundledTestCases, own_weather
from zenostat.gateways.boptest import test_periods
from zenostat.gateways.boptest.cases import TestCase
from zenostat.gateways.boptest.extensions import ExtendedTest
from zenostat.gateways.boptest.prices import read_rates
from zenostat.gateways.boptest.test_periods import TIME_PERIODS, simulate_test_periods
from zenostat.topics import yaml12
from zenostat.topics.scenario_ids import BUILDINGS

ROOT = Path(__file__).resolve().parents[2]
DAYS = Path(test_periods.__file__).with_name("test_periods.yaml")
PAGE = ROOT / "docs" / "boptest.md"
MARKS = ("<!-- table of test periods -->", "<!-- end of the table -->")
KPIS = ("tdis_tot", "ener_tot", "cost_tot", "emis_tot", "pele_tot", "pgas_tot")
HEAD = f"| building | weather | period | day | {' | '.join(f'`{kpi}`' for kpi in KPIS)} |"
_DAYS_COMMENT = "# Days of the test periods of bundled buildings, from 0; tests/support/boptest_table.py writes them.\n"


def write_days(days: dict[str, dict[str, int]]) -> None:
    rows = [
        f"{name}: {{{', '.join(f'{period}: {days[name][period]}' for period in TIME_PERIODS if period in days[name])}}}"
        for name in BUILDINGS
        if name in days
    ]
    DAYS.write_text(_DAYS_COMMENT + "\n".join(rows) + "\n", encoding="utf-8")


def kpi_rows(case: TestCase, days: dict[str, int]) -> list[str]:
    """Simulate each period under the baseline control, and return its row of the table."""
    test = ExtendedTest(case, read_rates(), lambda: days)
    rows = []
    try:
        for period, day in days.items():
            test.set_scenario({"time_period": period})
            rows_of_period = round(test_periods.PERIOD_S / test.episodes.building.step_s)
            baseline = test.beginning.baseline
            baseline.reach(rows_of_period)
            kpis = test.baseline_kpis(rows_of_period)
            figures = [("" if kpis[kpi] is None else f"{kpis[kpi]:.4g}") for kpi in KPIS]
            rows.append(f"| {case.name} | {own_weather(case.name)} | {period} | {day} | {' | '.join(figures)} |")
    finally:
        test.close()
    return rows


def table_rows() -> dict[str, list[str]]:
    """Return the rows of the table in the page, by building."""
    rows: dict[str, list[str]] = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        match = re.match(r"\| (\S+) \| USA_", line)
        if match:
            rows.setdefault(match[1], []).append(line)
    return rows


def write_table(rows: dict[str, list[str]]) -> None:
    lines = [
        HEAD,
        "|---|---|---|" + "---:|" * (len(KPIS) + 1),
        *(row for name in BUILDINGS for row in rows.get(name, ())),
    ]
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(MARKS[0])
    _, _, after = rest.partition(MARKS[1])
    PAGE.write_text(f"{before}{MARKS[0]}\n\n" + "\n".join(lines) + f"\n\n{MARKS[1]}{after}", encoding="utf-8")


def main(names: list[str]) -> None:
    cases = BundledTestCases()
    for name in names or [name for name in BUILDINGS if name not in table_rows()]:
        case, days = cases.find(name), yaml12.parse(DAYS.read_text(encoding="utf-8"), DAYS.name)
        if name not in days:
            days[name] = simulate_test_periods(case.arguments)
            write_days(days)
        write_table({**table_rows(), name: kpi_rows(case, days[name])})


if __name__ == "__main__":
    main(sys.argv[1:])
