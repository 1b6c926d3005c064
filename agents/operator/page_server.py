"""The page's web server: files, one exchange of a link for a secret, and one WebSocket a page. No other way in."""

import asyncio
import contextlib
import json
import ssl
from collections.abc import AsyncGenerator, Awaitable, Callable
from dataclasses import dataclass
from importlib.resources import files

from aiohttp import WSCloseCode, WSMsgType, web

from agents.operator.access import Access, Addresses
from agents.operator.desk import Desk
from agents.operator.screen import Screen
from agents.operator.wire import LONGEST_MESSAGE, Hello, WireError, parsed

HELLO_S, PING_S = 5.0, 5.0
MOST_MALFORMED = 3
"""Messages that no page sends, before the connection is ended."""
MOST_BODY = 1024
MOST_SCREENS = 12
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


@dataclass
class Counted:
    """What was refused since the beginning."""

    requests: int = 0
    messages: int = 0


class PageServer:
    """Serves one desk.

    Fields:
        addresses: at which it answers; none before they are known.
    """

    def __init__(self, desk: Desk, access: Access) -> None:
        self._desk, self._access = desk, access
        self.addresses = Addresses("http", ())
        self._files = {path.name: path.read_bytes() for path in files("agents.operator").joinpath("page").iterdir()}
        self.refused = Counted()
        self.application = web.Application(client_max_size=MOST_BODY, middlewares=[self._guarded])
        self.application.router.add_get("/", self._index)
        self.application.router.add_get("/page/{name}", self._file)
        self.application.router.add_post("/session", self._session)
        self.application.router.add_get("/ws", self._websocket)

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse what is not addressed to us by name, and say to browsers what this page may do."""
        if not self.addresses.is_ours(request.headers):
            self.refused.requests += 1
            return web.Response(status=421, text="no such host here\n", headers=HEADERS)
        try:
            response = await handler(request)
        except web.HTTPException as refusal:
            self.refused.requests += 1
            return web.Response(status=refusal.status, text=f"{refusal.reason}\n", headers=HEADERS)
        if not response.prepared:
            response.headers.update(HEADERS)
        return response

    async def _index(self, _request: web.Request) -> web.StreamResponse:
        return self._sent("index.html")

    async def _file(self, request: web.Request) -> web.StreamResponse:
        return self._sent(request.match_info["name"])

    def _sent(self, name: str) -> web.StreamResponse:
        content = self._files.get(name)
        kind = next((kind for ending, kind in TYPES.items() if name.endswith(ending)), None)
        if content is None or kind is None:
            raise web.HTTPNotFound
        return web.Response(body=content, content_type=kind, charset="utf-8")

    async def _session(self, request: web.Request) -> web.StreamResponse:
        """The secret for a link's token."""
        if not self.addresses.is_from_us(request.headers):
            raise web.HTTPForbidden
        try:
            told = json.loads(await request.text())
        except (ValueError, RecursionError, LookupError):
            raise web.HTTPBadRequest from None
        token = told.get("token") if isinstance(told, dict) else None
        secret = self._access.exchange(token) if isinstance(token, str) else None
        if secret is None:
            raise web.HTTPForbidden
        return web.json_response({"secret": secret})

    async def _websocket(self, request: web.Request) -> web.StreamResponse:
        if not self.addresses.is_from_us(request.headers):
            raise web.HTTPForbidden
        if len(self._desk.screens) >= MOST_SCREENS:
            raise web.HTTPServiceUnavailable
        socket = web.WebSocketResponse(heartbeat=PING_S, max_msg_size=LONGEST_MESSAGE, compress=False, timeout=1.0)
        await socket.prepare(request)
        entered = await self._entered(socket)
        if entered is None:
            self.refused.messages += 1
            await socket.close(code=WSCloseCode.POLICY_VIOLATION, message=b"this link was used")
            return socket
        name, secret = entered
        # whoever has the newest secret is that page, come back before its old connection was found to be dead
        self._desk.leave(name)
        screen = Screen(name, socket.send_str, socket.send_bytes)
        screen.say({"kind": "welcome", "you": name, "secret": secret})
        self._desk.join(screen)
        sending = asyncio.ensure_future(screen.send_all())
        sending.add_done_callback(_ended)
        try:
            await self._listen(socket, screen)
        finally:
            # nothing that may wait comes before this
            if self._desk.screens.get(name) is screen:
                self._desk.leave(name)
            sending.cancel()
            with contextlib.suppress(ConnectionError, TimeoutError):
                await socket.close()
        return socket

    async def _entered(self, socket: web.WebSocketResponse) -> tuple[str, str] | None:
        """Whose page this is, with its next secret."""
        try:
            message = await socket.receive(timeout=HELLO_S)
            said = parsed(message.data) if message.type is WSMsgType.TEXT else None
        except (TimeoutError, WireError):
            return None
        return self._access.enter(said.secret) if isinstance(said, Hello) else None

    async def _listen(self, socket: web.WebSocketResponse, screen: Screen) -> None:
        malformed = 0
        async for message in socket:
            if self._desk.screens.get(screen.name) is not screen:
                return
            try:
                if message.type is not WSMsgType.TEXT:
                    raise WireError("pages send text")
                said = parsed(message.data)
                if isinstance(said, Hello):
                    raise WireError("this page has said so already")
            except WireError:
                malformed += 1
                self.refused.messages += 1
                if malformed >= MOST_MALFORMED:
                    return
                continue
            self._desk.take(screen.name, said)


@contextlib.asynccontextmanager
async def serving(
    desk: Desk,
    access: Access,
    listen: str,
    port: int,
    names: tuple[str, ...],
    tls: ssl.SSLContext | None = None,
) -> AsyncGenerator[tuple[PageServer, str]]:
    """Serve a desk and keep it running; the server, and the address that it is found at.

    Args:
        names: of this host, as browsers may write them; the first is told.

    Raises:
        OSError: where that address cannot be listened on.
    """
    server, scheme = PageServer(desk, access), "http" if tls is None else "https"
    runner = web.AppRunner(server.application, access_log=None, shutdown_timeout=1.0)
    await runner.setup()
    running = asyncio.ensure_future(desk.run())
    try:
        site = web.TCPSite(runner, listen, port, ssl_context=tls)
        await site.start()
        found = runner.addresses[0][1]
        server.addresses = Addresses(scheme, tuple(f"{name}:{found}" for name in names))
        yield server, f"{scheme}://{server.addresses.hosts[0]}/"
    finally:
        await runner.cleanup()
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running


def _ended(task: "asyncio.Future[None]") -> None:
    """Sending to a page that is gone fails, and who listens to it finds out."""
    if not task.cancelled():
        task.exception()


def server_tls(certificate: str, key: str) -> ssl.SSLContext:
    """TLS as the rig's links have it: version 1.3 alone."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.load_cert_chain(certificate, key)
    return context
