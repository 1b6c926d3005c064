"""The states of one arm in a recording."""

from pathlib import Path

from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import RobotState
from schemas.topics import ROBOT_STATE, topic_of
from shared.recording.entry import RecordingError
from shared.recording.mcap_file import read_recording


def arm_states(path: Path, arm: str) -> list[RobotState]:
    """All of them, in order.

    Raises:
        RecordingError, OSError: where it is no recording, or holds none that can be read.
    """
    entries = (entry for entry in read_recording(path) if topic_of(entry.key) is ROBOT_STATE)
    try:
        states = [decode(RobotState, entry.payload) for entry in entries if entry.key.split("/")[3] == arm]
    except MessageError as error:
        raise RecordingError(f"{path}: {error}") from None
    if not states:
        raise RecordingError(f"{path}: it holds no state of an arm {arm!r}")
    return states
