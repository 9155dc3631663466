"""The result of a comparison in plain words; each number is computed from the episodes."""

from __future__ import annotations

from math import isnan

from zenostat.topics.plurals import counted
from zenostat.views.report.figures.comfort import rank_zones
from zenostat.views.report.figures.energy import fuel_label
from zenostat.views.report.runs import Comparison, Run
from zenostat.views.report.totals import (
    Difference,
    Metric,
    difference,
    has_equal_conditions,
    has_equal_lengths,
    kelvin_hours,
    names,
    number,
    total,
)

_ELECTRICITY = (
    Metric("electricity_kwh", "electricity", "kWh"),
    Metric("hvac_electricity_kwh", "electricity for heating, cooling and ventilation", "kWh"),
)
_NAMED_SHARE = 0.01
"""Share of the energy of all fuels from which on a fuel besides electricity is named."""
_PEAK = Metric("peak_kw", "peak power", "kW")
_OUTSIDE = Metric("occupied_outside_kh", "", "K h")
_WORST_KH = 0.5
"""Zones with fewer degree-hours outside are not mentioned."""


def summary(comparison: Comparison) -> list[str]:
    """Return the result as sentences, by controller."""
    reference, others = comparison.reference, comparison.runs[1:]
    texts = [_compared(run, reference) for run in others] or [_alone(reference)]
    texts += [text for run in comparison.runs for text in _irregular(run)]
    if comparison.episodes > 1:
        texts.append(f"Numbers are means over {comparison.episodes} episodes.")
    return texts


def _compared(run: Run, reference: Run) -> str:
    if not has_equal_lengths(run, reference):
        return f"The totals of {run.label} and {reference.label} do not compare: their episodes differ in length."
    sentences = [] if has_equal_conditions(run, reference) else [_other_conditions(run, reference)]
    parts, verdicts = [], []
    energy = next((metric for metric in _ELECTRICITY if total(run, metric.key) and total(reference, metric.key)), None)
    if energy is not None:
        energy_change = difference(run, reference, energy)
        assert energy_change is not None
        verdicts.append(energy_change.verdict)
        parts.append(_amount(run, reference, energy, energy_change))
    peak = difference(run, reference, _PEAK)
    if peak is not None:
        parts.append(_peak(run, reference, peak, is_first=not parts))
    fuels = [(fuel, change) for fuel in _fuels(run, reference) if (change := difference(run, reference, fuel))]
    if parts or not fuels:
        sentences.append("".join(parts) + "." if parts else _without_energy(run, reference))
    sentences += [f"{_amount(run, reference, fuel, change)}." for fuel, change in fuels]
    outside = difference(run, reference, _OUTSIDE)
    if outside is not None:
        energies = {*verdicts, *(change.verdict for _, change in fuels)} - {"equal"}
        is_contrast = (energies, outside.verdict) in (({"better"}, "worse"), ({"worse"}, "better"))
        sentences.append(_outside(run, reference, outside, is_contrast=is_contrast))
    return " ".join(sentences)


def _fuels(*runs: Run) -> list[Metric]:
    """Return the fuels besides electricity that have a part in the energy of one of the runs."""
    fuels = dict.fromkeys(fuel for run in runs for result in run.results for fuel in result.energy_kwh)
    shares = dict.fromkeys(fuels, 0.0)
    for run in runs:
        amounts = {fuel: used.mean for fuel in fuels if (used := total(run, f"{fuel}_kwh")) is not None}
        whole = sum(amounts.values())
        for fuel, amount in amounts.items():
            shares[fuel] = max(shares[fuel], amount / whole if whole > 0.0 else 0.0)
    return [
        Metric(f"{fuel}_kwh", fuel_label(fuel), "kWh")
        for fuel, share in shares.items()
        if fuel != "electricity" and share >= _NAMED_SHARE
    ]


def _other_conditions(run: Run, reference: Run) -> str:
    """Return in what the episodes of two runs differ besides their controllers."""
    weathers = [names(list(dict.fromkeys(each.weather_names))) for each in (run, reference)]
    if weathers[0] != weathers[1]:
        text = f"have different weather ({weathers[0]}; {weathers[1]})"
    else:
        seeds = [", ".join("?" if seed is None else str(seed) for seed in each.seeds) for each in (run, reference)]
        text = f"have different seeds ({seeds[0]}; {seeds[1]})" if seeds[0] != seeds[1] else "have different weather"
    return f"The episodes of {run.label} and {reference.label} {text}, which a difference between them contains."


def _without_energy(run: Run, reference: Run) -> str:
    """Return why the energy of two runs is not compared."""
    measured = [each.label for each in (run, reference) if any(total(each, metric.key) for metric in _ELECTRICITY)]
    if len(measured) == 1:
        return f"{run.label} and {reference.label}: energy is measured for {measured[0]} alone."
    return f"{run.label} and {reference.label}: no energy is measured that both have."


def _percent(value: float) -> str:
    """Return the size of a difference in percent; differences below `EQUAL_PERCENT` are called equal, not 0 %."""
    return f"{abs(value):.1f}\N{NO-BREAK SPACE}%"


def _amount(run: Run, reference: Run, metric: Metric, change: Difference) -> str:
    own, base = total(run, metric.key), total(reference, metric.key)
    assert own is not None
    assert base is not None
    amounts = f"{number(own.mean)} instead of {number(base.mean)} {metric.unit}"
    if change.verdict == "equal":
        return f"{run.label} used as much {metric.label} as {reference.label} ({number(own.mean)} {metric.unit})"
    if change.verdict == "unclear":
        return (
            f"{run.label} and {reference.label} do not differ clearly in {metric.label} ({amounts}; the 95 % interval "
            "of the difference contains zero)"
        )
    less = "less" if change.mean < 0 else "more"
    if change.percent is None:
        return f"{run.label} used {less} {metric.label} than {reference.label} ({amounts})"
    return f"{run.label} used {_percent(change.percent)} {less} {metric.label} than {reference.label} ({amounts})"


def _peak(run: Run, reference: Run, change: Difference, *, is_first: bool) -> str:
    own, base = total(run, "peak_kw"), total(reference, "peak_kw")
    assert own is not None
    assert base is not None
    subject = f"{run.label} has" if is_first else ", with"
    if change.verdict in ("equal", "unclear") or change.percent is None:
        if change.percent is None and change.verdict not in ("equal", "unclear"):
            return f"{subject} a peak of {number(own.mean)} instead of {number(base.mean)} kW"
        return f"{subject} about the same peak power ({number(own.mean)} kW)"
    lower = "lower" if change.mean < 0 else "higher"
    return f"{subject} a peak {_percent(change.percent)} {lower} ({number(own.mean)} instead of {number(base.mean)} kW)"


def _outside(run: Run, reference: Run, change: Difference, *, is_contrast: bool) -> str:
    own, base = total(run, _OUTSIDE.key), total(reference, _OUTSIDE.key)
    assert own is not None
    assert base is not None
    opening = "However, occupied" if is_contrast else "Occupied"
    if own.mean == 0.0:
        always = f"{opening} zones were within the comfort band at all times"
        return (
            f"{always}, as under {reference.label}."
            if base.mean == 0.0
            else f"{always} (under {reference.label} outside by {kelvin_hours(base.mean)})."
        )
    text = f"{opening} zones were outside the comfort band by {kelvin_hours(own.mean)}"
    if change.verdict == "equal":
        text += f", as much as under {reference.label}"
    elif change.verdict == "unclear":
        text += f" (under {reference.label} {kelvin_hours(base.mean)}; the difference is not clear)"
    elif change.percent is not None:
        less = "less" if change.mean < 0 else "more"
        text += f", {_percent(change.percent)} {less} than under {reference.label} ({kelvin_hours(base.mean)})"
    elif base.mean == 0.0:
        text += f"; under {reference.label} they were within it"
    else:
        text += f" (under {reference.label} by {kelvin_hours(base.mean)})"
    return f"{text}{_worst(run)}."


def _worst(run: Run) -> str:
    """Return a clause on the zone that was outside longest; only known of the first episode."""
    quantities = run.quantities
    comfort, hours = quantities.comfort, quantities.degree_hours
    if comfort is None or hours is None or len(comfort.labels) < 2:
        return ""
    totals = hours[0] + hours[1]
    place = int(totals.argmax())
    if totals[place] < _WORST_KH:
        return ""
    kind = "too warm" if hours[0][place] >= hours[1][place] else "too cold"
    amount = kelvin_hours(float(max(hours[0][place], hours[1][place])))
    where = " in the first episode" if len(run.results) > 1 else ""
    return f"; the worst zone{where} is {comfort.labels[place]} ({amount} {kind})"


def _alone(run: Run) -> str:
    amounts = [(metric, amount) for metric in _ELECTRICITY if (amount := total(run, metric.key)) is not None]
    sentences = [f"{run.label}: no energy is measured."]
    if amounts:
        metric, amount = amounts[0]
        peak = total(run, _PEAK.key)
        with_peak = f", with a peak of {number(peak.mean)} {_PEAK.unit}" if peak is not None else ""
        others = [(fuel, used) for fuel in _fuels(run) if (used := total(run, fuel.key)) is not None]
        fuels = "".join(f", and {number(used.mean)} {fuel.unit} of {fuel.label}" for fuel, used in others)
        sentences = [f"{run.label} used {number(amount.mean)} {metric.unit} of {metric.label}{with_peak}{fuels}."]
    outside = total(run, _OUTSIDE.key)
    if outside is not None:
        sentences.append(f"Occupied zones were outside the comfort band by {kelvin_hours(outside.mean)}{_worst(run)}.")
    return " ".join(sentences)


def _irregular(run: Run) -> list[str]:
    """Return sentences on episodes that ended early and on commands that were not accepted."""
    planned = run.trajectory.manifest.steps
    early = [result for result in run.results if result.terminated]
    texts = []
    if early:
        texts.append(
            f"{run.label}: a termination limit ended {len(early)} of {len(run.results)} episodes early, after "
            f"{names([str(result.steps) for result in early])} of {planned} timesteps."
        )
    partial = [result for result in run.results if not result.terminated and result.steps < planned]
    if partial:
        texts.append(f"{run.label} controlled {partial[0].steps} of {planned} timesteps.")
    lost = sum(result.lost for result in run.results)
    if lost:
        texts.append(f"{counted(lost, 'sample')} of {run.label} were lost; its totals lack their timesteps.")
    if any(value is not None and isnan(value) for result in run.results for value in result.metrics().values()):
        missing = run.trajectory.incomplete_steps
        which = f"{missing} of {run.trajectory.steps} timesteps" if missing else "some timesteps"
        texts.append(f"{run.label} lacks values of {which}; totals that need them are not known.")
    not_accepted = sum(result.late + result.rejected for result in run.results)
    if not_accepted:
        texts.append(f"The node did not accept {counted(not_accepted, 'message')} of {run.label} (late or rejected).")
    return texts


def worst_zones(comparison: Comparison, count: int) -> list[str]:
    """Return the zones with most degree-hours outside while occupied, worst first; none that was always within."""
    return [label for label, hours in rank_zones(comparison.curves)[:count] if hours > 0.0]
