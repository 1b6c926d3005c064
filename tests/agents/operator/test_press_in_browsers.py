"""Whatever takes a press away lets go of it, in Chromium and in Firefox: keys, pointers, focus, dialogs.

The presses are real input of the browser. Nothing is armed by them: the button would have to be held for longer.
"""

import asyncio
import contextlib
import re

import pytest

from agents.planner.agent import Planner
from agents.planner.config import PlannerConfig
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.simulated import SimulatedPsm
from shared.runtime.commands import new_header
from tests.rigs.browser import BrowserError, chromium
from tests.rigs.browser import found as chromium_found
from tests.rigs.firefox import firefox
from tests.rigs.firefox import found as firefox_found

pytestmark = pytest.mark.browser

PATIENT_S, NEVER_S, BEAT_S = 60.0, 1e6, 2.0
PLANNED = "suturegrasp.plans.psm1?.ok && suturegrasp.panel.state.goals.psm1?.text === ''"
PRESSES = "suturegrasp.panel.state.press?.stage === 'pressing'"
DOWN = "document.getElementById('press').classList.contains('down')"
FIELD = "document.getElementById('picture')"
CHROMIUM = pytest.param("chromium", marks=pytest.mark.skipif(chromium_found() is None, reason="no chromium here"))
FIREFOX = pytest.param("firefox", marks=pytest.mark.skipif(firefox_found() is None, reason="no firefox here"))


@pytest.fixture
def patient(settings, monkeypatch):
    """The settings of a rig that waits for a busy machine, and arms nothing."""
    monkeypatch.setattr("agents.operator.control.PRESS_S", NEVER_S)
    monkeypatch.setattr("agents.operator.control.BEAT_S", BEAT_S)
    monkeypatch.setattr("agents.operator.choosing.AGAIN_FOR_S", PATIENT_S)
    monkeypatch.setattr("agents.operator.carrying_out.new_header", lambda sender: new_header(sender, PATIENT_S))
    monkeypatch.setattr("shared.runtime.commands.FARTHEST_DEADLINE_S", 2 * PATIENT_S)
    return settings


@pytest.fixture
def planner():
    return Planner(PlannerConfig(arm_age_ms=1e3 * PATIENT_S))


@pytest.fixture
def rig(patient, planner, in_threads, hand_made_thread, hand_made_camera):
    bridge = RobotBridge(RobotBridgeConfig(), SimulatedPsm())
    with in_threads(patient, hand_made_thread(), hand_made_camera(), planner, bridge):
        yield patient


class InChromium:
    """What hands do by Chromium's protocol, beyond what its page does already."""

    browser = staticmethod(chromium)

    def __init__(self, page):
        self.page = page

    async def repeat(self, key, number):
        told = {"key": key, "code": key, "windowsVirtualKeyCode": number, "autoRepeat": True}
        await self.page.call("Input.dispatchKeyEvent", type="keyDown", **told)

    async def second_button(self, x, y):
        both = {"button": "right", "buttons": 3, "clickCount": 1}
        await self.page.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **both)
        await self.page.call("Input.dispatchMouseEvent", type="mouseReleased", x=x, y=y, **both | {"buttons": 1})

    async def touch(self, *fingers):
        """As many fingers as are told are down now."""
        points = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(fingers)]
        kind = "touchStart" if points else "touchEnd"
        await self.page.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)

    async def cancel(self):
        await self.page.call("Input.dispatchTouchEvent", type="touchCancel", touchPoints=[])

    async def dialog_over(self):
        await self.page.call("Page.handleJavaScriptDialog", accept=True)


class InFirefox:
    """The same by WebDriver BiDi."""

    browser = staticmethod(firefox)
    cancel = None

    def __init__(self, page):
        self.page, self._down = page, 0

    async def repeat(self, key, number):
        await self.page.repeat(key, key, number)

    async def second_button(self, x, y):
        await self.page.mouse("mousePressed", x, y, button=2)
        await self.page.mouse("mouseReleased", x, y, button=2)

    async def touch(self, *fingers):
        while self._down > len(fingers):
            self._down -= 1
            await self.page.touch("touchEnd", 0, 0, self._down)
        for number in range(self._down, len(fingers)):
            await self.page.touch("touchStart", *fingers[number], number)
            self._down += 1

    async def dialog_over(self):
        # a page loses its focus before the dialog is there
        async with asyncio.timeout(PATIENT_S):
            while True:
                with contextlib.suppress(BrowserError):
                    return await self.page.browser.call("browsingContext.handleUserPrompt", context=self.page.context)
                await asyncio.sleep(0.1)


class Hands:
    """Presses the button, loses the press in some way, and reads what was written down of why."""

    def __init__(self, page, ways, written):
        self.page, self.ways, self._written = page, ways, written

    async def by_mouse(self):
        x, y = await self.page.middle("#press")
        await self.page.mouse("mouseMoved", x, y)
        await self.page.mouse("mousePressed", x, y)
        return x, y

    async def by_key(self):
        await self.page.value("document.getElementById('press').focus()")
        await self.page.key("keyDown", "Enter", "Enter", 13)

    async def by_touch(self):
        x, y = await self.page.middle("#press")
        await self.ways.touch((x, y))
        return x, y

    async def begins(self, how):
        """Begin a press that lasts until more pictures have come."""
        at = await how()
        await self.page.until(f"{PRESSES} && {DOWN}", PATIENT_S)
        await self.lasts()
        return at

    async def lasts(self):
        """The press is still there after a few pictures, by what the server tells."""
        frame = await self.page.value("suturegrasp.presented.at(-1)[0]")
        await self.page.until(f"suturegrasp.presented.at(-1)[0] > {frame} + 3", PATIENT_S)
        assert await self.page.value(f"{PRESSES} && {DOWN}"), self.why()

    def why(self):
        return [told["text"] for what, told in self._written if what == "released"]

    async def lost(self, why):
        """The server has let go for this reason, and neither it nor the page goes on."""
        await self.page.until(f"!{DOWN} && !suturegrasp.panel.state.press", PATIENT_S)
        assert re.search(why, self.why()[-1]), f"{self.why()[-1]}, not {why}"

    async def key(self, key, number, kinds=("keyDown", "keyUp")):
        for kind in kinds:
            await self.page.key(kind, key, key, number)


async def planned(page):
    """Choose a place by keys, until there is a plan to press for."""
    await page.until("document.getElementById('control').textContent.includes('you control')", PATIENT_S)
    await page.value(f"{FIELD}.focus()")
    for kind in ("keyDown", "keyUp"):
        await page.key(kind, "ArrowRight", "ArrowRight", 39)
    await page.until(PLANNED, PATIENT_S)


async def lose_a_mouse(hands):
    page = hands.page

    async def lost(why, lose, up=True):
        x, y = await hands.begins(hands.by_mouse)
        await lose(x, y)
        await hands.lost(why)
        if up:
            await page.mouse("mouseReleased", x, y)

    await lost("the button was released", lambda x, y: page.mouse("mouseReleased", x, y), up=False)
    await lost("the pointer left the button", lambda x, y: page.mouse("mouseMoved", x, y + 200))
    await lost("another key was pressed", lambda _x, _y: hands.key("a", 65))
    await lost("another key was pressed", lambda _x, _y: hands.key("Alt", 18))
    await lost("another mouse button|a second pointer|a menu was asked for", hands.ways.second_button)
    await lost("the button lost the focus", lambda _x, _y: page.value(f"{FIELD}.focus()"))
    moved = "document.getElementById('press').style.marginTop = '300px'"
    await lost("the button moved away", lambda _x, _y: page.value(moved))
    await page.value("document.getElementById('press').style.marginTop = ''")
    for kind, target, why in (
        ("blur", "window", "the page lost the focus"),
        ("contextmenu", "document.getElementById('press')", "a menu was asked for"),
        ("dragstart", FIELD, "something was dragged"),
        ("pagehide", "window", "the page was left"),
        ("beforeprint", "window", "the page is to be printed"),
        ("freeze", "document", "the page was frozen"),
    ):
        happens = f"{target}.dispatchEvent(new Event('{kind}', {{ bubbles: true, cancelable: true }}))"
        await lost(why, lambda _x, _y, happens=happens: page.value(happens))
    # a dialog stops everything on the page, and what it does not answer is held
    x, y = await hands.begins(hands.by_mouse)
    await page.value("void setTimeout(() => alert('a dialog'), 0)")
    async with asyncio.timeout(PATIENT_S):
        told = len(hands.why())
        while len(hands.why()) == told:
            await asyncio.sleep(0.02)
    assert re.search("did not answer|lost the focus|not looked at", hands.why()[-1]), hands.why()[-1]
    await hands.ways.dialog_over()
    await page.mouse("mouseReleased", x, y)


async def lose_a_key(hands):
    page = hands.page

    async def lost(why, lose, up=True):
        await hands.begins(hands.by_key)
        await lose()
        await hands.lost(why)
        if up:
            await hands.key("Enter", 13, ["keyUp"])

    await hands.begins(hands.by_key)
    for _ in range(5):
        await hands.ways.repeat("Enter", 13)
    await hands.lasts()
    await hands.key("Enter", 13, ["keyUp"])
    await hands.lost("the key was released")
    await lost("another key was pressed", lambda: hands.key("Tab", 9))
    await lost("another key was pressed", lambda: hands.key("Alt", 18))
    await lost("the button lost the focus", lambda: page.value(f"{FIELD}.focus()"))
    # a key that is still down when the press was lost begins none anew
    await hands.begins(hands.by_key)
    await hands.key("Shift", 16)
    await hands.lost("another key was pressed")
    for _ in range(3):
        await hands.ways.repeat("Enter", 13)
    assert not await page.value(DOWN)
    await hands.key("Enter", 13, ["keyUp"])
    # a disabled button hears no key: its release is heard on the window
    await hands.begins(hands.by_key)
    await page.value("document.getElementById('press').disabled = true")
    await hands.key("Enter", 13, ["keyUp"])
    await hands.lost("the key was released|the button cannot be pressed|lost the focus")
    await page.until("!document.getElementById('press').disabled", PATIENT_S)


async def lose_a_touch(hands):
    await hands.begins(hands.by_touch)
    # for longer than after which a finger asks for a menu
    for _ in range(4):
        await hands.lasts()
    await hands.ways.touch()
    await hands.lost("the button was released")
    x, y = await hands.begins(hands.by_touch)
    await hands.ways.touch((x, y), (x - 300, y))
    await hands.lost("a second pointer was pressed")
    await hands.ways.touch()
    if hands.ways.cancel is not None:
        await hands.begins(hands.by_touch)
        await hands.ways.cancel()
        await hands.lost("the touch was cancelled")


@pytest.mark.parametrize("ways", [lose_a_mouse, lose_a_key, lose_a_touch])
@pytest.mark.parametrize("name", [CHROMIUM, FIREFOX])
def test_whatever_takes_a_press_away_lets_go_of_it(rig, looked_at, name, ways):
    written, driven = [], {"chromium": InChromium, "firefox": InFirefox}[name]

    async def look(page, _emulated):
        await planned(page)
        await ways(Hands(page, driven(page), written))

    looked_at(rig, look, opened=driven.browser, audit=lambda what, **told: written.append((what, told)))


@pytest.mark.skipif(chromium_found() is None, reason="no chromium here")
def test_a_picture_that_freezes_lets_go_of_a_press(
    patient,
    planner,
    in_threads,
    hand_made_thread,
    hand_made_camera,
    real_arm,
    bridge_of_real_arm,
    looked_at,
    monkeypatch,
):
    monkeypatch.setattr("agents.operator.control.BEAT_S", PATIENT_S)
    camera, written = hand_made_camera(echoes=True), []
    bridge = bridge_of_real_arm(real_arm, maximum_plan_age_s=PATIENT_S, maximum_frame_age_s=BEAT_S)

    async def look(page, _emulated):
        await planned(page)
        hands = Hands(page, InChromium(page), written)
        await hands.begins(hands.by_mouse)
        # pictures go on coming, and each is as old as this one
        camera.frozen.set()
        await hands.lost(r"the picture is [\d.]+ s old, and 2\.00 s are allowed")

    with in_threads(patient, hand_made_thread(echoes=True), camera, planner, bridge):
        looked_at(patient, look, audit=lambda what, **told: written.append((what, told)))
