"""What the page draws, where a click lands on the thread, and at what level pictures go."""

import base64
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.operator.choosing import WITHIN_PX, at_place, snapped
from agents.operator.drawn import MOST_STEPS, PLACES, draw_surface, draw_thread, way_of
from agents.operator.pictures import FAST_MS, JUDGED_AFTER, LEVELS, SLOW_MS, Pace, due, encoded
from schemas.messages import FrameStamp, ImageEncoding, Phase, TissueSurface, Waypoint
from shared.images import decode_image, encode_image
from tests.agents.operator.by_hand import CAMERA, thread_at

STAMP = FrameStamp(1, 1, 1, "hand")


def drawn(**changed):
    """The thread by hand, whose second half is known less well and whose middle is not seen, as it is drawn."""
    known_to = {"confidence": np.where(np.linspace(0, 1, 11) < 0.5, 0.9, 0.4), "unseen": np.array([[0.4, 0.6]])}
    found = draw_thread(replace(thread_at(STAMP), **known_to | changed))
    assert found is not None
    return found


def unpacked(text):
    return np.frombuffer(base64.b64decode(text), "<f4")


def test_the_thread_is_drawn_evenly_with_its_confidence_and_what_is_unseen():
    thread = drawn()
    assert thread.px.shape == (PLACES, 2)
    assert thread.length_mm == pytest.approx(40)
    assert thread.px[0] == pytest.approx([479.5 - 250, 269.5])
    assert np.diff(thread.px[:, 0]) == pytest.approx(500 / (PLACES - 1))
    assert thread.confidence[10] == pytest.approx(0.9)
    assert thread.unseen[[0, PLACES // 2]].tolist() == [False, True]
    document = thread.document()
    for name, exact in (("px", thread.px), ("mm", thread.points_mm), ("confidence", thread.confidence)):
        assert unpacked(document[name]) == pytest.approx(exact.ravel(), abs=1e-3)
    assert unpacked(document["unseen"]).tolist() == thread.unseen.tolist()
    unknown = drawn(camera=replace(CAMERA, metres_per_unit=None))
    assert unknown.document()["unit_known"] is False
    assert snapped(unknown, (480.0, 280.0))[0].off_mm is None


def test_a_click_lands_on_the_nearest_place_and_tells_how_far_that_is_and_of_another_strand_that_is_as_near():
    (place,) = snapped(drawn(), (479.5 + 125, 269.5 + 20))
    assert place.s == pytest.approx(0.75)
    assert place.along_mm == pytest.approx(30)
    assert (place.off_px, place.off_mm) == (pytest.approx(20), pytest.approx(1.6))
    assert place.confidence == pytest.approx(0.4)
    assert snapped(drawn(), (479.5, 269.5 + WITHIN_PX + 1)) == []
    control = np.array([[-0.02, -0.0003, 0.08], [0.02, 0, 0.08], [-0.02, 0.0003, 0.08]])
    hairpin = drawn(knots=np.array([0, 0, 0.5, 1, 1]), control_points_camera=control)
    assert [place.s for place in snapped(hairpin, (479.5, 267.0))] == pytest.approx([0.25, 0.75], abs=0.01)


@given(s=st.floats(0, 1))
def test_a_place_that_is_clicked_is_the_place_that_was_meant(s):
    meant = at_place(drawn(), s)
    assert snapped(drawn(), meant.px)[0].s == pytest.approx(s, abs=1e-6)
    assert meant.along_mm == pytest.approx(40 * s)


def test_the_way_of_a_plan_begins_and_ends_at_its_poses_in_small_steps():
    def waypoint(z, jaw, phase):
        pose = np.eye(4)
        pose[2, 3] = z
        return Waypoint(pose, jaw, phase, None)

    way = way_of(
        [waypoint(0.05, 1.0, Phase.APPROACH), waypoint(0.06, 1.0, Phase.CAPTURE), waypoint(0.06, 0.0, Phase.GRASP)],
        CAMERA,
    )
    assert 30 < len(way) <= MOST_STEPS
    assert way[0]["mm"][1] == [0, 0, 50]
    assert way[-1]["mm"][1] == [0, 0, 60]
    assert way[-1]["mm"][0] == way[-1]["mm"][2] == [0, 0, pytest.approx(70.2)]
    assert max(np.diff([pose["mm"][1][2] for pose in way])) < 0.7


def test_tissue_is_thinned_to_what_a_page_can_turn():
    u, v = np.arange(0.0, 960, 8), np.arange(0.0, 540, 8)
    valid = np.ones((len(v), len(u)), bool)
    valid[0] = False
    places = np.array(draw_surface(TissueSurface(STAMP, CAMERA, u, v, np.where(valid, 0.09, 0.0), valid)))
    assert 500 < len(places) <= 1200
    assert places[:, 2] == pytest.approx(90)


def test_pictures_that_a_browser_can_show_go_as_they_came_and_others_are_made_so():
    def shown(data):
        return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))

    pixels = np.random.default_rng(1).integers(0, 255, (540, 960, 3), np.uint8)
    jpeg, raw = (encode_image(pixels, encoding) for encoding in (ImageEncoding.JPEG, ImageEncoding.RAW))
    assert encoded(jpeg, LEVELS[0], None) == jpeg.data
    assert shown(encoded(raw, LEVELS[0], None)).shape == (540, 960, 3)
    assert shown(encoded(jpeg, LEVELS[3], None)).shape == (270, 480, 3)
    turned = shown(encoded(jpeg, LEVELS[0], lambda image: image[::-1]))
    assert abs(turned[::-1].astype(int) - decode_image(jpeg)).mean() < 20


def paced(pace, ms_of_level, pictures):
    for _ in range(pictures):
        pace.took(ms_of_level(pace.level))
    return pace.level


def test_a_slow_link_gets_coarser_pictures_until_they_are_fast_enough_unless_their_size_is_not_what_costs():
    pace = Pace()
    assert paced(pace, lambda _: 10 * SLOW_MS, JUDGED_AFTER - 1) == 0, "too few to judge by"
    assert paced(pace, lambda level: SLOW_MS * 4 * 0.4**level, 400) in (1, 2)
    assert paced(pace, lambda _: FAST_MS / 2, 400) == 0
    pace = Pace()
    levels = [paced(pace, lambda _: 2 * SLOW_MS, 10) for _ in range(40)]
    assert sum(level == 0 for level in levels) > 25


def test_who_only_watches_gets_fewer_pictures_of_a_fast_camera_and_least_from_a_busy_host():
    for controls, full, rate_hz, shown in ((True, True, 30, 60), (False, False, 30, 30), (False, True, 30, 10)):
        sent_s, sent = -1.0, 0
        for at_s in np.arange(2 * rate_hz) / rate_hz:
            if due(controls, at_s - sent_s, full):
                sent_s, sent = at_s, sent + 1
        assert sent == shown
