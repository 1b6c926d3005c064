"""Pictures of an evaluation: what became of the goals on each thread, and the moments of one grasp."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from agents.camera.sources import Pair
from agents.cli.evaluate.scenes import scenery_of
from agents.cli.evaluate.views import FieldView
from agents.simulated_trials.look import Came
from agents.simulated_trials.protocol import Laid, Protocol, threads_of
from agents.simulated_trials.report import Picture
from schemas.codec import decode
from schemas.messages import ExecutionEvent, ExecutionKind, RobotState, SimulatorState
from schemas.topics import EXECUTION, ROBOT_STATE, SIMULATOR_STATE, topic_of
from shared.recording.mcap_file import Entry
from shared.rendering.render import SceneError

Bgr = UInt8[np.ndarray, "h w 3"]
COLOUR = {"held": (80, 200, 80), "failed": (60, 60, 230), "declined": (150, 150, 150)}
WHITE = (255, 255, 255)
QUALITY = 82
CROP_PX = 300


def field_pictures(protocol: Protocol, came: Sequence[Came], folder: Path) -> list[Picture]:
    """One for each thread and row that anything was tried on, of the threads where something failed first."""
    pictures: list[Picture] = []
    for laid in threads_of(protocol):
        own = [one for one in came if one.trial.laid == laid]
        rows = dict.fromkeys((one.trial.method, one.trial.policy) for one in own if one.goal_px)
        if not rows:
            continue
        try:
            image = scenery_of(protocol, laid, folder).images[0]
        except SceneError:
            continue
        for method, policy in rows:
            some = [one for one in own if (one.trial.method, one.trial.policy) == (method, policy)]
            pictures.append(_field(laid, f"{method}, {policy}", image, some))
    return pictures


def moments(view: FieldView, entries: Sequence[Entry]) -> list[tuple[str, Bgr]]:
    """The left image at the end of each phase of each grasp, around the jaws, with the phase's name."""
    arm: RobotState | None = None
    field: SimulatorState | None = None
    found: list[tuple[str, Bgr]] = []
    for entry in entries:
        topic = topic_of(entry.key)
        if topic is ROBOT_STATE:
            arm = decode(RobotState, entry.payload)
        elif topic is SIMULATOR_STATE:
            field = decode(SimulatorState, entry.payload)
        elif topic is EXECUTION and arm is not None and field is not None:
            event = decode(ExecutionEvent, entry.payload)
            if event.kind is ExecutionKind.PHASE_REACHED and event.phase is not None:
                found.append((event.phase.name.lower(), _around(view.pair(field, len(found), arm), arm, field)))
    return found


def strip(named: Sequence[tuple[str, Bgr]]) -> Bgr:
    """Pictures side by side, each under its name; what begins again with the first name is a row of its own."""
    rows: list[list[Bgr]] = []
    for name, image in named:
        under = image.copy()
        cv2.putText(under, name, (8, 22), cv2.FONT_HERSHEY_SIMPLEX, 0.6, WHITE, 2, cv2.LINE_AA)
        if name == named[0][0]:
            rows.append([])
        rows[-1].append(under)
    longest = max(map(len, rows))
    blank = np.full_like(named[0][1], 255)
    return np.vstack([np.hstack([*row, *[blank] * (longest - len(row))]) for row in rows])


def _around(pair: Pair, arm: RobotState, field: SimulatorState) -> Bgr:
    """The left image around the jaws."""
    image, camera = pair[0], field.camera
    pin = (arm.T_camera_base @ arm.T_base_tool)[:3, 3]
    u = round(camera.fx_px * pin[0] / pin[2] + camera.cx_px)
    v = round(camera.fy_px * pin[1] / pin[2] + camera.cy_px)
    left = int(np.clip(u - CROP_PX // 2, 0, image.shape[1] - CROP_PX))
    top = int(np.clip(v - CROP_PX // 2, 0, image.shape[0] - CROP_PX))
    return image[top : top + CROP_PX, left : left + CROP_PX]


def _field(laid: Laid, row: str, image: Bgr, came: Sequence[Came]) -> Picture:
    drawn = image.copy()
    for one in came:
        goal = _place(one.goal_px)
        if goal is None:
            continue
        capture = _place(one.capture_px)
        if capture is not None and capture != goal:
            cv2.line(drawn, capture, goal, COLOUR[one.outcome], 1, cv2.LINE_AA)
        cv2.circle(drawn, goal, 6, WHITE, -1, cv2.LINE_AA)
        cv2.circle(drawn, goal, 5, COLOUR[one.outcome], -1, cv2.LINE_AA)
    held = sum(one.outcome == "held" for one in came)
    tried = sum(one.outcome != "declined" for one in came)
    caption = f"{laid.name}: {row}, {held} of {tried} held, {len(came) - tried} declined"
    _, data = cv2.imencode(
        ".jpg",
        cv2.resize(drawn, None, fx=0.625, fy=0.625, interpolation=cv2.INTER_AREA),
        [cv2.IMWRITE_JPEG_QUALITY, QUALITY],
    )
    return Picture(caption, data.tobytes())


def _place(pixel: tuple[float, float] | None) -> tuple[int, int] | None:
    return None if pixel is None else (round(pixel[0]), round(pixel[1]))
