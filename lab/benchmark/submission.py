"""Check results of others before they are published beside those of the benchmark."""

from __future__ import annotations

import math
import random
import secrets
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from zenostat.agent_sdk.controllers.loader import CONTROLLERS
from zenostat.lab.benchmark.definition import BASELINE, BASELINES, REWARD, SETS, VERSION, Episode, is_prepared
from zenostat.lab.benchmark.rerun import check_rows
from zenostat.lab.benchmark.results import NEEDED_VERSIONS, Results, changed_versions, episode_of, load_results
from zenostat.lab.benchmark.results_file import ROUNDING, TERMS, Row, is_rounding
from zenostat.lab.benchmark.run import check_controllers, name_of, stale_trainings
from zenostat.lab.benchmark.scores import relative_linear, relative_reward
from zenostat.lab.workers import Progress
from zenostat.topics.errors import InvalidConfig

_SHOWN = 5
_PUBLISHED_SET = "full"
_OTHER_VERSIONS = 0.01
"""Largest relative difference of rewards of the baseline control that were made with other versions."""
_HIGHEST, _LOWEST = 1.0, -100.0
"""Scores out of this range are errors of a program: 1 is a week without any costs."""

_PRICE: Mapping[str, Any] = REWARD["price"]
_PRICES = sorted(REWARD["weight"] * REWARD["lambda_cost"] * price for price in (
    _PRICE["otherwise"], *(entry["value"] for entry in _PRICE["table"])
))  # fmt: skip
_GAS_PRICE = REWARD["weight"] * REWARD["lambda_cost"] * REWARD["gas_price"]["value"]
_DEMAND_PRICE = REWARD["weight"] * REWARD["lambda_peak"]
_NEEDED = ("hvac_electricity_kwh", "electricity_kwh", "natural_gas_kwh", "peak_kw", "terminated", "kpi.ener_tot")


def check_submission(
    path: Path, reference: Path | None, hashes: Mapping[str, str], *, sample: int = 0, sample_seed: int | None = None,
    controllers: Sequence[str] = (), workers: int = 1, cache: Path | None = None, policies: Path | None = None,
    progress: Progress | None = None,
) -> tuple[list[str], list[str]]:  # fmt: skip
    """Check results of others: versions, hashes, completeness, plausible rewards, and the rows of the baseline control.

    The form of the file, its version, definition and the hash of its rows are checked when it is read.

    Args:
        path: the results.
        reference: published results of the same set; None: those in `docs/benchmark` of the working directory, if any.
        hashes: sha256 of the models and weather files by name.
        sample: number of rows to run again; 0: none.
        sample_seed: seed with which they are drawn; None: one that nobody knows beforehand.
        controllers: controllers that are not part of the benchmark and may be run: a file of results chooses no code.
        workers: as of `run_benchmark`.
        cache: folder of the trainings and tunings; None: a temporary one.
        policies: as of `run_benchmark`.
        progress: as of `run_benchmark`.

    Returns:
        The errors, and notes on what could not be checked.

    Raises:
        UnknownName, InvalidConfig: see `load_results`.
    """
    results = load_results(path)
    errors = [f"{name}: not the file of the benchmark" for name in hashes if results.hashes.get(name) != hashes[name]]
    errors += [f"{name}: trained or tuned for another definition" for name in stale_trainings(results)]
    known = check_controllers([name for name in results.names() if name in BASELINES or name in controllers])
    errors += [
        f"{name}: its hash is not that of the {'controller of the benchmark' if name in BASELINES else 'present file'}"
        for name, digest in known.items()
        if results.controllers.get(name, digest) != digest
    ]
    errors += [
        f"{name!r}: a name has printable characters without |, < and >, and no blank at its beginning or end"
        for name in results.names()
        if not name.isprintable() or name != name.strip() or set(name) & set("|<>")
    ]
    errors += _incomplete(results) + _implausible(results)
    different, notes = _compare_baseline(results, path, reference)
    errors += different
    if results.set != _PUBLISHED_SET:
        notes.append(f"results of the set {results.set!r}: a submission has those of {_PUBLISHED_SET!r}")
    if sample:
        seed = secrets.randbits(32) if sample_seed is None else sample_seed
        drawn, skipped = _draw(results, sample, seed, controllers)
        notes += [*skipped, f"{len(drawn)} rows are run again, drawn with --sample-seed {seed}"]
        with tempfile.TemporaryDirectory() as folder:
            errors += check_rows(
                results, drawn, cache=cache or Path(folder), workers=workers, policies=policies, progress=progress,
                but_for_rounding=True,
            )  # fmt: skip
    else:
        notes.append("no rows were run again, so these checks find contradictions alone: --sample 20 runs 20 of them")
    return errors, notes


def _compare_baseline(results: Results, path: Path, reference: Path | None) -> tuple[list[str], list[str]]:
    """Return the errors of a comparison with the published rows of the baseline control, and why it was not possible.

    Raises:
        UnknownName, InvalidConfig: the reference cannot be read, or is one of another set.
    """
    not_compared = "the rows of the baseline control were not compared"
    published_path = reference or Path("docs", "benchmark", f"{results.set}-{VERSION}.json")
    if reference is None and not published_path.is_file():
        return [], [f"{not_compared}: no published rows are in {published_path}; --reference names others"]
    published = load_results(published_path)
    if published.set != results.set:
        raise InvalidConfig(f"{path} has results of the set {results.set!r}, the reference those of {published.set!r}")
    changes = changed_versions(published.versions, results.versions, NEEDED_VERSIONS)
    errors, notes = (_far_baseline if changes else _other_baseline)(_baseline_pairs(results, published))
    return errors, [*(f"version of {change}" for change in changes), *notes]


def _incomplete(results: Results) -> list[str]:
    """Return an error for each controller without all tasks, seeds and trainings, and for episodes of no set."""
    names = results.names()
    errors = [] if BASELINE in names else ["there are no rows of the baseline control"]
    if not set(names) - {BASELINE}:
        errors.append("there are no rows of a controller besides the baseline control")
    expected = {episode.key: episode for episode in SETS[results.set].episodes(names)}
    errors += [
        f"{name}: {len(absent)} episodes are missing, such as {absent[0]}"
        for name in names
        if (absent := results.missing([name]))
    ]
    others = [episode_of(row) for key, row in results.rows.items() if key not in expected]
    errors += [f"{episode}: no episode of the set {results.set!r}" for episode in others[:_SHOWN]]
    needed = {name_of(episode) for episode in expected.values() if is_prepared(episode.controller)}
    errors += [f"{name}: its training or tuning is missing" for name in sorted(needed - results.trainings.keys())]
    return errors + [
        f"{name}: its hash is missing (that of a class is that of its file, named as path/to/file.py:MyController)"
        for name in names
        if not _is_identified(name, results)
    ]


def _is_identified(name: str, results: Results) -> bool:
    """Return whether a hash identifies a controller; a bundled one, whose hash is empty, has the product's version."""
    digest = results.controllers.get(name)
    return is_prepared(name) or bool(digest) or (digest is not None and name in CONTROLLERS)


def _implausible(results: Results) -> list[str]:
    """Return an error for each row whose numbers contradict each other or those of the baseline control."""
    errors = []
    hours = 24.0 * SETS[results.set].days
    baselines = {episode_of(row).key[1:5]: row for row in results.rows.values() if row.controller == BASELINE}
    for row in results.sorted_rows():
        episode: Episode = episode_of(row)
        baseline = baselines.get(episode.key[1:5])
        faults = _faults(row, hours)
        if not faults and baseline is not None and not _faults(baseline, hours):
            faults = _other_floor_area(row, baseline)
        errors += [f"{episode}: {fault}" for fault in faults]
        for name, relative in (("score", relative_reward), ("linear score", relative_linear)):
            score = None if baseline is None else relative(row, baseline)
            if score is not None and not _LOWEST <= score <= _HIGHEST:
                errors.append(f"{episode}: a {name} of {score:g} is out of range ({_LOWEST:g} to {_HIGHEST:g})")
    return errors


def _faults(row: Row, hours: float) -> list[str]:
    """Return what cannot be in the numbers of a row of an episode of some hours."""
    if absent := [name for name in TERMS if name not in row.terms]:
        return [f"the term {absent[0]!r} is missing"]
    if absent := [name for name in _NEEDED if name not in row.metrics]:
        return [f"the metric {absent[0]!r} is missing"]
    terms, metrics, total = row.terms, row.metrics, sum(row.terms.values())
    electricity, gas = metrics["hvac_electricity_kwh"], metrics["natural_gas_kwh"]
    whole, outside = metrics["electricity_kwh"], metrics["occupied_outside_kh"]
    checks = {
        f"the terms add up to {total!r}, the reward is {row.reward!r}": is_rounding(row.reward, total),
        "a term is above 0": max(terms.values()) <= 0.0,
        f"the linear reward {row.linear!r} is above 0": row.linear <= 0.0,
        "it ended early": not metrics["terminated"],
        f"a peak of {metrics['peak_kw']!r} kW costs other than {terms['peak']!r} EUR": is_rounding(
            -terms["peak"], _DEMAND_PRICE * metrics["peak_kw"]
        ),
        f"{electricity!r} kWh of electricity cannot cost {terms['cost']!r} EUR": (
            _PRICES[0] * electricity - ROUNDING <= -terms["cost"] <= _PRICES[-1] * electricity + ROUNDING
        ),
        f"{gas!r} kWh of gas cannot cost {terms['gas']!r} EUR": -terms["gas"] <= _GAS_PRICE * gas + ROUNDING,
        f"the HVAC's {electricity!r} kWh exceed the {whole!r} kWh of the whole building": (
            electricity <= whole + ROUNDING
        ),
        f"a peak of {metrics['peak_kw']!r} kW is below the mean of {whole!r} kWh in {hours:g} h": (
            whole <= metrics["peak_kw"] * hours + ROUNDING
        ),
        f"{outside!r} K h outside the comfort band are below 0": outside >= 0.0,
        f"{outside!r} K h outside the comfort band cost nothing": terms["comfort"] != 0.0 or outside <= ROUNDING,
    }
    return [text for text, holds in checks.items() if not holds]


def _other_floor_area(row: Row, baseline: Row) -> list[str]:
    """Return an error if a row's energy and its KPI for each m² are not those of the baseline's building."""
    (energy, kpi), (of_baseline, kpi_of_baseline) = (
        (of.metrics["hvac_electricity_kwh"] - of.terms["gas"] / _GAS_PRICE, of.metrics["kpi.ener_tot"])
        for of in (row, baseline)
    )
    if is_rounding(energy * kpi_of_baseline, of_baseline * kpi):
        return []
    return [f"{energy!r} kWh of HVAC energy are not {kpi!r} kWh/m² in this building"]


def _baseline_pairs(results: Results, published: Results) -> list[tuple[Row, Row]]:
    """Return the published rows of the baseline control that results have as well, each with that of the results."""
    rows = [row for row in published.rows.values() if row.controller == BASELINE]
    return [(row, own) for row in rows if (own := results.rows.get(episode_of(row).key)) is not None]


def _other_baseline(pairs: Sequence[tuple[Row, Row]]) -> tuple[list[str], list[str]]:
    """Return an error for each row of the baseline control that is not the published one, and a note on rounding."""
    different = [row for row, own in pairs if not row.is_close(own)]
    rounded = sum(not row.same(own) for row, own in pairs) - len(different)
    notes = [f"{rounded} rows of the baseline control equal the published ones but for rounding"] if rounded else []
    return [f"{episode_of(row)}: not the published row of the baseline control" for row in different[:_SHOWN]], notes


def _far_baseline(pairs: Sequence[tuple[Row, Row]]) -> tuple[list[str], list[str]]:
    """Return an error for each row that other versions do not explain, and a note on how the rows were compared."""
    far = [
        f"{episode_of(row)}: {what} {now!r}, in the published row of the baseline control {value!r}: other versions "
        "do not explain that"
        for row, own in pairs
        for what, value, now in (
            ("a reward of", row.reward, own.reward),
            ("a linear reward of", row.linear, own.linear),
        )
        if not math.isclose(value, now, rel_tol=_OTHER_VERSIONS)
    ]
    within = f"within {100.0 * _OTHER_VERSIONS:g} % only"
    return far[:_SHOWN], [
        f"the rows of the baseline control were compared {within}: they were made with other versions"
    ]


def _draw(results: Results, count: int, seed: int, controllers: Sequence[str]) -> tuple[list[Row], list[str]]:
    """Return rows to run again, of submitted controllers if there are any, and notes on those that cannot be drawn."""
    names = set(results.names())
    submitted = names - BASELINES.keys()
    runnable = (submitted or names) & {*BASELINES, *controllers}
    rows = [row for row in results.sorted_rows() if row.controller in runnable]
    notes = [
        f"{name}: not part of the benchmark, so its rows are run again only if --controllers names it"
        for name in sorted(submitted - runnable)
    ]
    return random.Random(seed).sample(rows, min(count, len(rows))), notes  # noqa: S311  # no secret
