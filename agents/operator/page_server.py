"""The page's web server: files, one exchange of a link for a secret, and one WebSocket a page. No other way in.

Who may use the page: addresses that it is served at, links that work once, and secrets that follow each other.

Nothing here is kept in a cookie, so that no other site's page can have a browser send it along. A page is named a
link's token in the part of the address that browsers send to nobody; it exchanges it for a secret, and each use of a
secret ends it and gives the next. What was overheard, or is played again, opens nothing.
"""

import asyncio
import contextlib
import hmac
import json
import secrets
import ssl
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from importlib.resources import files

from aiohttp import WSCloseCode, WSMsgType, web

from agents.operator.desk import Desk
from agents.operator.screen import Screen
from agents.operator.wire import LONGEST_MESSAGE, Hello, WireError, parsed

TOKEN_BYTES = 24
MOST_SESSIONS = 32
"""Screens that may be let in during one run; the one that was away longest is forgotten for a new one."""
ORIGIN, HOST, SITE = "Origin", "Host", "Sec-Fetch-Site"


def _new_token() -> str:
    return secrets.token_urlsafe(TOKEN_BYTES)


@dataclass(frozen=True)
class Addresses:
    """Where the page is served.

    Fields:
        hosts: host and port as a browser writes them.
    """

    scheme: str
    hosts: tuple[str, ...]

    def is_ours(self, headers: Mapping[str, str]) -> bool:
        """Whether a request names one of these, and not a name that somebody had resolve to this machine."""
        return headers.get(HOST, "").lower() in self.hosts

    def is_from_us(self, headers: Mapping[str, str]) -> bool:
        """Whether a request comes from the page itself: browsers let no other page write this header."""
        origins = [f"{self.scheme}://{host}" for host in self.hosts]
        site = headers.get(SITE, "same-origin")
        return self.is_ours(headers) and headers.get(ORIGIN, "") in origins and site == "same-origin"


@dataclass
class Access:
    """Links and secrets.

    Fields:
        link: the token of the link that works now.
        changed: told of each new link.
    """

    changed: Callable[[str], None] = lambda _link: None
    link: str = field(default_factory=_new_token)
    _secrets: dict[str, str] = field(default_factory=dict[str, str])
    _count: int = 0

    def exchange(self, token: str) -> str | None:
        """The first secret of a new session; None for a token that is not the link's. The next link is another one."""
        if not hmac.compare_digest(_bytes(token), _bytes(self.link)):
            return None
        self.link = _new_token()
        self._count += 1
        while len(self._secrets) >= MOST_SESSIONS:
            del self._secrets[next(iter(self._secrets))]
        secret = self._secrets[f"screen {self._count}"] = _new_token()
        self.changed(self.link)
        return secret

    def enter(self, secret: str) -> tuple[str, str] | None:
        """The session that a secret belongs to, and its next secret; None where it is none, or was used."""
        names = [name for name, known in self._secrets.items() if hmac.compare_digest(_bytes(secret), _bytes(known))]
        if not names:
            return None
        # at the end, among those that were used last
        del self._secrets[names[0]]
        self._secrets[names[0]] = _new_token()
        return names[0], self._secrets[names[0]]


def _bytes(text: str) -> bytes:
    # JSON can hold halves of characters
    return text.encode(errors="replace")


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


class PageServer:
    """Serves one desk.

    Fields:
        addresses: at which it answers; none before they are known.
    """

    def __init__(self, desk: Desk, access: Access) -> None:
        self._desk, self._access = desk, access
        self.addresses = Addresses("http", ())
        self._files = {path.name: path.read_bytes() for path in files("agents.operator").joinpath("page").iterdir()}
        self.application = web.Application(client_max_size=MOST_BODY, middlewares=[self._guarded])
        self.application.router.add_get("/", self._index)
        self.application.router.add_get("/page/{name}", self._file)
        self.application.router.add_post("/session", self._session)
        self.application.router.add_get("/ws", self._websocket)

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse what is not addressed to us by name, and say to browsers what this page may do."""
        if not self.addresses.is_ours(request.headers):
            return web.Response(status=421, text="no such host here\n", headers=HEADERS)
        try:
            response = await handler(request)
        except web.HTTPException as refusal:
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
