"""Waiting for something within the page's server."""

import asyncio

import pytest

from agents.operator.desk import until

LONG_S = 60.0


@pytest.mark.parametrize("turns", range(6))
def test_who_is_cancelled_as_the_event_comes_does_not_go_on(turns):
    async def run():
        event, goes_on = asyncio.Event(), asyncio.Event()

        async def work():
            await until(event, LONG_S)
            await goes_on.wait()

        working = asyncio.ensure_future(work())
        await asyncio.sleep(0)
        event.set()
        for _ in range(turns):
            await asyncio.sleep(0)
        working.cancel()
        _, left = await asyncio.wait({working}, timeout=1.0)
        goes_on.set()
        assert not left
        assert working.cancelled()

    asyncio.run(run())


def test_who_waits_in_vain_goes_on_after_a_while():
    asyncio.run(until(asyncio.Event(), 1e-3))
