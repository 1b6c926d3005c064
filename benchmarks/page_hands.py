"""What a person's hands do to the page in a real browser, and how soon the arm holds once they are gone."""

import asyncio
import contextlib
import json
import shutil
import signal
import subprocess
from collections.abc import AsyncGenerator, Awaitable, Callable
from dataclasses import dataclass

from benchmarks.page_rig import Rig
from schemas.messages import RobotMode
from shared.clock import monotonic_s, now_ns
from tests.rigs.browser import Browser, BrowserError, Page, chromium

FLAGS = ("--window-size=1100,800",)
SHARE = 0.45
TRIES = 12
MOVES_S, HOLDS_S = 4.0, 5.0
GOAL_PLACE = f"""(() => {{
  const {{ thread, canvas, header }} = suturegrasp.picture;
  const box = canvas.getBoundingClientRect();
  const [u, v] = thread.px[Math.round({SHARE} * (thread.px.length - 1))];
  return [box.x + (u + 0.5) * box.width / header.width, box.y + (v + 0.5) * box.height / header.height];
}})()"""
PLANNED = "suturegrasp.panel.state.goals.psm1?.text === '' && suturegrasp.plans.psm1?.ok && suturegrasp.plans.psm1.id"
NEWER = f"((id) => id && id !== BEFORE && id)({PLANNED})"
TABLE = "paged_cut"


@dataclass(frozen=True)
class Cut:
    """How soon the arm held after a loss, in ms, each time."""

    name: str
    held_ms: tuple[float, ...]


async def pictures(page: Page, seconds: float) -> list[tuple[int, float]]:
    """Every frame on the page's screen during that time: its number, and how far behind capture it was, in ms."""
    await page.until("window.suturegrasp?.presented.length > 20 && suturegrasp.picture.thread", 60.0)
    await page.value("suturegrasp.presented.length = 0")
    await asyncio.sleep(seconds)
    return [(int(f), float(ms)) for f, ms in await page.value("suturegrasp.presented.map((p) => [p[0], p[2] - p[1]])")]


async def moving(page: Page, rig: Rig) -> tuple[float, float]:
    """Click, look, press until the arm moves; where the button is."""
    for _ in range(TRIES):
        with contextlib.suppress(BrowserError):
            await page.until("window.suturegrasp?.picture.thread && suturegrasp.panel.state", 30.0)
            if await page.value("suturegrasp.panel.state.controller !== suturegrasp.panel.state.you"):
                await page.click("#take")
                await page.until("suturegrasp.panel.state.controller === suturegrasp.panel.state.you", 20.0)
            await page.value("document.getElementById('picture').scrollIntoView()")
            before = json.dumps(await page.value("suturegrasp.plans.psm1?.id"))
            await page.click_at(*await page.value(GOAL_PLACE))
            await page.until(NEWER.replace("BEFORE", before), 6.0)
            x, y = await page.middle("#press")
            await page.mouse("mouseMoved", x, y)
            await page.mouse("mousePressed", x, y)
            deadline_s = monotonic_s() + MOVES_S
            while monotonic_s() < deadline_s:
                if rig.mode() is RobotMode.MOVING:
                    # well into the motion
                    await asyncio.sleep(0.4)
                    if rig.mode() is RobotMode.MOVING:
                        return x, y
                await asyncio.sleep(0.01)
            await page.mouse("mouseReleased", x, y)
    raise BrowserError(f"the arm did not move: {await page.words()}")


async def held_after(rig: Rig, lose: Callable[[], Awaitable[None]]) -> float:
    """Lose something, and say how many ms later the arm's state says that it holds."""
    at_ns = now_ns()
    losing = asyncio.ensure_future(lose())
    deadline_s = monotonic_s() + HOLDS_S
    while monotonic_s() < deadline_s:
        for measured_ns, mode in reversed(rig.heard.states[-200:]):
            if measured_ns < at_ns:
                break
            if mode is RobotMode.HOLDING:
                first = next(ns for ns, m in rig.heard.states[-400:] if ns >= at_ns and m is RobotMode.HOLDING)
                with contextlib.suppress(BrowserError, TimeoutError, ConnectionError):
                    await asyncio.wait_for(losing, 1.0)
                return (first - at_ns) * 1e-6
        await asyncio.sleep(0.002)
    return float("inf")


async def all_cuts(rig: Rig, port: int, times: int, told: Callable[[str], None]) -> list[Cut]:
    """Every way of losing whoever presses, so many times each; at last the server itself."""
    cuts: list[Cut] = []
    for name, lose in (
        ("button released", _released),
        ("tab closed", _tab_closed),
        ("focus lost", _focus_lost),
        ("page frozen (endless loop)", _page_frozen),
        ("browser stopped (SIGSTOP)", _browser_stopped),
        ("browser killed (SIGKILL)", _browser_killed),
        ("network cut (packets dropped)", _network_cut(port)),
        ("page's server killed (SIGKILL)", _server_killed(rig)),
    ):
        if "network" in name and shutil.which("nft") is None:
            continue
        held = list[float]()
        for _ in range(1 if "server" in name else times):
            async with chromium(*FLAGS) as browser:
                page = await browser.open(rig.link())
                await moving(page, rig)
                held.append(await held_after(rig, lambda lose=lose, b=browser, p=page: lose(b, p)))
        cuts.append(Cut(name, tuple(held)))
        told(f"{name}: {', '.join(f'{ms:.0f}' for ms in held)} ms")
    return cuts


async def _released(_browser: Browser, page: Page) -> None:
    x, y = await page.middle("#press")
    await page.mouse("mouseReleased", x, y)


async def _tab_closed(_browser: Browser, page: Page) -> None:
    await page.close()


async def _focus_lost(_browser: Browser, page: Page) -> None:
    await page.value("window.dispatchEvent(new Event('blur'))")


async def _page_frozen(_browser: Browser, page: Page) -> None:
    await page.value("(() => { const end = performance.now() + 4000; while (performance.now() < end); })()")


async def _browser_stopped(browser: Browser, _page: Page) -> None:
    browser.signal(signal.SIGSTOP)


async def _browser_killed(browser: Browser, _page: Page) -> None:
    browser.signal(signal.SIGKILL)


def _network_cut(port: int) -> Callable[[Browser, Page], Awaitable[None]]:
    async def cut(_browser: Browser, _page: Page) -> None:
        async with packets_dropped(port):
            await asyncio.sleep(1.5)

    return cut


def _server_killed(rig: Rig) -> Callable[[Browser, Page], Awaitable[None]]:
    async def kill(_browser: Browser, _page: Page) -> None:
        assert rig.server.process is not None
        rig.server.process.kill()

    return kill


@contextlib.asynccontextmanager
async def packets_dropped(port: int) -> AsyncGenerator[None]:
    """Have the kernel drop what goes to and from a port of this host (nftables; needs root)."""
    drop = f"tcp dport {port} drop\n tcp sport {port} drop\n"
    rules = f"table inet {TABLE} {{\n chain c {{\n type filter hook input priority 0\n {drop} }}\n}}\n"
    subprocess.run(["nft", "-f", "-"], input=rules.encode(), check=True)  # noqa: S607
    try:
        yield
    finally:
        subprocess.run(["nft", "delete", "table", "inet", TABLE], check=True)  # noqa: S607
