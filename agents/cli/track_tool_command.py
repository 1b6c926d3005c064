"""`suturegrasp track-tool`: where a recorded tool is in the images, and what that says of the registration."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64

from agents.cli.process import EXIT_OK, EXIT_UNUSABLE
from agents.cli.recorded_options import TrackTool
from agents.cli.terminal import complain, say, warn
from agents.cli.track_tool_input import Seen, seen_in
from agents.perception.tool.acquisition import soft_pair
from agents.perception.tool.outline import outline
from agents.perception.tool.refinement import View
from agents.perception.tool.track import Following, Track, begun, followed
from shared.kinematics.psm import FINGER_M
from shared.recording.entry import RecordingError
from shared.rigid_transforms import apply, log_so3

EXIT_DRIFTED, EXIT_NOT_FOUND = 1, 3
FOLLOWING_S, SEARCHING_S = 0.2, 0.4
TIP = np.array([[0.0, 0.0, FINGER_M]])
BEFORE, AFTER = (0, 220, 255), (0, 255, 0)


def run(options: TrackTool) -> int:
    """Follow the tool through the recording, and tell; the exit status."""
    for path in (options.output, options.tips):
        if path is not None and path.exists():
            return complain(f"{path} exists already; give another name", EXIT_UNUSABLE)
    try:
        track, last, tips = _through(options)
    except (RecordingError, OSError) as error:
        return complain(str(error), EXIT_UNUSABLE)
    if last is None or track is None:
        return complain(f"{options.recording}: no frame has a state of {options.arm} of its time", EXIT_UNUSABLE)
    if options.tips is not None:
        _write_tips(options.tips, tips)
    if track.state is not Following.FOLLOWED or track.correction is None:
        return complain(f"the tool of {options.arm} was not found, or was lost: {track.reason}", EXIT_NOT_FOUND)
    off_m, off_rad, deviation_m = _off(track, last)
    told = f"{1e3 * off_m:.1f} mm and {np.degrees(off_rad):.1f} degrees"
    say(f"the tool is {told} from where registration and joints have it (deviation {1e3 * deviation_m:.1f} mm)")
    if options.output is not None:
        corrected = {"T_camera_base": (track.correction.matrix @ last.state.T_camera_base).tolist(), "unit": "m"}
        options.output.write_text(json.dumps(corrected) + "\n", encoding="utf-8")
        say(f"written to {options.output}, corrected; set T_camera_base_file to it in the arm's section of the rig")
    if off_m > 1e-3 * options.limit:
        warn(f"the registration is more than {options.limit:g} mm off: calibrate it again, or use the corrected one")
        return EXIT_DRIFTED
    return EXIT_OK


def _through(options: TrackTool) -> tuple[Track | None, Seen | None, list[list[float]]]:
    """The track and the frame at the end, and the tip before the camera whenever it was followed."""
    track, last, tips, before, next_s = None, None, list[list[float]](), Following.LOST, -np.inf
    for seen in seen_in(options.recording, options.arm, options.delay_ms):
        if seen.at_s < next_s:
            # looking at a frame takes about that long where it runs beside the camera
            continue
        state, waited_s = seen.state, FOLLOWING_S if last is None else max(seen.at_s - last.at_s, 0.0)
        view = View(seen.camera, (), state.T_camera_base, state.T_base_tool, state.jaw_rad)
        track = followed(track or begun(view), soft_pair(seen.left, seen.right), view, waited_s, 0)
        next_s = seen.at_s + (FOLLOWING_S if track.state is Following.FOLLOWED else SEARCHING_S)
        last = seen
        if track.state is not before:
            before = track.state
            say(f"{seen.at_s:.2f} s: {before.name.lower()}{': ' + track.reason if track.reason else ''}")
        if track.consistent and track.correction is not None:
            tip = apply(track.correction.matrix @ state.T_camera_base @ state.T_base_tool, TIP)[0]
            tips.append([seen.at_s, *tip.tolist()])
        if options.pictures is not None:
            _draw(options.pictures, seen, view, track)
    return track, last, tips


def _off(track: Track, last: Seen) -> tuple[float, float, float]:
    """How far the tip and the tool's axes are off, and the tip's deviation."""
    C = track.correction
    assert C is not None  # noqa: S101 - only what is followed is told
    before = apply(last.state.T_camera_base @ last.state.T_base_tool, TIP)
    after = apply(C.matrix, before)[0]
    turned = float(np.linalg.norm(log_so3(C.matrix[:3, :3])))
    return float(np.linalg.norm(after - before[0])), turned, float(np.sqrt(np.trace(C.point_covariance(after))))


def _write_tips(path: Path, tips: list[list[float]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", "x", "y", "z"])
        writer.writerows([[f"{at_s:.6f}", *(f"{x:.7f}" for x in place)] for at_s, *place in tips])


def _draw(folder: Path, seen: Seen, view: View, track: Track) -> None:
    """Both images with the outline as told (yellow) and as found (green)."""
    folder.mkdir(parents=True, exist_ok=True)
    found: Float64[np.ndarray, "4 4"] | None = track.correction.matrix if track.correction is not None else None
    images = []
    for image, eye_x in ((seen.left, 0.0), (seen.right, seen.camera.baseline)):
        drawn = image.copy()
        for C, colour in ((np.eye(4), BEFORE), (found, AFTER)):
            if C is not None:
                for u, v in outline(seen.camera, view.parts(C), eye_x).px:
                    cv2.circle(drawn, (round(u), round(v)), 2, colour, -1)
        images.append(drawn)
    cv2.imwrite(str(folder / f"{seen.at_s:.2f}.jpg"), np.hstack(images))
