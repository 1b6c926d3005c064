"""Who controls and what a press leads to, whatever pages say and however late; all of it in virtual time.

How it goes with queues between page, desk and bridge: tests/agents/robot_bridge/dvrk/test_chain.py.
"""

import pytest
from hypothesis import given
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
    return now_s + CHALLENGE_EVERY_S


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


def test_each_answer_in_time_of_the_page_that_presses_makes_one_heartbeat_that_echoes_what_the_bridge_asked():
    control = controlled("a", "b")
    now_s = armed(control)
    challenge = asked(control, now_s)
    assert control.beat("b", challenge.text, now_s) == []
    beat = BeatNow("psm1", "plan-1", "id-1", ns(now_s), GUARD)
    assert control.beat("a", challenge.text, now_s + 0.01) == [beat]
    assert control.beat("a", challenge.text, now_s + 0.02) == []
    assert control.beat("a", f"{ns(now_s) + 1}.{GUARD}", now_s + 0.02) == [], "it was never sent"
    now_s += CHALLENGE_EVERY_S
    withdrawn = asked(control, now_s)
    control.withdraw(withdrawn.text)
    assert control.beat("a", withdrawn.text, now_s) == []
    now_s += CHALLENGE_EVERY_S
    assert control.beat("a", asked(control, now_s).text, now_s + BEAT_S + 0.01) == [], "too late"


def test_challenges_go_out_every_40_ms_at_most_and_each_is_the_newest():
    control = controlled("a")
    began_s = armed(control)
    sent = list[float]()
    for tick in range(40):
        now_s = began_s + 0.005 * tick
        control.challenged("psm1", ns(now_s), GUARD)
        control.challenged("psm2", ns(NEVER_S), GUARD)  # another arm's
        if (due := control.challenge(now_s)) is not None:
            sent.append(now_s)
            assert due.challenge_ns == ns(now_s)
            control.beat("a", due.text, now_s)
    assert len(sent) == 5, "in 200 ms"
    # a state that is heard again is no new challenge
    assert asked(control, began_s + 1.0)
    control.challenged("psm1", ns(began_s + 1.0), GUARD)
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


@pytest.mark.parametrize(("asks", "why"), [(True, "a did not answer for"), (False, "the bridge of psm1 told no new")])
def test_silence_ends_a_press_and_holds_and_says_whether_the_page_or_the_bridge_was_silent(asks, why):
    control = controlled("a")
    now_s, effects = armed(control) - CHALLENGE_EVERY_S, []
    for turn in range(30):
        effects += control.turn(now_s + TURN_S * turn)
        if asks:
            control.challenged("psm1", ns(now_s + TURN_S * turn), GUARD)
            control.challenge(now_s + TURN_S * turn)
    (hold,) = of_kind(effects, HoldNow)
    assert hold.why.startswith(why)
    assert (hold.arm, control.press) == ("psm1", None)
    assert control.challenge(now_s + 1) is None


@pytest.mark.parametrize("stage", [pressed, armed])
def test_however_a_press_ends_once_it_arms_the_arm_holds(stage):
    for end in (
        lambda c: c.release("a", "the button was released"),
        lambda c: c.leave("a"),
        lambda c: c.turn(NEVER_S),
    ):
        control = controlled("a", "b")
        stage(control)
        assert there(control.press).stage is not Stage.PRESSING
        assert len(of_kind(end(control), HoldNow)) == 1
        assert control.press is None


STAGES = {
    "pressing": lambda control: pressed(control, until_s=PRESS_S / 2),
    "arming": lambda control: [pressed(control), control.arming("plan-1", "id-1")],
    "armed": armed,
}


@pytest.mark.parametrize(
    ("stage", "ends", "holds"), [("pressing", True, False), ("arming", True, True), ("armed", False, False)]
)
def test_a_press_for_a_plan_that_is_no_longer_the_newest_arms_nothing(stage, ends, holds):
    control = controlled("a")
    STAGES[stage](control)
    assert control.planned("psm1", "plan-1") == control.planned("psm2", "plan-2") == []
    effects = control.planned("psm1", "plan-2")
    assert (control.press is None) == ends
    assert any(isinstance(effect, HoldNow) for effect in effects) == holds
    assert [effect.what for effect in effects if isinstance(effect, Noted)] == (["released", "refused"] if ends else [])
    # what was on its way is not wanted any more
    assert not control.arming("plan-1", "id-2")


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("of", ["", "an arming of before"])
def test_a_hold_that_somebody_says_elsewhere_ends_a_press(stage, of):
    control = controlled("a")
    STAGES[stage](control)
    assert control.held("psm2", of, "operator said hold") == []
    effects = control.held("psm1", of, "operator said hold")
    assert control.press is None
    assert any(isinstance(effect, HoldNow) for effect in effects) == (stage != "pressing")
    assert effects[-1] == Noted("a", "refused", "psm1 holds (operator said hold): look, then press again")


def test_what_was_armed_here_and_is_held_is_no_hold_from_elsewhere():
    control = controlled("a")
    armed(control)
    assert control.held("psm1", "id-1", "the thread was lost") == []


def test_an_arming_that_is_accepted_after_the_button_is_up_is_held():
    control = controlled("a")
    pressed(control)
    assert control.arming("plan-1", "id-1")
    control.release("a", "released")
    assert not control.arming("plan-1", "id-2")
    (hold,) = control.armed("a", "psm1", "id-1", True)
    assert isinstance(hold, HoldNow)


def test_control_is_handed_over_or_passes_on_without_an_answer_and_never_while_the_button_is_pressed():
    control = controlled("a", "b", "c")
    assert of_kind(control.begin("b", "psm1", "plan-1", 0.0), Noted)[0].what == "refused"
    control.take("b", 0.0)
    assert of_kind(control.take("c", 0.0), Noted)[0].what == "refused"
    pressed(control)
    assert control.release("b", "not mine") == []
    assert of_kind(control.give("a", True), Noted)[0].what == "refused"
    control.release("a", "released")
    control.give("a", True)
    assert (control.controller, control.asking) == ("b", "")
    control.take("a", 1.0)
    control.give("b", False)
    assert (control.controller, control.asking) == ("b", "")
    control.take("a", 20.0)
    control.turn(20.0 + ASKED_S + 0.1)
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
            case "answer" | "stale" if challenges:
                effects += control.beat(screen, challenges[-1 if what == "answer" else 0].text, now_s)
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
