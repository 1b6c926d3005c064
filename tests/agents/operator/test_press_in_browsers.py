"""Whatever takes a press away lets go of it, in Chromium and in Firefox: keys, pointers, focus, dialogs.

The presses are real input of the browser. Nothing is armed by them: the button would have to be held for longer.
"""

import asyncio
import contextlib
import re

import pytest

from tests.agents.operator.by_hand import (
    PATIENT_S,
    PLANNED,
    HandMadeCamera,
    HandMadeThread,
    RealPsm,
    before_a_browser,
    patient_bridge,
    patient_planner,
)
from tests.rigs.browser import BrowserError, chromium
from tests.rigs.browser import found as chromium_found
from tests.rigs.firefox import firefox
from tests.rigs.firefox import found as firefox_found

pytestmark = pytest.mark.browser

NEVER_S, BEAT_S = 1e6, 2.0
PRESSES = "suturegrasp.panel.state.press?.stage === 'pressing'"
BUTTON = "document.getElementById('press')"
DOWN = f"{BUTTON}.classList.contains('down')"
FIELD = "document.getElementById('picture')"


class InChromium:
    """What hands do by Chromium's protocol, beyond what its page does already."""

    browser, found = staticmethod(chromium), staticmethod(chromium_found)

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

    browser, found = staticmethod(firefox), staticmethod(firefox_found)
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
        await self.page.value(f"{BUTTON}.focus()")
        await self.page.key("keyDown", "Enter", "Enter", 13)
        return ()

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

    async def loses(self, how, why, lose):
        """Begin a press, and lose it in this way; where that was."""
        at = await self.begins(how)
        await lose(*at)
        await self.lost(why)
        return at

    async def key(self, key, number, kinds=("keyDown", "keyUp")):
        for kind in kinds:
            await self.page.key(kind, key, key, number)


async def planned(hands):
    """Choose a place by keys, until there is a plan to press for."""
    page = hands.page
    await page.until("document.getElementById('control').textContent.includes('you control')", PATIENT_S)
    await page.value(f"{FIELD}.focus()")
    await hands.key("ArrowRight", 39)
    await page.until(PLANNED, PATIENT_S)


async def lose_a_mouse(hands):
    page = hands.page

    def happens(kind, target):
        return lambda *_: page.value(
            f"{target}.dispatchEvent(new Event('{kind}', {{bubbles: true, cancelable: true}}))"
        )

    await hands.loses(hands.by_mouse, "the button was released", lambda x, y: page.mouse("mouseReleased", x, y))
    for why, lose in (
        ("the pointer left the button", lambda x, y: page.mouse("mouseMoved", x, y + 200)),
        ("another key was pressed", lambda *_: hands.key("a", 65)),
        ("another key was pressed", lambda *_: hands.key("Alt", 18)),
        ("another mouse button|a second pointer|a menu was asked for", hands.ways.second_button),
        ("the button lost the focus", lambda *_: page.value(f"{FIELD}.focus()")),
        ("the button moved away", lambda *_: page.value(f"{BUTTON}.style.marginTop = '300px'")),
        ("the page lost the focus", happens("blur", "window")),
        ("a menu was asked for", happens("contextmenu", BUTTON)),
        ("something was dragged", happens("dragstart", FIELD)),
        ("the page was left", happens("pagehide", "window")),
        ("the page is to be printed", happens("beforeprint", "window")),
        ("the page was frozen", happens("freeze", "document")),
    ):
        await page.mouse("mouseReleased", *await hands.loses(hands.by_mouse, why, lose))
        await page.value(f"{BUTTON}.style.marginTop = ''")
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

    async def up():
        await hands.key("Enter", 13, ["keyUp"])

    async def repeats(times):
        for _ in range(times):
            await hands.ways.repeat("Enter", 13)

    await hands.begins(hands.by_key)
    await repeats(5)
    await hands.lasts()
    await up()
    await hands.lost("the key was released")
    for why, lose in (
        ("another key was pressed", lambda: hands.key("Tab", 9)),
        ("another key was pressed", lambda: hands.key("Alt", 18)),
        ("the button lost the focus", lambda: page.value(f"{FIELD}.focus()")),
    ):
        await hands.loses(hands.by_key, why, lose)
        await up()
    # a key that is still down when the press was lost begins none anew
    await hands.loses(hands.by_key, "another key was pressed", lambda: hands.key("Shift", 16))
    await repeats(3)
    assert not await page.value(DOWN)
    await up()
    # a disabled button hears no key: its release is heard on the window
    await hands.begins(hands.by_key)
    await page.value(f"{BUTTON}.disabled = true")
    await up()
    await hands.lost("the key was released|the button cannot be pressed|lost the focus")
    await page.until(f"!{BUTTON}.disabled", PATIENT_S)


async def lose_a_touch(hands):
    await hands.begins(hands.by_touch)
    # for longer than after which a finger asks for a menu
    for _ in range(4):
        await hands.lasts()
    await hands.ways.touch()
    await hands.lost("the button was released")
    second = "a second pointer was pressed"
    await hands.loses(hands.by_touch, second, lambda x, y: hands.ways.touch((x, y), (x - 300, y)))
    await hands.ways.touch()
    if hands.ways.cancel is not None:
        await hands.loses(hands.by_touch, "the touch was cancelled", lambda *_: hands.ways.cancel())


@pytest.fixture
def press(patient, monkeypatch, in_threads):
    """Have hands at a page with a plan, before a camera and a bridge; nothing is armed by them."""
    monkeypatch.setattr("agents.operator.control.PRESS_S", NEVER_S)
    monkeypatch.setattr("agents.operator.control.BEAT_S", BEAT_S)

    def press(driven, look, camera, bridge):
        if driven.found() is None:
            pytest.skip("there is no such browser here")
        written = []

        async def looks(page, _emulated):
            hands = Hands(page, driven(page), written)
            await planned(hands)
            await look(hands)

        with in_threads(patient, HandMadeThread(echoes=camera.echoes), camera, patient_planner(), bridge):
            audit = {"audit": lambda what, **told: written.append((what, told))}
            before_a_browser(patient, looks, opened=driven.browser, **audit)

    return press


@pytest.mark.parametrize("ways", [lose_a_mouse, lose_a_key, lose_a_touch])
@pytest.mark.parametrize("driven", [InChromium, InFirefox])
def test_whatever_takes_a_press_away_lets_go_of_it(press, driven, ways):
    press(driven, ways, HandMadeCamera(), patient_bridge())


def test_a_picture_that_freezes_lets_go_of_a_press(press, monkeypatch):
    monkeypatch.setattr("agents.operator.control.BEAT_S", PATIENT_S)
    camera = HandMadeCamera(echoes=True)

    async def look(hands):
        await hands.begins(hands.by_mouse)
        # pictures go on coming, and each is as old as this one
        camera.frozen.set()
        await hands.lost(r"the picture is [\d.]+ s old, and 2\.00 s are allowed")

    press(InChromium, look, camera, patient_bridge(RealPsm(), maximum_frame_age_s=BEAT_S))
