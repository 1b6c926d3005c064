"""What lies between page, bridge, guard, console and camera, in virtual time: clocks, links, topics, and a guard."""

import heapq
import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

from agents.guard.links import RESTS_NS
from agents.guard.monitor import Action
from agents.robot_bridge.limits import PSM_JOINT_SPEEDS, MotionLimits
from shared.ros.guarded import CHALLENGE, SetPoint, challenge_bytes, key_of
from tests.rigs.robot.world import EPOCH_NS, NAME, RIG_ARM, Topics, WorldGuard
from tests.rigs.robot.world import Link as RobotLink

MS = 1_000_000
TICK_NS = 10 * MS
LIMITS = MotionLimits(joint_speeds=PSM_JOINT_SPEEDS)
"""A rig's."""
"""A turn of bridge, guard and desk: the default of each."""
ROBOT_LINKS = ("to robot", "from robot")
RIG_LINKS = ("states", "answers", "guarded answers", "challenges", "frames", "pictures", "commands")
PAGES = ("ann", "ben")
BROWSER_LINKS = tuple(f"{way} {page}" for page in PAGES for way in ("to", "from"))
LINKS = (*ROBOT_LINKS, *RIG_LINKS, *BROWSER_LINKS)


class Time:
    """The monotonic time of all, and how far the wall clock of each computer is from it."""

    now_ns = EPOCH_NS
    offset_ns: ClassVar = {"bridge": 0, "desk": 0, "camera": 0}

    def agree(self) -> None:
        self.offset_ns.update(dict.fromkeys(self.offset_ns, 0))

    def wall_ns(self, computer: str) -> int:
        return self.now_ns + self.offset_ns[computer]


TIME = Time()
"""Of the chain that was made last: the product's own clocks read it (`virtual_time` in test_chain.py)."""


@dataclass
class Link:
    """How a link carries: each nth message is lost, and of three one comes by `jitter_ns` later, one by half as much.

    Where it is `ordered`, as on a connection of a browser, nothing overtakes or is lost.
    """

    delay_ns: int = 0
    lost: int = 0
    jitter_ns: int = 0
    ordered: bool = False
    broken_until_ns: int = 0
    count: int = 0
    last_ns: int = 0

    def arrives_ns(self, now_ns: int) -> int | None:
        """When what is sent now arrives; None where it never does."""
        self.count += 1
        if now_ns < self.broken_until_ns or (self.lost and not self.ordered and self.count % self.lost == 0):
            return None
        at_ns = now_ns + self.delay_ns + (0, self.jitter_ns // 2, self.jitter_ns)[self.count % 3]
        self.last_ns = max(at_ns, self.last_ns) if self.ordered else at_ns
        return self.last_ns


class Network:
    """Carries what is said, and does what is due later; `sent_ns` is when the message was sent that arrives now."""

    def __init__(self) -> None:
        self.links, self.sent_ns = dict[str, Link](), 0
        self._due: list[tuple[int, int, str, int, Callable[[], None]]] = []
        self._number = itertools.count()
        self.mend()

    def mend(self) -> None:
        """Every link carries at once again; what is under way stays so."""
        for name in LINKS:
            self.spoil(name, Link())

    def spoil(self, name: str, link: Link) -> None:
        """From now on a link is as this one."""
        before = self.links.get(name, link)
        link.ordered, link.last_ns, link.broken_until_ns = name in BROWSER_LINKS, before.last_ns, before.broken_until_ns
        self.links[name] = link

    def cut(self, names: Iterable[str], duration_ns: int) -> None:
        """Links break: what is under way is lost, and nothing is carried for a while."""
        cut = set(names)
        for name in cut:
            self.links[name].broken_until_ns, self.links[name].last_ns = TIME.now_ns + duration_ns, 0
        self._due = [each for each in self._due if each[2] not in cut]
        heapq.heapify(self._due)

    def carry(self, name: str, deliver: Callable[[], None]) -> None:
        """Over a link, as it is now."""
        at_ns = self.links[name].arrives_ns(TIME.now_ns)
        if at_ns is not None:
            heapq.heappush(self._due, (at_ns, next(self._number), name, TIME.now_ns, deliver))

    def later(self, after_ns: int, do: Callable[[], None]) -> None:
        heapq.heappush(self._due, (TIME.now_ns + after_ns, next(self._number), "", TIME.now_ns, do))

    def deliver(self) -> None:
        """What has arrived by now."""
        while self._due and self._due[0][0] <= TIME.now_ns:
            _, _, _, self.sent_ns, deliver = heapq.heappop(self._due)
            deliver()


class ChainTopics(Topics):
    """The topics on the robot's computer; the bridge reaches them over two links, one for each way."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network, self.ends = network, list[BridgeEnd]()
        self.later = lambda deliver: network.carry("from robot", deliver)
        self._now_ns = lambda: TIME.wall_ns("bridge")

    def link(self, now_ns: Callable[[], int]) -> Callable[..., "BridgeEnd"]:
        """What makes a bridge's end, as it makes a RosLink."""

        def made(*arguments: Any) -> BridgeEnd:
            self.ends.append(BridgeEnd(self, *arguments))
            return self.ends[-1]

        return made

    def killed(self) -> None:
        """The bridges are gone, and nobody hears for them."""
        self.ends.clear()
        self._bridge.clear()

    def lose(self, duration_ns: int) -> None:
        """The bridges' sessions are lost, and others opened after a while, as RosLink does it."""
        self.network.cut(ROBOT_LINKS, duration_ns)
        for end in self.ends:
            end.broken, end.lost_until_ns = end.broken + 1, TIME.now_ns + duration_ns
        self.network.later(duration_ns, self._tell_latched)

    def _tell_latched(self) -> None:
        for topic, heard in self._bridge.items():
            for one in heard:
                if one.latched and topic in self._latched:
                    one.receive(self._latched[topic], self._now_ns())


class BridgeEnd(RobotLink):
    """A bridge's end of the robot's link."""

    lost_until_ns = 0

    def __init__(self, topics: ChainTopics, *arguments: Any) -> None:
        super().__init__(topics, *arguments)
        self._network = topics.network

    def say(self, topic: str, payload: bytes) -> bool:
        """Have the console, or the guard, hear it; False while there is no session."""
        if TIME.now_ns < self.lost_until_ns or not self._open or topic not in self._said:
            return False
        self._network.carry("to robot", lambda: self._arrive(topic, payload))
        return True


class Guard(WorldGuard):
    """The real monitor beside the console, which knows nothing of before; `issued`: when each challenge was."""

    def __init__(self, topics: ChainTopics, passed: Callable[[SetPoint], None]) -> None:
        super().__init__(RIG_ARM, topics, lambda: TIME.now_ns, judges=True, limits=LIMITS)
        # nor has it been there for a while, as that of a world
        self.monitor = type(self.monitor)(self.monitor._robot)
        self.issued, self._passed = dict[int, int](), passed
        self._stirred_ns, self._turns = 0, 0

    def beat(self, arm: str, arming_id: str, guard_challenge: int, pressed: bool) -> None:
        """A heartbeat has come over the rig."""
        self._stirred_ns = TIME.now_ns
        self.do(self.monitor.hear_heartbeat(arm, arming_id, guard_challenge, pressed, TIME.now_ns))

    def turn(self) -> None:
        """What follows from time; a challenge every 20 ms, and every 80 ms at rest (agents/guard/__main__.py)."""
        self.do(self.monitor.turn(TIME.now_ns))
        self._turns += 1
        if self._turns % (2 if TIME.now_ns - self._stirred_ns < RESTS_NS else 8) == 0:
            told, name = self.monitor.challenge(TIME.now_ns), key_of(NAME, CHALLENGE)
            self.issued[told.challenge] = TIME.now_ns
            self._topics.later(lambda: self._topics.tell_bridge(name, challenge_bytes(name, told)))

    def _set_point(self, said: SetPoint, now_ns: int) -> list[Action]:
        self._stirred_ns = now_ns
        actions = self.monitor.hear_set_point(said, now_ns)
        if any(action.positions for action in actions):
            self._passed(said)
        return actions
