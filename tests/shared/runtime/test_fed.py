"""What an output lists of what its agent was fed."""

from schemas.messages import Consumed
from schemas.topics import FRAMES, PLAN, TOPICS, key
from shared.runtime.agent import Agent, Input
from shared.runtime.outlets import MOST_LISTED, OMITTED, TICK, Fed, adds_up, is_tick

FRAME, STATE, PLANS = key("lab", FRAMES), "suturegrasp/lab/robot_bridge/psm1/state", key("lab", PLAN)
OWN_TICK, OWN_OMITTED = f"suturegrasp/lab/planner/main/{TICK}", f"suturegrasp/lab/planner/main/{OMITTED}"
EPOCH = 7


class Some(Agent):
    kind, instance, outputs, commands = "planner", "main", (PLAN,), ()

    def __init__(self, tick_hz=None, only_newest_counts=False, only_newest_tick_counts=False, goes_on_from=None):
        self.tick_hz, self.inputs = tick_hz, (Input(FRAMES, only_newest_counts=only_newest_counts),)
        self.only_newest_tick_counts, self.goes_on_from = only_newest_tick_counts, goes_on_from

    def step(self, arrived):
        return ()


def fed(**agent):
    return Fed(Some(**agent), "lab", EPOCH)


def test_a_list_holds_messages_and_ticks_in_their_order_and_the_next_begins_with_the_output_before():
    each = fed(tick_hz=10.0)
    each.tick(1000)
    each.message(FRAME, 3, 5)
    each.tick(2000)
    ticks = Consumed(OWN_TICK, EPOCH, 1000), Consumed(OWN_TICK, EPOCH, 2000)
    assert each.listed() == (ticks[0], Consumed(FRAME, 3, 5), ticks[1])
    each.published(PLANS, 4)
    each.tick(2000)
    assert each.listed() == (Consumed(PLANS, EPOCH, 4), ticks[1])


def test_where_only_the_newest_counts_it_stays_and_no_output_before_is_named():
    each = fed(only_newest_counts=True)
    each.message(FRAME, 3, 5, only_newest_counts=True)
    each.message(FRAME, 3, 6, only_newest_counts=True)
    each.published(PLANS, 0)
    assert each.listed() == (Consumed(FRAME, 3, 6),)


def test_where_an_output_holds_the_whole_state_it_is_named_before_what_was_fed_since():
    each = fed(only_newest_counts=True, goes_on_from=PLAN)
    each.message(STATE, 1, 1, only_newest_counts=True)
    each.message(FRAME, 3, 5, only_newest_counts=True)
    each.published(PLANS, 0)
    each.message(FRAME, 3, 6, only_newest_counts=True)
    first = each.listed()
    assert first == (Consumed(STATE, 1, 1), Consumed(PLANS, EPOCH, 0), Consumed(FRAME, 3, 6))
    each.published(PLANS, 1)
    each.message(FRAME, 3, 9, only_newest_counts=True)
    # the state before the last one is in that
    assert each.listed() == (Consumed(STATE, 1, 1), Consumed(PLANS, EPOCH, 1), Consumed(FRAME, 3, 9))


def test_idle_ticks_that_change_nothing_are_left_out():
    each = fed(tick_hz=10.0, only_newest_tick_counts=True)
    for at_ns in range(MOST_LISTED + 9):
        each.tick(at_ns)
    assert each.listed() == (Consumed(OWN_TICK, EPOCH, MOST_LISTED + 8),)


def test_a_list_does_not_grow_without_bound_and_says_how_much_it_leaves_out():
    each = fed(tick_hz=10.0)
    each.message(STATE, 1, 1, only_newest_counts=True)
    for at_ns in range(MOST_LISTED + 9):
        each.tick(at_ns)
    omitted, state, *ticks = each.listed()
    assert (omitted, state) == (Consumed(OWN_OMITTED, EPOCH, 10), Consumed(STATE, 1, 1))
    assert [c.sequence for c in ticks] == list(range(10, MOST_LISTED + 9))
    each.published(PLANS, 0)
    assert each.listed() == (Consumed(STATE, 1, 1), Consumed(PLANS, EPOCH, 0))


def test_ticks_and_inputs_of_which_every_one_counts_add_up():
    assert adds_up(Some())
    assert adds_up(Some(tick_hz=1.0))
    assert not adds_up(Some(only_newest_counts=True))
    assert not adds_up(Some(goes_on_from=PLAN))


def test_nothing_is_published_where_ticks_are_listed():
    assert {TICK, OMITTED}.isdisjoint(topic.name for topic in TOPICS)
    assert is_tick(OWN_TICK)
    assert not any(is_tick(key("lab", topic)) for topic in TOPICS)
