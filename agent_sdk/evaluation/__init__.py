"""Evaluation: controllers side by side on the same episodes, metrics, and probes of what actuators do."""

from agent_sdk.evaluation.evaluate import Evaluation, evaluate, run_episode
from agent_sdk.evaluation.metrics import Result, Tally
from agent_sdk.evaluation.probe import Probed, probe

__all__ = ["Evaluation", "Probed", "Result", "Tally", "evaluate", "probe", "run_episode"]
