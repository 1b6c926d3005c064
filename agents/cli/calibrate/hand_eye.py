"""`suturegrasp calibrate hand-eye`: where an arm's base is before the camera, and what that is worth."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from agents.cli.calibrate.hand_eye_input import motion_in, motion_recorded, sightings_in
from agents.cli.calibrate.hand_eye_options import HandEye
from agents.launch.process import EXIT_OK, EXIT_UNUSABLE
from schemas.messages import StereoCalibration
from shared.calibration import CalibrationError, read_calibration
from shared.calibration.hand_eye.estimate import Estimate, estimated
from shared.calibration.hand_eye.file import implausible
from shared.calibration.identity import calibration_id
from shared.calibration.made import MADE, made_text
from shared.calibration.reader import stated_calibration
from shared.clock import now_ns
from shared.kinematics.psm import FINGER_M
from shared.terminal import complain, say, warn

EXIT_NONE = 3
GRASPING_M = 0.001
"""What a grasp of thread needs; a registration that is coarser is told so."""
MIDDLE_OF_FIELD = np.array([0.0, 0.0, 0.09])


def run(options: HandEye) -> int:
    """Carry it out; the exit status."""
    try:
        if (options.poses is None) == (options.recording is None):
            raise CalibrationError("give the robot's poses by one of --poses and --recording")
        if options.output is not None and options.output.exists():
            raise CalibrationError(f"{options.output} is there already; give a new file")
        camera = _camera(options)
        sightings = sightings_in(options.tips, camera)
        if options.poses is not None:
            motion, turned = motion_in(options.poses)
        else:
            motion, turned = motion_recorded(options.recording or Path(), options.arm), True
    except CalibrationError as error:
        return complain(str(error), EXIT_UNUSABLE)
    point = np.array(options.point if options.point is not None else (0.0, 0.0, FINGER_M if turned else 0.0))
    try:
        if not turned and (options.unknown_point or options.point is not None):
            raise CalibrationError("poses without a rotation tell nothing of a point of the tool; leave --point out")
        found = estimated(sightings, motion, point, not options.unknown_point)
        if wrong := implausible(found.T_camera_base):
            raise CalibrationError(f"{wrong}: see that tips and poses are in metres, and of one tool")
    except CalibrationError as error:
        return complain(str(error), EXIT_NONE)
    for sentence in _told(found, sightings.camera is not None):
        say(sentence)
    for index in np.flatnonzero(~found.used)[:5]:
        warn(f"the sighting at {sightings.time_s[index]:.3f} s contradicts the others, or has no pose; it was left out")
    if (error_m := float(np.median(found.held_out_m))) > GRASPING_M:
        warn(
            f"{1e3 * error_m:.1f} mm is coarser than a thread: "
            "have the tool corrected from images, docs/tool_tracking.md"
        )
    if options.output is not None:
        if camera is None:
            warn("the file does not say of which camera calibration it is, which a real arm needs: give --calibration")
        options.output.write_text(_file(found, camera), encoding="utf-8")
        say(f"written to {options.output}; set T_camera_base_file to it in the arm's section of the rig")
    return EXIT_OK


def _camera(options: HandEye) -> StereoCalibration | None:
    if not options.calibration:
        return None
    size, stated = options.size, stated_calibration(options.calibration).size
    if size is None and stated is not None:
        size = stated.width, stated.height
    if size is None:
        raise CalibrationError("the calibration does not say how large its images are; give --size")
    return read_calibration(options.calibration, unit=options.unit, image_size=size).calibration


def _told(found: Estimate, pixels: bool) -> list[str]:
    x, y, z = 1e3 * found.T_camera_base[:3, 3]
    residual = f"{np.median(found.residual):.2f} px and " if pixels else ""
    apart = f"{residual}{1e3 * np.median(found.residual_m):.2f} mm"
    held = f"{np.median(found.held_out):.2f} px and " if pixels else ""
    delay = "the delay between camera and joints cannot be told, for the tool hardly moved; 0 was taken"
    if found.delay_s is not None:
        deviation = f"(deviation {1e3 * found.delay_deviation_s:.1f} ms)"
        delay = f"the camera is {1e3 * found.delay_s:+.1f} ms behind the joints {deviation}"
    counted = f"{found.used.sum()} of {len(found.used)} sightings"
    return [
        f"{counted}: the base is at ({x:.2f}, {y:.2f}, {z:.2f}) mm before the camera",
        f"left over: {apart} (median), {1e3 * found.residual_m.max():.2f} mm (most)",
        f"on sightings held out: {held}{1e3 * np.median(found.held_out_m):.2f} mm (median), "
        f"{1e3 * np.percentile(found.held_out_m, 95):.2f} mm (95 %)",
        f"by noise alone a point 90 mm before the camera is known to {1e3 * found.deviation_m(MIDDLE_OF_FIELD):.2f} mm",
        delay,
    ]


def _file(found: Estimate, camera: StereoCalibration | None) -> str:
    told: dict[str, Any] = {
        MADE: made_text(now_ns()),
        "T_camera_base": found.T_camera_base.tolist(),
        "unit": "m",
        "delay_s": found.delay_s,
        "point_tool": found.point_tool.tolist(),
        "covariance": found.covariance.tolist(),
        "residual_mm": 1e3 * float(np.median(found.residual_m)),
        "held_out_mm": 1e3 * float(np.median(found.held_out_m)),
        "sightings": int(found.used.sum()),
    }
    if camera is not None:
        told["calibration_id"] = calibration_id(camera)
    return "{\n" + ",\n".join(f"  {json.dumps(name)}: {json.dumps(value)}" for name, value in told.items()) + "\n}\n"
