"""Cameras are recovered from what they see of a board, to stated bounds; what spoils an estimate is named."""

from dataclasses import replace

import numpy as np
import pytest

from shared.calibration import CalibrationError, read_calibration
from shared.calibration.estimation.board import Board
from shared.calibration.estimation.checking import checked, held_out, rotation_deg
from shared.calibration.estimation.covariance import errors_of
from shared.calibration.estimation.coverage import Coverage, View, coverage, lacking, why_not
from shared.calibration.estimation.estimate import estimated
from shared.calibration.estimation.projection import residuals_px
from shared.calibration.own_file import camera_info_texts, opencv_text
from shared.calibration.uncertainty import USUAL
from shared.rigid_transforms import exp_so3, transform
from tests.rigs.boards import endoscope, standings

CAMERA, SIZE, MM = endoscope(), (960, 540), 1e-3
BOARD = Board(14, 10, 3.0)
NOISE_PX = 0.15


def seen(camera, T, name=""):
    """What a camera sees of a board that stands there, without images."""
    number = np.arange(len(BOARD.points))
    none = View(name, number, np.zeros((len(number), 2)), np.zeros((len(number), 2)))
    return View(name, number, *(-residual for residual in residuals_px(camera, none, BOARD, T)))


def views_of(camera, count, seed, noise_px=NOISE_PX):
    """What a camera sees of boards here and there, whose corners lie a little off."""
    rng = np.random.default_rng(seed)
    views = []
    for k, T in enumerate(standings(count, BOARD, seed)):
        all_of_it = seen(camera, T, f"view{k:02d}")
        left, right = all_of_it.left, all_of_it.right
        inside = ((left > 0) & (right > 0) & (left < SIZE) & (right < SIZE)).all(axis=1)
        off = rng.normal(0, noise_px, (2, len(left), 2))
        views.append(View(all_of_it.name, np.flatnonzero(inside), (left + off[0])[inside], (right + off[1])[inside]))
    return tuple(views)


def estimate_of(views):
    return estimated(tuple(views), BOARD, SIZE, MM)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "zoom", "off_centre_px", "baseline_mm", "turned"),
    [(1, 1.0, 0.0, 5.6, 0.0), (2, 0.85, 40.0, 3.5, 0.02), (3, 1.2, -40.0, 9.0, -0.02)],
)
def test_a_camera_is_recovered_from_its_views(seed, zoom, off_centre_px, baseline_mm, turned):
    T = CAMERA.T_right_left.copy()
    T[:3, 3] *= baseline_mm / 5.6
    K_left, K_right = CAMERA.K_left.copy(), CAMERA.K_right.copy()
    for K in (K_left, K_right):
        K[0, 0] *= zoom
        K[1, 1] *= zoom
        K[0, 2] += off_centre_px
    bent = CAMERA.distortion_left * (1 + 5 * turned)
    camera = replace(CAMERA, K_left=K_left, K_right=K_right, T_right_left=T, distortion_left=bent)
    found = estimate_of(views_of(camera, 20, seed)).calibration
    for told, true in ((found.K_left, camera.K_left), (found.K_right, camera.K_right)):
        assert told.diagonal() == pytest.approx(true.diagonal(), rel=0.006)
        assert np.abs(told[:2, 2] - true[:2, 2]).max() < 4.0
    np.testing.assert_allclose(found.T_right_left[:3, 3], T[:3, 3], atol=0.012 * baseline_mm)
    assert rotation_deg(found.T_right_left @ np.linalg.inv(T)) < 0.12
    # what counts is what the camera makes of a board that it has never seen
    (new,) = views_of(camera, 1, seed + 1, noise_px=0.0)
    one = checked(new, BOARD, found)
    assert np.median(np.abs(one.rows_px)) < 0.1
    assert one.size == pytest.approx(1.0, abs=0.006)


@pytest.mark.slow
def test_the_covariance_of_an_estimate_is_that_of_its_errors():
    square, rest = [], []
    for seed in range(6):
        estimate = estimate_of(views_of(CAMERA, 20, seed, 0.3))
        stated = estimate.calibration.covariance
        assert stated is not None
        points = np.concatenate([BOARD.points @ T[:3, :3].T + T[:3, 3] for T in estimate.T_left_board])
        error = errors_of(CAMERA, [estimate.calibration], points)[:, 0]
        square.append(error @ np.linalg.solve(stated, error))
        rest.append(np.sqrt(np.diag(stated)) / USUAL)
    # of 6 times 8 values of deviation 1: mean 48, deviation 10
    assert 25 < sum(square) < 80
    assert np.median(rest) < 1.5


def test_held_out_views_tell_the_noise_of_corners_and_what_they_were_made_from():
    views = views_of(CAMERA, 9, 1)
    found = held_out(views, BOARD, SIZE, MM)
    assert {one.view.name for one in found} == {view.name for view in views}
    # the root mean square over both axes of the noise is sqrt(2) times that of one
    assert np.median([one.rms_px for one in found]) == pytest.approx(np.sqrt(2) * NOISE_PX, rel=0.15)
    assert np.median(np.abs(np.concatenate([one.rows_px for one in found]))) < 2 * NOISE_PX
    assert held_out(views_of(CAMERA, 5, 0), BOARD, SIZE, MM) == ()


def test_a_view_that_moved_between_the_eyes_is_named_and_left_out():
    views = list(views_of(CAMERA, 16, 2))
    assert estimate_of(views).left_out == ()
    views[5] = replace(views[5], right=views[5].right + np.array([0.0, 9.0]))
    estimate = estimate_of(views)
    assert [name for name, _ in estimate.left_out] == ["view05"]
    assert "view05" not in {view.name for view in estimate.views}
    assert estimate.calibration.K_left[0, 0] == pytest.approx(CAMERA.K_left[0, 0], rel=0.006)


def test_too_few_views_are_refused_and_few_make_up_no_third_radial_coefficient():
    with pytest.raises(CalibrationError, match="take at least 5"):
        estimate_of(views_of(CAMERA, 4, 0))
    with pytest.raises(CalibrationError, match="check --squares, which counts squares and not corners"):
        estimate_of(())
    for count, is_free in ((9, False), (10, True)):
        found = estimate_of(views_of(CAMERA, count, 11)).calibration
        for lens in (found.distortion_left, found.distortion_right):
            assert (lens[4] != 0) == is_free
            assert lens[:2].all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("right_eye", "said"),
    [
        # turned upside down, and counted from the end at which the other eye's corners begin
        (lambda view: (np.array(SIZE) - 1.0 - view.right)[::-1], "mirror"),
        (lambda view: view.right * (-1.0, 1.0) + (SIZE[0] - 1.0, 0.0), "mirror"),
        (lambda view: view.left, "one image given twice"),
    ],
    ids=["upside down", "mirrored", "the left eye again"],
)
def test_what_no_right_eye_sees_fits_no_camera(right_eye, said):
    with pytest.raises(CalibrationError, match=said):
        estimate_of(replace(view, right=right_eye(view)) for view in views_of(CAMERA, 12, 8))


def test_a_calibration_of_another_camera_fails_the_check():
    T = CAMERA.T_right_left.copy()
    T[:3, 3] *= 1.05
    (view,) = views_of(CAMERA, 1, 4, noise_px=0.0)
    right, wrong = checked(view, BOARD, CAMERA), checked(view, BOARD, replace(CAMERA, T_right_left=T))
    assert right.size == pytest.approx(1.0, abs=1e-4) and right.rms_px < 1e-3
    assert wrong.size == pytest.approx(1.05, abs=1e-3)
    assert len(wrong.squares) > 100
    for one in (right, wrong):
        assert np.mean(one.squares) == pytest.approx(one.size, abs=2e-3)


ENOUGH = np.full((3, 4), 9)
EVERY_WAY = np.array([[0.3, 0.3], [-0.3, 0.3], [0.3, -0.3], *([[0.0, 0.0]] * 12)])
NEAR_AND_FAR = np.linspace(10.0, 20.0, len(EVERY_WAY))


def without(row, column):
    cells = ENOUGH.copy()
    cells[row, column] = 4
    return cells


@pytest.mark.parametrize(
    ("lacks", "told"),
    [
        ({}, []),
        ({"left": without(0, 3)}, ["the left image's top right: show the board there"]),
        ({"right": without(2, 1)}, ["the right image's bottom centre left: show the board there"]),
        ({"tilt": abs(EVERY_WAY)}, ["the board's left side clearly nearer", "the board's upper side clearly nearer"]),
        ({"tilt": -abs(EVERY_WAY)}, ["the board's right side clearly nearer", "the board's lower side clearly nearer"]),
        ({"apparent": 10.0 + 0.1 * NEAR_AND_FAR}, ["all views are from one distance"]),
        ({"tilt": EVERY_WAY[:4], "apparent": NEAR_AND_FAR[[0, -1]]}, ["2 views: 13 more"]),
    ],
    ids=["nothing", "left", "right", "one way", "the other way", "one distance", "few"],
)
def test_each_thing_that_views_lack_is_named(lacks, told):
    covered = Coverage(**({"left": ENOUGH, "right": ENOUGH, "tilt": EVERY_WAY, "apparent": NEAR_AND_FAR} | lacks))
    sentences = lacking(covered)
    assert len(sentences) == len(told)
    for sentence, words in zip(sentences, told, strict=True):
        assert words in sentence


def test_views_cover_where_their_corners_are_and_are_tilted_to_their_nearer_side():
    assert lacking(coverage((), BOARD, SIZE)) == ["no view yet: show the whole board to both eyes"]
    views = views_of(CAMERA, 40, 5)
    assert "too few corners in the left image's" in lacking(coverage(views[:1], BOARD, SIZE))[0]
    assert lacking(coverage(views, BOARD, SIZE)) == []

    def tilted(about_x, about_y):
        R = exp_so3(np.array([about_x, about_y, 0.0]))
        T = transform(R, np.array([0.0, 0.0, 80.0]) - R @ np.array([21.0, 15.0, 0.0]))
        return coverage((seen(CAMERA, T),), BOARD, SIZE).tilt[0]

    # y points down and z away: turning about y by a positive angle takes the right side nearer
    assert tilted(0.0, 0.4)[0] > 0.1 > abs(tilted(0.0, 0.4)[1])
    assert tilted(0.0, -0.4)[0] < -0.1
    assert tilted(-0.4, 0.0)[1] > 0.1 > abs(tilted(-0.4, 0.0)[0])


def test_a_live_view_is_kept_when_the_board_is_still_and_elsewhere():
    one, other = views_of(CAMERA, 2, 6)
    nearly, moving = replace(one, left=one.left + 1.0), replace(one, left=one.left + 4.0)
    for before in (None, other, moving):
        assert why_not(one, before, (), 960) == "hold the board still"
    assert why_not(one, nearly, (nearly,), 960).startswith("move or tilt")
    assert why_not(one, nearly, (), 960) == why_not(one, nearly, (other,), 960) == ""


def test_opencv_and_ros_read_back_what_was_written(tmp_path):
    (tmp_path / "opencv.yaml").write_text(opencv_text(CAMERA))
    read = read_calibration(tmp_path / "opencv.yaml", unit=None, image_size=SIZE).calibration
    assert read.metres_per_unit == MM
    for name in ("K_left", "K_right", "distortion_left", "distortion_right"):
        np.testing.assert_array_equal(getattr(read, name), getattr(CAMERA, name))
    np.testing.assert_allclose(read.T_right_left, CAMERA.T_right_left, atol=1e-12)
    for side, text in zip(("left", "right"), camera_info_texts(CAMERA), strict=True):
        (tmp_path / f"{side}.yaml").write_text(text)
    ros = read_calibration((tmp_path / "left.yaml", tmp_path / "right.yaml"), unit=None, image_size=SIZE).calibration
    np.testing.assert_array_equal(ros.K_right, CAMERA.K_right)
    np.testing.assert_allclose(ros.T_right_left[:3, 3], CAMERA.T_right_left[:3, 3] * MM, atol=1e-9)
    np.testing.assert_allclose(ros.T_right_left[:3, :3], CAMERA.T_right_left[:3, :3], atol=1e-9)
    with pytest.raises(CalibrationError, match="name it with --unit"):
        camera_info_texts(replace(CAMERA, metres_per_unit=None))
