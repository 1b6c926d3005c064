"""What counts as a difference, and how large it is."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.replay import measures
from agents.replay.compare import OTHER, apart, differences
from agents.replay.tolerances import TOLERANCES, exact, tolerant
from schemas import messages
from schemas.checks import fields_of, without_none
from shared.images import encode_image
from shared.splines import clamped_uniform_knots
from tests.agents.session_report.conftest import thread as example

LINE = np.linspace((0.0, 0.0, 0.1), (0.03, 0.0, 0.1), 5)
RULES = tolerant(messages.ThreadReconstruction)


def thread(points=LINE, metres_per_unit: float | None = 1.0, **other):
    made = {"knots": clamped_uniform_knots(len(points)), "control_points_camera": points}
    return dataclasses.replace(example(0, 0.0, unit=metres_per_unit), **(made | other))


def failed(reason):
    return example(0, 0.0, unit=1.0, reason=reason)


def differing(then, now, rules=RULES):
    return {d.field: d.amount for d in differences(then, now, rules) if d.amount}


def test_equal_messages_do_not_differ_nor_does_what_an_output_was_made_from_and_all_without_a_rule_must_be_the_same():
    for rules in (exact(messages.ThreadReconstruction), RULES, {}):
        assert differing(thread(), thread(), rules) == {}
    assert (
        differing(thread(), thread(consumed=(messages.Consumed("a", 1, 2),)), exact(messages.ThreadReconstruction))
        == {}
    )
    then, now = (messages.Arm(messages.CommandHeader(name, 0, "a test"), "psm1", "p") for name in "ab")
    assert differing(then, now, tolerant(messages.Arm)) == {"header.id": OTHER}


@given(st.floats(-0.05, 0.05).filter(lambda d: abs(d) > 1e-9))
def test_a_curve_that_is_moved_differs_by_as_much(offset):
    found = differing(thread(), thread(LINE + np.array([0.0, 0.0, offset])))
    assert found["curve"] == pytest.approx(1000 * abs(offset), rel=1e-6)
    assert found["ends"] == pytest.approx(1000 * abs(offset), rel=1e-6)
    assert "control_points_camera" not in found


def test_curves_are_compared_by_their_points_and_ends_and_not_by_how_they_are_written():
    finer = thread(np.linspace(LINE[0], LINE[-1], 9))
    assert differing(thread(), finer).get("curve", 0.0) < 1e-9
    assert differing(thread(), finer, exact(messages.ThreadReconstruction))["knots"] == OTHER
    backwards = differing(thread(), thread(LINE[::-1]))
    assert backwards.get("curve", 0.0) < 1e-9
    assert backwards["ends"] == pytest.approx(30.0)
    beside_failure = differing(thread(), failed("nothing is seen"))
    assert beside_failure["status"] == beside_failure["curve"] == beside_failure["reason"] == OTHER
    # one of unknown unit is measured as if it were 100 mm away
    then, now = thread(7 * LINE, None), thread(7 * LINE + np.array([0.0, 0.0, 0.007]), None)
    assert differing(then, now)["curve"] == pytest.approx(1.0)


def test_reasons_differ_by_their_words_and_not_by_their_figures():
    assert differing(failed("only 3 of 40 px"), failed("only 4.5 of 41 px")) == {}
    assert differing(failed("only 3 of 40 px"), failed("no pixel at all")) == {"reason": OTHER}


def test_another_strand_above_is_a_difference_and_one_that_is_left_open_is_none():
    def crossing(over, s=0.2):
        return (messages.Crossing(s, 0.8, np.zeros(2), over, 0.0),)

    assert measures.crossings_apart(crossing(messages.Over.FIRST), crossing(messages.Over.SECOND)) == OTHER
    assert measures.crossings_apart(
        crossing(messages.Over.FIRST), crossing(messages.Over.UNDETERMINED, 0.25)
    ) == pytest.approx(0.05)
    assert measures.crossings_apart(crossing(messages.Over.FIRST), ()) == OTHER


@pytest.mark.parametrize("encoding", [messages.ImageEncoding.PNG, messages.ImageEncoding.RAW])
def test_images_differ_by_their_pixels_and_not_by_their_bytes(encoding):
    pixels = np.zeros((10, 10), np.uint8)
    changed = pixels.copy()
    changed[3, 4] = 255
    then, now = encode_image(pixels, messages.ImageEncoding.PNG), encode_image(changed, encoding)
    assert measures.images_apart(then, now) == pytest.approx(0.01)
    assert measures.images_apart(then, messages.Image(messages.ImageEncoding.PNG, 10, 10, 1, b"none")) == OTHER


numbers = st.one_of(st.integers(-(2**53), 2**53), st.floats(allow_infinity=False))
scalars = st.one_of(numbers, st.booleans(), st.text(), st.none(), st.sampled_from(messages.Policy))


@given(scalars, scalars)
def test_any_two_values_are_as_far_apart_either_way_and_none_from_itself(a, b):
    assert apart(a, a) == 0.0 or (isinstance(a, float) and math.isnan(a))
    assert apart(a, b) == apart(b, a) or math.isnan(apart(a, b))
    assert (apart(a, b) == 0.0) == (a == b) or isinstance(a, bool) != isinstance(b, bool) or math.isnan(apart(a, b))


def test_a_number_beside_none_and_another_shape_are_no_numbers():
    assert apart(0.0, None) == apart(None, np.zeros(2)) == apart(np.zeros(2), None) == OTHER
    assert apart(np.zeros(3), np.zeros(4)) == apart((1, 2), (1,)) == OTHER
    assert apart(np.array([np.nan, 1.0]), np.array([np.nan, 3.0])) == 2.0
    assert measures.images_apart(None, None) == measures.stretches_apart(None, None) == 0.0
    assert measures.stretches_apart(None, np.zeros((0, 2))) == OTHER
    assert measures.metres_in_mm(0.002, 0.0025) == pytest.approx(0.5)
    assert measures.metres_in_mm(None, None) == 0.0
    assert measures.metres_in_mm(0.0, None) == measures.metres_in_mm(None, 0.0) == OTHER


def fields_below(message, prefix=""):
    for name, annotation in fields_of(message).items():
        yield f"{prefix}{name}"
        declared = without_none(annotation)
        if dataclasses.is_dataclass(declared):
            yield from fields_below(declared, f"{prefix}{name}.")


def test_a_rule_names_a_field_or_measures_the_whole_message():
    """A rule for a field that was renamed would go unnoticed."""
    for message, rules in TOLERANCES.items():
        known = set(fields_below(message))
        for name, rule in rules.items():
            assert name in known or (rule.measure is not None and "." not in name), (message, name)
