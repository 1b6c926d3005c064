import numpy as np
import pytest

from benchmarks.occlusions import END_SHARE, LEAST_HIDDEN, MOST_HIDDEN, hiding_shaft
from schemas.messages import RectifiedStereo
from shared.camera import project

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5, 1e-3)


@pytest.fixture
def thread():
    t = np.linspace(-1, 1, 1500)
    return np.column_stack((25 * t, 8 * np.sin(3 * t), 90 + 4 * t**2))


@pytest.mark.parametrize("seed", range(5))
def test_a_tool_hides_a_third_of_the_thread_from_both_cameras_and_neither_end(thread, seed):
    visible = np.ones((len(thread), 2), bool)
    shaft = hiding_shaft(CAMERA, thread, visible, seed)
    hidden = shaft.hides(CAMERA, thread)
    end = round(END_SHARE * len(thread))
    assert (hidden.mean(axis=0) >= LEAST_HIDDEN).all()
    assert (hidden.mean(axis=0) <= MOST_HIDDEN).all()
    assert not hidden[:end].any()
    assert not hidden[-end:].any()
    assert shaft.disparity_px > (project(CAMERA, thread)[0] - project(CAMERA, thread)[1])[:, 0].max()


def test_a_painted_tool_covers_the_mask_exactly_where_it_hides_points(thread):
    shaft = hiding_shaft(CAMERA, thread, np.ones((len(thread), 2), bool), 1)
    hidden = shaft.hides(CAMERA, thread)
    for eye, px in enumerate(project(CAMERA, thread)):
        image = np.full((540, 960, 3), 90, np.uint8)
        painted, mask = shaft.paint(image, np.full((540, 960), 255, np.uint8), eye)
        at = np.rint(px).astype(int)
        clear_of_border = np.abs(shaft.distance(px, eye) - shaft.half_width_px) > 2.0
        covered = mask[at[:, 1], at[:, 0]] == 0
        assert (covered == hidden[:, eye])[clear_of_border].all()
        assert (painted[mask == 255] == 90).all()


def test_a_thread_without_ends_to_spare_is_refused():
    point = np.tile([[0.0, 0.0, 90.0]], (200, 1))
    with pytest.raises(ValueError, match="both ends"):
        hiding_shaft(CAMERA, point, np.ones((200, 2), bool), 0)
