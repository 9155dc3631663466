"""Ending asyncio's tasks."""

from __future__ import annotations

import asyncio
from typing import Any


async def cancel(*tasks: asyncio.Task[Any], retry_s: float) -> None:
    """Cancel tasks and wait until they have ended.

    In Python 3.11, `asyncio.wait_for` loses a cancellation that arrives together with its result. So a task that has
    not ended is cancelled again.

    Args:
        tasks: the tasks; what they have raised is not raised again.
        retry_s: time after which a task is cancelled again, longer than its own cleanup takes.
    """
    while pending := [task for task in tasks if not task.done()]:
        for task in pending:
            task.cancel()
        await asyncio.wait(pending, timeout=retry_s)
    for task in tasks:
        if not task.cancelled():
            task.exception()  # else asyncio prints it as one that nobody has retrieved
