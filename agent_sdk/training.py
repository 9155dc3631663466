"""Training with stable-baselines3: evaluation that does not affect the training, and trained models as controllers."""

from agent_sdk.controllers.policy import ALGORITHMS, PolicyController, load_policy
from agent_sdk.evaluation.sb3_callback import EvaluationCallback, MakeEnv, evaluate_model

__all__ = ["ALGORITHMS", "EvaluationCallback", "MakeEnv", "PolicyController", "evaluate_model", "load_policy"]
