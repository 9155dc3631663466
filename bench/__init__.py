"""Benchmarks: costs as ratios within one run. They are no tests."""
