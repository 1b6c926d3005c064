"""What is known of a suture needle: what both images show of it, and its pose."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from schemas.checks import check_message, require
from schemas.messages.grasping import check_pose
from schemas.messages.imaging import FrameStamp, Image, RectifiedStereo
from schemas.messages.running import Consumed
from schemas.messages.thread import Centrelines, Status
from schemas.shown import Shown, Shows


@dataclass(frozen=True)
class NeedleView:
    """What one eye sees around a needle: lines that look like needle or thread.

    Fields:
        lines: their middle in the rectified image; none where neither eye sees a needle.
        needle: of each point, how much of it looks like needle and not like thread, 0 to 1.
        colour_bgr: of each point; blue, green, red.
        instruments: what hides a needle: a smaller copy of the image, as in `Occluders`.
    """

    lines: Centrelines
    needle: Float64[np.ndarray, "n"]
    colour_bgr: UInt8[np.ndarray, "n 3"]
    instruments: Image

    def __post_init__(self) -> None:
        check_message(self)
        counts = {len(self.lines.point_px), len(self.needle), len(self.colour_bgr)}
        require(len(counts) == 1, "every point has a share of needle and a colour")
        require(bool(((self.needle >= 0) & (self.needle <= 1)).all()), "a share lies within 0 and 1")


@dataclass(frozen=True)
class NeedleObservations:
    """What both rectified images of a pair show around a needle."""

    stamp: FrameStamp
    camera: RectifiedStereo
    left: NeedleView
    right: NeedleView
    consumed: tuple[Consumed, ...] = ()

    def __post_init__(self) -> None:
        check_message(self)


@dataclass(frozen=True)
class NeedlePose(Shows):
    """A curved needle as an arc of a circle. A failure has a reason, and no pose.

    Fields:
        T_camera_needle: its frame: the middle of the circle, x towards the swage, where the thread enters it, and z
            such that the needle runs from x towards y. Lengths in the calibration's unit. None where it is not known.
        radius: of the circle, in the calibration's unit; 0 likewise.
        arc_rad: from swage to point; 0 likewise.
        covariance: of the middle (3), a small turn about it (3, as a rotation vector, both in the camera frame), the
            radius and arc_rad; zeros likewise.
        ends_seen: whether the swage and the point are in view; what is hidden is told as far as a needle of its kind
            reaches, with the deviation that this has.
        swage_probability: that x points to the swage, and not to the point.
        seen_rad: how much of the arc both eyes see.
        residual_px: root mean square of what is seen, across the arc.
    """

    stamp: FrameStamp
    camera: RectifiedStereo
    status: Status
    reason: str
    T_camera_needle: Float64[np.ndarray, "4 4"] | None
    radius: float
    arc_rad: float
    covariance: Float64[np.ndarray, "8 8"]
    ends_seen: Bool[np.ndarray, "2"]
    swage_probability: float
    seen_rad: float
    residual_px: float
    consumed: tuple[Consumed, ...] = ()

    def __post_init__(self) -> None:
        check_message(self)
        known = self.status is Status.OK
        require(known == (self.reason == ""), "a failure needs a reason, and a success has none")
        require(known == (self.T_camera_needle is not None), "a needle that is known has a pose, and no other one")
        require(0 <= self.swage_probability <= 1, "a probability lies within 0 and 1")
        if self.T_camera_needle is not None:
            check_pose("NeedlePose.T_camera_needle", self.T_camera_needle)
            require(self.radius > 0 and 0 < self.arc_rad < 2 * np.pi, "a needle has a radius, and is no full circle")

    def at(self, angle: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "n 3"]:
        """Places on the arc in the camera frame, at angles from the swage in radians; none where it is not known."""
        if self.T_camera_needle is None:
            return np.zeros((0, 3))
        in_plane = self.radius * np.column_stack((np.cos(angle), np.sin(angle)))
        return self.T_camera_needle[:3, 3] + in_plane @ self.T_camera_needle[:3, :2].T

    def covariance_at(self, angle: float) -> Float64[np.ndarray, "3 3"]:
        """The covariance of the place at an angle from the swage; at `arc_rad` that of the point."""
        if self.T_camera_needle is None:
            return np.zeros((3, 3))
        arm = self.at(np.array([angle]))[0] - self.T_camera_needle[:3, 3]
        turned = np.array([[0.0, arm[2], -arm[1]], [-arm[2], 0.0, arm[0]], [arm[1], -arm[0], 0.0]])
        further = np.cross(self.T_camera_needle[:3, 2], arm) * (angle / self.arc_rad)
        J = np.column_stack((np.eye(3), turned, arm / self.radius, further))
        return J @ self.covariance @ J.T

    def shown(self) -> Shown:
        """The arc, and its ends with how well they are known."""
        if self.T_camera_needle is None:
            gone = {"arc": np.zeros((0, 3)), "swage": np.zeros((0, 3)), "point": np.zeros((0, 3))}
            return Shown(gone, {}, {}, "failed", f"the needle is not known: {self.reason}")
        ends = {"swage": 0.0, "point": self.arc_rad}
        places = {name: (self.at(np.array([angle]))[0], self.covariance_at(angle)) for name, angle in ends.items()}
        unseen = [name for name, seen in zip(ends, self.ends_seen, strict=True) if not seen]
        hidden = f"; out of view: {', '.join(unseen)}" if unseen else ""
        scale_mm = 1e3 * (self.camera.metres_per_unit or 1e-3)
        figures = {"radius_mm": scale_mm * self.radius, "arc_deg": float(np.degrees(self.arc_rad))}
        figures["residual_px"] = self.residual_px
        sentence = (
            f"the needle has a radius of {figures['radius_mm']:.1f} mm and {figures['arc_deg']:.0f} degrees{hidden}"
        )
        arc = self.at(np.linspace(0.0, self.arc_rad, 60))
        return Shown({"arc": arc}, places, figures, "ok", sentence)
