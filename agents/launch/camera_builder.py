"""The agent that shows a rig's images, from their configured source."""

import sys
from collections.abc import Callable
from pathlib import Path

from agents.camera.agent import Camera, CameraConfig, SceneCamera
from agents.camera.sources import ImageSource, PipeSource, Source, SourceError
from agents.camera.video import VideoSource
from agents.configuration.rig import CameraSection
from schemas.messages import ImageEncoding, Severity, StereoCalibration
from shared.calibration import CalibrationError, ReadCalibration, read_calibration
from shared.runtime.agent import Agent
from shared.runtime.session import SessionSettings

Calibrated = Callable[[str | None, tuple[int, int]], ReadCalibration]


def built_camera(section: CameraSection, reached: SessionSettings) -> Agent:
    """A camera; robots' images are heard through `reached`.

    Raises:
        SourceError, ImageFileError, CalibrationError: where it has nothing to show.
    """
    config = CameraConfig(
        rate_hz=section.rate_hz,
        encoding=ImageEncoding[section.encoding.upper()],
        jpeg_quality=section.jpeg_quality,
        latency_ms=section.latency_ms,
    )
    if section.source == "scene":
        # of all sources this one alone needs what draws threads
        from agents.camera.scene_source import SceneSource, calibration_of

        return SceneCamera(SceneSource().render, lambda state: calibration_of(state.camera), config)
    source, size, own = _opened(section, reached)
    try:
        path = section.calibration or Path()
        read = own(section.unit, size) if own is not None and section.calibration is None else None
        return Camera(source, _usable(read or read_calibration(path, unit=section.unit, image_size=size)), config)
    except CalibrationError:
        source.close()
        raise


def _opened(section: CameraSection, reached: SessionSettings) -> tuple[Source, tuple[int, int], Calibrated | None]:
    """The source, the width and height of one eye's image, and what reads a calibration that the source has itself."""
    left, right = section.left or "", section.right
    match section.source:
        case "plugin":
            from agents.camera.plugin import PluginSource

            plugin = PluginSource(section.plugin or "", section.options or {})
            return plugin, plugin.size(), None
        case "bag":
            # reading bags takes as long to load as all else
            from agents.camera.bag import BagSource

            bag = BagSource(Path(left), section.left_topic, section.right_topic, section.loop)
            return bag, bag.size(), bag.calibration
        case "ros":
            from agents.camera.ros import RosSource
            from agents.launch.guard_process import naming_of

            # as keys have them, where ROS writes a slash before
            topics = ((name or "").strip("/") for name in (section.left_topic, section.right_topic))
            ros = RosSource(reached, naming_of(section), *topics)
            return ros, ros.size(), ros.calibration
        case "pipe":
            width, height = section.width or 0, section.height or 0
            stream = sys.stdin.buffer if left == "-" else Path(left).open("rb")  # noqa: SIM115
            return PipeSource(stream, width, height), (width // 2, height), None
        case "video":
            # a device can be opened once only
            video = VideoSource(left, right)
            return video, video.size(), None
        case _:
            folders = Path(left), Path(right) if right is not None else None
            return ImageSource(*folders, loop=section.loop), _size_of_first(ImageSource(*folders, loop=False)), None


def _size_of_first(source: Source) -> tuple[int, int]:
    pair = source.read()
    source.close()
    if pair is None:
        raise SourceError("the source gives no frame")
    return pair[0].shape[1], pair[0].shape[0]


def _usable(read: ReadCalibration) -> StereoCalibration:
    for judgement in read.judgements:
        if judgement.severity is Severity.FAULT:
            raise CalibrationError(f"{judgement.finding}; {judgement.remedy}")
    return read.calibration
