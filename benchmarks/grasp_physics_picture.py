"""A capture, a slide and a miss as contact physics has them, seen obliquely from the side.

    .venv/bin/python -m benchmarks.grasp_physics_picture docs/pictures/grasp_physics.webp

Each row is one trial of `benchmarks.grasp_physics`, each column a moment of it.
"""

import sys
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from agents.simulator.contact.model import FINGER_MM, THICKNESS_MM
from agents.simulator.contact.physics import ContactPhysics
from agents.simulator.contact.world import Pose
from agents.simulator.field import MM, Field
from agents.simulator.outcome import MeasuredArm
from benchmarks.grasp_physics import NO_LIMIT_N
from benchmarks.grasp_physics_trials import PERIOD_S, Trial, drawn_field, trials_of
from shared.rigid_transforms import apply
from shared.scene.surface import depth_at_points

ROWS = (("easy", 500, 0, "capture"), ("easy", 500, 1, "slide"), ("singularity", 500, 2, "miss"))
WIDTH, HEIGHT, SCALE = 260, 180, 9.0
TURN_RAD, DOWN_RAD = np.radians(35.0), np.radians(20.0)
TISSUE, METAL, THREAD, INK = (190, 185, 225), (190, 185, 175), (130, 30, 110), (40, 40, 40)


def main() -> None:
    """Draw the sheet into the file that is named."""
    sheet = np.vstack([np.hstack(row_of(*row)) for row in ROWS])
    cv2.imwrite(str(Path(sys.argv[1])), sheet, [cv2.IMWRITE_WEBP_QUALITY, 60])


def row_of(config: str, seed: int, goal: int, name: str) -> list[UInt8[np.ndarray, "h w 3"]]:
    """Four moments of a trial: the jaw open on the thread, about to close, shut, and lifted."""
    physics = ContactPhysics(drawn_field(config, seed), NO_LIMIT_N)
    trial = next(trial for trial in trials_of(physics.field, config, seed, 8) if trial.goal == goal)
    physics.lay()
    shown, found = moments(trial), []
    tip = None
    for i, (T_camera_tool, jaw_rad) in enumerate(zip(trial.T_camera_tool, trial.jaw_rad, strict=True), 1):
        outcome = physics.follow(MeasuredArm("psm1", "p", T_camera_tool, float(jaw_rad), round(1e9 * PERIOD_S * i)))
        if i in shown or outcome.settled:
            said = outcome.code.replace("_", " ").lower() if outcome.settled else f"{name}, {PERIOD_S * i:.2f} s"
            in_mm = T_camera_tool.copy()
            in_mm[:3, 3] /= MM
            if tip is None:
                tip = apply(in_mm, np.array([[0.0, 0.0, FINGER_MM]]))[0]
            found.append(drawn(physics.field, Pose(in_mm, float(jaw_rad)), tip, said))
        if outcome.settled:
            break
    return found


def moments(trial: Trial) -> list[int]:
    """When the jaw is widest last, when it begins to close from its opening for a slide, and when it is shut first."""
    degrees = np.degrees(trial.jaw_rad)
    after = int(np.argmax(degrees))
    wide = int(np.flatnonzero(degrees > degrees.max() - 0.1)[-1])
    shut = int(np.flatnonzero((degrees < 0.05) & (np.arange(len(degrees)) > after))[0])
    still = np.flatnonzero(np.abs(np.diff(degrees[wide:shut])) < 1e-3)
    return [wide, wide + int(still[-1]) if len(still) else (wide + shut) // 2, shut]


def drawn(field: Field, pose: Pose, tip: Float64[np.ndarray, "3"], said: str) -> UInt8[np.ndarray, "h w 3"]:
    """The field about a place, with the fingers at a pose; in millimetres."""
    right = pose.T_camera_tool[:3, 1] * np.cos(TURN_RAD) + pose.T_camera_tool[:3, 0] * np.sin(TURN_RAD)
    right[2] = 0.0
    right /= np.linalg.norm(right)
    away = np.cross(np.array([0.0, 0.0, 1.0]), right)
    down = np.array([0.0, 0.0, np.cos(DOWN_RAD)]) - away * np.sin(DOWN_RAD)
    image = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)

    def pixels(points: Float64[np.ndarray, "n 3"]) -> np.ndarray:
        at = (points - tip) @ np.column_stack((right, down)) * SCALE + (WIDTH / 2, 0.62 * HEIGHT)
        return np.round(8 * at).astype(np.int32)

    across = np.linspace(-18.0, 18.0, 13)
    ground = tip + across[:, None, None] * right + across[None, :, None] * away
    ground[..., 2] = depth_at_points(field.surface, ground[..., :2].reshape(-1, 2)).reshape(13, 13)
    for strand in (*ground, *ground.swapaxes(0, 1)):
        cv2.polylines(image, [pixels(strand)], False, TISSUE, 1, cv2.LINE_AA, 3)
    faces = [apply(pose.T_camera_tool, finger(side, pose.jaw_rad)) for side in (1, -1)]
    behind, before = sorted(faces, key=lambda face: -float(face.mean(axis=0) @ away))
    fill(image, pixels(behind))
    thread = pixels(field.points / MM)
    cv2.polylines(image, [thread], False, THREAD, max(round(2e3 * field.radius_m * SCALE), 2), cv2.LINE_AA, 3)
    fill(image, pixels(before))
    cv2.putText(image, said, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, INK, 1, cv2.LINE_AA)
    return cv2.rectangle(image, (0, 0), (WIDTH - 1, HEIGHT - 1), (220, 220, 220), 1)


def finger(side: int, jaw_rad: float) -> Float64[np.ndarray, "4 3"]:
    """The corners of a finger's middle plane along the pin, in the tool frame."""
    half = 0.5 * max(jaw_rad, 0.0)
    along, out = np.array([0.0, side * np.sin(half), np.cos(half)]), np.array([0.0, side * np.cos(half), -np.sin(half)])
    back = THICKNESS_MM * out
    return np.array([0.0 * along, FINGER_MM * along, FINGER_MM * along + back, back])


def fill(image: UInt8[np.ndarray, "h w 3"], corners: np.ndarray) -> None:
    """A face with its outline."""
    cv2.fillPoly(image, [corners], METAL, cv2.LINE_AA, 3)
    cv2.polylines(image, [corners], True, INK, 1, cv2.LINE_AA, 3)


if __name__ == "__main__":
    main()
