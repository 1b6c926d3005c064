"""One arm with everything that leads to it, in virtual time.

Real are the guard's monitor, the bridge with its backend and its clock, the console's emulation, the desk's control
and what follows from it (StandingBy), and what the camera says of its frames. Stand-ins are the page (deadman.js and
sight.js), the desk's turn, its commands' way, and every link.
"""

import itertools
from collections.abc import Callable, Coroutine, Generator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agents.camera.agent import CameraConfig, FrameSender
from agents.dvrk_emulator.arm import start_of
from agents.dvrk_emulator.console import Behaviour, EmulatedConsole
from agents.dvrk_emulator.oracle import Field, Oracle
from agents.guard import cdr
from agents.operator.arming import StandingBy
from agents.operator.control import BeatNow, Control, HoldNow
from agents.operator.words import Voice
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.dvrk.psm import DvrkPsm
from schemas.messages import (
    Arm,
    CommandAnswer,
    CommandHeader,
    ExecutionEvent,
    ExecutionKind,
    FrameNotice,
    FrameStamp,
    GraspPlan,
    Heartbeat,
    Hold,
    ImageEncoding,
    Outcome,
    Phase,
    RobotState,
    Waypoint,
)
from schemas.topics import ARM, EXECUTION, FRAME_NOTICE, HEARTBEAT, HOLD, PLAN, ROBOT_STATE
from shared.kinematics.simulated_setup import SIMULATED_BASES
from shared.rigid_transforms import exp_so3, transform
from shared.ros.guarded import SetPoint
from shared.ros.naming import Ros2dds
from shared.runtime.agent import Command, Output, Received, Tick
from shared.runtime.clocks import AgentClock
from shared.runtime.commands import untimely
from shared.runtime.session import SessionSettings
from tests.agents.robot_bridge.drive import plan
from tests.agents.robot_bridge.dvrk.chain_links import (
    LIMITS,
    MS,
    PAGES,
    RIG_LINKS,
    TICK_NS,
    TIME,
    ChainTopics,
    Guard,
    Network,
)
from tests.rigs.robot.world import EPOCH_NS, NAME, RIG_ARM, SECOND_NS, TOOL

PRESENT_NS, SEEN_NS, UNDER_WAY_NS = 250 * MS, 650 * MS, 110 * MS
"""From release, and from the newest frame that was really taken, to the last set point: the frame's bound is 0.5 s, and
what is on its way to the guard may be 0.1 s old. What a bridge that was told to hold had sent may be as old, too."""
LINK_NS = 100 * MS
"""How old the guard's challenge may be that a set point echoes."""
FRAME_NS, GUARD_STARTS_NS, ANSWER_NS = 33 * MS, 300 * MS, 3 * SECOND_NS
ENDS = (ExecutionKind.FINISHED, ExecutionKind.HELD, ExecutionKind.REFUSED)
CONFIGURED: dict[str, Any] = {}
"""What bridges are configured with beside what they must be."""


@dataclass(eq=False)
class Press:
    """A finger on a button: since when it is up, and since when page or desk know it to be over, perhaps before."""

    up_ns: int | None = None
    over_ns: int | None = None

    def lift(self) -> None:
        self.up_ns = TIME.now_ns if self.up_ns is None else self.up_ns
        self.end()

    def end(self) -> None:
        self.over_ns = TIME.now_ns if self.over_ns is None else self.over_ns


@dataclass
class Arming:
    """One command to arm: who sent it, when a bridge was told to hold first since, or whether the console was."""

    press: Press
    accepted: bool = False
    held_ns: int | None = None
    stopped: bool = False


class Coming:
    """An answer that is awaited; whoever waits goes on as soon as the first comes."""

    def __init__(self) -> None:
        self.answer: Any = None
        self.goes_on: Callable[[], None] = lambda: None

    def __await__(self) -> Generator["Coming", None, Any]:
        while self.answer is None:
            yield self
        return self.answer

    def come(self, answer: Any) -> None:
        if self.answer is None:
            self.answer = answer
            self.goes_on()


class Standing(StandingBy):
    """The real one; what takes a while goes on when its answer comes, in place of tasks of an event loop."""

    def start(self, work: Coroutine[Any, Any, None]) -> None:
        try:
            awaited: Coming = work.send(None)
        except StopIteration:
            return
        awaited.goes_on = lambda: self.start(work)


class Bridge:
    """One process: the real bridge, its backend and its clock."""

    def __init__(self, topics: ChainTopics) -> None:
        self.backend = DvrkPsm(
            NAME,
            SessionSettings(),
            Ros2dds(),
            TOOL,
            dry_run=False,
            has_no=("teleoperation", "endoscope_arm", "clutch"),
            linked=topics.link(lambda: TIME.wall_ns("bridge")),
            clock=lambda: TIME.wall_ns("bridge"),
            monotonic=lambda: TIME.now_ns,
        )
        known = {"calibration_id": "c", "registered_ns": EPOCH_NS, "tissue_needed": False}
        told: dict[str, Any] = known | {"limits": LIMITS} | CONFIGURED
        self.agent = RobotBridge(RobotBridgeConfig(RIG_ARM, SIMULATED_BASES[RIG_ARM], **told), self.backend)
        self.clock, self._ticked_ns = AgentClock(lambda: self.agent.keeps_time), 0

    def due(self) -> bool:
        """Whether its next turn has come."""
        if TIME.now_ns - self._ticked_ns < round(SECOND_NS / self.agent.tick_hz):
            return False
        self._ticked_ns = TIME.now_ns
        return True


class Page:
    """What deadman.js and sight.js do, and the finger before the screen."""

    def __init__(self, name: str, desk: "Desk") -> None:
        self.name, self.desk, self.drawn, self.gone = name, desk, None, False
        self.finger: Press | None = None
        self.down: Press | None = None

    def press(self, plan: GraspPlan) -> None:
        if self.finger is None:
            self.gone, self.finger = False, Press()
            self.down = self.finger
            self.tell(lambda desk, press=self.down: desk.pressed(self.name, plan, press))

    def lift(self) -> None:
        if self.finger is not None:
            self.finger.lift()
            self.release("the button was released")
            self.finger = None

    def vanish(self) -> None:
        """The finger goes up, and the page says nothing until it is there again: a killed browser."""
        self.gone = True
        if self.finger is not None:
            self.finger.lift()
        self.finger = self.down = None
        self.desk.network.cut((f"to {self.name}", f"from {self.name}"), 0)

    def release(self, why: str) -> None:
        """The page lets go, whatever the finger does."""
        if self.down is not None:
            self.down.end()
            self.down = None
            self.tell(lambda desk: desk.follow(desk.control.release(self.name, why)))

    def challenge(self, text: str, at_ns: int, limit_ms: int) -> None:
        """Answer while the button is down and the picture is new enough."""
        if self.down is None:
            self.tell(lambda desk: desk.follow(desk.control.release(self.name, "the button is up")))
        elif self.blind(at_ns, limit_ms):
            self.release("the picture is old")
        else:
            self.tell(lambda desk: desk.follow(desk.control.beat(self.name, text, desk.now_s())))

    def blind(self, at_ns: int, limit_ms: int) -> bool:
        """Whether the picture is too old, or of another time, for a challenge of then."""
        echo_ns = 0 if self.drawn is None else self.drawn.echo_of(RIG_ARM)
        return not (echo_ns and at_ns) or not -limit_ms * MS <= at_ns - echo_ns <= limit_ms * MS

    def tell(self, what: "Callable[[Desk], None]") -> None:
        """Have the desk hear it."""
        desk = self.desk
        if not self.gone:
            desk.network.carry(f"from {self.name}", lambda: what(desk) if desk.alive else None)

    def say(self, document: dict[str, Any]) -> None:
        """Hear what is said to this page alone (Voice)."""
        if document["kind"] == "refused":
            self.desk.network.carry(f"to {self.name}", lambda: self.release("it was refused"))


class Desk:
    """The page's server: the real control and what follows from it; a stand-in of its turn and its links."""

    def __init__(self, chain: "Chain") -> None:
        self.chain, self.network, self.alive = chain, chain.network, True
        self.control, self.state, self.heard_ns = Control(), None, 0
        self.pages = {name: Page(name, self) for name in PAGES}
        screens: Any = self.pages
        commands: Any = self
        voice = Voice(screens, lambda *_, **__: None)
        self.standing_by = Standing(
            self.control, commands, voice, lambda _arm: self.newest_ns, lambda _arm, _plan_id: None
        )
        self.now_pressed = Press()
        for name in PAGES:
            self.follow(self.control.join(name))

    @property
    def newest_ns(self) -> int:
        """The newest challenge of the bridge that was heard."""
        return 0 if self.state is None else self.state.challenge_ns

    def now_s(self) -> float:
        return 1e-9 * (TIME.now_ns - EPOCH_NS)

    def follow(self, effects: Any) -> None:
        """What follows from the state of control."""
        self.standing_by.follow(effects)

    def pressed(self, name: str, plan: GraspPlan, press: Press) -> None:
        """A page's button went down."""
        before = self.control.press
        self.follow(self.control.begin(name, RIG_ARM, plan.plan_id, self.now_s()))
        if self.control.press is not before:
            self.now_pressed = press

    def hold_all(self, name: str) -> None:
        """A page says hold."""
        press, why = self.control.press, f"{name} said hold"
        if press is not None:
            self.now_pressed.end()
        effects = self.control.release(press.screen, why) if press else []
        told = any(isinstance(effect, HoldNow) for effect in effects)
        self.follow([*effects, *([] if told else [HoldNow(name, RIG_ARM, why)])])

    def turn(self) -> None:
        """As `Desk._turn`."""
        self.follow(self.control.turn(self.now_s()))
        if self.control.press is None:
            return
        if self.state is not None:
            self.control.challenged(RIG_ARM, self.state.challenge_ns, self.state.guard_challenge)
        if (due := self.control.challenge(self.now_s())) is not None:
            at_ns = due.challenge_ns or (self.newest_ns and self.newest_ns + TIME.now_ns - self.heard_ns)
            limit_ms = 0 if self.state is None else round(1e3 * self.state.maximum_frame_age_s)
            page = self.pages[due.screen]
            self.network.carry(f"to {due.screen}", lambda: page.challenge(due.text, at_ns, limit_ms))

    def hear(self, told: RobotState | ExecutionEvent) -> None:
        """What the bridge says."""
        if isinstance(told, RobotState):
            self.state, self.heard_ns = told, TIME.now_ns
        elif told.kind in ENDS:
            self.control.ended(told.arming_id)

    def show(self, stamp: FrameStamp) -> None:
        """A frame has come, and goes to the pages."""
        for page in self.pages.values():
            self.network.carry(f"to {page.name}", lambda page=page: setattr(page, "drawn", stamp))

    # the way of its commands (agents/operator/arming.py)

    def beat(self, effect: BeatNow) -> None:
        """One heartbeat, of a person who presses, to bridge and guard."""
        of = effect.challenge_ns, effect.guard_challenge
        at_ns = TIME.wall_ns("desk")
        beat = Heartbeat(effect.arm, effect.plan_id, at_ns, effect.arming_id, *of, pressed=True)
        said, chain = (beat.arm, beat.arming_id, beat.guard_challenge, beat.pressed), self.chain
        self.network.carry("answers", lambda: chain.receive(HEARTBEAT, beat))
        self.network.carry("guarded answers", lambda: chain.guard.beat(*said) if chain.guard else None)

    async def arm(
        self,
        screen: str,
        arm: str,
        plan_id: str,
        begins: Callable[[str], bool],
        challenge_ns: Callable[[], int],
        _pull: None = None,
    ) -> CommandAnswer | None:
        """Arm a plan; one that is not known yet is not tried again here."""
        header = self.chain.header(f"page {screen}")
        if not begins(header.id):
            return None
        self.chain.armings[header.id] = Arming(self.now_pressed)
        return await self.chain.command(ARM, Arm(header, arm, plan_id, challenge_ns(), pressed=True))

    def hold(self, arm: str) -> Coming:
        return self.chain.command(HOLD, Hold(self.chain.header("operator page"), arm))


@dataclass
class Camera:
    """What the real camera says of its frames, which hears challenges over the rig."""

    sender: FrameSender = field(
        default_factory=lambda: FrameSender(CameraConfig(encoding=ImageEncoding.RAW, latency_ms=10.0))
    )
    frozen: bool = False
    taken_ns: int = 0
    sent_ns: int = 0

    def __post_init__(self) -> None:
        self.sender._calibration_id = "c"

    def frame(self) -> FrameStamp | None:
        """The next one, if it is time."""
        if self.frozen or TIME.now_ns - self.sent_ns < FRAME_NS:
            return None
        self.sent_ns, now_ns = TIME.now_ns, TIME.wall_ns("camera")
        self.taken_ns = TIME.now_ns - round(self.sender.config.latency_ms * MS)
        self.sender.ticked(now_ns)
        picture = np.full((8, 8, 3), self.sender.sent % 251, np.uint8)
        return self.sender.frame((picture, picture), now_ns).stamp


class Chain:
    """One arm with everything that leads to it; time goes on when it is told to.

    Fields:
        armings: by their ids.
        passed, passed_ns: how many set points did, and when the last one.
        violations: what passed and must not have.
    """

    def __init__(self) -> None:
        TIME.now_ns = EPOCH_NS
        TIME.agree()
        self.network, self._numbers = Network(), itertools.count()
        self.topics, self.armings = ChainTopics(self.network), dict[str, Arming]()
        self.passed, self.passed_ns, self.violations = 0, 0, list[str]()
        clocks: dict[str, Any] = {"now_ns": lambda: TIME.now_ns, "monotonic_s": lambda: TIME.now_ns * 1e-9}
        oracle = Oracle(Field(SIMULATED_BASES[RIG_ARM]), hears_heartbeats=True)
        self.console = EmulatedConsole(self.topics, NAME, oracle, Behaviour(True, 0.0, start_of(NAME), **clocks))
        self.guard: Guard | None = None
        self.start_guard()
        self.bridges, self.camera, self.newest_plan = [Bridge(self.topics)], Camera(), None
        self.desk = Desk(self)

    def go(self, ticks: int) -> None:
        """Let time pass."""
        for _ in range(ticks):
            TIME.now_ns += TICK_NS
            self.network.deliver()
            self.console.turn(TICK_NS * 1e-9)
            if self.guard is not None:
                self.guard.turn()
            if self.desk.alive:
                self.desk.turn()
            if (stamp := self.camera.frame()) is not None:
                self.network.carry("frames", lambda stamp=stamp: self.receive(FRAME_NOTICE, FrameNotice(stamp)))
                self.network.carry("pictures", lambda stamp=stamp: self.desk.show(stamp))
            for bridge in self.bridges:
                if bridge.due():
                    self.step(bridge, Tick(bridge.clock.now_ns()))

    @property
    def moves(self) -> bool:
        """Whether set points pass now."""
        return TIME.now_ns - self.passed_ns < 50 * MS

    # people

    def press(self, name: str = "ann") -> None:
        """Somebody presses to arm a new plan, made of what their page shows."""
        page = self.desk.pages[name]
        if page.finger is None and page.drawn is not None:
            page.press(self.plan_of(page.drawn))

    def vanish(self) -> None:
        """Whoever presses is gone without a word."""
        for page in self.desk.pages.values():
            page.vanish()

    def hold(self) -> None:
        """Somebody says hold elsewhere than on a page (`suturegrasp hold`)."""
        self.command(HOLD, Hold(self.header("ops"), RIG_ARM))

    def hold_at_console(self) -> None:
        """A program of the console's computer says hold there, which guard and bridge hear."""
        for arming in self.armings.values():
            arming.stopped = arming.stopped or arming.accepted
        self.topics.tell_console(f"{NAME}/hold", cdr.EMPTY)
        self.topics.tell_guard(f"{NAME}/hold", cdr.EMPTY)
        self.topics.later(lambda: self.topics.tell_bridge(f"{NAME}/hold", cdr.EMPTY))

    # processes

    def freeze(self) -> None:
        """The camera takes no frame any more."""
        self.camera.frozen = True

    def start_guard(self) -> None:
        self.guard = Guard(self.topics, self.check)
        self.topics.guards[:] = [self.guard]

    def restart_guard(self, after_ns: int = GUARD_STARTS_NS) -> None:
        """It is killed, or has lost the robot's Zenoh, and begins anew."""
        if self.guard is not None:
            self.guard = None
            self.topics.guards.clear()
            self.network.later(after_ns, self.start_guard)

    def restart_bridge(self, after_ns: int = 0) -> None:
        """It is killed, and begins anew; alone."""
        self.bridges.clear()
        self.topics.killed()
        self.network.later(after_ns, lambda: None if self.bridges else self._start_bridge())

    def _start_bridge(self) -> None:
        """It hears the newest plan anew, which the planner's cache has."""
        self.bridges.append(Bridge(self.topics))
        if self.newest_plan is not None:
            self.receive(PLAN, self.newest_plan)

    def another_bridge(self) -> None:
        """A second one of the same arm, by mistake."""
        if len(self.bridges) == 1:
            self._start_bridge()

    def restart_page(self, after_ns: int = GUARD_STARTS_NS) -> None:
        """The server is killed, and begins anew; whoever presses presses a page that is gone."""
        self.desk.alive = False
        for page in self.desk.pages.values():
            page.lift()
        self.network.later(after_ns, self._start_desk)

    def _start_desk(self) -> None:
        if not self.desk.alive:
            self.desk = Desk(self)

    def lose_robot(self, duration_ns: int) -> None:
        """The robot's Zenoh goes: bridge and guard lose their sessions, and the guard ends with status 75."""
        self.topics.lose(duration_ns)
        self.restart_guard(max(duration_ns, GUARD_STARTS_NS))

    def lose_bridge(self, duration_ns: int) -> None:
        """The way from the bridge to the robot's Zenoh goes; the guard is beside it."""
        self.topics.lose(duration_ns)

    def lose_rig(self, duration_ns: int) -> None:
        """The rig's router goes."""
        self.network.cut(RIG_LINKS, duration_ns)

    def well(self) -> None:
        """Everything is mended, and everybody lets go."""
        TIME.agree()
        self.network.mend()
        self.camera.frozen = False
        for page in self.desk.pages.values():
            page.lift()
        if len(self.bridges) != 1:
            self.restart_bridge()

    def move(self, by: str = "ann") -> bool:
        """Have the arm move, pressed by one of the pages; whether it does."""
        if self.armings:
            self.well()
            self.go(45)
        control = self.desk.control
        if control.controller != by:
            self.desk.follow(control.take(by, self.desk.now_s()))
            self.desk.follow(control.give(control.controller, yes=True))
        self.press(by)
        before = self.passed
        for _ in range(16):
            self.go(10)
            if self.passed - before > 10:
                return True
        return False

    # what is said

    def header(self, sender: str) -> CommandHeader:
        return CommandHeader(f"c{next(self._numbers)}", TIME.wall_ns("desk") + 2 * SECOND_NS, sender)

    def command(self, topic: Any, message: Any) -> Coming:
        """A command, and its answer; where none comes the outcome is not known."""
        coming = Coming()
        self.network.carry("commands", lambda: self._carry_out(topic, message, coming))
        unknown = CommandAnswer(message.header.id, Outcome.UNKNOWN, "no_answer", "nothing came")
        self.network.later(ANSWER_NS, lambda: coming.come(unknown))
        return coming

    def receive(self, topic: Any, message: Any) -> None:
        """Have every bridge hear a message."""
        for bridge in self.bridges:
            self.step(bridge, Received(topic, "", 0, message))

    def step(self, bridge: Bridge, arrived: Any) -> list[Any]:
        """One step of a bridge; what it says goes out."""
        replies = list(bridge.agent.step(arrived))
        for reply in replies:
            if isinstance(reply, Output) and reply.topic in (ROBOT_STATE, EXECUTION):
                self.network.carry("states", lambda told=reply.message: self.desk.hear(told))
            if isinstance(reply, Output) and reply.topic is ROBOT_STATE:
                state = reply.message
                self.network.carry("challenges", lambda state=state: self.camera.sender.challenged(state))
        return replies

    def _carry_out(self, topic: Any, message: Any, coming: Coming) -> None:
        """As the runner has it: what stops halts at once, what is too late is refused."""
        for bridge in self.bridges:
            now_ns = bridge.clock.now_ns()
            if topic is HOLD:
                bridge.agent.halt()
            answer = None if topic is HOLD else untimely(message.header, now_ns)
            if answer is None:
                replies = self.step(bridge, Command(topic, RIG_ARM, message, now_ns))
                answer = next(each for each in replies if isinstance(each, CommandAnswer))
            self._note(topic, message.header.id, answer)
            self.network.carry("states", lambda answer=answer: coming.come(answer))

    def _note(self, topic: Any, arming_id: str, answer: CommandAnswer) -> None:
        """What is true from now on, whether or not anybody hears of it."""
        if topic is ARM:
            self.armings[arming_id].accepted |= answer.outcome is Outcome.ACCEPTED
            return
        for arming in self.armings.values():
            if arming.accepted and arming.held_ns is None:
                arming.held_ns = TIME.now_ns

    def check(self, said: SetPoint) -> None:
        """What must be true whenever a set point passes."""
        self.passed, self.passed_ns = self.passed + 1, TIME.now_ns
        now_ns, arming = TIME.now_ns, self.armings.get(said.arming_id, Arming(Press(0, 0)))
        since_ns = [0 if at_ns is None else now_ns - at_ns for at_ns in (arming.press.up_ns, arming.press.over_ns)]
        held_ns, issued_ns = arming.held_ns or now_ns, self.guard.issued.get(said.challenge, 0) if self.guard else 0
        for wrong, what in (
            (not arming.accepted, "it was not armed"),
            (since_ns[0] > PRESENT_NS, "nobody pressed"),
            (since_ns[1] > PRESENT_NS, "the press was over"),
            (now_ns - self.camera.taken_ns > SEEN_NS, "nobody saw"),
            (now_ns - held_ns > UNDER_WAY_NS, "it was held"),
            (arming.stopped, "it was held at the console"),
            (now_ns - issued_ns > LINK_NS, "it was not challenged"),
            (now_ns - self.network.sent_ns > UNDER_WAY_NS, "it was long on its way"),
        ):
            if wrong:
                self.violations.append(f"{what}: {said.arming_id} at {(now_ns - EPOCH_NS) / MS:.0f} ms")

    def plan_of(self, stamp: FrameStamp) -> GraspPlan:
        """A plan made of a frame, which the bridges hear."""
        points = [(0.02 * (-1) ** k, 0.002 * k, 0.08) for k in range(8)]
        poses = [transform(exp_so3(np.array((0.1, 0, 0.3))), np.array(point)) for point in points]
        waypoints = tuple(Waypoint(pose, 0.5, Phase.APPROACH, None) for pose in poses)
        made = plan(f"plan-{next(self._numbers)}", RIG_ARM, stamp=stamp, waypoints=waypoints)
        self.newest_plan = made
        self.receive(PLAN, made)
        return made
