"""What the page draws, where a click lands on the thread, and at what level pictures go."""

import base64
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.operator.drawn import MOST_STEPS, draw_surface, way_of
from agents.operator.drawn_thread import PLACES, draw_thread, evenly
from agents.operator.pictures import FAST_MS, JUDGED_AFTER, LEVELS, SLOW_MS, Pace, due, encoded
from agents.operator.snapping import WITHIN_PX, at_place, snapped
from schemas.messages import (
    FrameStamp,
    ImageEncoding,
    Phase,
    RectifiedStereo,
    TissueSurface,
    Waypoint,
)
from shared import arc_length, splines
from shared.images import decode_image, encode_image
from shared.runtime.agent import Tick

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 0.0055, 1.0)


@pytest.fixture(scope="module")
def thread(hand_made_thread):
    """A straight one of 40 mm, 80 mm away, whose second half is known less well and whose middle is not seen."""
    (output,) = hand_made_thread().step(Tick(1))
    confidence = np.where(output.message.confidence_s < 0.5, 0.9, 0.4)
    return replace(output.message, confidence=confidence, unseen=np.array([[0.4, 0.6]]))


def drawn_of(thread):
    drawn = draw_thread(thread)
    assert drawn is not None
    return drawn


def test_the_thread_is_drawn_evenly_with_its_confidence_and_what_is_unseen(thread):
    drawn = drawn_of(thread)
    assert drawn.px.shape == (PLACES, 2)
    assert drawn.length_mm == pytest.approx(40)
    assert drawn.px[0] == pytest.approx([479.5 - 250, 269.5])
    assert np.diff(drawn.px[:, 0]) == pytest.approx(500 / (PLACES - 1))
    assert drawn.confidence[10] == pytest.approx(0.9)
    assert drawn.unseen[PLACES // 2]
    assert not drawn.unseen[0]
    document = drawn.document()
    assert unpacked(document["px"]).reshape(-1, 2) == pytest.approx(drawn.px, abs=1e-3)
    assert unpacked(document["mm"]).reshape(-1, 3) == pytest.approx(drawn.points_mm, abs=1e-3)
    assert unpacked(document["confidence"]) == pytest.approx(drawn.confidence)
    assert unpacked(document["unseen"]).tolist() == drawn.unseen.tolist()


def unpacked(text):
    return np.frombuffer(base64.b64decode(text), "<f4")


def test_places_are_as_even_as_arc_length_has_them():
    control = np.array(
        [[-20.0, 0, 80], [-15, 9, 78], [-1, -12, 84], [3, 11, 90], [11, -3, 80], [12, 4, 70], [25, 0, 80]]
    )
    knots = splines.clamped_uniform_knots(len(control))
    points, length = evenly(knots, control, 3, PLACES)
    assert length == pytest.approx(arc_length.length(knots, control, 3), rel=1e-4)
    exact = splines.evaluate(knots, control, 3, arc_length.even_parameters(knots, control, 3, PLACES))
    assert np.abs(points - exact).max() < 2e-3, "mm, of 90"


def test_a_thread_of_unknown_unit_is_drawn_and_says_so(thread):
    unknown = replace(CAMERA, metres_per_unit=None)
    drawn = drawn_of(replace(thread, camera=unknown))
    assert drawn.document()["unit_known"] is False
    assert snapped(drawn, (480.0, 280.0))[0].off_mm is None


def test_a_click_lands_on_the_nearest_place_and_tells_how_far_that_is(thread):
    (place,) = snapped(drawn_of(thread), (479.5 + 125, 269.5 + 20))
    assert place.s == pytest.approx(0.75)
    assert place.along_mm == pytest.approx(30)
    assert (place.off_px, place.off_mm) == (pytest.approx(20), pytest.approx(1.6))
    assert place.confidence == pytest.approx(0.4)
    assert snapped(drawn_of(thread), (479.5, 269.5 + WITHIN_PX + 1)) == []


def test_where_two_strands_are_near_both_are_told(thread):
    control = np.array([[-0.02, -0.0003, 0.08], [0.02, 0, 0.08], [-0.02, 0.0003, 0.08]])
    hairpin = replace(thread, knots=np.array([0, 0, 0.5, 1, 1]), control_points_camera=control)
    nearest, other = snapped(drawn_of(hairpin), (479.5, 267.0))
    assert [nearest.s, other.s] == pytest.approx([0.25, 0.75], abs=0.01)


@given(s=st.floats(0, 1))
def test_a_place_that_is_clicked_is_the_place_that_was_meant(thread, s):
    drawn = drawn_of(thread)
    meant = at_place(drawn, s)
    assert snapped(drawn, meant.px)[0].s == pytest.approx(s, abs=1e-6)
    assert meant.along_mm == pytest.approx(40 * s)


def test_the_way_of_a_plan_begins_and_ends_at_its_poses_in_small_steps():
    def waypoint(z, jaw, phase):
        pose = np.eye(4)
        pose[:3, 3] = 0, 0, z
        return Waypoint(pose, jaw, phase, None)

    way = way_of(
        [waypoint(0.05, 1.0, Phase.APPROACH), waypoint(0.06, 1.0, Phase.CAPTURE), waypoint(0.06, 0.0, Phase.GRASP)],
        CAMERA,
    )
    assert 30 < len(way) <= MOST_STEPS
    assert way[0]["mm"][1] == [0, 0, 50]
    assert way[-1]["mm"][1] == [0, 0, 60]
    assert way[-1]["mm"][0] == way[-1]["mm"][2] == [0, 0, pytest.approx(70.2)]
    depths = [pose["mm"][1][2] for pose in way]
    assert max(np.diff(depths)) < 0.7


def test_tissue_is_thinned_to_what_a_page_can_turn():
    u, v = np.arange(0.0, 960, 8), np.arange(0.0, 540, 8)
    valid = np.ones((len(v), len(u)), bool)
    valid[0] = False
    surface = TissueSurface(FrameStamp(1, 1, 1, "x"), CAMERA, u, v, np.where(valid, 0.09, 0.0), valid)
    places = np.array(draw_surface(surface))
    assert 500 < len(places) <= 1200
    assert places[:, 2] == pytest.approx(90)


def test_pictures_that_a_browser_can_show_go_as_they_came_and_others_are_made_so():
    pixels = np.random.default_rng(1).integers(0, 255, (540, 960, 3), np.uint8)
    jpeg, raw = (encode_image(pixels, encoding) for encoding in (ImageEncoding.JPEG, ImageEncoding.RAW))
    assert encoded(jpeg, LEVELS[0], None) == jpeg.data
    assert shown(encoded(raw, LEVELS[0], None)).shape == (540, 960, 3)
    assert shown(encoded(jpeg, LEVELS[3], None)).shape == (270, 480, 3)
    turned = shown(encoded(jpeg, LEVELS[0], lambda image: image[::-1]))
    assert abs(turned[::-1].astype(int) - decode_image(jpeg)).mean() < 20


def shown(data):
    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))


def paced(pace, ms_of_level, pictures):
    for _ in range(pictures):
        pace.took(ms_of_level(pace.level))
    return pace.level


def test_a_slow_link_gets_coarser_pictures_until_they_are_fast_enough_and_the_finest_once_it_is_fast():
    pace = Pace()
    assert paced(pace, lambda _: 10 * SLOW_MS, JUDGED_AFTER - 1) == 0, "too few to judge by"
    assert paced(pace, lambda level: SLOW_MS * 4 * 0.4**level, 400) in (1, 2)
    assert paced(pace, lambda _: FAST_MS / 2, 400) == 0


def test_pictures_stay_fine_where_their_size_is_not_what_costs():
    pace = Pace()
    levels = [paced(pace, lambda _: 2 * SLOW_MS, 10) for _ in range(40)]
    assert sum(level == 0 for level in levels) > 25


@pytest.mark.parametrize(
    ("controls", "full", "rate_hz", "shown"),
    [
        (True, False, 30, 60),
        (False, False, 30, 30),
        (False, False, 15, 30),
        (True, True, 30, 60),
        (False, True, 30, 10),
    ],
)
def test_who_only_watches_gets_fewer_pictures_of_a_fast_camera_and_least_from_a_busy_host(
    controls, full, rate_hz, shown
):
    sent_s, sent = -1.0, 0
    for at_s in np.arange(2 * rate_hz) / rate_hz:
        if due(controls, at_s - sent_s, full):
            sent_s, sent = at_s, sent + 1
    assert sent == shown
