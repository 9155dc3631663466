"""Studies: evaluations, probes, trainings, tuning, benchmarks, data sets, replays on another node."""
