"""Small pictures of what the left camera saw around each grasp, with the thread as it was known then.

The recording is read a second time for them: which frames matter is known only at its end, and images are too large to
be kept until then.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from agents.session_report.grasps import event_name
from agents.session_report.session import Session
from schemas.messages import GraspPlan, Status, StereoCalibration, StereoFrame, ThreadReconstruction
from schemas.topics import CALIBRATION, FRAMES, THREAD
from shared.arc_length import length, parameters_at
from shared.camera import is_rectified, project
from shared.images import ImageDataError, decode_image
from shared.recording.mcap_file import UntilDamage
from shared.splines import evaluate

WIDTH_PX, JPEG_QUALITY = 400, 80
MOST_PICTURES = 120
CURVE_POINTS = 200
PLANNED = "planned from"
THREAD_BGR, CAPTURE_BGR, GOAL_BGR = (80, 255, 80), (0, 200, 255), (255, 255, 255)


@dataclass(frozen=True)
class Wanted:
    """A moment of a grasp (counted from 1) that is worth a picture."""

    grasp: int
    what: str
    at_ns: int
    plan: GraspPlan | None


@dataclass
class Picture:
    """The newest frame at that moment, made small; colour is blue first."""

    of: Wanted
    captured_ns: int
    full_width: int
    pixels: UInt8[np.ndarray, "h w 3"]

    @property
    def jpeg(self) -> bytes:
        """The picture as a page holds it."""
        return cv2.imencode(".jpg", self.pixels, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


@dataclass
class _Seen:
    frame: StereoFrame | None = None
    thread: ThreadReconstruction | None = None
    rectified: bool = False
    pictures: list[Picture] = field(default_factory=list[Picture])

    def learn(self, thread: ThreadReconstruction) -> None:
        """Take a thread; it is drawn into what it was made from, where a plan was made from that."""
        self.thread = thread
        for picture in self.pictures:
            if picture.of.what == PLANNED and picture.captured_ns == thread.stamp.capture_left_ns:
                self.draw(picture, thread)

    def take(self, frame: StereoFrame, wanted: Wanted) -> None:
        """Keep a picture of a frame, if it can be decoded."""
        try:
            pixels = decode_image(frame.left)
        except ImageDataError:
            return
        small = _shrunk(pixels if pixels.ndim == 3 else cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR))
        picture = Picture(wanted, frame.stamp.capture_left_ns, frame.left.width, small)
        self.pictures.append(picture)
        if wanted.what != PLANNED and self.thread is not None:
            self.draw(picture, self.thread)

    def draw(self, picture: Picture, thread: ThreadReconstruction) -> None:
        """Draw a thread, which is known in rectified pixels alone."""
        if self.rectified:
            _draw_thread(picture.pixels, thread, picture.of.plan, picture.full_width)


def moments(session: Session) -> list[Wanted]:
    """The moments of all grasps that went on to a plan, in the order of their times."""
    wanted: list[Wanted] = []
    for number, grasp in enumerate(session.grasps, 1):
        plan = grasp.plan
        if plan is not None:
            wanted.append(Wanted(number, PLANNED, plan.stamp.capture_left_ns, plan))
        for arming in grasp.armings:
            wanted += [Wanted(number, event_name(event), event.at_ns, plan) for event in arming.events]
            if arming.judgement is not None:
                wanted.append(Wanted(number, "judged", arming.judgement.at_ns, plan))
    return sorted(wanted, key=lambda one: one.at_ns)


def pictures_of(session: Session) -> list[Picture]:
    """Pictures of the first moments, as many as a page can bear; fewer where frames are missing or damaged."""
    waiting = moments(session)[:MOST_PICTURES]
    seen = _Seen()
    for _, message in UntilDamage(session.path).messages(CALIBRATION, FRAMES, THREAD):
        if not waiting and not _undrawn(seen):
            break
        if isinstance(message, StereoCalibration):
            seen.rectified = is_rectified(message)
        elif isinstance(message, ThreadReconstruction):
            seen.learn(message)
        elif isinstance(message, StereoFrame):
            while waiting and seen.frame and waiting[0].at_ns < message.stamp.capture_left_ns:
                seen.take(seen.frame, waiting.pop(0))
            seen.frame = message
    for wanted in waiting:
        if seen.frame:
            seen.take(seen.frame, wanted)
    return seen.pictures


def _undrawn(seen: _Seen) -> bool:
    """Whether the thread of the last frame that was kept is still to come."""
    thread_ns = seen.thread.stamp.capture_left_ns if seen.thread else 0
    return any(picture.of.what == PLANNED and picture.captured_ns > thread_ns for picture in seen.pictures)


def _shrunk(pixels: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h2 w2 3"]:
    height, width = pixels.shape[:2]
    if width <= WIDTH_PX:
        return pixels.copy()
    size = WIDTH_PX, max(1, round(height * WIDTH_PX / width))
    return cv2.resize(pixels, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)


def _draw_thread(
    small: UInt8[np.ndarray, "h w 3"], thread: ThreadReconstruction, plan: GraspPlan | None, full_width: int
) -> None:
    """The curve in green, where the plan captures in yellow and where it grasps in white."""
    if thread.status is not Status.OK or thread.camera.image_width != full_width:
        return
    scale = small.shape[1] / full_width
    line = _pixels(thread, np.linspace(0.0, 1.0, CURVE_POINTS)) * scale
    if not np.isfinite(line).all() or np.abs(line).max() > 1e6:
        return
    cv2.polylines(small, [np.round(line * 16).astype(np.int32)], False, THREAD_BGR, 1, cv2.LINE_AA, 4)
    for s, colour in _places(plan):
        u, v = np.round(_pixels(thread, np.array([s]))[0] * scale).astype(int)
        cv2.circle(small, (int(u), int(v)), 5, colour, 1, cv2.LINE_AA)


def _places(plan: GraspPlan | None) -> Iterator[tuple[float, tuple[int, int, int]]]:
    if plan is not None:
        for s, colour in ((plan.s_capture, CAPTURE_BGR), (plan.s_goal, GOAL_BGR)):
            if s is not None:
                yield s, colour


def _pixels(thread: ThreadReconstruction, s: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n 2"]:
    """Left pixels at shares of the arc length."""
    knots, points, degree = thread.knots, thread.control_points_camera, thread.degree
    at = parameters_at(knots, points, degree, s * length(knots, points, degree))
    with np.errstate(all="ignore"):
        return project(thread.camera, evaluate(knots, points, degree, at))[0]
