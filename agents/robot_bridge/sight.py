"""How old the newest camera frame is, by the bridge's clock: a motion must not go on where nobody sees it.

Frames echo the bridge's challenges (presence.py). A frame that echoes a challenge was taken after that was issued, so
the time since then bounds its age, and a queue that is as long all the time cannot make an old frame pass for a new
one. A camera that tells no frames at all is an older recording's, or a simulated arm's without one: nothing is known
then, which speaks against moving a real arm alone.
"""

from agents.robot_bridge.refusals import Code, Refusal
from schemas.messages import FrameStamp


class Sight:
    """What one arm's bridge has been told of frames."""

    def __init__(self, arm: str, is_real: bool) -> None:
        self._arm, self._is_real = arm, is_real
        self._newest: FrameStamp | None = None

    def hear(self, stamp: FrameStamp) -> None:
        """A frame was taken."""
        self._newest = stamp

    def refusal(self, now_ns: int, maximum_age_s: float) -> Refusal | None:
        """Why nobody may be moved by what the camera shows; None where it is new enough."""
        if self._newest is None:
            silent = "no camera has told of a frame yet: see that the camera runs, and that it is of this version"
            return Refusal(Code.FRAME_AGE, silent) if self._is_real else None
        return too_old(self._newest, self._arm, self._is_real, now_ns, maximum_age_s, "the newest camera frame")


def too_old(stamp: FrameStamp, arm: str, is_real: bool, now_ns: int, maximum_age_s: float, what: str) -> Refusal | None:
    """Why a frame is too old to be moved by; None where it is not. Without an echo its own clock is believed."""
    echo_ns = stamp.echo_of(arm)
    if echo_ns == 0 and is_real:
        blind = f"{what} echoes no challenge of {arm}, so that nobody knows how old it is"
        return Refusal(Code.FRAME_AGE, f"{blind}: see that the camera's agent hears the bridge of {arm}")
    since_ns = echo_ns or min(stamp.capture_left_ns, stamp.capture_right_ns)
    age_s = (now_ns - since_ns) * 1e-9
    if echo_ns and age_s < 0:
        return Refusal(
            Code.FRAME_AGE, f"{what} echoes a challenge of before the bridge's clock was set: wait for another"
        )
    if age_s <= maximum_age_s:
        return None
    old = f"{what} is {age_s:.1f} s old, and {maximum_age_s:g} s are allowed"
    return Refusal(Code.FRAME_AGE, f"{old}: see to the camera and its link, then plan again")
