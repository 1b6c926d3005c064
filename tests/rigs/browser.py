"""A headless Chromium driven by its own DevTools protocol: what a person does to a page, with a real browser.

async with chromium() as browser:
    page = await browser.open("http://127.0.0.1:7450/#token=...")
    await page.click("#hold")
"""

import asyncio
import base64
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
    "--remote-debugging-port=0",
)
LISTENS = re.compile(rb"DevTools listening on (ws://\S+)")
STARTS_S, WAITS_S = 30.0, 30.0
LARGEST_MESSAGE = 1 << 26


def found() -> str | None:
    """Where a Chromium is; None where there is none."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


NAVIGATED = "Inspected target navigated or closed"


class BrowserError(RuntimeError):
    """What the browser would not do."""


@dataclass
class Page:
    """One tab; `held` is the mouse button that is down."""

    browser: "Browser"
    target: str
    session: str
    errors: list[str] = field(default_factory=list[str])
    held: int = 0

    async def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A method of the protocol."""
        return await self.browser.call(method, self.session, **parameters)

    async def value(self, expression: str) -> Any:
        """What an expression comes to, awaited."""
        said = await self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in said:
            raise BrowserError(f"{expression}: {said['exceptionDetails']}")
        return said["result"].get("value")

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
        raise BrowserError(f"waited {seconds:.0f} s for {expression}; the page says: {await self.words()}")

    async def words(self) -> str:
        """What the page says it is doing."""
        return str(await self.value("document.getElementById('words')?.textContent"))

    async def middle(self, selector: str) -> tuple[float, float]:
        """The middle of an element, scrolled into view."""
        box = f"document.querySelector({selector!r})"
        await self.value(f"{box}.scrollIntoView({{block: 'center'}})")
        x, y, width, height = await self.value(f"(r => [r.x, r.y, r.width, r.height])({box}.getBoundingClientRect())")
        return x + width / 2, y + height / 2

    async def mouse(self, kind: str, x: float, y: float) -> None:
        """Move, press or release: mouseMoved, mousePressed, mouseReleased."""
        if kind != "mouseMoved":
            self.held = int(kind == "mousePressed")
        idle = kind == "mouseMoved" and not self.held
        told = {"button": "none" if idle else "left", "buttons": self.held, "clickCount": 1}
        await self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **told)

    async def to_front(self) -> None:
        """Have this tab be the one that is seen: one behind others draws once a second."""
        await self.call("Page.bringToFront")

    async def click_at(self, x: float, y: float) -> None:
        """A click at a place of the window."""
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            await self.mouse(kind, x, y)

    async def click(self, selector: str) -> None:
        """A click into the middle of an element."""
        await self.click_at(*await self.middle(selector))

    async def key(self, kind: str, key: str, code: str, number: int) -> None:
        """A key: keyDown or keyUp."""
        await self.call(
            "Input.dispatchKeyEvent",
            type=kind,
            key=key,
            code=code,
            windowsVirtualKeyCode=number,
            nativeVirtualKeyCode=number,
        )

    async def picture(self, path: Path, width: int, height: int, quality: int = 80) -> None:
        """A screenshot of a window of that size, whole pages with height 0."""
        size = {"width": width, "height": height or 900, "deviceScaleFactor": 1, "mobile": False}
        await self.call("Emulation.setDeviceMetricsOverride", **size)
        await asyncio.sleep(0.6)
        kind = "webp" if path.suffix == ".webp" else "png"
        options: dict[str, Any] = {"format": kind, "captureBeyondViewport": height == 0}
        if kind == "webp":
            options["quality"] = quality
        said = await self.call("Page.captureScreenshot", **options)
        path.write_bytes(base64.b64decode(said["data"]))

    async def close(self) -> None:
        """Close the tab, as a person does."""
        await self.browser.call("Target.closeTarget", targetId=self.target)


class Browser:
    """A Chromium process."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse, process: "subprocess.Popen[bytes]") -> None:
        self._socket, self.process = socket, process
        self._numbers, self._answers = itertools.count(1), dict[int, asyncio.Future[dict[str, Any]]]()
        self._pages: dict[str, Page] = {}
        self._reading = asyncio.ensure_future(self._read())

    async def call(self, method: str, session: str = "", **parameters: Any) -> dict[str, Any]:
        """A method of the protocol, of the browser or of one tab."""
        number = next(self._numbers)
        self._answers[number] = asyncio.get_running_loop().create_future()
        message = {"id": number, "method": method, "params": parameters}
        await self._socket.send_json(message | ({"sessionId": session} if session else {}))
        async with asyncio.timeout(WAITS_S):
            said = await self._answers[number]
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

    def signal(self, number: signal.Signals) -> None:
        """To all its processes at once."""
        os.killpg(self.process.pid, number)

    async def close(self) -> None:
        """End it."""
        self._reading.cancel()
        with contextlib.suppress(ProcessLookupError, PermissionError):
            self.signal(signal.SIGKILL)
        self.process.wait()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._socket.close(), 1.0)

    async def _read(self) -> None:
        async for message in self._socket:
            said = message.json()
            if "id" in said:
                waiting = self._answers.pop(said["id"], None)
                if waiting is not None and not waiting.done():
                    waiting.set_result(said)
            elif said.get("method") == "Runtime.exceptionThrown":
                page = self._pages.get(said.get("sessionId", ""))
                if page is not None:
                    page.errors.append(str(said["params"]["exceptionDetails"].get("exception", said["params"])))


@contextlib.asynccontextmanager
async def chromium(*flags: str) -> AsyncGenerator[Browser]:
    """A Chromium of its own, with a profile of its own."""
    path = found()
    if path is None:
        raise BrowserError("there is no chromium here")
    with (
        tempfile.TemporaryDirectory(prefix="suturegrasp-browser-", ignore_cleanup_errors=True) as profile,
        _process(path, profile, *flags) as (process, address),
    ):
        async with aiohttp.ClientSession() as session:
            browser = Browser(await session.ws_connect(address, max_msg_size=LARGEST_MESSAGE), process)
            try:
                yield browser
            finally:
                await browser.close()


@contextlib.contextmanager
def _process(path: str, profile: str, *flags: str) -> Generator[tuple["subprocess.Popen[bytes]", str]]:
    log = Path(profile) / "log"
    with log.open("wb") as out:
        process = subprocess.Popen(
            [path, *FLAGS, *flags, f"--user-data-dir={profile}", "about:blank"],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        yield process, _listening(process, log)
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
            raise BrowserError(f"chromium ended: {log.read_text(errors='replace')[-300:]}")
    raise BrowserError("chromium did not start")
