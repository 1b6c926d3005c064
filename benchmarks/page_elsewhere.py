"""A page that shows as much and belongs to no rig: what one page was sent is kept, and sent again to whoever looks.

Browsers before it take the time that showing takes, and nobody serves them from the rig. As a program it serves what
a file holds, and prints its address.
"""

import asyncio
import base64
import contextlib
import json
import struct
import sys
from importlib.resources import files
from pathlib import Path
from typing import Any

import aiohttp
from aiohttp import WSMsgType, web

from agents.operator.page_server import TYPES
from agents.operator.pictures import due
from agents.operator.showing import LOOK_S
from agents.operator.spare import Spare
from shared.clock import monotonic_s

HERE = "127.0.0.1"


async def kept(socket: aiohttp.ClientWebSocketResponse, seconds: float) -> list[tuple[float, str, str]]:
    """What comes within that time: when, a header or text, and a picture in base 64; each picture is acknowledged."""
    messages: list[tuple[float, str, str]] = []
    began_s = monotonic_s()
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            async for message in socket:
                at_s = monotonic_s() - began_s
                if message.type is WSMsgType.TEXT:
                    messages.append((at_s, message.data, ""))
                elif message.type is WSMsgType.BINARY:
                    (length,) = struct.unpack("<I", message.data[:4])
                    header, picture = message.data[4 : 4 + length].decode(), message.data[4 + length :]
                    messages.append((at_s, header, base64.b64encode(picture).decode()))
                    await socket.send_json({"kind": "shown", "frame": json.loads(header)["frame"], "at_ms": 0})
    return messages


class Elsewhere:
    """Sends what was kept over and over as the rig's page does: a picture once the last is shown, and fewer to those
    who only watch, which are all but the first.
    """

    def __init__(self, messages: list[tuple[float, str, str]]) -> None:
        self._messages, self._pages, self._spare = messages, 0, Spare()
        self.application = web.Application()
        self.application.router.add_get("/", self._file)
        self.application.router.add_get("/page/{name}", self._file)
        self.application.router.add_post("/session", self._session)
        self.application.router.add_get("/ws", self._websocket)

    async def look_at_host(self) -> None:
        """Until cancelled, as the rig's page does."""
        while True:
            await asyncio.sleep(LOOK_S)
            self._spare.look(monotonic_s())

    async def _file(self, request: web.Request) -> web.StreamResponse:
        name = request.match_info.get("name", "index.html")
        kind = next(kind for ending, kind in TYPES.items() if name.endswith(ending))
        page = files("agents.operator").joinpath("page", name)
        return web.Response(body=page.read_bytes(), content_type=kind, charset="utf-8")

    async def _session(self, _request: web.Request) -> web.StreamResponse:
        return web.json_response({"secret": "none"})

    async def _websocket(self, request: web.Request) -> web.StreamResponse:
        socket, shown = web.WebSocketResponse(), asyncio.Event()
        await socket.prepare(request)
        self._pages += 1
        sending = asyncio.ensure_future(self._send_while_there(socket, shown, self._pages == 1))
        try:
            async for message in socket:
                if message.type is WSMsgType.TEXT and '"shown"' in message.data:
                    shown.set()
        finally:
            sending.cancel()
        return socket

    async def _send_while_there(self, socket: web.WebSocketResponse, shown: asyncio.Event, controls: bool) -> None:
        # a browser that is killed is found to be gone by who sends before by who listens
        with contextlib.suppress(ConnectionError, aiohttp.ClientConnectionError):
            await self._send(socket, shown, controls)

    async def _send(self, socket: web.WebSocketResponse, shown: asyncio.Event, controls: bool) -> None:
        shown.set()
        sent_s = 0.0
        while True:
            began_s, lasts = monotonic_s(), dict[str, Any]()
            for at_s, text, picture in self._messages:
                await asyncio.sleep(max(0.0, began_s + at_s - monotonic_s()))
                if not picture:
                    await socket.send_str(text)
                    continue
                # a thread or a surface that comes with a picture that is left out comes with the next
                lasts |= {k: v for k, v in json.loads(text).items() if k in ("thread", "surface")}
                if shown.is_set() and due(controls, monotonic_s() - sent_s, self._spare.full):
                    shown.clear()
                    sent_s = monotonic_s()
                    header = json.dumps(json.loads(text) | lasts, separators=(",", ":")).encode()
                    lasts.clear()
                    await socket.send_bytes(struct.pack("<I", len(header)) + header + base64.b64decode(picture))


async def serve(path: Path) -> None:
    """Serve what a file holds, until killed."""
    elsewhere = Elsewhere(json.loads(path.read_text()))
    runner = web.AppRunner(elsewhere.application, access_log=None)
    await runner.setup()
    site = web.TCPSite(runner, HERE, 0)
    await site.start()
    print(f"http://{HERE}:{runner.addresses[0][1]}/#token=none", flush=True)
    await elsewhere.look_at_host()


if __name__ == "__main__":
    asyncio.run(serve(Path(sys.argv[1])))
