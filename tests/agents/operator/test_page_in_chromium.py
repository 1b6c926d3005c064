"""The real page in a headless Chromium before a running simulated rig: click, preview, arm, hold, a lost tab.

The rig is that of the demo, as processes, except that its thread is made by hand: a thread that perception sees may be
too old for the planner where a test machine is busy. `benchmarks.page` does the same with all of the demo.
"""

import asyncio
import json
import re
import signal
import subprocess
import sys
import threading

import pytest

from benchmarks.browser import BrowserError, chromium, found
from schemas.codec import decode
from schemas.messages import ExecutionEvent, ExecutionKind, RobotMode, RobotState
from schemas.topics import EXECUTION, ROBOT_STATE
from shared.runtime.connection import connected
from shared.runtime.session import SessionSettings, free_local_endpoint

pytestmark = pytest.mark.skipif(found() is None, reason="there is no chromium here (apt-get install chromium)")

STARTS_S, PATIENT_S = 90.0, 60.0
RIG = """
rig = "paged"
[router]
endpoint = "{endpoint}"
[camera]
rate_hz = 10
[planner]
least_probability = 0.0
[robot.psm1]
[simulator]
seed = 3
config = "easy"
[recorder]
folder = "{folder}"
"""
GOAL_PLACE = """(() => {
  scrollTo(0, 0);
  const { thread, canvas, header } = suturegrasp.picture;
  const box = canvas.getBoundingClientRect();
  const [u, v] = thread.px[Math.round(SHARE * (thread.px.length - 1))];
  return [box.x + (u + 0.5) * box.width / header.width, box.y + (v + 0.5) * box.height / header.height];
})()"""
PLANNED = "suturegrasp.panel.state.goals.psm1?.text === '' && suturegrasp.plans.psm1?.ok && suturegrasp.plans.psm1.id"
NEWER = f"((id) => id && id !== BEFORE && id)({PLANNED})"
MOVES = "suturegrasp.panel.state.arms[0].mode === 'moving'"


class Rig:
    """The page's server with all that it started, its links and what its arm tells."""

    def __init__(self, process, settings, audit):
        self.audit = audit
        self.process, self.settings, self.links = process, settings, []
        self.modes, self.ends = [], []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self.process.stdout:
            self.links += re.findall(r"http://\S+", line)

    def hear(self, connection):
        connection.listen((ROBOT_STATE,), lambda t: self.modes.append(decode(RobotState, t.payload).mode))
        connection.listen((EXECUTION,), lambda t: self.ends.append(decode(ExecutionEvent, t.payload)))


@pytest.fixture(scope="module")
def rig(tmp_path_factory, until, in_threads, hand_made_thread):
    folder = tmp_path_factory.mktemp("paged")
    endpoint, config = free_local_endpoint(), folder / "rig.toml"
    config.write_text(RIG.format(endpoint=endpoint, folder=folder))
    command = [
        sys.executable,
        "-m",
        "agents.cli",
        "page",
        "--start",
        "--no-open",
        "--port",
        "0",
        "--config",
        str(config),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            rig = Rig(process, SessionSettings("paged", endpoint), folder / "audit" / "operator-page.jsonl")
            until(lambda: rig.links, "the page's link", STARTS_S)
            with in_threads(rig.settings, hand_made_thread()), connected(rig.settings, STARTS_S) as connection:
                rig.hear(connection)
                yield rig
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(STARTS_S)


async def eventually(condition, what, seconds=PATIENT_S):
    """Wait for something outside of the browser."""
    async with asyncio.timeout(seconds):
        while not condition():
            await asyncio.sleep(0.02)
    assert condition(), what


async def planned(page, share):
    """Click the thread until there is a plan: on a busy machine thread or arm may be too old for the planner."""
    for _ in range(20):
        await page.until("suturegrasp.picture.thread", STARTS_S)
        before = json.dumps(await page.value("suturegrasp.plans.psm1?.id"))
        await page.click_at(*await page.value(GOAL_PLACE.replace("SHARE", str(share))))
        try:
            return await page.until(NEWER.replace("BEFORE", before), 5.0)
        except BrowserError:
            continue
    raise AssertionError(await page.words())


async def armed(page, share=0.4):
    """Press until the arm moves: on a busy machine a page may not answer in time, and is let go of, as it should."""
    for _ in range(20):
        await planned(page, share)
        x, y = await page.middle("#press")
        await page.mouse("mouseMoved", x, y)
        await page.mouse("mousePressed", x, y)
        try:
            await page.until(MOVES, 4.0)
            return x, y
        except BrowserError:
            await page.mouse("mouseReleased", x, y)
    raise AssertionError(await page.value("[...suturegrasp.panel.state.lines, suturegrasp.panel.note].join(' | ')"))


def test_a_person_sees_clicks_previews_arms_and_holds(rig):
    async def person():
        async with chromium("--window-size=1100,800") as browser:
            page = await browser.open(rig.links[-1])
            await page.until("window.suturegrasp?.presented.length > 5", STARTS_S)
            await planned(page, 0.5)
            goal = await page.value("document.getElementById('goal').textContent")
            assert re.search(r"predicted success.*s = 0\.\d+, [\d.]+ mm along", goal), goal
            await page.until("document.getElementById('words').textContent.includes('press and hold to arm psm1')")
            way = await page.value("[suturegrasp.plans.psm1.way.length, suturegrasp.picture.previewed() !== null]")
            assert way[0] > 10, "the preview has a way to go"
            assert way[1]
            x, y = await armed(page)
            await page.mouse("mouseReleased", x, y)
            await eventually(lambda: rig.modes[-1] is RobotMode.HOLDING, "the arm holds")
            await page.until("document.getElementById('lines').textContent.includes('psm1 holds')")
            # a lost tab is as good as a hand that lets go
            await armed(page)
            rig.ends.clear()
            other = await browser.open(rig.links[-1])
            await other.until("window.suturegrasp?.panel.state")
            await page.close()
            await eventually(lambda: any(e.kind is ExecutionKind.HELD for e in rig.ends), "the arm holds")
            # the other page watched, and is told that nobody controls now
            await other.until("document.getElementById('screens').textContent.includes('nobody controls')")
            await other.click("#take")
            await other.until("document.getElementById('control').textContent.includes('you control')")
            await armed(other)
            rig.ends.clear()
            await other.key("keyDown", " ", "Space", 32)
            await other.key("keyUp", " ", "Space", 32)
            await eventually(lambda: any(e.kind is ExecutionKind.HELD for e in rig.ends), "Space holds the arm")
            assert page.errors + other.errors == []

    asyncio.run(person())
    written = [json.loads(line)["what"] for line in rig.audit.read_text().splitlines()]
    assert {"started", "goal", "pressed", "arm", "answer", "hold", "released", "control"} <= set(written)
