"""What pages cost the pipeline: with none, with light clients, with browsers, and with browsers that look elsewhere.

A browser takes the processor's time wherever it is, and on one machine that is time which perception lacks. What the
page costs is therefore told apart: light clients take pictures without drawing them, so that it is the server's cost
that is left; and browsers before a page that shows as much and belongs to no rig cost what browsers cost.
"""

import asyncio
import contextlib
import json
import statistics
import subprocess
import sys
from collections.abc import AsyncGenerator, Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.page_client import client, connected_page
from benchmarks.page_elsewhere import kept
from benchmarks.page_rig import LINK, Rig
from shared.clock import monotonic_s
from tests.rigs.browser import chromium

CLIENTS = 3
KEPT_S, SETTLES_S, STARTS_S = 6.0, 2.5, 30.0
PIPELINE = ("perception", "reconstruction")
FLAGS = ("--window-size=1100,800",)
NOBODY, LIGHT, BROWSERS, ELSEWHERE = "nobody", "light clients", "browsers", "browsers, elsewhere"
ORDER = (NOBODY, LIGHT, BROWSERS, NOBODY, ELSEWHERE)
"""Runs without pages are those that tell the noise, so there are twice as many."""
Looking = Callable[[], AbstractAsyncContextManager[list[int]]]


@dataclass(frozen=True)
class Run:
    """One run; processor time in per cent of one core.

    Fields:
        p50_ms, p95_ms: how old each thread is when it comes; hz: threads a second.
        server, pipeline, lookers: processor time of the page's server, of perception and reconstruction, and of
            whoever looks; idle: of all cores, the share that nobody took.
    """

    p50_ms: float
    p95_ms: float
    hz: float
    server: float
    pipeline: float
    lookers: float
    idle: float


async def measured(rig: Rig, seconds: float, rounds: int, scratch: Path) -> dict[str, list[Run]]:
    """So many runs of each, in turns, so that what the machine does meanwhile meets all of them."""
    async with connected_page(rig.link()) as socket:
        messages = await kept(socket, KEPT_S)
    path = scratch / "kept.json"
    path.write_text(json.dumps(messages))
    ways: dict[str, Looking] = {
        NOBODY: _nobody,
        LIGHT: lambda: _light(rig),
        BROWSERS: lambda: _browsers(rig.link),
        ELSEWHERE: lambda: _elsewhere(path),
    }
    runs: dict[str, list[Run]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name in ORDER:
            async with ways[name]() as lookers:
                await asyncio.sleep(SETTLES_S)
                runs[name].append(await _run(rig, seconds, lookers))
    return runs


async def _run(rig: Rig, seconds: float, lookers: list[int]) -> Run:
    def taken() -> tuple[float, float, float, float, float]:
        pids = {child.name: child.process.pid for child in rig.supervisor.children if child.process is not None}
        pipeline = sum(_processor_s(pids[name]) for name in PIPELINE)
        # light clients live in this very process
        looked = sum(map(_processor_s, lookers)) if lookers else _own_processor_s()
        return monotonic_s(), _processor_s(pids["page"]), pipeline, looked, psutil.cpu_times().idle

    before, heard = taken(), len(rig.heard.thread_ms)
    await asyncio.sleep(seconds)
    ages = [ms for _, ms in rig.heard.thread_ms[heard:]]
    took_s, server, pipeline, looked, idle = (b - a for a, b in zip(before, taken(), strict=True))
    share = 100.0 / took_s
    p50, p95 = (float(v) for v in np.percentile(ages, (50, 95))) if ages else (float("inf"), float("inf"))
    return Run(
        p50_ms=p50,
        p95_ms=p95,
        hz=len(ages) / took_s,
        server=share * server,
        pipeline=share * pipeline,
        lookers=share * looked,
        idle=share * idle / (psutil.cpu_count() or 1),
    )


def _processor_s(pid: int) -> float:
    """Of a process and all that it started."""
    total = 0.0
    with contextlib.suppress(psutil.NoSuchProcess):
        process = psutil.Process(pid)
        for each in (process, *process.children(recursive=True)):
            with contextlib.suppress(psutil.NoSuchProcess):
                times = each.cpu_times()
                total += times.user + times.system
    return total


def _own_processor_s() -> float:
    times = psutil.Process().cpu_times()
    return times.user + times.system


@contextlib.asynccontextmanager
async def _nobody() -> AsyncGenerator[list[int]]:
    yield []


@contextlib.asynccontextmanager
async def _light(rig: Rig) -> AsyncGenerator[list[int]]:
    async with AsyncExitStack() as stack:
        for _ in range(CLIENTS):
            await stack.enter_async_context(client(rig.link()))
        yield []


@contextlib.asynccontextmanager
async def _browsers(link: Callable[[], str]) -> AsyncGenerator[list[int]]:
    async with AsyncExitStack() as stack:
        pids: list[int] = []
        for _ in range(CLIENTS):
            browser = await stack.enter_async_context(chromium(*FLAGS))
            page = await browser.open(link())
            await page.until("window.suturegrasp?.presented.length > 5", STARTS_S)
            pids.append(browser.process.pid)
        yield pids


@contextlib.asynccontextmanager
async def _elsewhere(path: Path) -> AsyncGenerator[list[int]]:
    command = [sys.executable, "-m", "benchmarks.page_elsewhere", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            found = LINK.search(await asyncio.to_thread(process.stdout.readline))
            assert found is not None
            async with _browsers(lambda: found[0]) as pids:
                yield [*pids, process.pid]
        finally:
            process.kill()


def row_of(runs: list[Run]) -> dict[str, Any]:
    """The median of runs, with the lowest and the highest of what is compared."""
    told: dict[str, Any] = {name: statistics.median(getattr(r, name) for r in runs) for name in Run.__annotations__}
    for name in ("p50_ms", "hz"):
        values = [getattr(run, name) for run in runs]
        told[f"{name}_range"] = [min(values), max(values)]
    return told


def within(runs: list[Run], noise: list[Run]) -> bool:
    """Whether the median latency of runs lies among those of others, or below."""
    return statistics.median(run.p50_ms for run in runs) <= max(run.p50_ms for run in noise)
