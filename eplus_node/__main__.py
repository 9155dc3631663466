"""A node as a program, for whoever starts one of their own: `python -m eplus_node`.

Standard input: one line of JSON, the settings of `NodeConfig`; the node ends when its other end is closed.
Standard output: one line of JSON, `{"ready": name, "manifest": {...}}` or `{"error": class, "message": text}`.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from typing import Any

from bridge.runtime.signals import TERMINATION_SIGNALS
from eplus_node.config import plan, read_config
from eplus_node.node import Node
from topics.errors import ZenostatError, to_wire


def _end_with_owner() -> None:
    while os.read(0, 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _say(**what: Any) -> None:
    try:
        print(json.dumps(what), flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the owner is gone; the lifeline says so as well


def main() -> int:
    """Runs the node; 0 if it was told to stop, 1 if it could not start or EnergyPlus failed."""
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
            _say(ready=config.name)
            return 0
        with Node(config, program=True) as node:
            _say(ready=config.name, manifest=node.manifest.model_dump(mode="json"))
            node.serve()
    except ZenostatError as error:
        _say(**to_wire(error))
        return 1
    except Exception as error:
        _say(**to_wire(error))
        raise
    return 0


if __name__ == "__main__":
    code = main()
    for ignored in TERMINATION_SIGNALS:  # all is closed; a signal would only change the exit code
        signal.signal(ignored, signal.SIG_IGN)
    sys.exit(code)
