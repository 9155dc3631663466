"""Training with stable-baselines3: from a file, evaluation that does not affect it, trained models as controllers."""

from zenostat.agent_sdk.controllers.policy import ALGORITHMS, PolicyController, load_policy
from zenostat.agent_sdk.evaluation.sb3_callback import EvaluationCallback, MakeEnv, evaluate_model
from zenostat.agent_sdk.training.config import TrainingConfig, load_training, read_training
from zenostat.agent_sdk.training.run import TrainingResult, TrainingStatus, resume_training, train

__all__ = [
    "ALGORITHMS",
    "EvaluationCallback",
    "MakeEnv",
    "PolicyController",
    "TrainingConfig",
    "TrainingResult",
    "TrainingStatus",
    "evaluate_model",
    "load_policy",
    "load_training",
    "read_training",
    "resume_training",
    "train",
]
