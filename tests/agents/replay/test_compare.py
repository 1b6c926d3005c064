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
from schemas.checks import fields_of, without_none
from schemas.messages import (
    Arm,
    CommandHeader,
    Consumed,
    Crossing,
    FrameStamp,
    Image,
    ImageEncoding,
    Over,
    Policy,
    RectifiedStereo,
    ReliabilityRegions,
    Status,
    ThreadReconstruction,
)
from shared.images import encode_image
from shared.splines import clamped_uniform_knots

CAMERA = RectifiedStereo(480, 270, 500.0, 500.0, 239.5, 134.5, 5.5e-3, 1.0)
NONE = ReliabilityRegions(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
LINE = np.linspace((0.0, 0.0, 0.1), (0.03, 0.0, 0.1), 5)


def thread(points=LINE, camera=CAMERA, **other):
    made = ThreadReconstruction(
        stamp=FrameStamp(0, 0, 0, ""),
        camera=camera,
        status=Status.OK,
        reason="",
        method="refined",
        degree=3,
        knots=clamped_uniform_knots(len(points)),
        control_points_camera=points,
        regions=NONE,
        confidence_s=np.array([0.0, 1.0]),
        confidence=np.array([1.0, 1.0]),
    )
    return dataclasses.replace(made, **other)


def failed(reason):
    nothing = dict.fromkeys(("knots", "confidence_s", "confidence"), np.zeros(0))
    return thread(status=Status.FAILED, reason=reason, control_points_camera=np.zeros((0, 3)), **nothing)


def differing(then, now, rules):
    return {d.field: d.amount for d in differences(then, now, rules) if d.amount}


def test_equal_messages_do_not_differ_nor_does_what_an_output_was_made_from():
    for rules in (exact(ThreadReconstruction), tolerant(ThreadReconstruction), {}):
        assert differing(thread(), thread(), rules) == {}
    assert differing(thread(), thread(consumed=(Consumed("a", 1, 2),)), exact(ThreadReconstruction)) == {}


def test_fields_without_a_rule_must_be_the_same():
    then, now = (Arm(CommandHeader(name, 0, "a test"), "psm1", "p") for name in "ab")
    assert differing(then, now, tolerant(Arm)) == {"header.id": OTHER}


@given(st.floats(-0.05, 0.05).filter(lambda d: abs(d) > 1e-9))
def test_a_curve_that_is_moved_differs_by_as_much(offset):
    found = differing(thread(), thread(LINE + np.array([0.0, 0.0, offset])), tolerant(ThreadReconstruction))
    assert found["curve"] == pytest.approx(1000 * abs(offset), rel=1e-6)
    assert found["ends"] == pytest.approx(1000 * abs(offset), rel=1e-6)
    assert "control_points_camera" not in found


def test_curves_are_compared_by_their_points_and_ends_and_not_by_how_they_are_written():
    rules = tolerant(ThreadReconstruction)
    finer = thread(np.linspace(LINE[0], LINE[-1], 9))
    assert differing(thread(), finer, rules).get("curve", 0.0) < 1e-9
    assert differing(thread(), finer, exact(ThreadReconstruction))["knots"] == OTHER
    backwards = differing(thread(), thread(LINE[::-1]), rules)
    assert backwards.get("curve", 0.0) < 1e-9
    assert backwards["ends"] == pytest.approx(30.0)
    beside_failure = differing(thread(), failed("nothing is seen"), rules)
    assert beside_failure["status"] == beside_failure["curve"] == beside_failure["reason"] == OTHER


def test_a_thread_of_unknown_unit_is_measured_as_if_it_were_100_mm_away():
    unknown = dataclasses.replace(CAMERA, metres_per_unit=None)
    then, now = thread(7 * LINE, unknown), thread(7 * LINE + np.array([0.0, 0.0, 0.007]), unknown)
    assert differing(then, now, tolerant(ThreadReconstruction))["curve"] == pytest.approx(1.0)


def test_reasons_differ_by_their_words_and_not_by_their_figures():
    rules = tolerant(ThreadReconstruction)
    assert differing(failed("only 3 of 40 px"), failed("only 4.5 of 41 px"), rules) == {}
    assert differing(failed("only 3 of 40 px"), failed("no pixel at all"), rules) == {"reason": OTHER}


def test_another_strand_above_is_a_difference_and_one_that_is_left_open_is_none():
    def crossing(over, s=0.2):
        return (Crossing(s, 0.8, np.zeros(2), over, 0.0),)

    assert measures.crossings_apart(crossing(Over.FIRST), crossing(Over.SECOND)) == OTHER
    assert measures.crossings_apart(crossing(Over.FIRST), crossing(Over.UNDETERMINED, 0.25)) == pytest.approx(0.05)
    assert measures.crossings_apart(crossing(Over.FIRST), ()) == OTHER


@pytest.mark.parametrize("encoding", [ImageEncoding.PNG, ImageEncoding.RAW])
def test_images_differ_by_their_pixels_and_not_by_their_bytes(encoding):
    pixels = np.zeros((10, 10), np.uint8)
    changed = pixels.copy()
    changed[3, 4] = 255
    then, now = encode_image(pixels, ImageEncoding.PNG), encode_image(changed, encoding)
    assert measures.images_apart(then, now) == pytest.approx(0.01)
    assert measures.images_apart(then, Image(ImageEncoding.PNG, 10, 10, 1, b"none")) == OTHER


scalars = st.one_of(
    st.integers(-(2**53), 2**53),
    st.floats(allow_infinity=False),
    st.booleans(),
    st.text(),
    st.none(),
    st.sampled_from(Policy),
)


@given(scalars, scalars)
def test_any_two_values_are_as_far_apart_either_way_and_none_from_itself(a, b):
    assert apart(a, a) == 0.0 or (isinstance(a, float) and math.isnan(a))
    assert apart(a, b) == apart(b, a) or math.isnan(apart(a, b))
    assert (apart(a, b) == 0.0) == (a == b) or isinstance(a, bool) != isinstance(b, bool) or math.isnan(apart(a, b))


def test_a_number_beside_none_and_another_shape_are_no_numbers():
    assert apart(0.0, None) == OTHER
    assert apart(None, np.zeros(2)) == apart(np.zeros(2), None) == OTHER
    assert measures.images_apart(None, None) == measures.stretches_apart(None, None) == 0.0
    assert measures.stretches_apart(None, np.zeros((0, 2))) == OTHER
    assert apart(np.zeros(3), np.zeros(4)) == OTHER
    assert apart((1, 2), (1,)) == OTHER
    assert apart(np.array([np.nan, 1.0]), np.array([np.nan, 3.0])) == 2.0
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
            assert not (rule.ignored and (rule.tolerance or rule.measure)), (message, name)
