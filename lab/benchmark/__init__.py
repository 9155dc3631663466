"""A benchmark of controllers: fixed buildings, weather, seeds, reward and score; see docs/benchmark.md."""

from zenostat.lab.benchmark.bound_file import Bound, load_bound, load_bounds
from zenostat.lab.benchmark.bounds import BoundTask, check_bound, improve_bound, tasks_of
from zenostat.lab.benchmark.definition import BASELINES, SETS, VERSION, BenchmarkSet, Episode, Task
from zenostat.lab.benchmark.gap import gap_share, gap_table
from zenostat.lab.benchmark.rerun import check
from zenostat.lab.benchmark.results import Results, load_results
from zenostat.lab.benchmark.results_file import Row
from zenostat.lab.benchmark.run import run_benchmark
from zenostat.lab.benchmark.scores import Interval, Scores, interquartile_mean, relative_score, score_rows
from zenostat.lab.benchmark.selection import Selection

__all__ = [
    "BASELINES",
    "SETS",
    "VERSION",
    "BenchmarkSet",
    "Bound",
    "BoundTask",
    "Episode",
    "Interval",
    "Results",
    "Row",
    "Scores",
    "Selection",
    "Task",
    "check",
    "check_bound",
    "gap_share",
    "gap_table",
    "improve_bound",
    "interquartile_mean",
    "load_bound",
    "load_bounds",
    "load_results",
    "relative_score",
    "run_benchmark",
    "score_rows",
    "tasks_of",
]
