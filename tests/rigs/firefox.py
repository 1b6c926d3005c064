"""A headless Firefox driven by WebDriver BiDi, which it speaks itself: as much of it as the page's press needs."""

import contextlib
import json
import shutil
import subprocess
from collections.abc import AsyncGenerator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import aiohttp

from tests.rigs.browser import Asked, BrowserError, Tab, profile_of, started

NAMES = ("firefox-esr", "firefox")
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
class FirefoxPage(Tab):
    """One tab."""

    browser: "Firefox"
    context: str

    async def value(self, expression: str) -> Any:
        # as text, for values of this protocol are told type by type
        asked = f"(async () => JSON.stringify(await ({expression})))()"
        target = {"context": self.context}
        said = await self.browser.call("script.evaluate", expression=asked, target=target, awaitPromise=True)
        if said["type"] == "exception":
            raise BrowserError(f"{expression}: {said['exceptionDetails']}")
        return json.loads(said["result"]["value"]) if "value" in said["result"] else None

    async def mouse(self, kind: str, x: float, y: float, button: int = 0) -> None:
        action = {"type": POINTED[kind]}
        action |= {"x": round(x), "y": round(y)} if kind == "mouseMoved" else {"button": button}
        await self._act("pointer", "mouse", action, parameters={"pointerType": "mouse"})

    async def touch(self, kind: str, x: float, y: float, finger: int = 0) -> None:
        """Touch or lift a finger: touchStart, touchEnd."""
        actions: list[dict[str, Any]] = [{"type": "pointerUp", "button": 0}]
        if kind == "touchStart":
            actions = [{"type": "pointerMove", "x": round(x), "y": round(y)}, {"type": "pointerDown", "button": 0}]
        await self._act("pointer", f"finger {finger}", *actions, parameters={"pointerType": "touch"})

    async def key(self, kind: str, key: str, code: str, number: int) -> None:
        """A key: keyDown, again while it is down for a repetition, or keyUp."""
        await self._act("key", "keys", {"type": kind, "value": KEYS.get(key, key)})

    async def repeat(self, key: str, code: str, number: int) -> None:
        """A key that is down repeats itself."""
        await self.key("keyDown", key, code, number)

    async def _act(self, kind: str, source: str, *actions: dict[str, Any], **more: Any) -> None:
        told = {"type": kind, "id": source, "actions": list(actions)} | more
        await self.browser.call("input.performActions", context=self.context, actions=[told])


class Firefox(Asked):
    """A Firefox."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse, process: "subprocess.Popen[bytes]") -> None:
        super().__init__(socket, process)
        self._pages: dict[str, FirefoxPage] = {}

    async def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A command of the protocol."""
        said = await self.ask(method, parameters)
        if said["type"] == "error":
            raise BrowserError(f"{method}: {said['error']}: {said['message']}")
        return said["result"]

    async def open(self, address: str) -> FirefoxPage:
        """A new tab at an address."""
        context = (await self.call("browsingContext.create", type="tab"))["context"]
        page = self._pages[context] = FirefoxPage(self, context)
        await self.call("browsingContext.navigate", context=context, url=address, wait="complete")
        return page

    def heard(self, said: dict[str, Any]) -> None:
        if said.get("method") == "log.entryAdded" and said["params"]["type"] == "javascript":
            page = self._pages.get(said["params"]["source"].get("context", ""))
            if page is not None:
                page.errors.append(str(said["params"]["text"]))


@contextlib.asynccontextmanager
async def firefox(*flags: str) -> AsyncGenerator[Firefox]:
    """A Firefox of its own, with a profile of its own."""
    with profile_of("firefox") as profile:
        lines = [f'user_pref("{name}", {value});' for name, value in PREFERENCES.items()]
        (Path(profile) / "user.js").write_text("\n".join(lines))
        arguments = ("--headless", "--no-remote", "--profile", profile, *flags)
        async with started(found(), profile, *arguments) as (process, connect):
            browser = Firefox(await connect("/session"), process)
            try:
                # what asks for a person is left standing, as it would before one
                await browser.call("session.new", capabilities={"alwaysMatch": {"unhandledPromptBehavior": PROMPTS}})
                await browser.call("session.subscribe", events=["log.entryAdded"])
                yield browser
            finally:
                await browser.close()
