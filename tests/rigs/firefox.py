"""A headless Firefox driven by WebDriver BiDi, which it speaks itself: as much of a browser as the page's press needs.

async with firefox() as browser:
    page = await browser.open("http://127.0.0.1:7450/#token=...")
    await page.key("keyDown", "Enter", "Enter", 13)
"""

import asyncio
import contextlib
import itertools
import json
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
from tests.rigs.browser import LARGEST_MESSAGE, STARTS_S, WAITS_S, BrowserError

NAMES = ("firefox-esr", "firefox")
LISTENS = re.compile(rb"WebDriver BiDi listening on (ws://\S+)")
PREFERENCES = {
    # a window without a screen has the focus
    "focusmanager.testmode": "true",
    "browser.shell.checkDefaultBrowser": "false",
    "datareporting.policy.dataSubmissionEnabled": "false",
    "app.normandy.enabled": "false",
    "network.captive-portal-service.enabled": "false",
    "network.connectivity-service.enabled": "false",
}
KEYS = {
    "Enter": "\ue007",
    "Escape": "\ue00c",
    "Alt": "\ue00a",
    "Shift": "\ue008",
    "Tab": "\ue004",
    "ArrowRight": "\ue014",
}
"""As WebDriver names those that write nothing."""
PROMPTS = dict.fromkeys(("alert", "confirm", "prompt", "beforeUnload"), "ignore")
POINTED = {"mouseMoved": "pointerMove", "mousePressed": "pointerDown", "mouseReleased": "pointerUp"}


def found() -> str | None:
    """Where a Firefox is; None where there is none."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


@dataclass
class FirefoxPage:
    """One tab."""

    browser: "Firefox"
    context: str
    errors: list[str] = field(default_factory=list[str])

    async def value(self, expression: str) -> Any:
        """What an expression comes to, awaited."""
        # as text, for values of this protocol are told type by type
        asked = f"(async () => JSON.stringify(await ({expression})))()"
        target = {"context": self.context}
        said = await self.browser.call("script.evaluate", expression=asked, target=target, awaitPromise=True)
        if said["type"] == "exception":
            raise BrowserError(f"{expression}: {said['exceptionDetails']}")
        return json.loads(said["result"]["value"]) if "value" in said["result"] else None

    async def until(self, expression: str, seconds: float = WAITS_S) -> Any:
        """Wait until an expression is true, and return it."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while not (value := await self.value(expression)):
                    await asyncio.sleep(0.02)
                return value
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

    async def mouse(self, kind: str, x: float, y: float, button: int = 0) -> None:
        """Move, press or release: mouseMoved, mousePressed, mouseReleased."""
        action = {"type": POINTED[kind]}
        action |= {"x": round(x), "y": round(y)} if kind == "mouseMoved" else {"button": button}
        await self._act("pointer", "mouse", action, parameters={"pointerType": "mouse"})

    async def touch(self, kind: str, x: float, y: float, finger: int = 0) -> None:
        """Touch or lift a finger: touchStart, touchEnd."""
        source = {"parameters": {"pointerType": "touch"}}
        if kind == "touchStart":
            move = {"type": "pointerMove", "x": round(x), "y": round(y)}
            await self._act("pointer", f"finger {finger}", move, {"type": "pointerDown", "button": 0}, **source)
        else:
            await self._act("pointer", f"finger {finger}", {"type": "pointerUp", "button": 0}, **source)

    async def key(self, kind: str, key: str, code: str, number: int) -> None:
        """A key: keyDown, again while it is down for a repetition, or keyUp."""
        await self._act("key", "keys", {"type": kind, "value": KEYS.get(key, key)})

    async def repeat(self, key: str, code: str, number: int) -> None:
        """A key that is down repeats itself."""
        await self.key("keyDown", key, code, number)

    async def close(self) -> None:
        """Close the tab, as a person does."""
        await self.browser.call("browsingContext.close", context=self.context)

    async def _act(self, kind: str, source: str, *actions: dict[str, Any], **more: Any) -> None:
        told = {"type": kind, "id": source, "actions": list(actions)} | more
        await self.browser.call("input.performActions", context=self.context, actions=[told])


class Firefox:
    """A Firefox process."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse, process: "subprocess.Popen[bytes]") -> None:
        self._socket, self.process = socket, process
        self._numbers, self._answers = itertools.count(1), dict[int, asyncio.Future[dict[str, Any]]]()
        self._pages: dict[str, FirefoxPage] = {}
        self._reading = asyncio.ensure_future(self._read())

    async def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A command of the protocol."""
        number = next(self._numbers)
        self._answers[number] = asyncio.get_running_loop().create_future()
        await self._socket.send_json({"id": number, "method": method, "params": parameters})
        async with asyncio.timeout(WAITS_S):
            said = await self._answers[number]
        if said["type"] == "error":
            raise BrowserError(f"{method}: {said['error']}: {said['message']}")
        return said["result"]

    async def open(self, address: str) -> FirefoxPage:
        """A new tab at an address."""
        context = (await self.call("browsingContext.create", type="tab"))["context"]
        page = self._pages[context] = FirefoxPage(self, context)
        await self.call("browsingContext.navigate", context=context, url=address, wait="complete")
        return page

    async def close(self) -> None:
        """End it."""
        self._reading.cancel()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._socket.close(), 1.0)

    async def _read(self) -> None:
        async for message in self._socket:
            said = message.json()
            if "id" in said:
                waiting = self._answers.pop(said["id"], None)
                if waiting is not None and not waiting.done():
                    waiting.set_result(said)
            elif said.get("method") == "log.entryAdded" and said["params"]["type"] == "javascript":
                page = self._pages.get(said["params"]["source"].get("context", ""))
                if page is not None:
                    page.errors.append(str(said["params"]["text"]))


@contextlib.asynccontextmanager
async def firefox(*flags: str) -> AsyncGenerator[Firefox]:
    """A Firefox of its own, with a profile of its own."""
    path = found()
    if path is None:
        raise BrowserError("there is no firefox here")
    with (
        tempfile.TemporaryDirectory(prefix="suturegrasp-firefox-", ignore_cleanup_errors=True) as profile,
        _process(path, Path(profile), *flags) as (process, address),
    ):
        async with aiohttp.ClientSession() as session:
            socket = await session.ws_connect(f"{address}/session", max_msg_size=LARGEST_MESSAGE)
            browser = Firefox(socket, process)
            try:
                # what asks for a person is left standing, as it would before one
                await browser.call("session.new", capabilities={"alwaysMatch": {"unhandledPromptBehavior": PROMPTS}})
                await browser.call("session.subscribe", events=["log.entryAdded"])
                yield browser
            finally:
                await browser.close()


@contextlib.contextmanager
def _process(path: str, profile: Path, *flags: str) -> Generator[tuple["subprocess.Popen[bytes]", str]]:
    lines = [f'user_pref("{name}", {value});' for name, value in PREFERENCES.items()]
    (profile / "user.js").write_text("\n".join(lines))
    log = profile / "log"
    with log.open("wb") as out:
        process = subprocess.Popen(
            [path, "--headless", "--no-remote", "--profile", profile, "--remote-debugging-port=0", *flags],
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
            raise BrowserError(f"firefox ended: {log.read_text(errors='replace')[-300:]}")
    raise BrowserError("firefox did not start")
