"""Studies of Optuna on trainings and on the parameters of controllers."""

from zenostat.lab.tuning.controller_tuning import TrialRecord, TunedController, tune_controller
from zenostat.lab.tuning.search_spaces import RULE_SEARCH_SPACE

__all__ = ["RULE_SEARCH_SPACE", "TrialRecord", "TunedController", "tune_controller"]
