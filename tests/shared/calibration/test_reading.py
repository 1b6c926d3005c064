"""A calibration is read whoever wrote it: named matrices, our own file, ROS, folders of text, rectified pairs."""

import dataclasses
import json

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.messages import StereoCalibration
from shared.calibration import CalibrationError, OtherSizeError, read_calibration, write_calibration
from shared.calibration.made import made_ns, made_text
from shared.calibration.named_matrices import counted_from_centres
from shared.calibration.own_file import opencv_text
from shared.rigid_transforms import exp_so3, transform

SIZE = (960, 540)
small = st.floats(-0.1, 0.1)


def read(where, unit=None, size=SIZE):
    return read_calibration(where, unit=unit, image_size=size)


@pytest.mark.parametrize(("written", "read_as"), [("yml", "yml"), ("yml", "xml"), ("xml", "txt"), ("json", "yaml")])
def test_what_opencv_writes_is_read_and_its_content_decides_the_format(tmp_path, named, assert_read, written, read_as):
    storage = cv2.FileStorage(str(tmp_path / f"stereo.{written}"), cv2.FILE_STORAGE_WRITE)
    for name, value in named.items():
        storage.write(name, np.array(value))
    storage.startWriteStruct("image_size", cv2.FileNode_SEQ)
    for number in SIZE:
        storage.write("", number)
    storage.endWriteStruct()
    storage.release()
    assert_read((tmp_path / f"stereo.{written}").rename(tmp_path / f"x.{read_as}"))


@pytest.mark.parametrize(
    "names",
    [
        ("M1", "D1", "M2", "D2", "R", "T"),
        ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2", "R", "T"),
        ("left_camera_matrix", "left_distortion", "right_camera_matrix", "right_distortion", "rotation_matrix", "tvec"),
        ("mtxL", "distL", "mtxR", "distR", "Rmat", "translation_vector"),
        ("K_LEFT", "DISTORTION_LEFT", "K_RIGHT", "DISTORTION_RIGHT", "R_right_left", "t_right_left"),
    ],
)
def test_the_names_that_people_give_the_matrices_are_known(named, write, assert_read, names):
    assert_read(write(**{"stereo.yaml": dict(zip(names, named.values(), strict=True))}))


def test_matrices_may_be_put_together_in_several_ways(tmp_path, endoscope, named, write, assert_read):
    assert_read(write(**{"a.yaml": named | {"R": cv2.Rodrigues(np.array(named["R"]))[0].tolist()}}))
    extrinsics = {"R1": np.eye(3).tolist(), "Q": np.eye(4).tolist()} | {name: named.pop(name) for name in "RT"}
    for name, rows in (("T_right_left", 3), ("T", 4), ("l2r", 4)):
        assert_read(write(**{"a.yaml": named | {name: endoscope.T_right_left[:rows].tolist()}}))
    nested = {side: {"K": named[f"K{n}"], "D": named[f"D{n}"]} for side, n in (("left", 1), ("right", 2))}
    assert_read(write(**{"a.yaml": nested | extrinsics}))
    (tmp_path / "a.yaml").unlink()
    first, second = write(**{"intrinsics.yml": named, "extrinsics.yml": extrinsics})
    for paths in ((first, second), (second, first), tmp_path):
        assert_read(paths)


@pytest.mark.parametrize(
    ("size", "turned_is_well"),
    [
        ({"imageSize": SIZE}, True),
        ({"imageSize": SIZE[::-1]}, True),
        ({"imageSize": [SIZE]}, True),
        ({"image_width": SIZE[0], "image_height": SIZE[1]}, False),
    ],
)
def test_an_image_size_is_read_in_either_order_if_it_has_none_and_other_images_refused(
    named, write, assert_read, size, turned_is_well
):
    (path,) = write(**{"stereo.yaml": named | size})
    assert_read(path)
    for other in ((640, 480), SIZE[::-1])[: 1 if turned_is_well else 2]:
        said = f"for 960x540 images, and these are {other[0]}x{other[1]}; use the images"
        with pytest.raises(OtherSizeError, match=said) as raised:
            read(path, "mm", other)
        assert raised.value.size == SIZE


@given(rotation=st.tuples(small, small, small), count=st.sampled_from((0, 4, 5, 8, 12, 14)), baseline=st.floats(1, 20))
@settings(max_examples=20)
def test_any_calibration_survives_our_own_file(tmp_path_factory, endoscope, rotation, count, baseline):
    written = dataclasses.replace(
        endoscope,
        metres_per_unit=(1.0, 1e-2, 1e-3, 1e-6, None)[count % 5],
        distortion_right=np.random.default_rng(count).normal(size=count),
        covariance=np.diag(np.random.default_rng(count).uniform(size=8)) if count % 2 else None,
        T_right_left=transform(exp_so3(np.array(rotation)), np.array([-baseline, baseline / 9, 0.01])),
    )
    path = tmp_path_factory.mktemp("round") / "calibration.json"
    write_calibration(path, written)
    # as `suturegrasp calibrate` leaves it, beside the same in another format
    (path.parent / "opencv.yaml").write_text("%YAML:1.0\n")
    found = read(path.parent).calibration
    for field in dataclasses.fields(StereoCalibration):
        np.testing.assert_array_equal(getattr(found, field.name), getattr(written, field.name), err_msg=field.name)


def test_a_given_unit_fills_in_for_an_unknown_one_and_may_not_contradict_a_known_one(tmp_path, endoscope):
    path = tmp_path / "calibration.json"
    write_calibration(path, dataclasses.replace(endoscope, metres_per_unit=None))
    assert read(path, "cm").calibration.metres_per_unit == 1e-2
    assert [judgement.code for judgement in read(path).judgements] == ["unit_unknown"]
    with pytest.raises(CalibrationError, match=r"unknown unit 'furlong'; choose from m, cm, mm, um"):
        read(path, "furlong")
    write_calibration(path, endoscope)
    assert read(path, "mm").calibration.metres_per_unit == 1e-3
    with pytest.raises(CalibrationError, match=r"lengths in mm, which contradicts --unit m$"):
        read(path, "m")
    with pytest.raises(CalibrationError, match=r"unit of 0\.0254 m has no name"):
        write_calibration(path, dataclasses.replace(endoscope, metres_per_unit=0.0254))
    with pytest.raises(CalibrationError, match="cannot be written"):
        write_calibration(tmp_path / "nowhere" / "x.json", endoscope)


@pytest.mark.parametrize(
    ("left", "right"),
    [("left.yaml", "right.yaml"), ("myLeftCamera.yaml", "myRightCamera.yaml"), ("left_0042.yml", "right_0043.yml")],
)
def test_a_pair_of_ros_files_gives_the_transform_that_it_was_rectified_from(
    tmp_path, cameras, write, assert_read, left, right
):
    paths = write(**{left: cameras[0], right: cameras[1]})
    (tmp_path / "ost.txt").write_text("# oST version 5.0 parameters\n")
    # of a pair, the name of one leads to the other
    alone = paths if left != "left_0042.yml" else ()
    for where in (paths, tmp_path, *alone):
        assert_read(where)


def message(camera, names="dkrp", **header):
    """What `ros2 topic echo` shows of a camera, or `rostopic echo` with names in upper case."""
    long = ("distortion_coefficients", "camera_matrix", "rectification_matrix", "projection_matrix")
    arrays = {short: camera[name]["data"] for short, name in zip(names, long, strict=True)}
    told = {"header": header, "height": SIZE[1], "width": SIZE[0], "distortion_model": "plumb_bob"} | arrays
    return "".join(f"{name}: {json.dumps(value)}\n" for name, value in told.items())


@pytest.mark.parametrize("names", ["dkrp", "DKRP"])
def test_printed_messages_are_read_of_a_topic_that_was_recorded_for_a_while_too(cameras, write, assert_read, names):
    left, right = ("---\n".join(message(one, names, stamp=k, frame_id="cam") for k in range(3)) for one in cameras)
    for where in (paths := write(**{"left.yaml": left, "right.yaml": right}), paths[0]):
        assert_read(where)


def test_both_cameras_may_be_documents_or_entries_of_one_file(cameras, write, assert_read):
    left, right = cameras
    for pair in (((left, "left"), (right, "right")), ((right, "a_right"), (left, "left")), ((left, "a"), (right, "b"))):
        assert_read(write(**{"both.yaml": "---\n".join(message(one, frame_id=frame) for one, frame in pair)}))
    assert_read(write(**{"both.json": json.dumps({"left": left, "right": right})}))


def test_ros_counts_in_metres_and_millimetres_taken_for_them_are_noticed(cameras, write):
    D, (left, right) = np.arange(8) / 100, cameras
    for camera in cameras:
        lens = {"rows": 1, "cols": 8, "data": D.tolist()}
        camera |= {"distortion_coefficients": lens, "distortion_model": "rational_polynomial"}
    (judgement,) = read(write(**{"left.yaml": left, "right.yaml": right})).judgements
    assert judgement.code == "baseline_implausible"
    assert "--unit mm" in judgement.remedy
    right["projection_matrix"]["data"][3] *= 1e-3
    paths = write(**{"left.yaml": left, "right.yaml": right})
    assert (read(paths).calibration.metres_per_unit, read(paths).judgements) == (1, ())
    assert read(paths, "cm").calibration.metres_per_unit == 1e-2
    np.testing.assert_array_equal(read(paths).calibration.distortion_left, D)


def test_a_folder_of_text_matrices_is_read(tmp_path, text_matrices, write, assert_read):
    write(**text_matrices)
    assert_read(tmp_path)
    *rows, _ = text_matrices["calib.l2r.txt"].splitlines()
    R, t = zip(*((row.split()[:3], row.split()[3]) for row in rows), strict=True)
    lens = text_matrices["calib.left.intrinsics.txt"].splitlines()[-1]
    apart = {"calib.left.intrinsics.txt": text_matrices["calib.left.intrinsics.txt"].removesuffix(lens + "\n")}
    for left_to_right in ("\n".join(rows), "\n".join(map(" ".join, (*R, t))), "# x\n\n" + ",\n".join(rows)):
        write(**apart, **{"calib.left.distortion.txt": lens, "calib.l2r.txt": left_to_right})
        assert_read(tmp_path)


K_PAIR = [[1000.0, 0.0, 479.5], [0.0, 1000.0, 269.5], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    ("baseline", "length", "metres"),
    [
        ({"baseline_mm": 5.5}, 5.5, 1e-3),
        ({"baseline_m": 0.0055}, 0.0055, 1.0),
        ({"baseline": 5.5, "unit": "mm"}, 5.5, 1e-3),
        ({"baseline": 5.5}, 5.5, None),
    ],
)
def test_the_right_camera_of_a_rectified_pair_sits_one_baseline_along_x(write, baseline, length, metres):
    scene = {"name": "scene", "width": 960, "height": 540, "K": K_PAIR, "post": {"blur": 0.6}} | baseline
    calibration = read(write(**{"scene.json": json.dumps(scene)})).calibration
    np.testing.assert_array_equal(np.linalg.inv(calibration.T_right_left) @ [0, 0, 0, 1], [length, 0, 0, 1])
    for K in (calibration.K_left, calibration.K_right):
        np.testing.assert_array_equal(K, K_PAIR)
    assert not calibration.distortion_left.any()
    assert calibration.metres_per_unit == metres


K = np.array([[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]])
IDEAL = StereoCalibration(640, 480, K, K, np.zeros(5), np.zeros(5), np.eye(4) - 5.0 * np.eye(4, k=3), None)


def test_the_middle_of_the_image_is_between_its_middle_pixels_unless_it_was_estimated_or_is_our_own(tmp_path):
    moved, judgements = counted_from_centres(IDEAL)
    for camera_matrix in (moved.K_left, moved.K_right):
        np.testing.assert_array_equal(camera_matrix[:2, 2], [319.5, 239.5])
        np.testing.assert_array_equal(camera_matrix[:2, :2], K[:2, :2])
    assert [judgement.code for judgement in judgements] == ["pixels_from_corners"]
    write_calibration(tmp_path / "ideal.json", IDEAL)
    np.testing.assert_array_equal(read(tmp_path / "ideal.json", size=(640, 480)).calibration.K_left, K)
    for changes in ({"K_right": K + 0.25 * np.eye(3, k=2)}, {"distortion_left": np.array([0.1, 0.0, 0.0, 0.0, 0.0])}):
        estimated = dataclasses.replace(IDEAL, **changes)
        assert counted_from_centres(estimated) == (estimated, ())


AT_NS = 1_700_000_000 * 10**9
"""2023-11-14T22:13:20 in UTC."""
BY_OPENCV = '<calibration_time>"Tue Nov 14 22:13:20 2023"</calibration_time>'


def test_our_files_state_when_they_were_made_and_of_several_the_oldest_counts(endoscope, tmp_path):
    own, opencv = tmp_path / "own.json", tmp_path / "opencv.yaml"
    write_calibration(own, endoscope, AT_NS)
    opencv.write_text(opencv_text(endoscope, AT_NS))
    assert [made_ns((path,)) for path in (own, opencv)] == [AT_NS, AT_NS]
    assert made_text(AT_NS) == "2023-11-14T22:13:20+00:00"
    for day in (14, 12, 13):
        (tmp_path / f"{day}.json").write_text(f'{{"made": "2023-11-{day}T22:13:20+00:00"}}')
    (tmp_path / "left").mkdir()
    assert made_ns((tmp_path,)) == AT_NS - 2 * 86400 * 10**9
    assert made_ns((tmp_path / "nowhere", tmp_path / "left")) is None


@pytest.mark.parametrize(
    ("name", "text", "told_ns"),
    [
        ("a.json", '{"made": "2023-11-14T23:13:20+01:00"}', AT_NS),
        ("a.yml", '%YAML:1.0\n---\ncalibration_time: "Tue Nov 14 22:13:20 2023"\nflags: 0\n', AT_NS),
        ("a.xml", f"<opencv_storage>{BY_OPENCV}</opencv_storage>", AT_NS),
        ("a.json", '{"made": {"on": "2023-11-14"}}', None),
        ("a.json", "no JSON", None),
        ("a.json", '{"made": "9999-12-31T23:59:59+00:00"}', 253402300799 * 10**9),
    ],
)
def test_what_a_file_states_of_its_making_is_understood_or_nobody_knows(tmp_path, name, text, told_ns):
    (tmp_path / name).write_text(text)
    assert made_ns((tmp_path / name,)) == told_ns
