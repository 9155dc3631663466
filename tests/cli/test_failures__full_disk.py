"""A file that cannot be written ends a command with one sentence; a defect keeps its traceback."""

import errno
from pathlib import Path

import pytest
from support.run_cli import plain

from zenostat.cli.failures import print_failure


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "error: No space left on device"),
        (OSError(errno.ENOSPC, "anything", "run.csv"), "error: run.csv: No space left on device"),
        (PermissionError(errno.EACCES, "Permission denied", Path("/x")), "error: /x: Permission denied"),
    ],
)
def test_failures__file_that_cannot_be_written_is_one_sentence(
    error: OSError, text: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert print_failure(error) == 1
    assert plain(capfd.readouterr().err) == text


@pytest.mark.parametrize("error", [OSError("without a number"), OSError(errno.EBADF, "a defect"), ValueError("no")])
def test_failures__other_errors_are_raised_again(error: Exception) -> None:
    with pytest.raises(type(error)):
        print_failure(error)


def test_failures__removed_working_directory_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()
    assert print_failure(FileNotFoundError(errno.ENOENT, "No such file or directory")) == 1
    assert plain(capfd.readouterr().err) == "error: the working directory has been removed; change to another one"
