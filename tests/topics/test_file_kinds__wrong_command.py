"""A file that was given to the wrong command is one sentence that names the right one."""

import pytest

from zenostat.topics.errors import InvalidConfig
from zenostat.topics.file_kinds import FileKind, check_file_kind

FILES = {
    FileKind.SCENARIO: {"building", "weather", "steps_per_hour"},
    FileKind.TRAINING: {"algorithm", "scenario", "steps", "parameters"},
    FileKind.TUNING: {"study", "training", "parameters"},
    FileKind.CONTROLLER: {"controller", "parameters"},
    FileKind.CALIBRATION: {"timestamps", "periods", "parameters"},
    FileKind.DISTRICT: {"name", "timestep", "plants", "reward"},
}


@pytest.mark.parametrize("kind", FileKind)
@pytest.mark.parametrize("expected", FileKind)
def test_file_kinds__file_of_another_kind_is_refused(kind: FileKind, expected: FileKind) -> None:
    if kind is expected:
        check_file_kind(FILES[kind], expected, "f.yaml")
        return
    with pytest.raises(InvalidConfig, match=f"^f.yaml is a {kind} file, not a {expected} file: .*zenostat"):
        check_file_kind(FILES[kind], expected, "f.yaml")


@pytest.mark.parametrize("fields", [set(), {"parameters"}, {"study", "algorithm"}, {"nonsense"}])
def test_file_kinds__file_that_may_be_of_the_expected_kind_is_left_to_the_checks_of_its_fields(
    fields: set[str],
) -> None:
    check_file_kind(fields, FileKind.TUNING, "f.yaml")
