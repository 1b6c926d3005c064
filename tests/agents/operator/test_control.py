"""Who controls and what a press leads to, whatever pages say and however late."""

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
            effects += control.beat(*due, now_s)
        now_s += 0.01
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


def of_kind(effects, kind):
    return [effect for effect in effects if isinstance(effect, kind)]


def test_a_press_arms_once_and_only_after_a_while():
    control = controlled("a")
    effects, _ = pressed(control, until_s=PRESS_S - 0.1)
    assert not of_kind(effects, ArmNow)
    control = controlled("a")
    effects, _ = pressed(control, until_s=2 * PRESS_S)
    assert of_kind(effects, ArmNow) == [ArmNow("a", "psm1", "plan-1")]


def test_each_answer_makes_one_heartbeat_and_an_answer_that_was_used_makes_none():
    control = controlled("a")
    now_s = armed(control) + CHALLENGE_EVERY_S
    screen, challenge = there(control.challenge(now_s))
    assert control.beat(screen, challenge, now_s + 0.01) == [BeatNow("psm1", "plan-1", "id-1")]
    assert control.beat(screen, challenge, now_s + 0.02) == []
    assert control.beat(screen, "made up", now_s + 0.02) == []


def test_an_answer_that_was_long_on_its_way_counts_for_nothing():
    control = controlled("a")
    now_s = armed(control) + CHALLENGE_EVERY_S
    screen, challenge = there(control.challenge(now_s))
    assert control.beat(screen, challenge, now_s + BEAT_S + 0.01) == []


def test_a_page_that_falls_silent_is_held_and_the_press_is_over():
    control = controlled("a")
    now_s = armed(control)
    effects = [effect for i in range(30) for effect in control.turn(now_s + 0.01 * i)]
    (hold,) = of_kind(effects, HoldNow)
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


def test_releasing_before_anything_is_armed_holds_nothing():
    control = controlled("a")
    pressed(control, until_s=PRESS_S / 2)
    assert not of_kind(control.release("a", "a slip"), HoldNow)


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
    _, challenge = there(control.challenge(now_s))
    assert control.beat("b", challenge, now_s) == []
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
    control, now_s, last_answer_s, challenges, armings = Control(), 0.0, -NEVER_S, [], 0
    for what, screen, wait_s in sayings:
        now_s += wait_s
        effects = control.turn(now_s)
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
                effects += control.beat(screen, challenges[-1][1], now_s)
            case "stale" if challenges:
                effects += control.beat(screen, challenges[0][1], now_s)
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
        assert control.press is None or now_s - control.press.alive_s <= BEAT_S or last_answer_s == now_s
