"""The database of a study, for the process that runs it and those of its trials."""

from __future__ import annotations

import copy
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from zenostat.lab.tuning.study_config import Pruner
from zenostat.topics.errors import InvalidConfig
from zenostat.topics.extras import requires_extra

with requires_extra("tune", "tuning", "Optuna"):
    import optuna
    import sqlalchemy


HEARTBEAT_S, GRACE_S = 30, 120
_POSTGRESQL = {"connect_timeout": 10, "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 3,
               "tcp_user_timeout": 30_000}  # fmt: skip
"""Time limits of libpq, without which a connection to a machine that has disappeared waits for many minutes."""


@contextmanager
def database_errors(url: str) -> Iterator[None]:
    """Report errors of the database as one sentence, with the URL as the user wrote it, but without its password.

    Raises:
        InvalidConfig: the URL is invalid; or the database cannot be reached, was lost, or is not Optuna's.
    """
    try:
        yield
    except (sqlalchemy.exc.ArgumentError, ImportError) as error:
        raise InvalidConfig(
            f"storage: {without_password(url)}: {error.__cause__ or error}; expected a URL as "
            "postgresql://user@host/name, which needs the extra postgresql, or sqlite:///study.db"
        ) from None
    except (optuna.exceptions.StorageInternalError, sqlalchemy.exc.SQLAlchemyError) as error:
        cause: BaseException = error.__cause__ or error
        reason = str(getattr(cause, "orig", None) or cause).strip().partition("\n")[0]
        raise InvalidConfig(
            f"the database {without_password(url)} cannot be used: {reason}; finished trials are kept: repeat the "
            "command when it is back"
        ) from None


def without_password(url: str) -> str:
    """Return the address of a database as errors show it."""
    return re.sub(r"([?&]password)=[^&]*", r"\1=...", re.sub(r"(://[^:/@]*):.*@", r"\1@", url))


def _with_driver(url: str) -> str:
    """Return the URL for SQLAlchemy, which has another default driver for PostgreSQL."""
    return re.sub(r"^postgres(ql)?://", "postgresql+psycopg://", url)


def open_storage(url: str) -> Any:
    """Open the database of a study, with heartbeats by which trials of lost machines are recognized."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        url = _with_driver(url)
        is_sqlite = url.startswith("sqlite")
        limits: Mapping[str, int] = {"timeout": 60} if is_sqlite else _POSTGRESQL if "+psycopg" in url else {}
        options = sqlalchemy.make_url(url).query  # those in the URL override
        limits = {name: limit for name, limit in limits.items() if name not in options}
        engine = {"connect_args": limits, "pool_pre_ping": not is_sqlite}
        return optuna.storages.RDBStorage(
            url, engine_kwargs=engine, heartbeat_interval=HEARTBEAT_S, grace_period=GRACE_S
        )


class LatestMedianPruner(optuna.pruners.MedianPruner):
    """Median pruner by the latest value of a trial.

    Optuna's own compares the best value so far, so a mean that begins with the mildest weather would never be pruned,
    nor a training that was good before.
    """

    def prune(self, study: optuna.Study, trial: optuna.trial.FrozenTrial) -> bool:
        """Return whether the latest value is worse than the median of finished trials at the same step."""
        latest, step = copy.copy(trial), trial.last_step
        latest.intermediate_values = {} if step is None else {step: trial.intermediate_values[step]}
        return super().prune(study, latest)


def make_pruner(settings: Pruner | Any) -> optuna.pruners.BasePruner:
    """Return the pruner of a study."""
    if not settings:
        return optuna.pruners.NopPruner()
    if settings.kind == "halving":
        return optuna.pruners.SuccessiveHalvingPruner(min_resource=max(settings.warmup_steps, 1))
    return LatestMedianPruner(settings.startup_trials, settings.warmup_steps)
