"""Who controls and what a press leads to, whatever pages say and however late; all of it in virtual time."""

import heapq
import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agents.operator.control import (
    ASKED_S,
    BEAT_S,
    CHALLENGE_EVERY_S,
    PRESS_S,
    ArmNow,
    BeatNow,
    Control,
    HoldNow,
    Noted,
    Stage,
)

NEVER_S = 1e3
TURN_S = 0.01
GUARD = 1 << 60


def controlled(*screens):
    control = Control()
    for screen in screens:
        control.join(screen)
    return control


def pressed(control, from_s=0.0, until_s=PRESS_S + 0.1):
    """Press on the first page and answer every challenge at once until then; what followed, and the time."""
    effects, now_s = control.begin(control.controller, "psm1", "plan-1", from_s), from_s
    while now_s < until_s:
        effects += control.turn(now_s)
        if (due := control.challenge(now_s)) is not None:
            effects += control.beat(due.screen, due.text, now_s)
        now_s += TURN_S
    return effects, now_s


def there(value):
    """What must not be None."""
    assert value is not None
    return value


def armed(control):
    _, now_s = pressed(control)
    assert control.arming("plan-1", "id-1")
    assert control.armed(control.controller, "psm1", "id-1", True) == []
    return now_s


def ns(seconds):
    """The time by a bridge's clock, of which a float has no nanoseconds."""
    return 1_700_000_000_000_000_000 + round(seconds * 1e9)


def asked(control, now_s):
    """What is sent when a challenge of the arm's bridge has just come."""
    control.challenged("psm1", ns(now_s), GUARD)
    return there(control.challenge(now_s))


def of_kind(effects, kind):
    return [effect for effect in effects if isinstance(effect, kind)]


def test_a_press_arms_once_and_only_after_a_while_before_which_its_release_holds_nothing():
    control = controlled("a")
    effects, _ = pressed(control, until_s=PRESS_S - 0.1)
    effects += control.release("a", "a slip")
    assert not of_kind(effects, ArmNow | HoldNow)
    effects, _ = pressed(control, from_s=1.0, until_s=1.0 + 2 * PRESS_S)
    assert of_kind(effects, ArmNow) == [ArmNow("a", "psm1", "plan-1")]


def test_each_answer_makes_one_heartbeat_that_echoes_what_the_bridge_asked_to_the_last_digit():
    control = controlled("a")
    now_s = armed(control) + CHALLENGE_EVERY_S
    challenge = asked(control, now_s)
    beat = BeatNow("psm1", "plan-1", "id-1", ns(now_s), GUARD)
    assert control.beat("a", challenge.text, now_s + 0.01) == [beat]
    assert control.beat("a", challenge.text, now_s + 0.02) == []
    assert control.beat("a", f"{ns(now_s) + 1}.{GUARD}", now_s + 0.02) == [], "it was never sent"


def test_challenges_go_out_every_40_ms_at_most_and_each_is_the_newest():
    control = controlled("a")
    began_s = armed(control) + CHALLENGE_EVERY_S
    sent, now_s = list[float](), began_s
    for tick in range(40):
        now_s = began_s + 0.005 * tick
        control.challenged("psm1", ns(now_s), GUARD)
        control.challenged("psm2", ns(NEVER_S), GUARD)  # another arm's
        if (due := control.challenge(now_s)) is not None:
            sent.append(now_s)
            assert due.challenge_ns == ns(now_s)
            control.beat("a", due.text, now_s)
    assert len(sent) == 5
    assert min(b - a for a, b in itertools.pairwise(sent)) >= CHALLENGE_EVERY_S - 1e-9
    # a state that is heard again is no new challenge
    now_s += CHALLENGE_EVERY_S
    assert asked(control, now_s)
    control.challenged("psm1", ns(now_s), GUARD)
    assert control.challenge(NEVER_S) is None


def test_a_challenge_of_before_the_arm_was_armed_makes_no_heartbeat():
    control = controlled("a")
    _, now_s = pressed(control)
    assert control.arming("plan-1", "id-1")
    control.challenged("psm1", ns(now_s - 0.2), GUARD)  # from an arm at rest
    now_s += CHALLENGE_EVERY_S
    own = there(control.challenge(now_s))
    assert own.challenge_ns == 0
    assert control.beat("a", own.text, now_s) == []
    control.armed("a", "psm1", "id-1", True)
    assert control.challenge(now_s + CHALLENGE_EVERY_S) is None
    assert asked(control, now_s + 0.01 + CHALLENGE_EVERY_S).challenge_ns


def test_an_answer_that_was_long_on_its_way_or_to_a_challenge_that_did_not_go_out_counts_for_nothing():
    control = controlled("a")
    now_s = armed(control) + CHALLENGE_EVERY_S
    late = asked(control, now_s)
    assert control.beat("a", late.text, now_s + BEAT_S + 0.01) == []
    withdrawn = asked(control, now_s + CHALLENGE_EVERY_S)
    control.withdraw(withdrawn.text)
    assert control.beat("a", withdrawn.text, now_s + CHALLENGE_EVERY_S) == []


@pytest.mark.parametrize(("asks", "why"), [(True, "a did not answer for"), (False, "the bridge of psm1 told no new")])
def test_silence_ends_a_press_and_holds_and_says_whether_the_page_or_the_bridge_was_silent(asks, why):
    control = controlled("a")
    now_s, effects = armed(control), []
    for turn in range(30):
        effects += control.turn(now_s + TURN_S * turn)
        if asks:
            control.challenged("psm1", ns(now_s + TURN_S * turn), GUARD)
            control.challenge(now_s + TURN_S * turn)
    (hold,) = of_kind(effects, HoldNow)
    assert hold.why.startswith(why)
    assert (hold.arm, control.press) == ("psm1", None)
    assert control.challenge(now_s + 1) is None


def test_however_a_press_ends_once_it_arms_the_arm_holds():
    for end in (
        lambda c: c.release("a", "the button was released"),
        lambda c: c.leave("a"),
        lambda c: c.turn(NEVER_S),
    ):
        for stage in (pressed, armed):
            control = controlled("a", "b")
            stage(control)
            assert there(control.press).stage is not Stage.PRESSING
            assert len(of_kind(end(control), HoldNow)) == 1
            assert control.press is None


def test_an_arming_that_is_accepted_after_the_button_is_up_is_held():
    control = controlled("a")
    pressed(control)
    assert control.arming("plan-1", "id-1")
    control.release("a", "released")
    assert not control.arming("plan-1", "id-2")
    (hold,) = control.armed("a", "psm1", "id-1", True)
    assert isinstance(hold, HoldNow)


def test_only_the_controlling_page_presses_and_only_its_answers_count():
    control = controlled("a", "b")
    assert of_kind(control.begin("b", "psm1", "plan-1", 0.0), Noted)[0].what == "refused"
    now_s = armed(control) + CHALLENGE_EVERY_S
    assert control.beat("b", asked(control, now_s).text, now_s) == []
    assert control.release("b", "not mine") == []


def test_control_is_handed_over_seen_by_all_and_never_while_the_button_is_pressed():
    control = controlled("a", "b", "c")
    control.take("b", 0.0)
    assert (control.controller, control.asking) == ("a", "b")
    assert of_kind(control.take("c", 0.0), Noted)[0].what == "refused"
    pressed(control)
    assert of_kind(control.give("a", True), Noted)[0].what == "refused"
    control.turn(NEVER_S)  # ends the press
    control.give("a", True)
    assert (control.controller, control.asking) == ("b", "")
    control.take("a", 1.0)
    control.give("b", False)
    assert (control.controller, control.asking) == ("b", "")


def test_whoever_does_not_answer_loses_control_and_whoever_leaves_too():
    control = controlled("a", "b")
    control.take("b", 0.0)
    control.turn(ASKED_S + 0.1)
    assert control.controller == "b"
    control.take("a", 20.0)
    control.leave("b")
    assert control.controller == "a"
    control.leave("a")
    assert control.controller == ""


SAYINGS = st.lists(
    st.tuples(
        st.sampled_from(["join", "leave", "take", "give", "keep", "begin", "answer", "stale", "release", "arming"]),
        st.sampled_from("abc"),
        st.floats(0.0, 0.3),
    ),
    max_size=60,
)


@given(SAYINGS)
def test_nothing_beats_or_arms_but_what_the_controlling_page_answers_now(sayings):
    control, now_s, challenges, armings = Control(), 0.0, [], 0
    for what, screen, wait_s in sayings:
        now_s += wait_s
        effects = control.turn(now_s)
        control.challenged("psm1", ns(now_s), GUARD)
        due = control.challenge(now_s)
        challenges += [due] if due else []
        before = control.press
        match what:
            case "join" if screen not in control.screens:
                effects += control.join(screen)
            case "leave":
                effects += control.leave(screen)
            case "take" if screen in control.screens:
                effects += control.take(screen, now_s)
            case "give" | "keep":
                effects += control.give(screen, what == "give")
            case "begin":
                effects += control.begin(screen, "psm1", "plan-1", now_s)
            case "answer" if challenges:
                effects += control.beat(screen, challenges[-1].text, now_s)
            case "stale" if challenges:
                effects += control.beat(screen, challenges[0].text, now_s)
            case "release":
                effects += control.release(screen, "released")
            case "arming":
                armings += 1
                if control.arming("plan-1", f"id-{armings}"):
                    effects += control.armed(screen, "psm1", f"id-{armings}", True)
            case _:
                pass
        for effect in effects:
            if isinstance(effect, BeatNow | ArmNow):
                assert what in ("answer", "stale")
                assert screen == there(before).screen == control.controller
        assert control.press is None or control.press.screen == control.controller
        assert control.controller in ("", *control.screens)
        ended = before is not None and before.stage is not Stage.PRESSING and control.press is not before
        assert not ended or of_kind(effects, HoldNow)
        assert control.press is None or now_s - control.press.alive_s <= BEAT_S


class Pressing:
    """A page and its arm's bridge before a desk, with queues between them, in virtual time."""

    def __init__(self, there_s, back_s, told_s):
        self.control, self.now_s = controlled("a"), 0.0
        self._ways = {
            "there": itertools.cycle(there_s),
            "back": itertools.cycle(back_s),
            "told": itertools.cycle(told_s),
        }
        self._due, self._number, self._last_s = [], itertools.count(), {}
        self.beats, self.answered_s = [], {}

    def _later(self, way, what, *rest):
        # a queue keeps its order
        at_s = max(self.now_s + next(self._ways[way]), self._last_s.get(way, 0.0))
        self._last_s[way] = at_s
        heapq.heappush(self._due, (at_s, next(self._number), what, *rest))

    def _follow(self, effects):
        for effect in effects:
            if isinstance(effect, ArmNow):
                self.control.arming("plan-1", "id-1")
                self.control.armed("a", "psm1", "id-1", True)
            elif isinstance(effect, BeatNow):
                self.beats.append((self.now_s, effect.challenge_ns))

    def run(self, until_s, released_s):
        self._follow(self.control.begin("a", "psm1", "plan-1", 0.0))
        while self.now_s < until_s:
            self._follow(self.control.turn(self.now_s))
            self._later("told", "state", ns(self.now_s))
            while self._due and self._due[0][0] <= self.now_s:
                _, _, what, *rest = heapq.heappop(self._due)
                self._arrived(what, rest, released_s)
            if (due := self.control.challenge(self.now_s)) is not None:
                self._later("there", "challenge", due.text, due.challenge_ns)
            self.now_s += TURN_S

    def _arrived(self, what, rest, released_s):
        if what == "state":
            self.control.challenged("psm1", rest[0], GUARD)
        elif what == "challenge" and self.now_s < released_s:
            self.answered_s[rest[1]] = self.now_s
            self._later("back", "answer", rest[0])
        elif what == "answer":
            self._follow(self.control.beat("a", rest[0], self.now_s))


DELAYS = st.lists(st.floats(0.0, 0.6), min_size=1, max_size=12)
SHORT = st.lists(st.floats(0.0, 0.05), min_size=1, max_size=12)


@settings(max_examples=20)
@given(SHORT | DELAYS, SHORT | DELAYS, SHORT | DELAYS, st.floats(0.7, 1.6))
def test_whatever_the_queues_a_heartbeat_echoes_what_the_bridge_asked_before_the_button_was_released(
    there_s, back_s, told_s, released_s
):
    press = Pressing(there_s, back_s, told_s)
    press.run(2.5, released_s)
    echoed = [challenge_ns for _, challenge_ns in press.beats]
    assert len(set(echoed)) == len(echoed), "each is answered once"
    for at_s, challenge_ns in press.beats:
        # issued before it was answered, which was before the button was released; nothing makes it younger
        assert challenge_ns <= ns(press.answered_s[challenge_ns]) <= ns(min(at_s, released_s))
    assert press.control.press is None, "without answers the press has ended"


def test_through_short_queues_a_press_lasts_until_it_is_released():
    press = Pressing([0.02], [0.03], [0.01])
    press.run(1.5, released_s=NEVER_S)
    assert there(press.control.press).stage is Stage.ARMED
    at_s, challenge_ns = press.beats[-1]
    assert ns(at_s) - challenge_ns < 0.2e9
