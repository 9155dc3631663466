"""Studies of Optuna: trials run in processes of their own, so that the end of one affects no other."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zenostat.bridge.runtime.processes import end_processes
from zenostat.lab.tuning.search_space import DEFAULT, ask, decode, encode
from zenostat.lab.tuning.study_config import CONTENT, StudyConfig, starting_point
from zenostat.lab.tuning.study_storage import (
    GRACE_S,
    HEARTBEAT_S,
    database_errors,
    make_pruner,
    open_storage,
    without_password,
)
from zenostat.lab.tuning.trial import REQUEST, RESULT
from zenostat.topics import yaml12
from zenostat.topics.atomic_file import atomic_file
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra

with requires_extra("tune", "tuning", "Optuna"):
    import optuna
    from optuna.trial import FrozenTrial, TrialState

    from zenostat.lab.tuning.study_sampler import RETRY_OF, make_sampler

_REASON = "reason"
_IDENTITY = "zenostat"
_INTERRUPTED = "interrupted"
"""Mark of a trial that repeats one that was interrupted, which is none of its `retries`."""
_POLL_S = 0.2
_CREATION_S = 10.0
"""Time for another machine to write the settings and first trials of a study that it creates."""
_INVALID_TRIALS = 3
"""Number of first trials that fail because their configuration is invalid, after which the study ends."""
_END_S = 20.0
"""Time for a trial's process to write its checkpoint, after which it is killed."""

_LONGEST_ERROR = 200
_PRUNED = {"median": "worse than the median of the trials before", "halving": "not among the best of the trials before"}

OnTrial = Callable[[FrozenTrial], None]


def reason_of(trial: FrozenTrial) -> str:
    """Return why a trial failed or was pruned; empty for one that did neither."""
    is_lost = trial.state is TrialState.FAIL  # without a reason, as `_fail_lost` does
    return str(trial.user_attrs.get(_REASON, "the machine that ran it was lost" if is_lost else ""))


def _without_nulls(value: Any) -> Any:
    """Return JSON without fields that are null: one that a later version adds changes no study."""
    if isinstance(value, dict):
        return {name: _without_nulls(part) for name, part in value.items() if part is not None}
    return [_without_nulls(part) for part in value] if isinstance(value, list) else value


def open_study(config: StudyConfig) -> optuna.Study:
    """Create the study of a configuration, or open it if it exists.

    Raises:
        InvalidConfig: the database cannot be used, or has a study of that name with other settings.
    """
    config.folder.mkdir(parents=True, exist_ok=True)
    identity = _without_nulls(json.loads(json.dumps(config.identity())))
    with database_errors(config.url):
        storage = open_storage(config.url)
        sampler = make_sampler(config.sampler, config.seed, config.parameters)
        arguments: dict[str, Any] = {"sampler": sampler, "pruner": make_pruner(config.pruner)}
        try:
            study = optuna.create_study(
                study_name=config.study, storage=storage, direction=config.direction, **arguments
            )
            if config.begins_with_default:
                study.enqueue_trial({}, user_attrs={DEFAULT: True})
            start = starting_point(config.parameters)
            for point in config.grid() if config.sampler == "grid" else [start] if start else []:
                study.enqueue_trial({name: encode(value) for name, value in point.items()})
            study.set_user_attr(_IDENTITY, identity)  # last: another machine then has all that was queued
        except optuna.exceptions.DuplicatedStudyError:
            study = optuna.load_study(study_name=config.study, storage=storage, **arguments)
            saved = _without_nulls(_identity_of(study))
            # Studies of earlier versions have no contents of files.
            compared = [name for name in identity if name in saved or not name.startswith(CONTENT)]
            if differing := [name for name in compared if saved.get(name) != identity[name]]:
                raise InvalidConfig(
                    f"the study {config.study!r} exists in {without_password(config.url)} with other settings "
                    f"({', '.join(differing)}): choose another name, or restore them"
                ) from None
    return study


def _identity_of(study: optuna.Study) -> dict[str, Any]:
    """Return the settings of a study that exists; wait while another machine is creating it."""
    end = time.monotonic() + _CREATION_S
    while not (identity := study.user_attrs.get(_IDENTITY, {})) and time.monotonic() < end:
        time.sleep(_POLL_S)
    return dict(identity)


@dataclass
class _Worker:
    """The process of a trial."""

    trial: optuna.Trial
    process: subprocess.Popen[bytes]
    folder: Path
    log: Path


class Tuning:
    """The trials of a study that run on this machine.

    Several machines can work on one study: each has its own `Tuning` with the same configuration and database.

    Args:
        config: the study.
        on_trial: called with each trial that has ended here, or that a lost machine had.
        on_wait: called when no trial is left to start, but others run elsewhere; see `run`.

    Raises:
        InvalidConfig: see `open_study` and `StudyConfig.check`.
    """

    def __init__(
        self, config: StudyConfig, on_trial: OnTrial | None = None, on_wait: Callable[[], None] | None = None
    ) -> None:
        self._config, self._on_trial, self._on_wait = config, on_trial, on_wait
        config.check()
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self.study = open_study(config)
        self._workers: list[_Worker] = []
        self._idle: list[tuple[subprocess.Popen[bytes], Path]] = []
        self._beat = 0.0
        self._waits_since: float | None = None
        self._invalid: list[optuna.Trial] | None = []

    @property
    def processes(self) -> list[int]:
        """Ids of the processes of the running trials."""
        return [worker.process.pid for worker in self._workers]

    def run(self, stop: threading.Event | None = None) -> bool:
        """Run trials until the study has its number of trials; return whether it has.

        While others run elsewhere, it waits for as long as it takes to see that their machines were lost, or their
        commands killed. Those that are lost fail, and are repeated as far as `retries` allows.

        Args:
            stop: when it is set, the running trials are ended and queued again, and this returns.

        Raises:
            InvalidConfig: the database was lost; or the first trials are all invalid. These are queued again, since the
                cause may be one that can be mended, such as a missing file.
        """
        stop = stop or threading.Event()
        with ExitStack() as stack:
            stack.callback(self._end_processes)
            with database_errors(self._config.url), warnings.catch_warnings():
                warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
                warnings.filterwarnings("ignore", "Heartbeat of storage")  # `_heartbeat` records it
                try:
                    while not stop.is_set():
                        if self._poll():
                            return True
                        stop.wait(_POLL_S)
                except InvalidConfig:
                    self._interrupt()
                    raise
                self._interrupt()
        return False

    def _poll(self) -> bool:
        """Finish trials that have ended, and start others; return whether the study has its number of trials."""
        self._heartbeat()
        for worker in [worker for worker in self._workers if self._has_ended(worker)]:
            self._finish(worker)
        while len(self._workers) < self._config.workers and self._is_open():
            self._start()
        return not self._workers and not self._is_open() and not self._waits_for_others()

    def _waits_for_others(self) -> bool:
        """Whether trials that run elsewhere may still prove to be lost."""
        if not any(trial.state is TrialState.RUNNING for trial in self.study.get_trials(deepcopy=False)):
            return False
        if self._waits_since is None:
            self._waits_since = time.monotonic()
            if self._on_wait is not None:
                self._on_wait()
        return time.monotonic() - self._waits_since < GRACE_S + HEARTBEAT_S

    def _interrupt(self) -> None:
        """End the running trials, and queue them again, after the first ones if all of these were invalid."""
        self._end_processes()
        for trial in self._invalid or ():
            self._queue_again(trial, interrupted=True)
        for worker in list(self._workers):
            self._finish(worker, interrupted=True)

    def ended(self) -> int:
        """Return the number of trials that have ended, on all machines; repeated ones count once."""
        trials = self.study.get_trials(deepcopy=False)
        return sum(trial.state.is_finished() for trial in trials) - _repeated(trials)

    def total(self) -> int:
        """Return the number of trials that the study will have; a grid has all, and that of the defaults, at once."""
        trials = self.study.get_trials(deepcopy=False)
        return max(len(trials) - _repeated(trials), self._config.trials or 0)

    def _is_open(self) -> bool:
        """Whether the study needs another trial."""
        trials = self.study.get_trials(deepcopy=False)
        if any(trial.state is TrialState.WAITING for trial in trials):
            return True
        return self._config.sampler != "grid" and len(trials) - _repeated(trials) < (self._config.trials or 0)

    def _start(self) -> None:
        config = self._config
        trial = ask(self.study, config.parameters)
        self._record_heartbeat(trial)  # a trial without any would never be seen to be lost
        self._waits_since = None
        folder = (config.folder / "trials" / f"{trial.number:04d}").absolute()
        try:
            fields = config.trial_fields(decode(config.parameters, trial.params), folder)
        except InvalidConfig as error:
            self._fail_invalid(trial, str(error))
            return
        shutil.rmtree(folder, ignore_errors=True)  # of a deleted study of that name
        folder.mkdir(parents=True)
        request = {
            "url": config.url, "study": config.study, "trial_id": trial._trial_id, "metric": config.metric,  # noqa: SLF001
            "pruner": config.pruner and config.pruner.model_dump(),
            **fields,
        }  # fmt: skip
        (folder / REQUEST).write_text(json.dumps(request, indent=1), encoding="utf-8")
        (folder / REQUEST).chmod(0o600)  # the URL may contain a password
        process, log = self._process(folder)
        self._workers.append(_Worker(trial, process, folder, log))

    def _fail_invalid(self, trial: optuna.Trial, reason: str) -> None:
        """Record a trial whose combination of parameters is not valid."""
        trial.set_user_attr(_REASON, reason)
        self.study.tell(trial, state=TrialState.FAIL)
        if self._on_trial is not None:
            self._on_trial(self.study.trials[trial.number])
        self._check_first_trials(trial, reason)

    def _process(self, folder: Path) -> tuple[subprocess.Popen[bytes], Path]:
        """Return a process that runs the trial of a folder, and the path of its log."""
        while self._idle:
            process, log = self._idle.pop()
            if process.poll() is None and _send(process, folder):
                return process, log
            _close_input(process)
        log, keeps = folder / "log.txt", self._config.keeps_processes
        arguments = [] if keeps else [str(folder)]
        with log.open("wb") as output:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", self._config.trial_module, *arguments, str(os.getpid())],
                stdin=subprocess.PIPE if keeps else subprocess.DEVNULL, stdout=output, stderr=output, process_group=0,
            )  # fmt: skip
        if keeps:
            _send(process, folder)
        return process, log

    def _has_ended(self, worker: _Worker) -> bool:
        if self._config.keeps_processes and (worker.folder / RESULT).is_file():
            return True
        return worker.process.poll() is not None

    def _finish(self, worker: _Worker, *, interrupted: bool = False) -> None:
        """Record the result of a trial whose process has ended."""
        self._workers.remove(worker)
        if worker.process.stdin is not None:
            if worker.process.poll() is None:
                self._idle.append((worker.process, worker.log))
            else:
                _close_input(worker.process)
        try:
            result = json.loads((worker.folder / RESULT).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            code = worker.process.returncode
            result = {"state": "fail", "reason": f"its process ended with {code}{_error_in(worker)}; see {worker.log}"}
            result["again"] = interrupted or self._may_retry(worker.trial)
        states = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "fail": TrialState.FAIL}
        if result["state"] == "fail":
            worker.trial.set_user_attr(_REASON, "interrupted" if interrupted else result["reason"])
        elif result["state"] == "pruned" and self._config.pruner:
            worker.trial.set_user_attr(_REASON, f"{_PRUNED[self._config.pruner.kind]} at step {result['step']}")
        reason = result["reason"] if result.get("invalid") else None
        # A pruned trial's value is that of its last report.
        value = result["value"] if result["state"] == "complete" else None
        with suppress(optuna.exceptions.UpdateFinishedTrialError):  # another machine took it for lost
            self.study.tell(worker.trial, value, state=states[result["state"]])
        if result.get("again") or (interrupted and reason is not None):
            self._queue_again(worker.trial, interrupted=interrupted)
        if self._on_trial is not None:
            self._on_trial(self.study.trials[worker.trial.number])
        if not interrupted:
            self._check_first_trials(worker.trial, reason)

    def _queue_again(self, trial: optuna.Trial | FrozenTrial, *, interrupted: bool) -> None:
        """Queue a trial that repeats another one, with its values."""
        attributes = {name: True for name in (DEFAULT,) if name in trial.user_attrs}
        attributes |= {_INTERRUPTED: True} if interrupted else {}
        of = trial.user_attrs.get(RETRY_OF, trial.number)
        self.study.enqueue_trial(trial.params, user_attrs={RETRY_OF: of, **attributes})

    def _check_first_trials(self, trial: optuna.Trial, reason: str | None) -> None:
        """Collect the first trials that are invalid; reason None: this one is valid."""
        if reason is None:
            self._invalid = None
        elif self._invalid is not None:
            self._invalid.append(trial)
            if len(self._invalid) >= min(_INVALID_TRIALS, self._config.trials or 1):
                raise InvalidConfig(f"no trial of the study can be run: {reason}")

    def _may_retry(self, trial: optuna.Trial | FrozenTrial) -> bool:
        of = trial.user_attrs.get(RETRY_OF, trial.number)
        retries: int = sum(
            other.user_attrs.get(RETRY_OF) == of and _INTERRUPTED not in other.user_attrs
            for other in self.study.get_trials(deepcopy=False)
        )
        return retries < self._config.retries

    def _heartbeat(self) -> None:
        """Show other machines that the trials here are running, and fail those of machines that are lost."""
        if time.monotonic() - self._beat < HEARTBEAT_S:
            return
        self._beat = time.monotonic()
        for worker in self._workers:
            self._record_heartbeat(worker.trial)
        self._fail_lost()

    def _record_heartbeat(self, trial: optuna.Trial) -> None:
        storage: Any = self.study._storage  # noqa: SLF001  # Optuna's own `optimize` does the same
        getattr(storage, "_backend", storage).record_heartbeat(trial._trial_id)  # noqa: SLF001

    def _fail_lost(self) -> None:
        """Fail the trials of lost machines, as `optuna.storages.fail_stale_trials`, and queue them again."""
        storage: Any = self.study._storage  # noqa: SLF001
        for trial_id in storage._get_stale_trial_ids(self.study._study_id):  # noqa: SLF001
            trial = storage.get_trial(trial_id)
            try:
                storage.set_trial_state_values(trial_id, state=TrialState.FAIL)
            except optuna.exceptions.UpdateFinishedTrialError:  # another machine did
                continue
            if self._may_retry(trial):
                self._queue_again(trial, interrupted=False)
            if self._on_trial is not None:
                self._on_trial(self.study.trials[trial.number])

    def _end_processes(self) -> None:
        """End the processes of the trials; their nodes end with them."""
        processes = [worker.process for worker in self._workers] + [process for process, _ in self._idle]
        self._idle = []
        end_processes(processes, _END_S)
        for process in processes:
            _close_input(process)

    def best(self) -> optuna.trial.FrozenTrial | None:
        """Return the best finished trial; None before the first has finished."""
        try:
            return self.study.best_trial
        except ValueError:
            return None

    def write_best(self) -> Path | None:
        """Write the training or controller of the best trial as `best.yaml`; None before the first has finished."""
        best = self.best()
        if best is None:
            return None
        path = self._config.folder / "best.yaml"
        fields = self._config.best_fields(decode(self._config.parameters, best.params))
        with atomic_file(path) as temporary:
            temporary.write_text(yaml12.dump(fields), encoding="utf-8")
        return path


def _repeated(trials: Iterable[FrozenTrial]) -> int:
    """Return the number of trials that repeat another."""
    return sum(RETRY_OF in trial.user_attrs for trial in trials)


def _error_in(worker: _Worker) -> str:
    """Return the error with which a process ended: the line that names its exception, else the last that it printed."""
    if (worker.process.returncode or 0) <= 0:  # a signal: what it printed is not about that
        return ""
    with suppress(OSError):
        text = worker.log.read_text(encoding="utf-8", errors="replace").strip()
        _, traceback, error = text.rpartition("Traceback (most recent call last):\n")
        lines = error.splitlines()
        # The frames of a traceback are indented; an exception's own text may have several lines.
        named = (line for line in lines if traceback and not line.startswith(" "))
        return f": {next(named, lines[-1])[:_LONGEST_ERROR]}" if lines else ""
    return ""


def _close_input(process: subprocess.Popen[bytes]) -> None:
    """Close the pipe to a process, whose reading end may have gone with unread lines."""
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()


def _send(process: subprocess.Popen[bytes], folder: Path) -> bool:
    """Ask a process to run the trial of a folder; return whether it can still be asked."""
    assert process.stdin is not None
    try:
        process.stdin.write(f"{folder}\n".encode())
        process.stdin.flush()
    except OSError:
        return False
    return True
