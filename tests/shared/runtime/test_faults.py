"""Which failure of an agent's steps holds, and for how long."""

from shared.runtime.accounts import LIKE_PER_LINE, SHOWN_S, Faults


def test_a_failure_holds_until_a_step_of_its_kind_goes_well_and_is_shown_for_a_while():
    faults = Faults()
    assert faults.failed("camera/frames", "no left image", 0.0)
    faults.went_well("tick")
    assert not faults.ended(2 * SHOWN_S)
    faults.went_well("camera/frames")
    assert faults.text == "no left image"
    assert faults.ended(2 * SHOWN_S)
    assert not faults.ended(3 * SHOWN_S)
    assert (faults.text, faults.count) == ("", 1)


def test_a_failure_that_comes_and_goes_holds_all_along():
    faults = Faults()
    for second in range(20):
        faults.failed("tick", "late", float(second))
        faults.went_well("tick")
        assert not faults.ended(second + 0.5)
    assert faults.count == 20
    assert faults.ended(19.0 + 2 * SHOWN_S)


def test_what_nothing_like_it_follows_holds_for_no_longer_than_it_is_shown():
    faults = Faults()
    faults.failed("operator/goal", "no such place", 0.0, alone=True)
    assert not faults.ended(0.5 * SHOWN_S)
    assert faults.ended(2 * SHOWN_S)


def test_like_failures_get_a_line_in_the_log_now_and_then_and_another_one_at_once():
    faults = Faults()
    logged = [faults.failed("tick", "late", 0.0) for _ in range(2 * LIKE_PER_LINE)]
    assert [number for number, line in enumerate(logged) if line] == [0, LIKE_PER_LINE]
    assert faults.failed("tick", "blind", 0.0)
