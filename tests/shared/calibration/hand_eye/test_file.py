"""Hand-eye files as others write them lead to one pose; what is none of them is refused in a sentence."""

import json

import numpy as np
import pytest

from shared.calibration import CalibrationError
from shared.calibration.hand_eye.file import FLIP, Axes, Reference, read_hand_eye
from shared.calibration.own_file import calibration_text, opencv_text
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as T
from shared.rigid_transforms import exp_se3, inverse
from shared.units import METRES_PER_UNIT

OURS = json.dumps({"T_camera_base": T.tolist(), "unit": "m", "delay_s": None})
OPENCV_JSON = json.dumps({"base-frame": {"reference-frame": "camera", "transform": T.tolist()}})
DA_VINCI = '"base-frame": ' + json.dumps({"reference-frame": "camera", "transform": (FLIP @ T).tolist()}) + "\n"
FLAT = ", ".join(str(x) for x in T.ravel())
YAML = f"%YAML:1.0\n---\nT_camera_base: !!opencv-matrix {{ rows: 4, cols: 4, dt: d, data: [ {FLAT} ] }}\n"
R, MM = T[:3, :3].tolist(), (1e3 * T[:3, 3]).tolist()
R_AND_T = json.dumps({"pose": "T_camera_base", "R": R, "T": MM, "unit": "mm"})
BY_NAME = json.dumps({"R_camera_base": R, "t_camera_base": MM, "unit": "mm"})
XML = f'<opencv_storage><T_camera_base>{FLAT.replace(",", "")}</T_camera_base><unit>"m"</unit></opencv_storage>'


def of_ecm(pose, name="PSM2"):
    return json.dumps({"name": name, "measured_cp": np.asarray(pose).tolist()})


@pytest.mark.parametrize(
    ("name", "text", "axes", "arm"),
    [
        ("ours.json", OURS, None, ""),
        ("PSM1-registration-open-cv.json", OPENCV_JSON, None, "PSM1"),
        ("any.json", OPENCV_JSON, Axes.OPENCV, ""),
        ("PSM1-registration-dVRK.json", DA_VINCI, None, "PSM1"),
        ("piece.json", DA_VINCI, None, ""),
        ("PSM1-dVRK.json", f"{{{DA_VINCI}}}", None, ""),
        ("hand_eye.yaml", YAML, None, ""),
        ("hand_eye.xml", XML, None, ""),
        ("r_and_t.json", R_AND_T, None, ""),
        ("by_name.json", BY_NAME, None, ""),
    ],
)
def test_every_form_leads_to_the_same_pose_and_says_of_which_arm_or_nobody_knows(tmp_path, name, text, axes, arm):
    (tmp_path / name).write_text(text)
    read = read_hand_eye(tmp_path / name, axes)
    np.testing.assert_allclose(read.before_camera(), T, atol=1e-9)
    assert read.arm == arm


def test_a_base_told_from_the_ecm_follows_it(tmp_path):
    rng = np.random.default_rng(0)
    then, now = (exp_se3(rng.normal(0, (0.1,) * 3 + (0.4,) * 3)) for _ in range(2))
    path = tmp_path / "PSM1-registration-dVRK.json"
    path.write_text(of_ecm(then @ FLIP @ T))
    read = read_hand_eye(path)
    assert (read.reference, read.arm) == (Reference.ECM_BASE, "PSM2")
    np.testing.assert_allclose(read.before_camera(then), T, atol=1e-9)
    np.testing.assert_allclose(read.before_camera(now), FLIP @ inverse(now) @ then @ FLIP @ T, atol=1e-9)
    # the camera, 10 mm farther along its view, has the base 10 mm nearer
    nearer = read.before_camera(then @ exp_se3(np.array([0, 0, 0.01, 0, 0, 0])))
    np.testing.assert_allclose(nearer[:3, 3] - T[:3, 3], (0, 0, -0.01), atol=1e-9)
    with pytest.raises(CalibrationError, match="whose pose is not known"):
        read.before_camera()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (OPENCV_JSON, "whose axes"),
        ('{"base-frame": {"reference-frame": "camera"}}', "no transform"),
        ('{"base-frame": {"reference-frame": "camera"', "not valid JSON"),
        (OURS.replace('"m"', '"furlong"'), "unit 'furlong' is unknown"),
        (json.dumps({"T_camera_base": (2 * T).tolist()}), "last row"),
        (json.dumps({"T_camera_base": np.diag((1, 1, -1, 1)).tolist()}), "no rotation"),
        (json.dumps({"T_camera_base": [[1, 0], [0, 1]]}), "4x4"),
        (json.dumps({"R_camera_base": R, "t_camera_base": [1, 2, 3, 4]}), "t_camera_base must have three numbers"),
        (R_AND_T.replace(json.dumps(MM), "[1, 2]"), "three numbers"),
        (R_AND_T.replace("pose", "of"), "does not say what R and T are of.*R_camera_base and t_camera_base"),
        (json.dumps({"T_camera_base": T.tolist(), "T_Camera_Base": T.tolist()}), "differ in nothing but how they are"),
        (json.dumps({"measured_cp": T.tolist()}), "without the name of an arm"),
        (f"{YAML}---\nT_camera_base: 1\n", "2 documents"),
        (json.dumps({"T_camera_base": T.tolist(), "calibration_id": [5]}), "calibration_id is no text"),
        ("[a, b]: 1\n", "no hand-eye file"),
        ("", "it is empty"),
    ],
)
def test_what_is_no_such_file_is_refused(tmp_path, text, said):
    path = tmp_path / "file.json"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=said) as raised:
        read_hand_eye(path)
    assert str(path) in str(raised.value)


EYES = {"R": np.eye(3).tolist(), "T": [-55, 0, 0]}
K = [[800, 0, 480], [0, 800, 270], [0, 0, 1]]


@pytest.mark.parametrize(
    "text",
    [
        opencv_text,
        lambda camera: calibration_text(camera, "own"),
        lambda _: json.dumps(EYES | {"R1": EYES["R"], "unit": "mm"}),
        lambda _: json.dumps(EYES | {"cameraMatrix1": K, "cameraMatrix2": K}),
        lambda _: json.dumps(EYES | {"left": {"K": K}, "right": {"K": K}}),
        lambda _: json.dumps({"distortion_model": "plumb_bob", "T": [0, 0, 0.1], "R": EYES["R"]}),
        lambda _: json.dumps(EYES | {"imageSize": [960, 540]}),
        # whether such a pose is told of the rectified camera, nobody knows
        lambda _: json.dumps({"T_camera_base": T.tolist(), "K1": K, "D1": [0, 0, 0, 0]}),
    ],
)
def test_a_camera_calibration_is_no_hand_eye_file(endoscope, tmp_path, text):
    (tmp_path / "file.json").write_text(text(endoscope))
    said = "no hand-eye file but the calibration of a camera or of both eyes.* in a file of its own"
    with pytest.raises(CalibrationError, match=said):
        read_hand_eye(tmp_path / "file.json")


def test_a_unit_that_is_wrong_by_a_hundred_or_more_is_found_out_at_any_distance(tmp_path):
    path = tmp_path / "ours.json"
    for away_m in (0.021, 0.1, 0.84):
        pose = T.copy()
        pose[:3, 3] *= away_m / np.linalg.norm(T[:3, 3])
        for unit, factor in METRES_PER_UNIT.items():
            in_unit = pose.copy()
            in_unit[:3, 3] /= factor
            for called, other in METRES_PER_UNIT.items():
                path.write_text(json.dumps({"T_camera_base": in_unit.tolist(), "unit": called}))
                if unit == called:
                    assert np.linalg.norm(read_hand_eye(path).T[:3, 3]) == pytest.approx(away_m)
                elif not 1 / 99 < factor / other < 99:
                    with pytest.raises(CalibrationError, match=r"0.02 to 0.85 m make sense: is it in another unit"):
                        read_hand_eye(path)


@pytest.mark.parametrize(("away_m", "plausible"), [(0.019, False), (0.021, True), (0.9, True), (1.2, False)])
def test_a_base_told_from_the_ecm_has_bounds_too(tmp_path, away_m, plausible):
    path = tmp_path / "PSM1-registration-dVRK.json"
    path.write_text(of_ecm(np.eye(4) + away_m * np.eye(4, k=3)))
    if plausible:
        assert read_hand_eye(path).T[0, 3] == away_m
        return
    with pytest.raises(CalibrationError, match=r"from the ECM's base, and 0.02 to 1.1 m make sense"):
        read_hand_eye(path)
