"""Waiting for something within the page's server."""

import asyncio
import contextlib


async def until(event: asyncio.Event, within_s: float) -> None:
    """Wait for an event, so long at most."""
    # `asyncio.wait_for` of Python 3.11 forgets a cancellation that comes with the event, and the server would not end
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(within_s):
            await event.wait()
