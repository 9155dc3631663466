"""Training with stable-baselines3: from a file, evaluation that does not affect it, trained models as controllers."""

from zenostat.agent_sdk.controllers.policy import ALGORITHMS, PolicyController
from zenostat.agent_sdk.controllers.policy_loader import load_policy
from zenostat.lab.training.config import TrainingConfig, load_training, read_training
from zenostat.lab.training.evaluation_callback import EvaluationCallback, MakeEnv, evaluate_model
from zenostat.lab.training.policy_export import export_policy
from zenostat.lab.training.run import TrainingResult, TrainingStatus, resume_training, train

__all__ = [
    "ALGORITHMS",
    "EvaluationCallback",
    "MakeEnv",
    "PolicyController",
    "TrainingConfig",
    "TrainingResult",
    "TrainingStatus",
    "evaluate_model",
    "export_policy",
    "load_policy",
    "load_training",
    "read_training",
    "resume_training",
    "train",
]
