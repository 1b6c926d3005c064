"""Images, when they were taken, and the cameras that took them."""

import enum
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from schemas.checks import UInt32, UInt64, check_message, require
from schemas.messages.running import Consumed

ROTATION_TOLERANCE = 1e-2
"""How far `R Rᵀ` may be from the identity before a matrix is no rotation at all. Text files keep four digits, and
what is merely imprecise is judged and repaired where it is read."""
LARGEST_SIDE_PX = 1 << 14
"""Twice the side of an 8K image: a greater size in a calibration is a slip, and maps made for it fill the memory."""


class ImageEncoding(enum.Enum):
    """How the bytes of an image are to be read; RAW is rows of pixels, channels interleaved, blue first."""

    RAW = 1
    PNG = 2
    JPEG = 3


@dataclass(frozen=True)
class Image:
    """An image as it travels: encoded bytes, with the size they decode to. Colour is blue first.

    Fields:
        data: of a large raw image that was received, a read-only view of the message.
    """

    encoding: ImageEncoding
    width: UInt32
    height: UInt32
    channels: UInt32
    data: bytes

    def __post_init__(self) -> None:
        check_message(self)
        require(self.width > 0 and self.height > 0, f"Image size must be positive, not {self.width}x{self.height}")
        require(self.channels in (1, 3), f"Image.channels must be 1 or 3, not {self.channels}")
        expected = self.width * self.height * self.channels
        if self.encoding is ImageEncoding.RAW:
            require(
                len(self.data) == expected,
                f"Image.data holds {len(self.data)} bytes where a raw image of this size has {expected}",
            )
        else:
            object.__setattr__(self, "data", bytes(self.data))
            require(len(self.data) > 0, "Image.data is empty")


@dataclass(frozen=True)
class ChallengeEcho:
    """The newest challenge of an arm's bridge that the camera had heard when it took a frame.

    A challenge is the time at which the bridge issued it, by the bridge's own clock. So the frame is no older by that
    clock than the challenge is, however far the camera's clock is off and however long the frame was on its way.
    """

    arm: str
    challenge_ns: int

    def __post_init__(self) -> None:
        check_message(self)


@dataclass(frozen=True)
class FrameStamp:
    """Which frame something descends from, and when each eye saw it.

    Fields:
        echoes: one for each arm whose bridge the camera hears.
    """

    sequence: UInt64
    capture_left_ns: int
    capture_right_ns: int
    calibration_id: str
    echoes: tuple[ChallengeEcho, ...] = ()

    def __post_init__(self) -> None:
        check_message(self)
        require(self.sequence >= 0, f"FrameStamp.sequence must not be negative, and is {self.sequence}")

    def echo_of(self, arm: str) -> int:
        """The challenge of that arm's bridge that the frame echoes; 0 where it echoes none."""
        return next((echo.challenge_ns for echo in self.echoes if echo.arm == arm), 0)


@dataclass(frozen=True)
class FrameNotice:
    """A frame was taken: its stamp alone, for whoever asks how old the newest image is and needs no image."""

    stamp: FrameStamp
    consumed: tuple[Consumed, ...] = ()

    def __post_init__(self) -> None:
        check_message(self)


@dataclass(frozen=True)
class StereoFrame:
    """A pair of images as the camera gave them, not yet rectified."""

    stamp: FrameStamp
    left: Image
    right: Image
    consumed: tuple[Consumed, ...] = ()

    def __post_init__(self) -> None:
        check_message(self)
        left, right = self.left, self.right
        require(
            (left.width, left.height) == (right.width, right.height),
            f"StereoFrame needs images of one size; left is {left.width}x{left.height}, "
            f"right is {right.width}x{right.height}",
        )


@dataclass(frozen=True)
class StereoCalibration:
    """A calibrated stereo camera: pinhole matrices, OpenCV distortion, and the way from left to right.

    `T_right_left` maps points of the left camera into the right one. Its translation, and everything that is
    measured with this calibration, is in a unit of `metres_per_unit` metres, or in an unknown one (None). What it may
    be off by is told by the covariance of the eight errors in `shared.calibration.uncertainty`; None where nobody says.
    """

    image_width: UInt32
    image_height: UInt32
    K_left: Float64[np.ndarray, "3 3"]
    K_right: Float64[np.ndarray, "3 3"]
    distortion_left: Float64[np.ndarray, "d_left"]
    distortion_right: Float64[np.ndarray, "d_right"]
    T_right_left: Float64[np.ndarray, "4 4"]
    metres_per_unit: float | None
    consumed: tuple[Consumed, ...] = ()
    covariance: Float64[np.ndarray, "8 8"] | None = None

    def __post_init__(self) -> None:
        check_message(self)
        if self.covariance is not None:
            require(bool((np.diag(self.covariance) >= 0).all()), "a variance of the calibration is negative")
            require(bool((self.covariance == self.covariance.T).all()), "the calibration's covariance is not symmetric")
        require(
            self.image_width > 0 and self.image_height > 0,
            f"the calibration's image size must be positive, not {self.image_width}x{self.image_height}",
        )
        require(
            max(self.image_width, self.image_height) <= LARGEST_SIDE_PX,
            f"the calibration is for images of {self.image_width}x{self.image_height} px, and no side may exceed "
            f"{LARGEST_SIDE_PX} px: look at the size in its file",
        )
        for name, K in (("left", self.K_left), ("right", self.K_right)):
            require(K[0, 0] > 0 and K[1, 1] > 0, f"the {name} focal lengths must be positive")
            require(bool((K[2] == (0, 0, 1)).all()), f"the last row of the {name} camera matrix must be 0 0 1")
        for name, distortion in (("left", self.distortion_left), ("right", self.distortion_right)):
            require(
                len(distortion) in (0, 4, 5, 8, 12, 14),
                f"the {name} camera has {len(distortion)} distortion coefficients; OpenCV knows 0, 4, 5, 8, 12 or 14",
            )
        R = self.T_right_left[:3, :3]
        require(bool((self.T_right_left[3] == (0, 0, 0, 1)).all()), "the last row of T_right_left must be 0 0 0 1")
        require(
            bool(np.abs(R @ R.T - np.eye(3)).max() < ROTATION_TOLERANCE and np.linalg.det(R) > 0),
            "the rotation between the cameras is no rotation: its rows are not orthonormal",
        )
        require(bool(np.linalg.norm(self.T_right_left[:3, 3]) > 0), "the baseline between the cameras is zero")
        _check_unit(self.metres_per_unit)


@dataclass(frozen=True)
class RectifiedStereo:
    """Two parallel pinhole cameras with shared intrinsics; the right one sits `baseline` along +x of the left one.

    Integer coordinates are pixel centres. `baseline` is in the calibration's unit.
    """

    image_width: UInt32
    image_height: UInt32
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    baseline: float
    metres_per_unit: float | None

    def __post_init__(self) -> None:
        check_message(self)
        require(self.image_width > 0 and self.image_height > 0, "the rectified image size must be positive")
        require(self.fx_px > 0 and self.fy_px > 0, "the rectified focal lengths must be positive")
        require(self.baseline > 0, f"the rectified baseline must be positive, not {self.baseline}")
        _check_unit(self.metres_per_unit)


def _check_unit(metres_per_unit: float | None) -> None:
    require(
        metres_per_unit is None or metres_per_unit > 0,
        f"metres_per_unit must be positive, not {metres_per_unit}",
    )
