"""Entry point of `zenostat`; imports little, so that signal handlers are installed before slow imports."""

from __future__ import annotations

import gc
import io
import os
import signal
import sys
from typing import Any, NoReturn

from zenostat.bridge.runtime.signals import TERMINATION_SIGNALS, Terminated


def main() -> NoReturn:
    """Run the command line; exit codes: 2 for a usage error, 1 for a runtime error, 128 + the signal's number."""
    for number in TERMINATION_SIGNALS:
        signal.signal(number, lambda number, _: os._exit(128 + number))  # nothing to clean up yet
    gc.set_threshold(100_000, 20, 100)  # what is imported stays; scanning it again and again took a tenth of a start
    from zenostat.cli.commands import app
    from zenostat.cli.failures import print_failure

    def terminate(number: int, _: Any) -> NoReturn:
        raise Terminated(128 + number)  # lets `with` blocks clean up

    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a locale that is not UTF-8 lacks m², … and some names
    code: int | str | None = 0
    try:
        for number in TERMINATION_SIGNALS:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else terminate)
        app()
    except KeyboardInterrupt:
        code = 130
    except SystemExit as exit_:
        code = exit_.code
    except Exception as error:
        code = print_failure(error)
    for number in TERMINATION_SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # everything is closed; a signal would only change the exit code
    sys.exit(code)


if __name__ == "__main__":
    main()
