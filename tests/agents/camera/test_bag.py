"""Bags of ROS 1 and ROS 2 that rosbags wrote, with frames that are missing too."""

import contextlib
import itertools

import cv2
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from agents.camera.agent import Camera
from agents.camera.bag import BagSource
from agents.camera.sources import SourceError
from agents.configuration.rig import CameraSection, RigConfig
from agents.launch.builders import build
from schemas.messages import FrameNotice, StereoCalibration, StereoFrame
from shared.calibration import CalibrationError
from shared.runtime.agent import Output, Tick

WIDTH, HEIGHT, PERIOD_NS, BASELINE = 64, 48, 100_000_000, 0.005
START_NS = 1_700_000_000_000_000_000
ENCODINGS = ["bgr8", "rgb8", "mono8", "bgra8", "rgba8", "mono16", "bayer_rggb8", "compressed"]
both_versions = pytest.mark.parametrize("version", [1, 2])


class Bag:
    """Writes a bag with both eyes of a camera."""

    def __init__(self, folder, version):
        self.path = folder / ("session.bag" if version == 1 else "session")
        self._types = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
        self._version, self._number = version, itertools.count()
        self._writer = Writer1(self.path) if version == 1 else Writer2(self.path, version=9)
        self._writer.open()
        self._connections = {}

    def _type(self, name):
        return self._types.types[name]

    def header(self, taken_ns, frame):
        stamp = self._type("builtin_interfaces/msg/Time")(*divmod(taken_ns, 1_000_000_000))
        number = {"seq": next(self._number)} if self._version == 1 else {}
        return self._type("std_msgs/msg/Header")(stamp=stamp, frame_id=frame, **number)

    def write(self, topic, name, at_ns, message):
        """One message of any type."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, name, typestore=self._types)
        serialize = self._types.serialize_ros1 if self._version == 1 else self._types.serialize_cdr
        self._writer.write(self._connections[topic], at_ns, serialize(message, name))

    def image(self, topic, taken_ns, grey, encoding="bgr8", padding=0, late_ns=0):
        """A plain image, with that many bytes behind every row; stamped 0 where it does not know when it was taken."""
        header = self.header(taken_ns, "eye")
        if encoding == "compressed":
            name = "sensor_msgs/msg/CompressedImage"
            data = cv2.imencode(".png", np.full((HEIGHT, WIDTH, 3), grey, np.uint8))[1].ravel()
            message = self._type(name)(header=header, format="png", data=data)
        else:
            name, channels = "sensor_msgs/msg/Image", {"m": 1, "b": 3, "r": 3}[encoding[0]]
            channels = 4 if "a8" in encoding else 1 if "bayer" in encoding else channels
            depth = np.uint16 if "16" in encoding else np.uint8
            row = np.full(WIDTH * channels, grey * 257 if depth is np.uint16 else grey, depth).view(np.uint8)
            rows = np.hstack([np.tile(row, (HEIGHT, 1)), np.full((HEIGHT, padding), 255, np.uint8)])
            step, data = rows.shape[1], rows.ravel()
            message = self._type(name)(header, HEIGHT, WIDTH, encoding, 0, step, data)
        self.write(topic, name, taken_ns + late_ns, message)

    def info(self, topic, baseline):
        """A camera_info."""
        K = np.array([[90.0, 0, 31.5], [0, 90, 23.5], [0, 0, 1]])
        P = np.array([[80.0, 0, 30.5, -80.0 * baseline], [0, 80, 22.5, 0], [0, 0, 1, 0]])
        upper = self._version == 1
        matrices = {"d": np.array([0.1, 0, 0, 0, 0]), "k": K.ravel(), "r": np.eye(3).ravel(), "p": P.ravel()}
        name = "sensor_msgs/msg/CameraInfo"
        message = self._type(name)(
            header=self.header(START_NS, "eye"),
            height=HEIGHT,
            width=WIDTH,
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=self._type("sensor_msgs/msg/RegionOfInterest")(0, 0, 0, 0, False),
            **{(key.upper() if upper else key): value for key, value in matrices.items()},
        )
        self.write(topic, name, START_NS, message)

    def done(self):
        self._writer.close()
        return self.path


class Clock:
    """A clock that goes on by a tick with every reading of the source."""

    def __init__(self):
        self.now_s = 0.0

    def __call__(self):
        return self.now_s


def stereo_bag(
    folder,
    version,
    left: tuple[int, ...] = (0, 1, 2, 3),
    right: tuple[int, ...] = (0, 1, 2, 3),
    shift_ns=0,
    name="image_raw",
    **options,
):
    bag = Bag(folder, version)
    for side, baseline in (("left", 0.0), ("right", BASELINE)):
        bag.info(f"/endoscope/{side}/camera_info", baseline)
    frames = [(n * PERIOD_NS, "left", n) for n in left] + [(n * PERIOD_NS + shift_ns, "right", n) for n in right]
    for offset_ns, side, n in sorted(frames):
        grey = 20 + 10 * n + (100 if side == "right" else 0)
        bag.image(f"/endoscope/{side}/{name}", START_NS + offset_ns, grey, **options)
    return bag.done()


@pytest.fixture
def opened():
    """Opens bags, and closes them in the end."""
    with contextlib.ExitStack() as stack:

        def open_bag(*arguments, **options):
            source = BagSource(*arguments, **options)
            stack.callback(source.close)
            return source

        yield open_bag


def all_of(source, clock, ticks=20, tick_s=0.1):
    """Greys of both images of every pair, with the tick at which it came and when its images were taken."""
    found = []
    for tick in range(ticks):
        if (pair := source.read()) is not None:
            found.append((tick, [round(float(image.mean())) for image in pair], source.taken_ns))
        clock.now_s += tick_s
    return found


@pytest.mark.parametrize(("encoding", "version"), [(encoding, 1 + n % 2) for n, encoding in enumerate(ENCODINGS)])
def test_pairs_come_in_order_whatever_the_encoding(tmp_path, opened, version, encoding):
    clock = Clock()
    path = stereo_bag(tmp_path, version, encoding=encoding, padding=0 if encoding == "compressed" else 12)
    source = opened(path, loop=False, clock_s=clock)
    assert source.size() == (WIDTH, HEIGHT)
    assert [greys for _, greys, _ in all_of(source, clock)] == [[20 + 10 * n, 120 + 10 * n] for n in range(4)]


def test_a_pair_comes_no_sooner_than_its_stamp_and_one_for_every_question(tmp_path, opened):
    path, clock = stereo_bag(tmp_path, 2), Clock()
    found = all_of(opened(path, loop=False, clock_s=clock), clock, tick_s=0.05)
    assert [tick for tick, _, _ in found] == [0, 2, 4, 6]
    found = all_of(opened(path, loop=False, clock_s=clock), clock, tick_s=5.0)
    assert [tick for tick, _, _ in found] == [0, 1, 2, 3]


def test_it_begins_again_where_it_loops_and_at_its_own_pace(tmp_path, opened):
    clock = Clock()
    found = all_of(opened(stereo_bag(tmp_path, 1), loop=True, clock_s=clock), clock, ticks=10, tick_s=0.1001)
    assert [greys[0] for _, greys, _ in found] == [20, 30, 40, 50, 20, 30, 40, 50, 20, 30]


def test_frames_without_a_partner_are_dropped_and_the_delay_of_an_eye_is_told(tmp_path, opened):
    clock = Clock()
    path = stereo_bag(tmp_path, 2, left=(0, 1, 2, 4, 5), right=(0, 2, 3, 4, 5), shift_ns=7_000_000)
    source = opened(path, loop=False, clock_s=clock)
    found = all_of(source, clock)
    assert [greys for _, greys, _ in found] == [[20 + 10 * n, 120 + 10 * n] for n in (0, 2, 4, 5)]
    assert {taken for _, _, taken in found} == {(-7_000_000, 0)}
    assert source.dropped == 2


def test_frames_without_stamps_count_from_when_they_were_recorded(tmp_path, opened):
    bag, clock = Bag(tmp_path, 2), Clock()
    for n in range(3):
        for side in ("left", "right"):
            bag.image(f"/{side}/image", 0, 20 + 10 * n, late_ns=START_NS + n * PERIOD_NS)
    found = all_of(opened(bag.done(), loop=False, clock_s=clock), clock, tick_s=0.05)
    assert [tick for tick, _, _ in found] == [0, 2, 4]


@both_versions
def test_the_calibration_beside_raw_images_is_that_of_k_and_d_and_beside_rectified_ones_that_of_p(
    tmp_path, opened, version
):
    raw, rectified = tmp_path / "raw", tmp_path / "rectified"
    for folder in (raw, rectified):
        folder.mkdir()
    calibration = opened(stereo_bag(raw, version)).calibration(None, (WIDTH, HEIGHT)).calibration
    assert calibration.K_left[0, 0] == 90.0
    assert calibration.distortion_left[0] == 0.1
    assert calibration.T_right_left[:3, 3] == pytest.approx((-BASELINE, 0, 0))
    assert calibration.metres_per_unit == 1.0
    path = stereo_bag(rectified, version, name="image_rect_color")
    calibration = opened(path).calibration(None, (WIDTH, HEIGHT)).calibration
    assert (calibration.K_left[0, 0], calibration.K_right[0, 2]) == (80.0, 30.5)
    assert calibration.distortion_left.size == 0
    assert calibration.T_right_left[:3, 3] == pytest.approx((-BASELINE, 0, 0))


def test_topics_that_do_not_tell_their_side_are_named(tmp_path, opened):
    bag = Bag(tmp_path, 2)
    for topic in ("/a/image", "/b/image", "/left/one", "/left/two"):
        bag.image(topic, START_NS, 50)
    path, clock = bag.done(), Clock()
    with pytest.raises(
        SourceError, match=r"has 2 image topics that are named left; give left_topic, one of: /a/image, "
    ):
        opened(path)
    with pytest.raises(SourceError, match=r"has no image topic /c; give right_topic, one of: /a/image, /b/image"):
        opened(path, "/a/image", "/c")
    source = opened(path, "/a/image", "/b/image", loop=False, clock_s=clock)
    with pytest.raises(CalibrationError, match=r"has no /a/camera_info beside /a/image .* give a calibration"):
        source.calibration(None, (WIDTH, HEIGHT))
    assert len(all_of(source, clock)) == 1


def test_no_bag_and_half_a_bag_are_named(tmp_path, opened):
    with pytest.raises(SourceError, match=r"absent.bag cannot be read as a bag"):
        opened(tmp_path / "absent.bag")
    (tmp_path / "text.bag").write_text("not a bag")
    with pytest.raises(SourceError, match=r"text.bag cannot be read as a bag"):
        opened(tmp_path / "text.bag")
    path = stereo_bag(tmp_path, 1)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(SourceError, match=r"session.bag"):
        opened(path).size()


def test_an_unknown_encoding_and_frames_that_never_meet_are_named(tmp_path, opened):
    bag = Bag(tmp_path, 2)
    for side in ("left", "right"):
        bag.image(f"/{side}/image", START_NS, 50, encoding="mono8_of_my_own")
    source = opened(bag.done())
    with pytest.raises(SourceError, match=r"an image of /left/image cannot be decoded: .*mono8_of_my_own"):
        source.read()
    with pytest.raises(SourceError, match="lie within half a frame period"):
        opened(stereo_bag(tmp_path, 1, left=(0, 1), right=(7, 8))).size()


def test_the_camera_of_a_rig_takes_a_bag_and_its_calibration(tmp_path):
    rig = RigConfig(camera=CameraSection(source="bag", left=str(stereo_bag(tmp_path, 2)), encoding="raw"))
    camera = build(rig, "camera", "main")
    assert isinstance(camera, Camera)
    made = [output.message for output in camera.step(Tick(10**18)) if isinstance(output, Output)]
    assert [type(message) for message in made] == [StereoCalibration, StereoFrame, FrameNotice]
    assert made[1].stamp.calibration_id
    camera.close()
