"""Page, bridge, guard and the links between them as one model, in virtual time, on the real objects (chain_model.py).

Whatever delays, losses, reorderings, broken links, restarts, clock jumps, second operators, second bridges and frozen
cameras do: no set point passes the guard unless it was armed, somebody pressed, and a camera saw, all within their
bounds; and what was released or held passes nothing until it is armed anew. That the model would notice is shown by
taking defences away, one at a time.

    SUTUREGRASP_CHAIN_EXAMPLES=500 .venv/bin/python -m pytest tests/agents/robot_bridge/dvrk/test_chain.py -k whatever

tries so many other, longer examples, as for a night.
"""

import logging
import math
import os
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test

from agents.guard.monitor import Action, Monitor
from agents.robot_bridge.agent import RobotBridge
from agents.robot_bridge.arm_status import Sight
from agents.robot_bridge.dvrk.psm import DvrkPsm
from shared.ros.guarded import SetPoint
from shared.runtime import clocks
from tests.agents.robot_bridge.dvrk import chain_model
from tests.agents.robot_bridge.dvrk.chain_links import LINKS, MS, PAGES, ROBOT_LINKS, TIME, Link
from tests.agents.robot_bridge.dvrk.chain_model import PRESENT_NS, Chain, Page
from tests.rigs.robot.world import SECOND_NS

NIGHTLY = int(os.environ.get("SUTUREGRASP_CHAIN_EXAMPLES", "0"))
EXAMPLES, STEPS = 12, 6


@pytest.fixture(autouse=True, scope="module")
def virtual_time():
    """The bridge's own clock, which does not jump while it is armed, reads the chain's."""
    with pytest.MonkeyPatch.context() as patched:
        logging.getLogger("suturegrasp.robot_bridge.psm1").setLevel(logging.ERROR)
        patched.setattr(clocks, "now_ns", lambda: TIME.wall_ns("bridge"))
        patched.setattr(clocks, "monotonic_ns", lambda: TIME.now_ns)
        patched.setattr(clocks, "monotonic_s", lambda: TIME.now_ns * 1e-9)
        yield


def moving(by: str = "ann") -> Chain:
    """A chain whose arm moves."""
    chain = Chain()
    chain.go(30)
    assert chain.move(by), (chain.bridges[0].agent._stands.measured.not_ready, chain.desk.control)
    return chain


@pytest.mark.parametrize(
    ("link", "delay_ms"),
    [("states", 0), ("states", 200), ("to robot", 200), ("to ann", 200), ("guarded answers", 60)],
)
def test_after_release_nothing_passes_later_than_the_bound_whichever_link_queues(link, delay_ms):
    chain = moving()
    chain.network.spoil(link, Link(delay_ms * MS))
    chain.go(10)
    chain.desk.pages["ann"].vanish()
    released_ns = TIME.now_ns
    chain.go(40 + delay_ms // 10)
    assert chain.passed_ns - released_ns <= PRESENT_NS
    assert chain.violations == []


@pytest.mark.parametrize("link", ["to robot", "states", "guarded answers", "challenges", "from ann"])
def test_where_a_way_takes_too_long_an_arm_is_not_moved_at_all(link):
    chain = Chain()
    chain.network.spoil(link, Link((2000 if link == "challenges" else 250) * MS))
    chain.go(250 if link == "challenges" else 75)
    chain.press()
    chain.go(120)
    assert (chain.passed, chain.violations) == (0, [])


@pytest.mark.slow
@pytest.mark.parametrize("by", PAGES)
def test_the_model_moves_and_nothing_is_wrong_with_that(by):
    chain = moving(by)
    before = chain.passed
    chain.go(100)
    assert chain.passed - before > 75
    assert chain.violations == []


def test_a_hold_at_the_console_counts_before_the_first_set_point_passes():
    chain = Chain()
    chain.go(30)
    chain.press()
    while not any(arming.accepted for arming in chain.armings.values()):
        chain.go(1)
    assert chain.passed == 0
    chain.hold_at_console()
    chain.go(100)
    assert chain.violations == []


Fault = Callable[[Chain], Any]
"""What goes wrong, or what somebody does."""


def does(name: str, *arguments: Any) -> Fault:
    """What a chain does itself."""
    return lambda chain: getattr(chain, name)(*arguments)


def spoils(link: str, how: Link) -> Fault:
    return lambda chain: chain.network.spoil(link, replace(how))


def jumps(computer: str, by_s: float) -> Fault:
    """The wall clock of a computer is set."""

    def fault(_chain: Chain) -> None:
        TIME.offset_ns[computer] += round(by_s * SECOND_NS)

    return fault


def says(page: str, what: str) -> Fault:
    """Somebody does something on a page."""

    def fault(chain: Chain) -> None:
        control = {
            "hold": lambda desk: desk.hold_all(page),
            "take": lambda desk: desk.follow(desk.control.take(page, desk.now_s())),
            "give": lambda desk: desk.follow(desk.control.give(page, yes=True)),
        }
        if what in control:
            chain.desk.pages[page].tell(control[what])
        elif what == "press":
            chain.press(page)
        else:
            getattr(chain.desk.pages[page], what)()

    return fault


def ms(*values: int) -> st.SearchStrategy[int]:
    return st.sampled_from(values).map(lambda value: value * MS)


LINK = st.builds(
    Link,
    delay_ns=ms(0, 5, 40, 80, 95, 120, 150, 300, 1500, 5000),
    lost=st.sampled_from([0, 0, 0, 2, 3, 10]),
    jitter_ns=ms(0, 10, 40, 80, 150, 500),
)
PAGE, TICKS = st.sampled_from(PAGES), st.sampled_from([10, 30, 30, 50, 90])
VANISHES = st.builds(does, st.just("vanish"))
LETS_GO = VANISHES | st.builds(says, PAGE, st.sampled_from(["vanish", "lift"]))
HOLDS = st.builds(does, st.sampled_from(["hold", "hold_at_console"])) | st.builds(says, PAGE, st.just("hold"))
OTHERS = st.builds(says, PAGE, st.sampled_from(["press", "take", "give"])) | st.builds(does, st.just("another_bridge"))
SLOWS = st.builds(spoils, st.sampled_from(LINKS), LINK) | st.builds(spoils, st.sampled_from(ROBOT_LINKS), LINK)
BREAKS = st.builds(does, st.sampled_from(["lose_robot", "lose_bridge", "lose_rig"]), ms(50, 200, 300, 1000))
JUMPS = st.builds(jumps, st.sampled_from(["bridge", "desk", "camera"]), st.sampled_from([-10, -1, -0.05, 0.05, 1, 10]))
RESTARTS = st.builds(does, st.sampled_from(["restart_guard", "restart_bridge", "restart_page"]), ms(300, 1000))
FREEZES = st.builds(does, st.just("freeze"))
FAULT = st.one_of(LETS_GO, HOLDS, OTHERS, SLOWS, BREAKS, JUMPS, RESTARTS, FREEZES)


def seldom(fault: st.SearchStrategy[Fault]) -> st.SearchStrategy[Fault | None]:
    """One in three times; for where more goes wrong the arm is held sooner, and less is seen of each."""
    return st.sampled_from([False, False, True]).flatmap(lambda comes: fault if comes else st.none())


SCENES = st.one_of(
    st.tuples(seldom(SLOWS), LETS_GO),
    st.tuples(seldom(SLOWS), VANISHES),
    st.tuples(seldom(SLOWS), HOLDS),
    st.tuples(seldom(SLOWS | OTHERS), FREEZES),
    st.tuples(SLOWS, seldom(LETS_GO | SLOWS)),
    st.tuples(BREAKS | JUMPS | RESTARTS, seldom(FAULT)),
    st.lists(FAULT, min_size=2, max_size=4),
)
"""What goes wrong together, or shortly after each other."""
TALLY = {True: 0, False: 0}
"""How many steps began in mid-motion, and how many could not."""


class Whole(RuleBasedStateMachine):
    """An arm moves, something goes wrong, time passes; and anything else, in any order."""

    chain: Chain | None = None

    @initialize(by=PAGE)
    def begin(self, by: str) -> None:
        self.chain = Chain()
        self.chain.go(30)
        self.chain.move(by)

    @rule(moves=st.sampled_from([True, True, True, False]), faults=SCENES, by=PAGE, ticks=TICKS)
    def something_goes_wrong(self, moves: bool, faults: Iterable[Fault | None], by: str, ticks: int) -> None:
        """One after another, a little apart, mostly while the arm moves; then time passes."""
        assert self.chain is not None
        if moves:
            TALLY[self.chain.moves or self.chain.move(by)] += 1
        for apart, fault in enumerate(faults):
            if fault is not None:
                fault(self.chain)
                self.chain.go(3 * apart)
        self.chain.go(ticks)

    @invariant()
    def nothing_passes_that_must_not(self) -> None:
        assert self.chain is None or self.chain.violations == []


@pytest.mark.slow
@pytest.mark.timeout(180 + 20 * NIGHTLY)
def test_whatever_happens_nothing_passes_that_must_not():
    TALLY.update({True: 0, False: 0})
    check = settings(
        max_examples=NIGHTLY or EXAMPLES,
        stateful_step_count=25 if NIGHTLY else STEPS,
        deadline=None,
        derandomize=not NIGHTLY,
        database=None,
        phases=[Phase.generate, Phase.shrink] if NIGHTLY else [Phase.generate],
        report_multiple_bugs=False,
        print_blob=True,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
    )
    run_state_machine_as_test(Whole, settings=check)
    assert TALLY[True] > 4 * TALLY[False], TALLY


def without_dead_man(patched: pytest.MonkeyPatch) -> None:
    """Each of guard, bridge and desk ends a motion by itself, so that all three bounds must go to be noticed."""
    for bound in ("PRESENCE_NS", "LINK_NS"):
        patched.setattr(f"agents.guard.monitor.{bound}", 10 * SECOND_NS)
    patched.setitem(chain_model.CONFIGURED, "dead_man_s", 10.0)
    patched.setattr("agents.operator.control.BEAT_S", 10.0)


def without_sight(patched: pytest.MonkeyPatch) -> None:
    """The bridge alone stops a blind motion, and so does the page that answers no more: both must go."""
    patched.setattr(RobotBridge, "_blind", lambda *_: None)
    patched.setattr(Sight, "refusal", lambda *_: None)
    patched.setattr(Page, "blind", lambda *_: False)


def without_hold(patched: pytest.MonkeyPatch) -> None:
    """The bridge ignores whatever stops it; what its backend would say to the console, the guard would hear."""
    patched.setattr(RobotBridge, "halt", lambda _: None)
    patched.setattr(RobotBridge, "stop", lambda *_: [])
    patched.setattr(Monitor, "hear_hold", lambda *_: [])


def with_burnt_armings(patched: pytest.MonkeyPatch) -> None:
    """The guard forgets what it has held, and when; the bridge hears of a hold at the console from the guard alone."""
    judged = Monitor.hear_set_point

    def forgets(monitor: Monitor, said: SetPoint, now_ns: int) -> list[Action]:
        monitor._burnt.clear()
        monitor._stopped_ns = -math.inf
        return judged(monitor, said, now_ns)

    patched.setattr(Monitor, "hear_set_point", forgets)
    patched.setattr(DvrkPsm, "_hear_hold", lambda *_: None)


def without_age_of_set_points(patched: pytest.MonkeyPatch) -> None:
    """Neither guard nor bridge asks for how long messages are on their way."""
    patched.setattr("agents.guard.monitor.LINK_NS", 10 * SECOND_NS)
    patched.setitem(chain_model.CONFIGURED, "dead_man_s", 10.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mutant", "fault", "noticed"),
    [
        (without_dead_man, does("vanish"), "nobody pressed"),
        (without_sight, does("freeze"), "nobody saw"),
        (without_hold, does("hold"), "it was held"),
        (with_burnt_armings, does("hold_at_console"), "it was held at the console"),
        (without_age_of_set_points, spoils("from robot", Link(150 * MS)), "it was not challenged"),
    ],
)
def test_the_model_notices_that_a_defence_is_gone(mutant, fault, noticed, monkeypatch):
    for gone in (False, True):
        if gone:
            mutant(monkeypatch)
        chain = moving()
        fault(chain)
        chain.go(120)
        found = {each.partition(":")[0] for each in chain.violations}
        assert (noticed in found) if gone else not found
