"""The migration page is complete: it names everything that a program which uses Sinergym can name."""

import re
from pathlib import Path

import pytest
from support import data_packs as packs

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("from-sinergym.md", "wrappers.md")
"""The second is that of the wrappers, to which the first one refers."""

MODULES = (
    "envs/eplus_env.py", "utils/callbacks.py", "utils/common.py", "utils/controllers.py", "utils/env_checker.py",
    "utils/rewards.py", "utils/wrappers.py",
)  # fmt: skip
HELPERS = {
    "observation_space",  # Gymnasium's
    "epsilon",
    "normalize",
    "verbose",
    *("new_init", "store_init_metadata", "set_energy_cost_data", "set_forecast_data", "reverting_action"),
    *("convert_conf_to_env_parameters", "deep_update", "eppy_element_to_dict", "get_delta_seconds", "import_from_path"),
    *("parse_actuators_settings", "parse_meters_settings", "parse_variables_settings"),
    *("process_algorithm_parameters", "process_environment_parameters", "process_wrapper_parameters"),
    *("set_mean", "set_var", "set_count"),  # behind the files that `restore_normalization` reads
}
"""What only Sinergym's own code uses, and what has the same name in Gymnasium."""

DEFINED = re.compile(r"^(?:    )?(?:def|class) ([A-Za-z]\w*)", re.MULTILINE)
CONSTRUCTOR = re.compile(r"def __init__\((.*?)\n    +\):", re.DOTALL)
ARGUMENT = re.compile(r"^ {8,12}([a-z]\w*): ", re.MULTILINE)
"""One on each line, as its formatter has it; the language is newer than the lowest version of Python that runs this."""


ATTRIBUTE = re.compile(r"^ +self\.([a-z]\w*)(?:: [^=\n]+)? = ", re.MULTILINE)
INTERNALS = {"act_queue", "context_queue", "energyplus_simulator", "info_queue", "np_random", "obs_queue"}
"""Attributes with which its environment and its simulator exchange values, and one of Gymnasium."""


@pytest.fixture(scope="module")
def page() -> str:
    return "\n".join((DOCS / name).read_text() for name in PAGES)


@pytest.mark.parametrize("module", MODULES)
def test_sinergym__each_name_of_sinergym_has_a_row(module: str, page: str) -> None:
    code = (packs.sinergym() / "sinergym" / module).read_text()
    defined = set(DEFINED.findall(code))
    arguments = {name for head in CONSTRUCTOR.findall(code) for name in ARGUMENT.findall(head)} - {"env"}
    assert defined, "its form has changed"
    assert arguments or module in ("utils/common.py", "utils/controllers.py", "utils/env_checker.py")
    missing = sorted(n for n in (defined | arguments) - HELPERS if not re.search(rf"\b{n}\b", page))
    assert missing == []


def test_sinergym__each_attribute_of_its_environment_has_a_row(page: str) -> None:
    attributes = set(ATTRIBUTE.findall((packs.sinergym() / "sinergym/envs/eplus_env.py").read_text()))
    assert attributes >= INTERNALS - {"np_random"} | {"observation_variables", "action_variables"}
    assert sorted(n for n in attributes - INTERNALS if not re.search(rf"\b{n}\b", page)) == []
