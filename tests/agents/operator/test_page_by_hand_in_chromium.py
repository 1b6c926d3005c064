"""What a person does at the page, and what it shows of states that a running demo does not come to.

The planner, the arm's bridge and the browser are real; thread and camera are made by hand, and what is told beside it.
"""

import asyncio
import base64
import hashlib
import re
from dataclasses import replace

import numpy as np
import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from agents.cli.experiment.command import JOURNAL
from agents.cli.page.trials import trials_of
from agents.experiment.journal import Journal, Protocol
from schemas.messages import ExecutionEvent, ExecutionKind, RobotMode, RobotState
from schemas.topics import EXECUTION, MAIN, PROMPT, ROBOT_STATE, THREAD, TOOL
from shared.clock import now_ns
from shared.runtime.agent import Agent, Output, Tick
from shared.runtime.commands import accepted
from shared.runtime.config import parse_config
from tests.agents.operator.by_hand import (
    PATIENT_S,
    PLANNED,
    READY,
    HandMadeCamera,
    HandMadeThread,
    at_pixel,
    before_a_browser,
    followed,
    on_thread,
    patient_bridge,
    patient_planner,
)
from tests.agents.planner.pulling.bench import threaded
from tests.rigs.browser import found

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(found() is None, reason="there is no chromium here (apt-get install chromium)"),
]

MOVES = "suturegrasp.panel.state.arms[0].mode === 'moving' && suturegrasp.panel.state.press?.stage === 'armed'"
GOAL_S = "suturegrasp.panel.state.goals.psm1?.at.s"


class Prompted(Agent):
    """In the place of perception, as far as prompts go."""

    kind, instance = "perception", MAIN
    inputs, outputs, commands = (), (), (PROMPT,)
    tick_hz = 20.0

    def __init__(self):
        self.pixels = []

    def step(self, arrived):
        if isinstance(arrived, Tick):
            return []
        self.pixels.append(arrived.message.pixel)
        return [accepted(arrived.message.header.id)]


def of(element, what):
    return f"document.getElementById('{element}').{what}"


def says(element, words):
    return of(element, f"textContent.includes({words!r})")


async def pressed(page, key, number, code=""):
    for kind in ("keyDown", "keyUp"):
        await page.key(kind, key, code or key, number)


@pytest.fixture
def perception():
    return Prompted()


@pytest.fixture
def rig(request, patient, in_threads, perception):
    """A parameter tells after how many frames no more is seen of the thread."""
    made = HandMadeThread(getattr(request, "param", None)), HandMadeCamera()
    with in_threads(patient, *made, perception, patient_planner(), patient_bridge()):
        yield patient


def test_a_press_moves_the_arm_until_the_button_is_released_or_the_tab_is_closed(rig, monkeypatch):
    monkeypatch.setattr("agents.operator.control.BEAT_S", 2.0)
    written = []

    async def presses(page, share):
        before = await page.value("suturegrasp.plans.psm1?.id ?? ''")
        await page.click_at(*await page.value(on_thread(share)))
        await page.until(f"((id) => id && id !== {before!r})({PLANNED})", PATIENT_S)
        assert await page.value("suturegrasp.plans.psm1.way.length") > 10
        assert await page.value("suturegrasp.picture.previewed() !== null")
        await page.until(says("words", "press and hold to arm psm1"), PATIENT_S)
        x, y = await page.middle("#press")
        await page.mouse("mouseMoved", x, y)
        await page.mouse("mousePressed", x, y)
        await page.until(MOVES, PATIENT_S)
        return x, y

    async def held(why):
        async with asyncio.timeout(PATIENT_S):
            while not any(what == "hold" and re.search(why, told["why"]) for what, told in written):
                await asyncio.sleep(0.02)

    async def look(page, emulated):
        other = await emulated.another_page()
        await page.to_front()
        await page.mouse("mouseReleased", *await presses(page, 0.4))
        await held("the button was released")
        await page.until(says("lines", "psm1 holds"), PATIENT_S)
        await page.until("suturegrasp.panel.state.arms[0].mode === 'holding'", PATIENT_S)
        await presses(page, 0.7)
        await page.close()
        await held(r"the page was (left|hidden)|its connection ended|lost the focus")
        # the other page watched, and is told that nobody controls now
        await other.until(says("screens", "nobody controls"), PATIENT_S)
        await other.click("#take")
        await other.until(says("control", "you control"), PATIENT_S)
        assert other.errors == []

    before_a_browser(rig, look, audit=lambda what, **told: written.append((what, told)))


def test_a_goal_is_named_and_moved_by_keys_alone_and_its_plan_is_told_and_space_holds(rig):
    async def look(page, _emulated):
        await page.value(of("picture", "focus()"))
        await pressed(page, "ArrowRight", 39)
        await page.until(f"Math.abs({GOAL_S} - 0.51) < 1e-3", PATIENT_S)
        await pressed(page, "PageUp", 33)
        await page.until(f"Math.abs({GOAL_S} - 0.61) < 1e-3", PATIENT_S)
        await page.until(PLANNED, PATIENT_S)
        await page.until(says("goal", "predicted success"), PATIENT_S)
        assert await page.value(says("goal", "mm along"))
        assert await page.value("suturegrasp.plans.psm1.alternatives.length > 0")
        # a plan is previewed in space as well, which keys turn
        before = await page.value(of("space", "toDataURL()"))
        await page.value(of("space", "focus()"))
        await pressed(page, "ArrowLeft", 37)
        await page.until(f"{of('space', 'toDataURL()')} !== {before!r}", PATIENT_S)
        await pressed(page, " ", 32, "Space")
        await page.until(says("lines", "said hold"), PATIENT_S)

    before_a_browser(rig, look)


def test_a_hold_that_is_said_while_the_connection_is_lost_is_said_once_it_is_back(rig):
    written = []
    caught = "const send = WebSocket.prototype.send"
    caught += "; WebSocket.prototype.send = function (text) { window.socket = this; return send.call(this, text); }"

    async def connected_for(page, ms):
        await page.value("(() => { delete window.socket; window.sinceMs = performance.now(); })()")
        await page.until(f"window.socket?.readyState === 1 && performance.now() - sinceMs > {ms}", PATIENT_S)

    async def look(page, _emulated):
        await page.value(f"(() => {{ {caught}; }})()")
        await connected_for(page, 0)
        await page.value(f"(() => {{ socket.close(); {of('hold', 'click()')}; }})()")
        await page.until(says("words", "this page holds nothing; use suturegrasp hold"), PATIENT_S)
        async with asyncio.timeout(PATIENT_S):
            while not holds():
                await asyncio.sleep(0.02)
        # once it has arrived for certain a further loss does not say it again
        await connected_for(page, 2000)
        await page.value("socket.close()")
        await connected_for(page, 2000)
        assert len(holds()) == 1

    def holds():
        return [told for what, told in written if what == "hold" and "said hold" in told["why"]]

    before_a_browser(rig, look, audit=lambda what, **told: written.append((what, told)))


def test_a_prompt_goes_out_by_a_click_and_is_written_down(rig, perception):
    audit = []

    async def look(page, _emulated):
        await page.click("#meant")
        assert await page.value(of("meant", "getAttribute('aria-pressed')")) == "true"
        await page.click_at(*await page.value(on_thread(0.2)))
        await page.until(says("lines", "Perception has heard it"), PATIENT_S)
        assert await page.value(of("meant", "getAttribute('aria-pressed')")) == "false"

    before_a_browser(rig, look, audit=lambda what, **told: audit.append((what, told)))
    # a fifth of a thread of 500 pixels whose middle is the image's
    place = pytest.approx((479.5 - 150, 269.5), abs=2)
    assert [told["pixel"] for what, told in audit if what == "prompt"] == [place]
    assert [tuple(pixel) for pixel in perception.pixels] == [place]


class BothStrands(HandMadeThread):
    """A suture out of which no jaws draw thread."""

    def told(self, stamp):
        return [Output(THREAD, replace(threaded(parted=True), stamp=stamp))]


def test_a_pull_is_asked_for_armed_within_its_bounds_and_ends_by_its_own_reason(
    patient, in_threads, perception, monkeypatch
):
    monkeypatch.setattr("agents.operator.control.BEAT_S", 2.0)
    audit = []

    async def look(page, _emulated):
        await page.value("document.getElementById('tail').value = ''")
        await page.click("#pull")
        assert await page.value(of("pull", "getAttribute('aria-pressed')")) == "false", "there is no length"
        await page.value("document.getElementById('tail').value = 12")
        await page.click("#pull")
        await page.click_at(*await page.value(at_pixel(442, 269.5)))
        await page.until(PLANNED, PATIENT_S)
        await page.until(says("words", "pull until the tail is 12.0 mm. Look at it"), PATIENT_S)
        assert await page.value(says("goal", "armed forat most"))
        assert await page.value(says("goal", "pull until the tail is 12 mm long"))
        x, y = await page.middle("#press")
        await page.mouse("mouseMoved", x, y)
        await page.mouse("mousePressed", x, y)
        await page.until(MOVES, PATIENT_S)
        await page.until(says("words", "psm1 pulls ("), PATIENT_S)
        await page.until(says("words", "has carried out its plan: "), PATIENT_S)
        assert await page.value(says("goal", "it is held in the tissue"))
        await page.mouse("mouseReleased", x, y)

    with in_threads(patient, BothStrands(), HandMadeCamera(), perception, patient_planner(), patient_bridge()):
        before_a_browser(patient, look, audit=lambda what, **told: audit.append((what, told)))
    assert [told["tail_mm"] for what, told in audit if what == "pull"] == [12]
    bounds = [told["pull"] for what, told in audit if what == "arm"]
    assert len(bounds) == 1
    assert bounds[0]["length_m"] > 0.018


def test_goals_of_an_experiment_are_walked_through_and_judged_by_buttons(rig, tmp_path):
    protocol = Protocol(seed=1, goals=1, threads=("easy/paper",), arm="psm1", verdicts="operator")
    (tmp_path / JOURNAL).write_text(Journal(protocol=protocol).model_dump_json())

    async def look(page, emulated):
        await page.until(says("trials-text", "0 tried, 2 left"), PATIENT_S)
        assert await page.value(of("verdict", "hidden"))
        await page.click("#next")
        plan_id = await page.until(PLANNED, PATIENT_S)
        finished = ExecutionEvent(plan_id, "psm1", now_ns(), ExecutionKind.FINISHED, None, "", "")
        emulated.once(EXECUTION, "psm1", finished)
        await page.until(f"!{of('verdict', 'hidden')}", PATIENT_S)
        assert await page.value(of("press", "disabled")), "it was carried out"
        await page.click("#causes button[data-cause=slipped]")
        await page.until(says("trials-text", "1 tried, 1 left"), PATIENT_S)
        assert await page.value(of("verdict", "hidden"))

    before_a_browser(rig, look, trials=trials_of(tmp_path))
    journal = parse_config((tmp_path / JOURNAL).read_text(), Journal, "journal.json")
    assert [(a.outcome, a.cause) for a in journal.attempts] == [("failed", "slipped")]


def faulty(at_ns):
    """A second arm, a palm's breadth beside the first."""
    pose = np.eye(4)
    pose[2, 3] = 0.06
    return RobotState("psm2", at_ns, RobotMode.FAULT, pose, np.zeros(6), 0.3, np.eye(4), "")


def test_an_arm_with_a_fault_says_why_and_what_to_do_and_cannot_be_armed(rig):
    async def look(page, emulated):
        emulated.repeats(ROBOT_STATE, "psm2", faulty)
        emulated.log_of("robot_bridge", "psm2").warning("the arm is FAULT: its operating state is FAULT, not ENABLED")
        await page.until("[...document.getElementById('arm').options].some((o) => o.value === 'psm2')", PATIENT_S)
        # several arms can be chosen, and each is told of by itself
        await page.value(of("arm", "value = 'psm2'"))
        why = "psm2 has a fault and cannot be armed (the arm is FAULT: its operating"
        await page.until(says("words", why), PATIENT_S)
        assert await page.value(says("words", "suturegrasp state"))
        assert await page.value(of("words", "className")) == "grave"
        await page.until(says("press-text", "psm2 cannot be armed"))
        assert await page.value(of("press", "disabled"))
        await page.value(of("arm", "value = 'psm1'"))
        await page.until(says("press-text", "Press and hold to arm psm1"))
        assert await page.value(of("words", "className")) == ""

    before_a_browser(rig, look)


def test_what_a_recording_lacks_is_told_and_how_far_a_followed_tool_is_off_its_registration(rig):
    outline = np.column_stack((np.linspace(420, 520, 60), 200 + 30 * np.sin(np.linspace(0, 6, 60))))

    async def look(page, emulated):
        await page.until(says("recording", "nothing is recorded"))
        assert not await page.value(of("record", "hidden"))
        log = emulated.log_of("recorder", "main")
        await page.until(says("recording", "the rig's own recorder keeps this session: nothing is known to be lost"))
        assert await page.value(of("record", "hidden")), "it ends with the rig alone"
        log.warning("12 messages of camera/main/frames were lost")
        await page.until(says("recording", "12 messages of camera/main/frames were lost"), PATIENT_S)
        assert await page.value(of("recording", "className")) == "refused"
        emulated.repeats(TOOL, "psm1", lambda at_ns: followed(at_ns, outline_px=outline))
        await page.until(says("arms", "by the images its tool is 4.2 mm off its registration"), PATIENT_S)
        await page.until("suturegrasp.picture.tools[0]?.outline?.length === 60", PATIENT_S)
        assert await page.value("suturegrasp.picture.tools[0].off_mm") == 4.2
        assert await page.value(says("legend", "tool as the images show it"))

    before_a_browser(rig, look)


@pytest.mark.parametrize("rig", [200], indirect=True)
def test_a_thread_that_is_not_seen_any_more_is_drawn_as_an_old_one(rig):
    async def look(page, _emulated):
        await page.until("suturegrasp.picture.isOld()", PATIENT_S)
        await page.until(f"/The thread was seen \\d+ s ago/.test({of('words', 'textContent')})", PATIENT_S)

    before_a_browser(rig, look)


def test_over_tls_the_page_is_all_there_where_its_authority_is_trusted(rig, tls):
    context, home = tls
    public = x509.load_pem_x509_certificate((home / "operator.desk.pem").read_bytes()).public_key()
    spki = hashlib.sha256(public.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)).digest()

    async def look(page, _emulated):
        assert await page.value("location.protocol") == "https:"
        assert await page.value("isSecureContext")
        await page.until(says("control", "screen 1: you control"), PATIENT_S)
        # the token is gone from the address, and a reload goes on with the next secret
        assert await page.value("location.hash") == ""
        await page.value("window.before = true")
        await page.call("Page.reload")
        await page.until(f"!window.before && {READY}", PATIENT_S)
        await page.until(says("control", "screen 1: you control"), PATIENT_S)

    trusted = f"--ignore-certificate-errors-spki-list={base64.b64encode(spki).decode()}"
    before_a_browser(rig, look, trusted, tls=context)
