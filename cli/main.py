"""The `zenostat` program: light to import, so that signals are handled before anything heavy is."""

from __future__ import annotations

import os
import signal
import sys
from typing import NoReturn


def main() -> NoReturn:
    """Run the command line: 2 for a mistake in the call, 1 for what went wrong on the way, 128 and the signal."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: os._exit(128 + number))  # nothing has been started yet
    from cli.commands import app
    from cli.failures import say_failure

    code: int | str | None = 0
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))  # what runs is ended in good order
        app()
    except KeyboardInterrupt:
        code = 130
    except SystemExit as end:
        code = end.code
    except Exception as error:
        code = say_failure(error)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # all is closed; a signal would only change the exit code
    sys.exit(code)


if __name__ == "__main__":
    main()
