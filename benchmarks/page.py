"""The operator's page measured with a real browser before the demo's processes, all on this machine.

    python -m benchmarks.page [--only cost] [--seconds 10] [--rounds 3] [--times 3] [--hostile 10000] [--json FILE]

How far what is on the screen is behind capture; what three pages cost the pipeline (page_cost.py); how soon the arm
holds when whoever presses is lost; what of hostile clients reaches a command. Network cuts need root and nftables, and
are left out where there are none.
"""

import asyncio
import itertools
import json
import tempfile
from collections.abc import Callable, Coroutine
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
import tyro
import yarl
from rich.console import Console
from rich.table import Table

from benchmarks.page_cost import BROWSERS, CLIENTS, ELSEWHERE, LIGHT, NOBODY, measured, row_of, within
from benchmarks.page_hands import FLAGS, all_cuts, pictures
from benchmarks.page_hostile import attacked
from benchmarks.page_rig import Rig, frames_unaccounted, running
from tests.rigs.browser import chromium, found

GOAL_IMAGE_MS, GOAL_HOLD_MS = 80.0, 250.0
RANGED = (("p50_ms", 0), ("hz", 1))
CONSOLE = Console(width=140)


@dataclass(frozen=True)
class Options:
    """How much of it.

    Fields:
        seconds: of pictures, and of each run with and without pages; rounds: of five such runs.
        times: each loss.
        hostile: requests, and as many frames; a tenth of it of each other attack.
        only: `image`, `cost`, `hands` or `hostile` alone.
    """

    seconds: float = 10.0
    rounds: int = 3
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
    figures: dict[str, Any] = {}
    for name, measure in MEASURES.items():
        if options.only not in ("", name):
            continue
        # each has a rig of its own, since some of them end a part of it
        with (
            tempfile.TemporaryDirectory(prefix="suturegrasp-page-") as scratch,
            running(Path(scratch), options.rate_hz) as rig,
        ):
            figures[name] = asyncio.run(measure(rig, options))
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(figures, indent=1) + "\n")


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


async def _cost(rig: Rig, options: Options) -> dict[str, Any]:
    runs = await measured(rig, options.seconds, options.rounds, rig.folder)
    unaccounted, account = await asyncio.to_thread(frames_unaccounted, rig)
    title = (
        f"the pipeline with {CLIENTS} pages and without: medians of runs (lowest to highest); processor in % of a core"
    )
    table = Table(title=title, title_justify="left")
    for column in ("who looks", "runs", "thread behind capture, p50 ms", "p95 ms", "threads a second"):
        table.add_column(column, justify="left" if column == "who looks" else "right")
    for column in ("server", "pipeline", "lookers", "cores idle"):
        table.add_column(column, justify="right")
    rows = {name: row_of(of_name) for name, of_name in runs.items()}
    for name, row in rows.items():
        ranged = (f"{row[n]:.{d}f} ({' to '.join(f'{v:.{d}f}' for v in row[f'{n}_range'])})" for n, d in RANGED)
        p50, hz = ranged
        shares = (f"{row[n]:.0f}" for n in ("server", "pipeline", "lookers", "idle"))
        table.add_row(name, str(len(runs[name])), p50, f"{row['p95_ms']:.0f}", hz, *shares)
    CONSOLE.print(table)
    each = (rows[LIGHT]["server"] - rows[NOBODY]["server"]) / CLIENTS
    CONSOLE.print(f"the server takes {each:.1f} % of a core for each of {CLIENTS} pages")
    for name, noise in ((LIGHT, NOBODY), (BROWSERS, ELSEWHERE)):
        judged = "within" if within(runs[name], runs[noise]) else "beyond"
        CONSOLE.print(f"{name}: latency {judged} that of the runs with {noise}")
    CONSOLE.print(f"frames: {', '.join(f'{n} {v}' for n, v in account.items())}; unaccounted {unaccounted}")
    told = {name: [asdict(run) for run in of_name] for name, of_name in runs.items()}
    return {"runs": told, "server_each": each, "unaccounted": unaccounted, "account": account}


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
