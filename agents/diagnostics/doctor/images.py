"""What the doctor finds in images: in a pair from files, and in the frames of a rig that runs."""

import contextlib
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from agents.camera.image_files import ImageFileError, read_given
from agents.diagnostics.doctor.finding import UNKNOWN, Finding
from agents.diagnostics.doctor.image_answers import answers_about
from agents.perception.judging.answers import Answer
from agents.perception.judging.sequence import about_sequence
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import Severity, StereoCalibration, StereoFrame
from schemas.topics import CALIBRATION, FRAMES
from shared.calibration import CalibrationError, OtherSizeError, ReadCalibration, read_calibration
from shared.images import ImageDataError, decode_image
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped
from shared.terminal import UsageError

FRAMES_WANTED = 60
WITHIN_S = 4.0
FIRST_WITHIN_S = 1.0
"""A camera that gives nothing for so long does not run."""


@dataclass(frozen=True)
class Heard:
    """The frames that came, in their order, and the newest calibration."""

    frames: list[StereoFrame]
    calibration: StereoCalibration | None


def hear_frames(connection: Connection, wanted: int = FRAMES_WANTED, within_s: float = WITHIN_S) -> Heard:
    """As many frames as are wanted, or as come in time."""
    frames, calibrations, came = list[StereoFrame](), list[StereoCalibration](), threading.Condition()

    def take(tapped: Tapped) -> None:
        with contextlib.suppress(MessageError), came:
            if tapped.topic is FRAMES and len(frames) < wanted:
                frames.append(decode(StereoFrame, tapped.payload))
            elif tapped.topic is CALIBRATION:
                calibrations.append(decode(StereoCalibration, tapped.payload))
            came.notify_all()

    with connection.listening((FRAMES, CALIBRATION), take), came:
        came.wait_for(lambda: bool(frames), FIRST_WITHIN_S)
        if frames:
            came.wait_for(lambda: len(frames) >= wanted and bool(calibrations), within_s)
        ordered = sorted(frames, key=lambda frame: frame.stamp.sequence)
        return Heard(ordered, calibrations[-1] if calibrations else None)


IMAGES = "images"


@dataclass(frozen=True)
class PairFiles:
    """Where a pair and its calibration lie: two images, or one side by side; `unit` where the calibration has none."""

    left: Path | None
    right: Path | None
    stereo: Path | None
    calibration: tuple[Path, ...]
    unit: str | None

    @property
    def given(self) -> bool:
        """Whether a pair is to be looked at rather than a rig."""
        return any((self.left, self.right, self.stereo, self.calibration))


def examine_images(files: PairFiles) -> Iterator[Finding]:
    """Look at a pair from files, with its calibration.

    Raises:
        UsageError: where the files are no pair with its calibration.
    """
    if not 1 <= len(files.calibration) <= 2:
        raise UsageError("give the --calibration of the camera: one path, or two (left and right)")
    try:
        images = read_given(files.left, files.right, files.stereo)
    except ImageFileError as error:
        yield _wrong(IMAGES, str(error), "give both images of one frame, of one size")
        return
    height, width = images[0].shape[:2]
    try:
        read = _calibration(files, (width, height))
    except CalibrationError as error:
        yield _wrong("calibration", str(error), "give the calibration of the camera that took these images")
        return
    for judgement in read.judgements:
        remedy = "" if judgement.severity is Severity.NOTE else _plain(judgement.remedy)
        yield Finding("calibration", _plain(judgement.finding), remedy)
    yield from findings(answers_about(images, read.calibration))


def examine_frames(connection: Connection) -> Iterator[Finding]:
    """Look at some seconds of a running camera's frames, and judge the last of them."""
    heard = hear_frames(connection)
    if not heard.frames:
        yield Finding(IMAGES, f"{UNKNOWN}, for no frame came from a camera")
        return
    try:
        pairs = [(decode_image(frame.left), decode_image(frame.right)) for frame in heard.frames]
    except ImageDataError as error:
        yield Finding(IMAGES, str(error), "restart the camera, and check its link")
        return
    yield from findings(about_sequence(pairs, [frame.stamp for frame in heard.frames]))
    if heard.calibration is None:
        yield Finding("calibration", f"{UNKNOWN}, for none came with the frames, and no pair is judged without one")
        return
    yield from findings(answers_about(pairs[-1], heard.calibration))


def findings(answers: Iterable[Answer]) -> Iterator[Finding]:
    """Each answer as the doctor tells it."""
    for answer in answers:
        if answer.wrong is None:
            yield Finding(f"{IMAGES}, {answer.question}", answer.found)
        else:
            remedy = f"{answer.wrong.remedy} ({answer.wrong.severity.name.lower()} {answer.wrong.code})"
            yield Finding(f"{IMAGES}, {answer.question}", answer.found, remedy)


def _calibration(files: PairFiles, size: tuple[int, int]) -> ReadCalibration:
    try:
        return read_calibration(files.calibration, unit=files.unit, image_size=size)
    except OtherSizeError as error:
        # a question to the images like any other: they may be scaled, or cropped
        return read_calibration(files.calibration, unit=files.unit, image_size=error.size)


def _wrong(what: str, error: str, otherwise: str) -> Finding:
    """What cannot be read, with the remedy that the error names, or else another one."""
    found, _, remedy = error.partition("; ")
    return Finding(what, found, remedy or otherwise)


def _plain(sentence: str) -> str:
    return sentence[:1].lower() + sentence[1:].rstrip(".")
