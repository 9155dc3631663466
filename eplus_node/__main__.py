"""Run a node for another program: `python -m eplus_node`.

Standard input: one line of JSON with the settings of `NodeConfig`; the node ends when standard input is closed.
Standard output: one line of JSON, `{"ready": name, "manifest": {...}}` or `{"error": class, "message": text}`.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is imported: it needs no threads here

from bridge.runtime.signals import TERMINATION_SIGNALS
from eplus_node.config import read_config
from eplus_node.node import energyplus_node
from eplus_node.plan import plan
from topics.errors import ZenostatError, to_wire


def _end_with_owner() -> None:
    while os.read(0, 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _print_line(**fields: Any) -> None:
    try:
        print(json.dumps(fields), flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the owner has ended, which the lifeline detects as well


def main() -> int:
    """Run the node; return 0 after a request or signal to stop, 1 if it could not start."""
    for number in TERMINATION_SIGNALS:
        signal.signal(number, lambda *_: sys.exit(0))
    line = b""
    while not line.endswith(b"\n"):
        more = os.read(0, 65536)
        if not more:
            return 1
        line += more
    threading.Thread(target=_end_with_owner, daemon=True, name="lifeline").start()
    try:
        config = read_config(json.loads(line))
        if config.check:
            plan(config)
            _print_line(ready=config.name)
            return 0
        with energyplus_node(config, program=True) as node:
            _print_line(ready=config.name, manifest=node.manifest.model_dump(mode="json"))
            node.serve()
    except ZenostatError as error:
        _print_line(**to_wire(error))
        return 1
    except Exception as error:
        _print_line(**to_wire(error))
        raise
    return 0


if __name__ == "__main__":
    code = main()
    for ignored in TERMINATION_SIGNALS:  # everything is closed; a signal would only change the exit code
        signal.signal(ignored, signal.SIG_IGN)
    sys.exit(code)
