"""A headless Chromium driven by its own DevTools protocol: what a person does to a page, with a real browser.

async with chromium() as browser:
    page = await browser.open("http://127.0.0.1:7450/#token=...")
    await page.click("#hold")
"""

import asyncio
import contextlib
import itertools
import os
import re
import shutil
import signal
import subprocess
import tempfile
from collections.abc import AsyncGenerator, Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import aiohttp

from shared.clock import monotonic_s

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
LISTENS = re.compile(rb"(?:DevTools|WebDriver BiDi) listening on (ws://\S+)")
STARTS_S, WAITS_S = 30.0, 30.0
LARGEST_MESSAGE = 1 << 26
NAVIGATED = "Inspected target navigated or closed"


class BrowserError(RuntimeError):
    """What the browser would not do."""


def found() -> str | None:
    """Where a Chromium is; None where there is none."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


@dataclass
class Tab:
    """A page in any browser."""

    errors: list[str] = field(default_factory=list[str], init=False)

    async def value(self, expression: str) -> Any:
        """What an expression comes to, awaited."""
        raise NotImplementedError

    async def mouse(self, kind: str, x: float, y: float) -> None:
        """Move, press or release: mouseMoved, mousePressed, mouseReleased."""
        raise NotImplementedError

    async def until(self, expression: str, seconds: float = WAITS_S) -> Any:
        """Wait until an expression is true, and return it; where the page goes elsewhere meanwhile, of the next one."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while True:
                    try:
                        if value := await self.value(expression):
                            return value
                    except BrowserError as error:
                        if NAVIGATED not in str(error):
                            raise
                    await asyncio.sleep(0.02)
        words = await self.value("document.getElementById('words')?.textContent")
        raise BrowserError(f"waited {seconds:.0f} s for {expression}; the page says: {words}")

    async def middle(self, selector: str) -> tuple[float, float]:
        """The middle of an element, scrolled into view."""
        box = f"document.querySelector({selector!r})"
        await self.value(f"{box}.scrollIntoView({{block: 'center'}})")
        x, y, width, height = await self.value(f"(r => [r.x, r.y, r.width, r.height])({box}.getBoundingClientRect())")
        return x + width / 2, y + height / 2

    async def click_at(self, x: float, y: float) -> None:
        """A click at a place of the window."""
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            await self.mouse(kind, x, y)

    async def click(self, selector: str) -> None:
        """A click into the middle of an element."""
        await self.click_at(*await self.middle(selector))


class Asked:
    """A browser's process, and its answers to numbered messages on a socket."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse, process: "subprocess.Popen[bytes]") -> None:
        self._socket, self.process = socket, process
        self._numbers, self._answers = itertools.count(1), dict[int, asyncio.Future[dict[str, Any]]]()
        self._reading = asyncio.ensure_future(self._read())

    async def ask(self, method: str, parameters: dict[str, Any], **more: Any) -> dict[str, Any]:
        """What is answered, be it an error."""
        number = next(self._numbers)
        answer = self._answers[number] = asyncio.get_running_loop().create_future()
        await self._socket.send_json({"id": number, "method": method, "params": parameters, **more})
        async with asyncio.timeout(WAITS_S):
            return await answer

    def heard(self, said: dict[str, Any]) -> None:
        """What it says without being asked."""
        raise NotImplementedError

    async def close(self) -> None:
        """Hear nothing more."""
        self._reading.cancel()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._socket.close(), 1.0)

    async def _read(self) -> None:
        async for message in self._socket:
            said = message.json()
            if "id" not in said:
                self.heard(said)
            elif (waiting := self._answers.pop(said["id"], None)) is not None and not waiting.done():
                waiting.set_result(said)


@dataclass
class Page(Tab):
    """One tab; `held` is the mouse button that is down."""

    browser: "Browser"
    target: str
    session: str
    held: int = 0

    async def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A method of the protocol."""
        return await self.browser.call(method, self.session, **parameters)

    async def value(self, expression: str) -> Any:
        said = await self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in said:
            raise BrowserError(f"{expression}: {said['exceptionDetails']}")
        return said["result"].get("value")

    async def mouse(self, kind: str, x: float, y: float) -> None:
        if kind != "mouseMoved":
            self.held = int(kind == "mousePressed")
        idle = kind == "mouseMoved" and not self.held
        told = {"button": "none" if idle else "left", "buttons": self.held, "clickCount": 1}
        await self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **told)

    async def to_front(self) -> None:
        """Have this tab be the one that is seen: one behind others draws once a second."""
        await self.call("Page.bringToFront")

    async def key(self, kind: str, key: str, code: str, number: int) -> None:
        """A key: keyDown or keyUp."""
        told = {"windowsVirtualKeyCode": number, "nativeVirtualKeyCode": number}
        await self.call("Input.dispatchKeyEvent", type=kind, key=key, code=code, **told)

    async def close(self) -> None:
        """Close the tab, as a person does."""
        await self.browser.call("Target.closeTarget", targetId=self.target)


class Browser(Asked):
    """A Chromium."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse, process: "subprocess.Popen[bytes]") -> None:
        super().__init__(socket, process)
        self._pages: dict[str, Page] = {}

    async def call(self, method: str, session: str = "", **parameters: Any) -> dict[str, Any]:
        """A method of the protocol, of the browser or of one tab."""
        said = await self.ask(method, parameters, **({"sessionId": session} if session else {}))
        if "error" in said:
            raise BrowserError(f"{method}: {said['error']}")
        return said["result"]

    async def open(self, address: str) -> Page:
        """A new tab at an address."""
        target = (await self.call("Target.createTarget", url="about:blank"))["targetId"]
        session = (await self.call("Target.attachToTarget", targetId=target, flatten=True))["sessionId"]
        page = self._pages[session] = Page(self, target, session)
        await page.call("Runtime.enable")
        await page.call("Page.enable")
        await page.call("Emulation.setFocusEmulationEnabled", enabled=True)
        await page.call("Page.navigate", url=address)
        return page

    def heard(self, said: dict[str, Any]) -> None:
        page = self._pages.get(said.get("sessionId", ""))
        if said.get("method") == "Runtime.exceptionThrown" and page is not None:
            page.errors.append(str(said["params"]["exceptionDetails"].get("exception", said["params"])))


@contextlib.asynccontextmanager
async def chromium(*flags: str) -> AsyncGenerator[Browser]:
    """A Chromium of its own, with a profile of its own."""
    with profile_of("chromium") as profile:
        arguments = (*FLAGS, *flags, f"--user-data-dir={profile}", "about:blank")
        async with started(found(), profile, *arguments) as (process, connect):
            browser = Browser(await connect(""), process)
            try:
                yield browser
            finally:
                await browser.close()


def profile_of(name: str) -> "tempfile.TemporaryDirectory[str]":
    """A folder for a browser's profile, which may go on writing there for a moment."""
    return tempfile.TemporaryDirectory(prefix=f"suturegrasp-{name}-", ignore_cleanup_errors=True)


@contextlib.asynccontextmanager
async def started(path: str | None, profile: str, *arguments: str) -> AsyncGenerator[Any]:
    """A browser's process, killed in the end, and what connects to a place below the address that it listens on."""
    if path is None:
        raise BrowserError("there is no such browser here")
    log = Path(profile) / "log"
    with _process([path, "--remote-debugging-port=0", *arguments], log) as process:
        address = _listening(process, log)
        async with aiohttp.ClientSession() as session:
            yield process, lambda place: session.ws_connect(address + place, max_msg_size=LARGEST_MESSAGE)


@contextlib.contextmanager
def _process(command: list[str], log: Path) -> Generator["subprocess.Popen[bytes]"]:
    with log.open("wb") as out:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT, start_new_session=True
        )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _listening(process: "subprocess.Popen[bytes]", log: Path) -> str:
    deadline_s = monotonic_s() + STARTS_S
    while monotonic_s() < deadline_s:
        if match := LISTENS.search(log.read_bytes()):
            return match[1].decode()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.05)
            raise BrowserError(f"it ended: {log.read_text(errors='replace')[-300:]}")
    raise BrowserError("it did not start")
