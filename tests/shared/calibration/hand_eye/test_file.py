"""Hand-eye files as others write them lead to one pose; what is none of them is refused in a sentence."""

import json
from pathlib import Path

import numpy as np
import pytest

from shared.calibration import CalibrationError
from shared.calibration.hand_eye.file import FLIP, Axes, Reference, carried_by_ecm, read_hand_eye
from shared.kinematics.simulated_setup import SIMULATED_T_CAMERA_BASE as T
from shared.rigid_transforms import exp_se3

OURS = json.dumps({"T_camera_base": T.tolist(), "unit": "m", "delay_s": None})
OPENCV_JSON = json.dumps({"base-frame": {"reference-frame": "camera", "transform": T.tolist()}})
DA_VINCI = '"base-frame": ' + json.dumps({"reference-frame": "camera", "transform": (FLIP @ T).tolist()}) + "\n"
FLAT = ", ".join(str(x) for x in T.ravel())
YAML = f"%YAML:1.0\n---\nT_camera_base: !!opencv-matrix {{ rows: 4, cols: 4, dt: d, data: [ {FLAT} ] }}\n"
R_AND_T = json.dumps({"R": T[:3, :3].tolist(), "t": (1e3 * T[:3, 3]).tolist(), "unit": "mm"})


@pytest.mark.parametrize(
    ("name", "text", "axes"),
    [
        ("ours.json", OURS, None),
        ("PSM1-registration-open-cv.json", OPENCV_JSON, None),
        ("any.json", OPENCV_JSON, Axes.OPENCV),
        ("PSM1-registration-dVRK.json", DA_VINCI, None),
        ("piece.json", DA_VINCI, None),
        ("PSM1-dVRK.json", f"{{{DA_VINCI}}}", None),
        ("hand_eye.yaml", YAML, None),
        ("r_and_t.json", R_AND_T, None),
    ],
)
def test_every_form_leads_to_the_same_pose(tmp_path: Path, name: str, text: str, axes: Axes | None) -> None:
    (tmp_path / name).write_text(text)
    np.testing.assert_allclose(read_hand_eye(tmp_path / name, axes).before_camera(), T, atol=1e-9)


def test_a_base_told_from_the_ecm_follows_it(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    then, now = (exp_se3(rng.normal(0, (0.1,) * 3 + (0.4,) * 3)) for _ in range(2))
    path = tmp_path / "PSM1-registration-dVRK.json"
    path.write_text(json.dumps({"name": "PSM1", "measured_cp": (then @ FLIP @ T).tolist()}))
    read = read_hand_eye(path)
    assert read.reference is Reference.ECM_BASE
    np.testing.assert_allclose(read.before_camera(then), T, atol=1e-9)
    np.testing.assert_allclose(read.before_camera(now), carried_by_ecm(T, then, now), atol=1e-9)
    # the camera, 10 mm farther along its view, has the base 10 mm nearer
    nearer = carried_by_ecm(T, then, then @ exp_se3(np.array([0, 0, 0.01, 0, 0, 0])))
    np.testing.assert_allclose(nearer[:3, 3] - T[:3, 3], (0, 0, -0.01), atol=1e-9)
    with pytest.raises(CalibrationError, match="whose pose is not known"):
        read.before_camera()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (OPENCV_JSON, "whose axes"),
        ('{"base-frame": {"reference-frame": "camera"}}', "no transform"),
        ('{"base-frame": {"reference-frame": "camera"', "not valid JSON"),
        ('{"K": [1, 2]}', "no hand-eye file"),
        (OURS.replace('"m"', '"furlong"'), "unit 'furlong' is unknown"),
        (json.dumps({"T_camera_base": (2 * T).tolist()}), "last row"),
        (json.dumps({"T_camera_base": np.diag((1, 1, -1, 1)).tolist()}), "no rotation"),
        (json.dumps({"T_camera_base": [[1, 0, 0, 45], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}), "another unit"),
        (json.dumps({"T_camera_base": [[1, 0], [0, 1]]}), "4x4"),
        (json.dumps({"R": np.eye(3).tolist(), "t": [1, 2]}), "three numbers"),
        (json.dumps({"T_camera_base": T.tolist(), "calibration_id": [5]}), "calibration_id is no text"),
        ("", "it is empty"),
    ],
)
def test_what_is_no_such_file_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "file.json"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=said) as raised:
        read_hand_eye(path)
    assert str(path) in str(raised.value)
