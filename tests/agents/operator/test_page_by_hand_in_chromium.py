"""What a person does at the page besides arming, in a real browser: keys, prompts, an experiment's list with verdicts.

The planner and the arm's bridge are real; thread and camera are made by hand, and so is the end of a grasp.
"""

import pytest

from agents.cli.experiment.command import JOURNAL
from agents.cli.page.trials import trials_of
from agents.experiment.journal import Journal, Protocol
from agents.planner.agent import Planner
from agents.planner.config import PlannerConfig
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.messages import ExecutionEvent, ExecutionKind
from schemas.topics import EXECUTION, MAIN, PROMPT
from shared.clock import now_ns
from shared.runtime.agent import Agent, Tick
from shared.runtime.commands import accepted, new_header
from shared.runtime.config import parse_config
from tests.rigs.browser import found

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(found() is None, reason="there is no chromium here (apt-get install chromium)"),
]

PATIENT_S = 60.0
GOAL_S = "suturegrasp.panel.state.goals.psm1?.at.s"
PLANNED = "suturegrasp.plans.psm1?.ok && suturegrasp.panel.state.goals.psm1?.text === '' && suturegrasp.plans.psm1.id"
ON_THREAD = """(() => {
  const { thread, canvas, header } = suturegrasp.picture;
  const box = canvas.getBoundingClientRect();
  const [u, v] = thread.px[40];
  return [box.x + (u + 0.5) * box.width / header.width, box.y + (v + 0.5) * box.height / header.height];
})()"""


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


def says(element, words):
    return f"document.getElementById('{element}').textContent.includes({words!r})"


@pytest.fixture
def perception():
    return Prompted()


@pytest.fixture
def rig(settings, in_threads, hand_made_thread, hand_made_camera, perception, monkeypatch):
    monkeypatch.setattr("agents.operator.choosing.AGAIN_FOR_S", PATIENT_S)
    monkeypatch.setattr("agents.operator.carrying_out.new_header", lambda sender: new_header(sender, PATIENT_S))
    monkeypatch.setattr("shared.runtime.commands.FARTHEST_DEADLINE_S", 2 * PATIENT_S)
    planner = Planner(PlannerConfig(arm_age_ms=1e3 * PATIENT_S))
    bridge = RobotBridge(RobotBridgeConfig(), SimulatedPsm())
    with in_threads(settings, hand_made_thread(), hand_made_camera(), perception, planner, bridge):
        yield settings


async def pressed(page, key, number):
    for kind in ("keyDown", "keyUp"):
        await page.key(kind, key, key, number)


def test_a_goal_is_named_and_moved_by_keys_alone_and_its_plan_is_told(rig, looked_at):
    async def look(page, _emulated):
        await page.value("document.getElementById('picture').focus()")
        await pressed(page, "ArrowRight", 39)
        await page.until(f"Math.abs({GOAL_S} - 0.51) < 1e-3", PATIENT_S)
        await pressed(page, "PageUp", 33)
        await page.until(f"Math.abs({GOAL_S} - 0.61) < 1e-3", PATIENT_S)
        await page.until(PLANNED, PATIENT_S)
        await page.until(says("goal", "predicted success"), PATIENT_S)
        assert await page.value(says("goal", "mm along"))
        assert await page.value("suturegrasp.plans.psm1.alternatives.length > 0")
        # a plan is previewed in space as well, which keys turn
        before = await page.value("document.getElementById('space').toDataURL()")
        await page.value("document.getElementById('space').focus()")
        await pressed(page, "ArrowLeft", 37)
        await page.until(f"document.getElementById('space').toDataURL() !== {before!r}", PATIENT_S)

    looked_at(rig, look)


def test_a_prompt_goes_out_by_a_click_and_is_written_down(rig, looked_at, perception):
    audit = []

    async def look(page, _emulated):
        await page.click("#meant")
        assert await page.value("document.getElementById('meant').getAttribute('aria-pressed')") == "true"
        await page.click_at(*await page.value(ON_THREAD))
        await page.until(says("lines", "Perception has heard it"), PATIENT_S)
        assert await page.value("document.getElementById('meant').getAttribute('aria-pressed')") == "false"

    looked_at(rig, look, audit=lambda what, **told: audit.append((what, told)))
    # a fifth of a thread of 500 pixels whose middle is the image's
    place = pytest.approx((479.5 - 150, 269.5), abs=2)
    assert [told["pixel"] for what, told in audit if what == "prompt"] == [place]
    assert [tuple(pixel) for pixel in perception.pixels] == [place]


def test_goals_of_an_experiment_are_walked_through_and_judged_by_buttons(rig, looked_at, tmp_path):
    protocol = Protocol(seed=1, goals=1, threads=("easy/paper",), arm="psm1", verdicts="operator")
    (tmp_path / JOURNAL).write_text(Journal(protocol=protocol).model_dump_json())

    async def look(page, emulated):
        await page.until(says("trials-text", "0 tried, 2 left"), PATIENT_S)
        assert await page.value("document.getElementById('verdict').hidden")
        await page.click("#next")
        plan_id = await page.until(PLANNED, PATIENT_S)

        def finished(at_ns):
            return ExecutionEvent(plan_id, "psm1", at_ns, ExecutionKind.FINISHED, None, "", "")

        emulated.once(EXECUTION, "psm1", finished(now_ns()))
        await page.until("!document.getElementById('verdict').hidden", PATIENT_S)
        assert await page.value("document.getElementById('press').disabled"), "it was carried out"
        await page.click("#causes button[data-cause=slipped]")
        await page.until(says("trials-text", "1 tried, 1 left"), PATIENT_S)
        assert await page.value("document.getElementById('verdict').hidden")

    looked_at(rig, look, trials=trials_of(tmp_path))
    journal = parse_config((tmp_path / JOURNAL).read_text(), Journal, "journal.json")
    assert [(a.outcome, a.cause) for a in journal.attempts] == [("failed", "slipped")]
