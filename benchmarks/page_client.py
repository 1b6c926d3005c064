"""A page as a program: it takes what it is sent and says at once that it is shown."""

import asyncio
import contextlib
import json
import struct
from collections.abc import AsyncGenerator

import aiohttp
import yarl

LARGEST_MESSAGE = 1 << 24


@contextlib.asynccontextmanager
async def connected_page(link: str) -> AsyncGenerator[aiohttp.ClientWebSocketResponse]:
    """The socket of one page, which looks at tissue too, as the page does unless it is told otherwise."""
    url = yarl.URL(link)
    origin = str(url.origin())
    async with aiohttp.ClientSession(headers={"Origin": origin}) as session:
        token = url.fragment.removeprefix("token=")
        async with session.post(f"{origin}/session", json={"token": token}) as answer:
            secret = (await answer.json())["secret"]
        async with session.ws_connect(f"{origin}/ws", max_msg_size=LARGEST_MESSAGE) as socket:
            await socket.send_json({"kind": "hello", "secret": secret})
            await socket.send_json({"kind": "look", "observations": False, "space": True})
            yield socket


@contextlib.asynccontextmanager
async def client(link: str) -> AsyncGenerator[None]:
    """One connected page."""
    async with connected_page(link) as socket:
        taking = asyncio.ensure_future(_take(socket))
        try:
            yield
        finally:
            taking.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await taking


async def _take(socket: aiohttp.ClientWebSocketResponse) -> None:
    async for message in socket:
        if message.type is aiohttp.WSMsgType.BINARY:
            (length,) = struct.unpack("<I", message.data[:4])
            frame = json.loads(message.data[4 : 4 + length])["frame"]
            await socket.send_json({"kind": "shown", "frame": frame, "at_ms": 0})
