"""Page, bridge, guard and the links between them as one model, in virtual time, on the real objects.

Whatever delays, losses, reorderings, restarts, clock jumps, second operators, second bridges and frozen cameras do: no
set point passes the guard unless it was armed, somebody pressed, and a camera saw, all within their bounds; and what
was released or held passes nothing until it is armed anew.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from agents.operator.control import ArmNow, BeatNow, Control, HoldNow
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.dvrk.psm import DvrkPsm
from agents.robot_bridge.execution import Patience
from agents.robot_bridge.limits import MotionLimits
from benchmarks.robot_hostile_plans import any_plan
from benchmarks.robot_world import EPOCH_NS, HZ, NAME, RIG_ARM, SECOND_NS, TICK_NS, TOOL, Topics, World, WorldGuard
from schemas.messages import (
    Arm,
    ChallengeEcho,
    CommandAnswer,
    CommandHeader,
    FrameNotice,
    FrameStamp,
    Heartbeat,
    Hold,
    Outcome,
    Phase,
    RobotState,
    Waypoint,
)
from schemas.topics import ARM, FRAME_NOTICE, HEARTBEAT, HOLD, PLAN, ROBOT_STATE
from shared.rigid_transforms import exp_so3, transform
from shared.ros.naming import Ros2dds
from shared.runtime.agent import Command, Output, Received, Tick
from shared.runtime.session import SessionSettings

MS = 1_000_000
PRESENT_NS, SEEN_NS = 250 * MS, 650 * MS
"""From release, and from the newest frame that was really taken, to the last set point: the frame's bound is 0.5 s, and
what is on its way to the guard may be 0.1 s old."""
FRAME_NS = 33 * MS
LINKS = ("robot", "states", "answers", "guarded answers", "frames", "commands")


@dataclass
class Link:
    """How a link carries: every message so late, each nth lost, each mth so much later than the others."""

    delay_ns: int = 0
    lost: int = 0
    jitter_ns: int = 0
    count: int = 0


class Chain:
    """One arm with everything that leads to it; time goes on when it is told to.

    Fields:
        down: the person's finger, in truth; `pressed_ns` when it last was.
        frame_ns: when the camera last really took a frame.
        ended: armings that were released or held, and when.
    """

    def __init__(self) -> None:
        self.now_ns, self.offset_ns, self.desk_offset_s = EPOCH_NS, 0, 0.0
        self.links = {name: Link() for name in LINKS}
        self._due: list[tuple[int, int, Callable[[], None]]] = []
        self._number, self._commands = itertools.count(), itertools.count()
        self.world = World(MotionLimits(), 0.0)
        self.topics: Topics = self.world.topics
        self.now_ns = self.world.now_ns
        self.world.guard._now_ns = lambda: self.now_ns
        self.topics.later = lambda deliver: self.carry("robot", deliver)
        self.bridges: list[RobotBridge] = [self.world.bridge]
        self.world.backend._clock_ns = lambda: self.bridge_ns()
        self.world.backend._monotonic_ns = self.world.backend._guard._monotonic_ns = lambda: self.now_ns
        self.topics._now_ns = lambda: self.bridge_ns()
        self.control, self.down, self.pressed_ns, self.frame_ns = Control(), False, 0, 0
        for screen in ("ann", "ben"):
            self.control.join(screen)
        self.frozen, self.desk_state, self.camera_state = False, None, None
        self.shown: FrameStamp | None = None
        self.accepted, self.ended = set[str](), dict[str, int]()
        self.passed, self.violations = 0, list[str]()
        self._watch(self.world.guard)
        self.plan = self._plan()

    def bridge_ns(self) -> int:
        """The bridge's clock."""
        return self.now_ns + self.offset_ns

    def carry(self, name: str, deliver: Callable[[], None]) -> None:
        """Over a link, as it is now."""
        link = self.links[name]
        link.count += 1
        if link.lost and link.count % link.lost == 0:
            return
        late_ns = link.delay_ns + (link.jitter_ns if link.count % 3 == 0 else 0)
        self._due.append((self.now_ns + late_ns, next(self._number), deliver))

    def go(self, ticks: int) -> None:
        """Let time pass."""
        for _ in range(ticks):
            self.now_ns += TICK_NS
            # the console and the arm, whose state is told over the robot's link
            self.world.now_ns = self.now_ns
            self.world.console.turn(TICK_NS * 1e-9)
            if (self.now_ns // TICK_NS) % 4 == 0:
                self.world.guard.turn()
            self._deliver()
            self._desk()
            if not self.frozen and (self.now_ns // TICK_NS) % 7 == 0:
                self._frame()
            for bridge in self.bridges:
                self._said(bridge.step(Tick(self.bridge_ns())))

    def press(self) -> None:
        """A finger goes down on the newest plan, which was made of the newest frame."""
        self.down, self.plan = True, self._plan()
        for bridge in self.bridges:
            self._said(bridge.step(Received(PLAN, "", 0, self.plan)))
        self._follow(self.control.begin(self.control.controller or "ann", RIG_ARM, self.plan.plan_id, self.desk_s()))

    def release(self) -> None:
        """The finger goes up, and the page says so."""
        self.down = False
        self._ends()
        self._follow(self.control.release(self.control.controller, "the button was released"))

    def vanish(self) -> None:
        """The person is gone without a word: a killed browser, a cut cable."""
        self.down = False
        self._ends()

    def hold(self) -> None:
        """Somebody says hold."""
        self._ends()
        self._command(HOLD, lambda header: Hold(header, RIG_ARM), lambda _answer: None)

    def desk_s(self) -> float:
        return 1e-9 * self.now_ns + self.desk_offset_s

    def another_bridge(self) -> None:
        """A second one of the same arm, by mistake."""
        if len(self.bridges) < 2:
            self.bridges.append(self._bridge())

    def restart_bridge(self) -> None:
        """It is killed, and begins anew."""
        self.bridges = [self._bridge()]

    def restart_guard(self) -> None:
        """It is killed, and begins anew."""
        guard = WorldGuard(RIG_ARM, self.topics, lambda: self.now_ns, judges=True)
        self.topics.guards[:] = [guard]
        self.world.guard = guard
        self._watch(guard)

    def restart_page(self) -> None:
        """The server is killed; whoever presses presses a page that is gone."""
        self.vanish()
        self.control = Control()
        for screen in ("ann", "ben"):
            self.control.join(screen)

    def _bridge(self) -> RobotBridge:
        backend = DvrkPsm(
            NAME,
            SessionSettings(),
            Ros2dds(),
            TOOL,
            dry_run=False,
            has_no=("teleoperation", "endoscope_arm", "clutch"),
            linked=self.topics.link(self.bridge_ns),
            clock=self.bridge_ns,
            monotonic=lambda: self.now_ns,
        )
        known = self.world.bridge.config
        config = RobotBridgeConfig(
            RIG_ARM, known.T_camera_base, tick_hz=HZ, calibration_id="c", registered_ns=EPOCH_NS, tissue_needed=False
        )
        return RobotBridge(config, backend)

    def _watch(self, guard: WorldGuard) -> None:
        judged = guard.monitor.hear_set_point

        def hear(said: Any, now_ns: int) -> Any:
            actions = judged(said, now_ns)
            if any(action.positions for action in actions):
                self._passes(said.arming_id)
            return actions

        guard.monitor.hear_set_point = hear

    def _passes(self, arming_id: str) -> None:
        """What must be true whenever a set point passes."""
        self.passed += 1
        pressed_ns = self.now_ns if self.down else self.pressed_ns
        for wrong, what in (
            (arming_id not in self.accepted, "it was not armed"),
            (self.now_ns - pressed_ns > PRESENT_NS, "nobody pressed"),
            (self.now_ns - self.frame_ns > SEEN_NS, "nobody saw"),
            (self.now_ns - self.ended.get(arming_id, self.now_ns) > PRESENT_NS, "it was released or held"),
        ):
            if wrong:
                self.violations.append(f"{what}: {arming_id} at {(self.now_ns - EPOCH_NS) / MS:.0f} ms")

    def _ends(self) -> None:
        self.pressed_ns = self.now_ns
        for arming_id in self.accepted:
            self.ended.setdefault(arming_id, self.now_ns)

    def _deliver(self) -> None:
        due = sorted(each for each in self._due if each[0] <= self.now_ns)
        self._due = [each for each in self._due if each[0] > self.now_ns]
        for _, _, deliver in due:
            deliver()

    def _said(self, replies: Any) -> None:
        for reply in list(replies):
            if isinstance(reply, Output) and reply.topic is ROBOT_STATE:
                self.carry("states", lambda state=reply.message: self._hear_state(state))
                self.carry("frames", lambda state=reply.message: setattr(self, "camera_state", state))

    def _hear_state(self, state: RobotState) -> None:
        self.desk_state = state
        self.control.challenged(RIG_ARM, state.challenge_ns, state.guard_challenge)

    def _frame(self) -> None:
        self.frame_ns = self.now_ns
        echo = () if self.camera_state is None else (ChallengeEcho(RIG_ARM, self.camera_state.challenge_ns),)
        stamp = FrameStamp(1, self.bridge_ns(), self.bridge_ns(), "c", echo)
        self.carry("frames", lambda: self._see(stamp))

    def _see(self, stamp: FrameStamp) -> None:
        self.shown = stamp
        for bridge in self.bridges:
            self._said(bridge.step(Received(FRAME_NOTICE, "", 0, FrameNotice(stamp))))

    def _desk(self) -> None:
        self._follow(self.control.turn(self.desk_s()))
        asked = self.control.challenge(self.desk_s())
        # the page answers while the finger is down and what it shows is new enough (page/sight.js)
        if asked is not None and self.down and not self._blind(asked.challenge_ns):
            self._follow(self.control.beat(asked.screen, asked.text, self.desk_s()))

    def _blind(self, challenge_ns: int) -> bool:
        echo_ns = 0 if self.shown is None else self.shown.echo_of(RIG_ARM)
        return bool(challenge_ns) and (echo_ns == 0 or challenge_ns - echo_ns > 500 * MS)

    def _follow(self, effects: list[Any]) -> None:
        for effect in effects:
            match effect:
                case ArmNow(screen, arm, plan_id):
                    self._arm(screen, arm, plan_id)
                case BeatNow(arm, plan_id, arming_id, challenge_ns, guard_challenge):
                    of = challenge_ns, guard_challenge
                    beat = Heartbeat(arm, plan_id, self.now_ns, arming_id, *of, pressed=True)
                    self.carry("answers", lambda beat=beat: self._beat(beat))
                    self.carry("guarded answers", lambda beat=beat: self._beat_guard(beat))
                case HoldNow():
                    self._command(HOLD, lambda header: Hold(header, RIG_ARM), lambda _answer: None)
                case _:
                    pass

    def _beat(self, beat: Heartbeat) -> None:
        for bridge in self.bridges:
            self._said(bridge.step(Received(HEARTBEAT, "", 0, beat)))

    def _beat_guard(self, beat: Heartbeat) -> None:
        said = beat.arm, beat.arming_id, beat.guard_challenge, beat.pressed
        self.world.guard.monitor.hear_heartbeat(*said, self.now_ns)

    def _arm(self, screen: str, arm: str, plan_id: str) -> None:
        echo_ns = 0 if self.desk_state is None else self.desk_state.challenge_ns
        sent: list[str] = []

        def made(header: CommandHeader) -> Arm:
            sent.append(header.id)
            self.control.arming(plan_id, header.id)
            return Arm(header, arm, plan_id, echo_ns, pressed=True)

        def answered(answer: CommandAnswer) -> None:
            accepted = answer.outcome is Outcome.ACCEPTED
            if accepted:
                self.accepted.add(sent[0])
            self._follow(self.control.armed(screen, arm, sent[0], accepted))

        self._command(ARM, made, answered, wanted=lambda: self.down)

    def _command(
        self,
        topic: Any,
        made: Callable[[CommandHeader], Any],
        answered: Callable[[CommandAnswer], None],
        wanted: Callable[[], bool] = lambda: True,  # noqa: ARG002
    ) -> None:
        message = made(CommandHeader(f"c{next(self._commands)}", self.bridge_ns() + 2 * SECOND_NS, "a page"))

        def deliver() -> None:
            for bridge in self.bridges:
                replies = list(bridge.step(Command(topic, RIG_ARM, message, self.bridge_ns())))
                self._said(replies)
                answer = next(each for each in replies if isinstance(each, CommandAnswer))
                if topic is ARM and answer.outcome is Outcome.ACCEPTED:
                    # armed from now on, whether or not the page hears of it
                    self.accepted.add(message.header.id)
                    if not self.down:
                        self.ended.setdefault(message.header.id, self.now_ns)
                self.carry("states", lambda answer=answer: answered(answer))

        self.carry("commands", deliver)

    def _plan(self) -> Any:
        rng = np.random.default_rng(3)
        points = [(0.02 * (-1) ** k, 0.002 * k, 0.08) for k in range(8)]
        T = [transform(exp_so3(np.array((0.1, 0, 0.3))), np.array(point)) for point in points]
        waypoints = tuple(Waypoint(pose, 0.5, Phase.APPROACH, None) for pose in T)
        at_ns, echo = self.bridge_ns(), () if self.shown is None else self.shown.echoes
        named = f"plan-{next(self._number)}"
        stamp = FrameStamp(1, at_ns, at_ns, "c", echo)
        return any_plan(self.world, rng, plan_id=named, waypoints=waypoints, stamp=stamp)


def moving() -> Chain:
    """A chain whose arm moves."""
    chain = Chain()
    chain.go(100)
    chain.press()
    chain.go(300)
    assert chain.passed > 50, (chain.world.guard.actions, chain.bridges[0]._stands.measured.not_ready, chain.control)
    return chain


@pytest.mark.parametrize("delay_ms", [0, 60, 200, 5000])
@pytest.mark.parametrize("link", LINKS)
def test_after_release_nothing_passes_later_than_the_bound_whichever_link_queues(link, delay_ms):
    chain = moving()
    chain.links[link].delay_ns = delay_ms * MS
    chain.go(20)
    chain.vanish()
    released_ns, last_ns = chain.now_ns, 0
    for _ in range(1400):
        before = chain.passed
        chain.go(1)
        last_ns = chain.now_ns if chain.passed > before else last_ns
    assert last_ns - released_ns <= PRESENT_NS
    assert chain.violations == []


@pytest.mark.parametrize("blind", [False, True])
def test_the_model_would_notice(blind, monkeypatch):
    chain = moving()
    for bound in ("PRESENCE_NS", "LINK_NS"):
        monkeypatch.setattr(f"agents.guard.monitor.{bound}", 10 * SECOND_NS)
    bridge = chain.bridges[0]
    if blind:
        chain.frozen = True
        monkeypatch.setattr(chain, "_blind", lambda _challenge_ns: False)
        bridge.config = replace(bridge.config, maximum_frame_age_s=10.0)
    else:
        chain.vanish()
        monkeypatch.setattr(bridge._execution, "_patience", Patience(1.0, 10.0, 60.0))
        monkeypatch.setattr(chain.control, "turn", lambda _now_s: [])
    chain.go(200)
    assert ("nobody saw" if blind else "nobody pressed") in chain.violations[0]


@pytest.mark.parametrize("delay_ms", [250, 2000])
@pytest.mark.parametrize("link", ["robot", "states", "answers", "guarded answers"])
def test_where_a_way_takes_too_long_an_arm_is_not_moved_at_all(link, delay_ms):
    chain = Chain()
    chain.links[link].delay_ns = delay_ms * MS
    chain.go(1000)
    chain.press()
    chain.go(600)
    assert (chain.passed, chain.violations) == (0, [])


class Whole(RuleBasedStateMachine):
    """Anything, in any order."""

    @initialize()
    def begin(self) -> None:
        self.chain = Chain()
        self.chain.go(100)

    @rule()
    def goes_well_for_a_while(self) -> None:
        for link in self.chain.links.values():
            link.delay_ns = link.lost = link.jitter_ns = 0
        self.chain.frozen = False
        self.chain.go(150)
        if not self.chain.down:
            self.chain.press()
        self.chain.go(250)

    @rule(ticks=st.integers(1, 120))
    def time_passes(self, ticks: int) -> None:
        self.chain.go(ticks)

    @rule(
        link=st.sampled_from(LINKS),
        delay_ms=st.sampled_from([0, 5, 40, 120, 300, 1500, 5000]),
        lost=st.sampled_from([0, 0, 2, 3, 10]),
        jitter_ms=st.sampled_from([0, 0, 10, 80, 500]),
    )
    def a_link_goes_bad(self, link: str, delay_ms: int, lost: int, jitter_ms: int) -> None:
        self.chain.links[link] = Link(delay_ms * MS, lost, jitter_ms * MS)

    @rule(how=st.sampled_from(["release", "vanish", "hold"]))
    def somebody_stops(self, how: str) -> None:
        getattr(self.chain, how)()

    @rule()
    def somebody_presses(self) -> None:
        if not self.chain.down:
            self.chain.press()

    @rule(what=st.sampled_from(["bridge", "guard", "page"]))
    def something_begins_anew(self, what: str) -> None:
        getattr(self.chain, f"restart_{what}")()

    @rule()
    def a_second_bridge_comes(self) -> None:
        self.chain.another_bridge()

    @rule(jump_s=st.sampled_from([-3600, -1, -0.05, 0.05, 1, 3600]))
    def the_bridges_clock_is_set(self, jump_s: float) -> None:
        # while it is armed its time goes on by the monotonic clock (shared/runtime/replayed_time.py)
        if not any(bridge.keeps_time for bridge in self.chain.bridges):
            self.chain.offset_ns += round(jump_s * SECOND_NS)

    @rule(frozen=st.booleans())
    def the_camera_freezes_or_goes_on(self, frozen: bool) -> None:
        self.chain.frozen = frozen

    @rule(screen=st.sampled_from(["ann", "ben"]), yes=st.booleans())
    def another_operator_takes_part(self, screen: str, yes: bool) -> None:
        chain = self.chain
        chain._follow(chain.control.take(screen, chain.desk_s()))
        chain._follow(chain.control.give(chain.control.controller, yes))

    @invariant()
    def nothing_passes_that_must_not(self) -> None:
        assert getattr(self, "chain", None) is None or self.chain.violations == []


TestWhole = Whole.TestCase
TestWhole.settings = settings(
    max_examples=12,
    stateful_step_count=20,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
)
