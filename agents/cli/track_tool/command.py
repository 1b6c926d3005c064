"""`suturegrasp track-tool`: where a tool is in the images, and what that says of the registration."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64

from agents.cli.places import check_new
from agents.cli.recordings.options import TrackTool
from agents.cli.track_tool.input import Seen, seen_in, seen_live
from agents.configuration.this_host import rig_of
from agents.launch.process import EXIT_OK, EXIT_UNUSABLE, stopping
from agents.tool_tracker.correction import Correction
from agents.tool_tracker.outline import outline
from agents.tool_tracker.refinement import View
from agents.tool_tracker.search import soft_pair
from agents.tool_tracker.track import Following, Track, begun, followed
from shared.calibration.made import MADE, made_text
from shared.kinematics.psm import FINGER_M
from shared.rigid_transforms import apply, log_so3
from shared.runtime.connection import connected
from shared.terminal import UsageError, complain, say, warn

EXIT_DRIFTED, EXIT_NOT_FOUND = 1, 3
FOLLOWING_S, SEARCHING_S = 0.2, 0.4
TIP = np.array([[0.0, 0.0, FINGER_M]])
BEFORE, AFTER = (0, 220, 255), (0, 255, 0)


def run(options: TrackTool) -> int:
    """Follow the tool, and tell; the exit status."""
    for path in (options.output, options.tips):
        if path is not None:
            check_new(path)
    if options.live == (options.recording is not None):
        raise UsageError("give a recording, or --live")
    told = _Told(options)
    for seen in _seen(options):
        told.look(seen)
        if told.views == options.views:
            break
    if options.tips is not None:
        _write_tips(options.tips, told.tips)
    return told.conclusion()


def _seen(options: TrackTool) -> Iterator[Seen]:
    """Frames of the recording, or of the rig until stopped."""
    if options.recording is not None:
        yield from seen_in(options.recording, options.arm, options.delay_ms)
        return
    stopped = stopping()
    with connected(rig_of(options.config, options.host).session) as connection:
        yield from seen_live(connection, options.arm, options.delay_ms, stopped)


class _Told:
    """What was seen so far, and what was said of it."""

    def __init__(self, options: TrackTool) -> None:
        self._options, self.tips = options, list[list[float]]()
        self._track: Track | None = None
        self._last: Seen | None = None
        self._next_s, self._said, self._drifted, self.views = -np.inf, "", False, 0

    def look(self, seen: Seen) -> None:
        """Look at a frame, unless it came while the one before would still be looked at."""
        if seen.at_s < self._next_s:
            return
        placed, last = seen.placed, self._last
        view = View(seen.camera, (), placed.T_camera_base, placed.T_base_tool, placed.jaw_rad)
        waited_s = FOLLOWING_S if last is None else max(seen.at_s - last.at_s, 0.0)
        track = followed(self._track or begun(view), soft_pair(seen.left, seen.right), view, waited_s, 0)
        self._next_s = seen.at_s + (FOLLOWING_S if track.state is Following.FOLLOWED else SEARCHING_S)
        self._track, self._last, self.views = track, seen, self.views + 1
        if (said := track.state.name.lower()) != self._said:
            self._said = said
            say(f"{seen.at_s:.2f} s: {said}{': ' + track.reason if track.reason else ''}")
        if track.consistent and track.correction is not None:
            tip = apply(track.correction.matrix @ placed.T_camera_base @ placed.T_base_tool, TIP)[0]
            self.tips.append([seen.at_s, *tip.tolist()])
            self._judge(_off(track.correction, seen)[0])
        if self._options.pictures is not None:
            _draw(self._options.pictures, seen, view, track)

    def _judge(self, off_m: float) -> None:
        """Warn once when the registration is off, and say when it no longer is."""
        limit_m = 1e-3 * self._options.limit
        if not self._drifted and off_m > limit_m:
            self._drifted = True
            warn(
                f"the registration is {1e3 * off_m:.1f} mm off, more than the {self._options.limit:g} mm allowed: "
                "calibrate it again, or use the corrected one"
            )
        elif self._drifted and off_m < 0.8 * limit_m:
            self._drifted = False
            say(f"the registration is {1e3 * off_m:.1f} mm off again, which is allowed")

    def conclusion(self) -> int:
        """Say how it stands at the end; the exit status."""
        options, track, last = self._options, self._track, self._last
        if last is None or track is None:
            return complain(f"no frame has a state of {options.arm} of its time", EXIT_UNUSABLE)
        if track.state is not Following.FOLLOWED or track.correction is None:
            return complain(f"the tool of {options.arm} was not found, or was lost: {track.reason}", EXIT_NOT_FOUND)
        off_m, off_rad, deviation_m = _off(track.correction, last)
        told = f"{1e3 * off_m:.1f} mm and {np.degrees(off_rad):.1f} degrees"
        say(f"the tool is {told} from where registration and joints have it (deviation {1e3 * deviation_m:.1f} mm)")
        if options.output is not None:
            corrected = {
                MADE: made_text(round(1e9 * last.at_s)),
                "T_camera_base": (track.correction.matrix @ last.placed.T_camera_base).tolist(),
                "unit": "m",
                "calibration_id": last.calibration_id,
            }
            options.output.write_text(json.dumps(corrected) + "\n", encoding="utf-8")
            say(f"written to {options.output}, corrected; set T_camera_base_file to it in the arm's section of the rig")
        return EXIT_DRIFTED if self._drifted else EXIT_OK


def _off(correction: Correction, last: Seen) -> tuple[float, float, float]:
    """How far the tip and the tool's axes are off, and the tip's deviation."""
    before = apply(last.placed.T_camera_base @ last.placed.T_base_tool, TIP)
    after = apply(correction.matrix, before)[0]
    turned = float(np.linalg.norm(log_so3(correction.matrix[:3, :3])))
    return (
        float(np.linalg.norm(after - before[0])),
        turned,
        float(np.sqrt(np.trace(correction.point_covariance(after)))),
    )


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
