"""The agent that shows a rig's images, from their configured source."""

import sys
from pathlib import Path

from agents.camera.agent import Camera, CameraConfig, SceneCamera
from agents.camera.sources import ImageSource, PipeSource, Source, SourceError
from agents.camera.video import VideoSource
from agents.configuration.rig import CameraSection
from schemas.messages import ImageEncoding, Severity, StereoCalibration
from shared.calibration import CalibrationError, ReadCalibration, read_calibration
from shared.runtime.agent import Agent
from shared.runtime.session import SessionSettings


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
    if section.source == "plugin":
        from agents.camera.plugin import PluginSource

        plugin = PluginSource(section.plugin or "", section.options or {})
        try:
            return Camera(plugin, _usable(_read_calibration(section, plugin.size())), config)
        except CalibrationError:
            plugin.close()
            raise
    if section.source == "bag":
        # reading bags takes as long to load as all else
        from agents.camera.bag import BagSource

        bag = BagSource(Path(section.left or ""), section.left_topic, section.right_topic, section.loop)
        size = bag.size()
        read = _read_calibration(section, size) if section.calibration else bag.calibration(section.unit, size)
        return Camera(bag, _usable(read), config)
    if section.source == "ros":
        from agents.camera.ros import RosSource
        from agents.launch.guard_process import naming_of

        ros = RosSource(reached, naming_of(section), _topic(section.left_topic), _topic(section.right_topic))
        size = ros.size()
        read = _read_calibration(section, size) if section.calibration else ros.calibration(section.unit, size)
        return Camera(ros, _usable(read), config)
    source, size = _source(section)
    return Camera(source, _usable(_read_calibration(section, size)), config)


def _topic(name: str | None) -> str:
    """As keys have it, where ROS writes a slash before it."""
    return (name or "").strip("/")


def _source(section: CameraSection) -> tuple[Source, tuple[int, int]]:
    """The source, and the width and height of one eye's image."""
    left, right = section.left or "", section.right
    if section.source == "pipe":
        width, height = section.width or 0, section.height or 0
        stream = sys.stdin.buffer if left == "-" else Path(left).open("rb")  # noqa: SIM115
        return PipeSource(stream, width, height), (width // 2, height)
    if section.source == "video":
        # a device can be opened once only
        video = VideoSource(left, right)
        return video, video.size()
    folders = Path(left), Path(right) if right is not None else None
    return ImageSource(*folders, loop=section.loop), _size_of_first(ImageSource(*folders, loop=False))


def _size_of_first(source: Source) -> tuple[int, int]:
    pair = source.read()
    source.close()
    if pair is None:
        raise SourceError("the source gives no frame")
    return pair[0].shape[1], pair[0].shape[0]


def _read_calibration(section: CameraSection, size: tuple[int, int]) -> ReadCalibration:
    return read_calibration(section.calibration or Path(), unit=section.unit, image_size=size)


def _usable(read: ReadCalibration) -> StereoCalibration:
    for judgement in read.judgements:
        if judgement.severity is Severity.FAULT:
            raise CalibrationError(f"{judgement.finding}; {judgement.remedy}")
    return read.calibration
