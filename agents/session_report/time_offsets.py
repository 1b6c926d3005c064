"""By how much a recording's camera is later than the joints of each of its arms, where the arms move the most."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from agents.session_report.table import Table
from schemas.messages import RobotState
from schemas.topics import FRAMES, ROBOT_STATE
from shared.calibration.time_offset import TOO_LITTLE, TimeOffset, ToolMotion, motion_of, time_offset, windows_of
from shared.images import ImageDataError, decode_image
from shared.recording.mcap_file import UntilDamage

STRETCH_S = 60
"""So much of a recording is looked at: a second of video takes a tenth of a second."""


@dataclass(frozen=True)
class ArmOffset:
    """One arm's; None where too little moves to tell."""

    arm: str
    offset: TimeOffset | None

    @property
    def sentence(self) -> str:
        """How late the camera is, and how sure that is."""
        if self.offset is None:
            return TOO_LITTLE
        low, high = (1e3 * value for value in self.offset.interval_s)
        return f"{1e3 * self.offset.delay_s:+.0f} ms, 95 % within {low:+.0f} and {high:+.0f} ms"


def time_offsets(path: Path) -> tuple[ArmOffset, ...]:
    """Each arm's of a recording.

    Raises:
        RecordingError, OSError: as `read_recording`.
    """
    states: dict[str, dict[int, RobotState]] = {}
    for _, state in UntilDamage(path).messages(ROBOT_STATE):
        states.setdefault(state.arm, {})[state.measured_ns] = state
    motions = {arm: motion_of(of_arm) for arm, of_arm in sorted(states.items()) if len(of_arm) > 1}
    if not motions:
        return ()
    begin_s = _most_motion(list(motions.values()))
    windows = list(windows_of(_images(path, begin_s, begin_s + STRETCH_S)))
    return tuple(ArmOffset(arm, time_offset(windows, motion)) for arm, motion in motions.items())


def offset_table(offsets: tuple[ArmOffset, ...]) -> Table:
    """A row for each arm."""
    rows = tuple((one.arm, one.sentence) for one in offsets) or (("none", "the recording holds no states of an arm"),)
    return Table("the camera's stamps are later than the joints' by", ("arm", "by"), rows)


def _most_motion(motions: list[ToolMotion]) -> float:
    """Where the STRETCH_S begin in which a tool goes the farthest."""
    return max((_farthest(motion) for motion in motions), key=lambda way: way[0])[1]


def _farthest(motion: ToolMotion) -> tuple[float, float]:
    """How far this tool goes at most within STRETCH_S, and where that begins."""
    way_m = np.linalg.norm(np.diff(motion.T_base_tool[:, :3, 3], axis=0), axis=1)
    so_far = np.concatenate((np.zeros(1), np.cumsum(way_m)))
    last = np.searchsorted(motion.time_s, motion.time_s + STRETCH_S, side="right") - 1
    begin = int((so_far[last] - so_far).argmax())
    return float(so_far[last[begin]] - so_far[begin]), float(motion.time_s[begin])


def _images(path: Path, begin_s: float, end_s: float) -> Iterator[tuple[float, UInt8[np.ndarray, "h w *c"]]]:
    before_s = -np.inf
    for _, frame in UntilDamage(path).messages(FRAMES):
        at_s = frame.stamp.capture_left_ns * 1e-9
        if not begin_s <= at_s <= end_s or at_s <= before_s:
            continue
        try:
            yield at_s, decode_image(frame.left)
        except ImageDataError:
            continue
        before_s = at_s
