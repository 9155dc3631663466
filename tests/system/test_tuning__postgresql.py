"""Studies on a PostgreSQL server of the test's own, which also goes away in the midst of a study."""

import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.nodes import free_port, until
from support.run_cli import ZENOSTAT, plain, run_program

from zenostat.topics import yaml12

pytest.importorskip("stable_baselines3")
optuna = pytest.importorskip("optuna")
pytest.importorskip("psycopg")

FOLDERS = ":".join(map(str, sorted(Path("/usr/lib/postgresql").glob("*/bin"))))
PG_CTL = shutil.which("pg_ctl", path=f"{FOLDERS}:{os.environ.get('PATH', '')}")
TRAINING: dict[str, Any] = {
    "algorithm": "a2c", "scenario": "Fake-v1", "steps": 60, "threads": 1,
    "arguments": {"zones": 2, "begin": "07-03", "end": "07-03", "steps_per_hour": 1},
    "parameters": {"policy_kwargs": {"net_arch": [8]}}, "evaluation": {"every_steps": 30},
}  # fmt: skip
STUDY: dict[str, Any] = {
    "study": "s", "training": TRAINING, "parameters": {"parameters.n_steps": [5, 10]}, "trials": 3, "pruner": False,
    "output": "study",
}  # fmt: skip

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        PG_CTL is None, reason="no PostgreSQL server (pg_ctl) is installed; on Debian: apt install postgresql"
    ),
]


class Server:
    """A PostgreSQL server with a folder and a port of its own; it refuses to run as root."""

    def __init__(self, folder: Path) -> None:
        self._folder, self.port = folder, free_port()
        self.url = f"postgresql://me:secret@127.0.0.1:{self.port}/postgres"
        self._user: dict[str, Any] = {}
        if os.geteuid() == 0:
            account = pwd.getpwnam("postgres")
            os.chown(folder, account.pw_uid, account.pw_gid)
            self._user = {"user": account.pw_uid, "group": account.pw_gid, "extra_groups": []}
        self._control("initdb", "-o", "-U me --auth=trust -N")
        self.start()

    def _control(self, *arguments: str) -> None:
        assert PG_CTL is not None
        command = [PG_CTL, "-D", str(self._folder / "data"), "-w", *arguments]
        with (self._folder / "control.log").open("ab") as log:
            subprocess.run(command, check=True, cwd=self._folder, stdout=log, stderr=log, timeout=120, **self._user)

    def start(self) -> None:
        options = f"-p {self.port} -c listen_addresses=127.0.0.1 -c unix_socket_directories="
        self._control("-l", str(self._folder / "server.log"), "-o", options, "start")

    def stop(self) -> None:
        self._control("-m", "immediate", "stop")


@pytest.fixture
def server() -> Iterator[Server]:
    folder = Path(tempfile.mkdtemp(prefix="zt-", dir="/tmp"))
    try:
        server = Server(folder)
        try:
            yield server
        finally:
            if (folder / "data" / "postmaster.pid").exists():
                server.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def test_tuning__several_processes_tune_one_study(server: Server, tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(yaml12.dump(STUDY))
    done = run_program("tune", "s.yaml", "--workers", "2", "--storage", server.url, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    storage = optuna.storages.RDBStorage(server.url.replace("://", "+psycopg://"))
    trials = optuna.load_study(study_name="s", storage=storage).trials
    storage.engine.dispose()
    assert [trial.state.name for trial in trials] == ["COMPLETE"] * 3
    assert "3 complete" in plain(done.stdout) or "trial 2: complete" in done.stdout
    assert not (tmp_path / "study" / "study.db").exists()
    other = run_program("tune", "s.yaml", "--set", "seed=1", "--storage", server.url, cwd=tmp_path)
    assert other.returncode == 2
    assert "with other settings (seed)" in plain(other.stderr)


def test_tuning__server_that_goes_away_ends_the_study_with_one_sentence(server: Server, tmp_path: Path) -> None:
    study = {**STUDY, "training": {**TRAINING, "steps": 100_000}}
    (tmp_path / "s.yaml").write_text(yaml12.dump(study))
    command = [*ZENOSTAT, "tune", "s.yaml", "--storage", server.url]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        curve = tmp_path / "study" / "trials" / "0000" / "training" / "evaluations.csv"
        until(lambda: curve.exists() and curve.stat().st_size, "the first evaluation of the first trial")
        server.stop()
        _, err = process.communicate(timeout=120)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 2, err
    assert plain(err).startswith("error: the database postgresql://me@127.0.0.1")
    assert "finished trials are kept" in plain(err)
    assert "Traceback" not in err
    assert "secret" not in err
