"""The operator's page measured with a real browser before the demo's processes, all on this machine.

    python -m benchmarks.page [--seconds 20] [--times 3] [--hostile 10000] [--rate-hz 30] [--json out/page.json]

How far what is on the screen is behind capture; what three pages cost the pipeline; how soon the arm holds when whoever
presses is lost; what of hostile clients reaches a command. Network cuts need root and nftables, and are left out where
there are none.
"""

import asyncio
import contextlib
import itertools
import json
import tempfile
from collections.abc import AsyncGenerator, Callable, Coroutine
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import tyro
import yarl
from rich.console import Console
from rich.table import Table

from benchmarks.browser import chromium, found
from benchmarks.page_client import client
from benchmarks.page_hands import FLAGS, all_cuts, pictures
from benchmarks.page_hostile import attacked
from benchmarks.page_rig import Rig, frames_unaccounted, running
from shared.clock import monotonic_s

GOAL_IMAGE_MS, GOAL_HOLD_MS = 80.0, 250.0
CLIENTS, TURNS = 3, 2
CONSOLE = Console(width=140)


@dataclass(frozen=True)
class Options:
    """How much of it.

    Fields:
        seconds: of pictures, and of each turn with and without pages.
        times: each loss.
        hostile: requests, and as many frames; a tenth of it of each other attack.
        only: `image`, `cost`, `hands` or `hostile` alone.
    """

    seconds: float = 20.0
    times: int = 3
    hostile: int = 10_000
    rate_hz: float = 30.0
    only: str = ""
    json: Path | None = None


def main() -> None:
    """Measure, print, and write JSON where asked to."""
    options = tyro.cli(Options)
    if found() is None:
        raise SystemExit("nothing was measured: there is no chromium here (apt-get install chromium)")
    measured: dict[str, Any] = {}
    for name, measure in MEASURES.items():
        if options.only not in ("", name):
            continue
        # each has a rig of its own, since some of them end a part of it
        with (
            tempfile.TemporaryDirectory(prefix="suturegrasp-page-") as scratch,
            running(Path(scratch), options.rate_hz) as rig,
        ):
            measured[name] = asyncio.run(measure(rig, options))
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(measured, indent=1) + "\n")


async def _hands(rig: Rig, options: Options) -> list[dict[str, Any]]:
    port = yarl.URL(rig.link()).port or 0
    CONSOLE.print(f"the arm holds after a loss, each of {options.times} times (goal: {GOAL_HOLD_MS:.0f} ms)")
    return [asdict(cut) for cut in await all_cuts(rig, port, options.times, lambda line: CONSOLE.print(f"  {line}"))]


async def _image(rig: Rig, options: Options) -> dict[str, float]:
    seconds = options.seconds
    async with chromium(*FLAGS) as browser:
        page = await browser.open(rig.link())
        shown = await pictures(page, seconds)
    frames, ms = [frame for frame, _ in shown], np.array([ms for _, ms in shown])
    told = {
        "p50_ms": float(np.percentile(ms, 50)),
        "p95_ms": float(np.percentile(ms, 95)),
        "shown_hz": len(shown) / seconds,
        "out_of_order": float(sum(b <= a for a, b in itertools.pairwise(frames))),
    }
    table = Table(title=f"image on screen behind capture (goal: p50 {GOAL_IMAGE_MS:.0f} ms)", title_justify="left")
    for column in ("p50 ms", "p95 ms", "shown a second", "older than one shown before"):
        table.add_column(column, justify="right")
    table.add_row(*(f"{value:.0f}" for value in told.values()))
    CONSOLE.print(table)
    return told


@contextlib.asynccontextmanager
async def _clients(rig: Rig, count: int) -> AsyncGenerator[None]:
    """Pages as programs, which take what they are sent at once: a browser would take this machine's own time."""
    async with contextlib.AsyncExitStack() as stack:
        for _ in range(count):
            await stack.enter_async_context(client(rig.link()))
        yield


async def _cost(rig: Rig, options: Options) -> dict[str, Any]:
    ages: dict[int, list[float]] = {0: [], CLIENTS: []}
    seconds = options.seconds
    for _ in range(TURNS):
        for count, of_count in ages.items():
            async with _clients(rig, count):
                await asyncio.sleep(2.0)
                began_s = monotonic_s()
                await asyncio.sleep(seconds)
                of_count += [ms for at_s, ms in rig.heard.thread_ms if at_s >= began_s]
    unaccounted, account = await asyncio.to_thread(frames_unaccounted, rig)
    table = Table(title=f"the pipeline with and without {CLIENTS} pages", title_justify="left")
    for column in ("pages", "thread behind capture, p50 ms", "p95 ms", "threads a second"):
        table.add_column(column, justify="right")
    rows: dict[str, Any] = {}
    for count, of_count in ages.items():
        p50, p95 = (float(v) for v in np.percentile(of_count, (50, 95)))
        rows[str(count)] = {"p50_ms": p50, "p95_ms": p95, "hz": len(of_count) / (TURNS * seconds)}
        table.add_row(str(count), f"{p50:.0f}", f"{p95:.0f}", f"{len(of_count) / (TURNS * seconds):.1f}")
    CONSOLE.print(table)
    CONSOLE.print(f"frames: {', '.join(f'{n} {v}' for n, v in account.items())}; unaccounted {unaccounted}")
    return rows | {"unaccounted": unaccounted, "account": account}


async def _hostile(rig: Rig, options: Options) -> dict[str, Any]:
    link = yarl.URL(rig.link())
    address, token = f"{link.origin()}/", link.fragment.removeprefix("token=")
    async with aiohttp.ClientSession(headers={"Origin": str(link.origin())}) as session:
        async with session.post(f"{address}session", json={"token": token}) as answer:
            secret = (await answer.json())["secret"]
        async with session.ws_connect(f"{address}ws") as socket:
            await socket.send_json({"kind": "hello", "secret": secret})
            await socket.receive()
    before = rig.heard.commands
    attacks = await attacked(address, token, secret, options.hostile, seed=1)
    await asyncio.sleep(1.0)
    reached = rig.heard.commands - before
    table = Table(title="hostile clients", title_justify="left")
    for column in ("attack", "sent", "refused", "let in"):
        table.add_column(column, justify="left" if column == "attack" else "right")
    for attack in attacks:
        table.add_row(attack.name, str(attack.sent), str(attack.refused), str(attack.let_in))
    CONSOLE.print(table)
    alive = rig.server.process is not None and rig.server.process.poll() is None
    CONSOLE.print(f"commands that reached an agent: {reached}; the server {'still serves' if alive else 'has ended'}")
    return {"attacks": [asdict(attack) for attack in attacks], "commands": reached, "alive": alive}


MEASURES: dict[str, Callable[[Rig, Options], Coroutine[Any, Any, Any]]] = {
    "image": _image,
    "cost": _cost,
    "hands": _hands,
    "hostile": _hostile,
}


if __name__ == "__main__":
    main()
