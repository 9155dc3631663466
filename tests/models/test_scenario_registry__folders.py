"""A folder given as a scenario names the scenario file in it, as of a training."""

import re
from pathlib import Path

import pytest

from zenostat.models.scenario.registry import find_scenario
from zenostat.topics.errors import UnknownName


def test_scenario_registry__folder_of_a_training_names_its_scenario(tmp_path: Path) -> None:
    with pytest.raises(UnknownName, match=f"no scenario '{re.escape(str(tmp_path))}'; there are:"):
        find_scenario(str(tmp_path))
    (tmp_path / "scenario.yaml").touch()
    with pytest.raises(UnknownName, match=re.escape(f"that folder has one: {tmp_path / 'scenario.yaml'}")):
        find_scenario(str(tmp_path))
