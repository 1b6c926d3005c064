"""Bags of ROS 1 and ROS 2 that rosbags wrote, with frames that are missing too."""

import contextlib
import itertools

import cv2
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from agents.camera.bag import BagSource
from agents.camera.sources import SourceError
from agents.configuration.rig import CameraSection, RigConfig
from agents.launch.builders import build
from schemas.messages import FrameNotice, StereoCalibration, StereoFrame
from shared.calibration import CalibrationError
from shared.runtime.agent import Output, Tick
from tests.agents.camera.conftest import HEIGHT, WIDTH

PERIOD_NS, BASELINE = 100_000_000, 0.005
START_NS = 1_700_000_000_000_000_000
WHOLE = (0, 1, 2, 3)
GREYS = [[20 + 10 * n, 120 + 10 * n] for n in range(6)]
both_versions = pytest.mark.parametrize("version", [1, 2])


class Bag:
    """Writes a bag with both eyes of a camera."""

    def __init__(self, folder, version):
        folder.mkdir(exist_ok=True)
        self.path = folder / ("session.bag" if version == 1 else "session")
        self._types = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
        self._version, self._number, self._connections = version, itertools.count(), {}
        self._writer = Writer1(self.path) if version == 1 else Writer2(self.path, version=9)
        self._writer.open()

    def _type(self, name):
        return self._types.types[name]

    def _header(self, taken_ns):
        stamp = self._type("builtin_interfaces/msg/Time")(*divmod(taken_ns, 1_000_000_000))
        number = {"seq": next(self._number)} if self._version == 1 else {}
        return self._type("std_msgs/msg/Header")(stamp=stamp, frame_id="eye", **number)

    def _write(self, topic, name, at_ns, message):
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, name, typestore=self._types)
        serialize = self._types.serialize_ros1 if self._version == 1 else self._types.serialize_cdr
        self._writer.write(self._connections[topic], at_ns, serialize(message, name))

    def image(self, topic, taken_ns, grey, encoding="bgr8", padding=0, recorded_ns=None):
        """A plain image, with that many bytes behind every row."""
        header, name = self._header(taken_ns), "sensor_msgs/msg/Image"
        if encoding == "compressed":
            name = "sensor_msgs/msg/CompressedImage"
            png = cv2.imencode(".png", np.full((HEIGHT, WIDTH, 3), grey, np.uint8))[1].ravel()
            message = self._type(name)(header=header, format="png", data=png)
        else:
            bytes_per_pixel = {"bgr8": 3, "mono16": 2}.get(encoding, 1)
            rows = np.full((HEIGHT, bytes_per_pixel * WIDTH + padding), grey, np.uint8)
            rows[:, bytes_per_pixel * WIDTH :] = 255
            message = self._type(name)(header, HEIGHT, WIDTH, encoding, 0, rows.shape[1], rows.ravel())
        self._write(topic, name, recorded_ns or taken_ns, message)

    def info(self, topic, baseline):
        """A camera_info."""
        K = [90.0, 0, 31.5, 0, 90, 23.5, 0, 0, 1]
        P = [80.0, 0, 30.5, -80.0 * baseline, 0, 80, 22.5, 0, 0, 0, 1, 0]
        matrices = {"d": [0.1, 0, 0, 0, 0], "k": K, "r": np.eye(3).ravel(), "p": P}
        name, region = "sensor_msgs/msg/CameraInfo", self._type("sensor_msgs/msg/RegionOfInterest")
        message = self._type(name)(
            header=self._header(START_NS),
            height=HEIGHT,
            width=WIDTH,
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=region(0, 0, 0, 0, False),
            **{(key.upper() if self._version == 1 else key): np.array(value) for key, value in matrices.items()},
        )
        self._write(topic, name, START_NS, message)

    def done(self):
        self._writer.close()
        return self.path


def stereo_bag(folder, version=2, left=WHOLE, right=WHOLE, shift_ns=0, name="image_raw", **options):
    """Frames of these numbers, those of the right eye so much later, with their calibration."""
    bag = Bag(folder, version)
    for side, baseline in (("left", 0.0), ("right", BASELINE)):
        bag.info(f"/endoscope/{side}/camera_info", baseline)
    frames = [(n * PERIOD_NS, "left", GREYS[n][0]) for n in left]
    frames += [(n * PERIOD_NS + shift_ns, "right", GREYS[n][1]) for n in right]
    for offset_ns, side, grey in sorted(frames):
        bag.image(f"/endoscope/{side}/{name}", START_NS + offset_ns, grey, **options)
    return bag.done()


class Played:
    """A source, and a clock that goes on by a tick with every reading of it."""

    def __init__(self, path, *topics, loop=False):
        self.now_s = 0.0
        self.source = BagSource(path, *topics, loop=loop, clock_s=lambda: self.now_s)

    def pairs(self, ticks=20, tick_s=0.1):
        """Greys of every pair, with the tick at which it came and when its images were taken."""
        found = []
        for tick in range(ticks):
            if (pair := self.source.read()) is not None:
                found.append((tick, [round(float(image.mean())) for image in pair], self.source.taken_ns))
            self.now_s += tick_s
        return found


@pytest.fixture
def play():
    """Opens bags, and closes them in the end."""
    with contextlib.ExitStack() as stack:

        def opened(*arguments, **options):
            played = Played(*arguments, **options)
            stack.callback(played.source.close)
            return played

        yield opened


@pytest.mark.parametrize(("encoding", "version"), [("bgr8", 1), ("mono16", 2), ("compressed", 1), ("bgr8", 2)])
def test_pairs_come_in_order_whatever_the_encoding(tmp_path, play, version, encoding):
    played = play(stereo_bag(tmp_path, version, encoding=encoding, padding=12))
    assert played.source.size() == (WIDTH, HEIGHT)
    assert [greys for _, greys, _ in played.pairs()] == GREYS[:4]


def test_a_pair_comes_no_sooner_than_its_stamp_one_for_every_question_and_a_loop_begins_again(tmp_path, play):
    path = stereo_bag(tmp_path)
    for tick_s, ticks in ((0.05, [0, 2, 4, 6]), (5.0, [0, 1, 2, 3])):
        assert [tick for tick, _, _ in play(path).pairs(tick_s=tick_s)] == ticks
    looped = play(path, loop=True).pairs(ticks=10, tick_s=0.1001)
    assert [greys for _, greys, _ in looped] == [*GREYS[:4], *GREYS[:4], *GREYS[:2]]


def test_frames_without_a_partner_are_dropped_and_the_delay_of_an_eye_is_told(tmp_path, play):
    played = play(stereo_bag(tmp_path, left=(0, 1, 2, 4, 5), right=(0, 2, 3, 4, 5), shift_ns=7_000_000))
    found = played.pairs()
    assert [greys for _, greys, _ in found] == [GREYS[n] for n in (0, 2, 4, 5)]
    assert {taken for _, _, taken in found} == {(-7_000_000, 0)}
    assert played.source.dropped == 2


def test_frames_without_stamps_count_from_when_they_were_recorded(tmp_path, play):
    bag = Bag(tmp_path, 2)
    for n in range(3):
        for side in ("left", "right"):
            bag.image(f"/{side}/image", 0, 20, recorded_ns=START_NS + n * PERIOD_NS)
    assert [tick for tick, _, _ in play(bag.done()).pairs(tick_s=0.05)] == [0, 2, 4]


@both_versions
def test_the_calibration_beside_raw_images_is_that_of_k_and_d_and_beside_rectified_ones_that_of_p(
    tmp_path, play, version
):
    raw, rectified = (
        play(stereo_bag(tmp_path / name, version, name=name)).source.calibration(None, (WIDTH, HEIGHT)).calibration
        for name in ("image_raw", "image_rect_color")
    )
    assert (raw.K_left[0, 0], raw.distortion_left[0], raw.metres_per_unit) == (90.0, 0.1, 1.0)
    assert (rectified.K_left[0, 0], rectified.K_right[0, 2], rectified.distortion_left.size) == (80.0, 30.5, 0)
    for calibration in (raw, rectified):
        assert calibration.T_right_left[:3, 3] == pytest.approx((-BASELINE, 0, 0))


def test_topics_that_do_not_tell_their_side_are_named(tmp_path, play):
    bag = Bag(tmp_path, 2)
    for topic in ("/a/image", "/b/image", "/left/one", "/left/two"):
        bag.image(topic, START_NS, 50)
    path = bag.done()
    with pytest.raises(SourceError, match=r"2 image topics that are named left; give left_topic, one of: /a/image, "):
        play(path)
    with pytest.raises(SourceError, match=r"has no image topic /c; give right_topic, one of: /a/image, /b/image"):
        play(path, "/a/image", "/c")
    played = play(path, "/a/image", "/b/image")
    with pytest.raises(CalibrationError, match=r"has no /a/camera_info beside /a/image .* give a calibration"):
        played.source.calibration(None, (WIDTH, HEIGHT))
    assert len(played.pairs()) == 1


def test_what_cannot_be_played_is_named(tmp_path, play):
    (tmp_path / "text.bag").write_text("not a bag")
    for name in ("absent.bag", "text.bag"):
        with pytest.raises(SourceError, match=f"{name} cannot be read as a bag"):
            play(tmp_path / name)
    half = stereo_bag(tmp_path, 1)
    half.write_bytes(half.read_bytes()[: half.stat().st_size // 2])
    with pytest.raises(SourceError, match=r"session.bag"):
        play(half).source.size()
    with pytest.raises(SourceError, match=r"an image of .*/left/image_raw cannot be decoded: .*my_own"):
        play(stereo_bag(tmp_path / "own", encoding="my_own")).source.read()
    with pytest.raises(SourceError, match="lie within half a frame period"):
        play(stereo_bag(tmp_path / "apart", left=(0, 1), right=(4, 5))).source.size()


def test_the_camera_of_a_rig_takes_a_bag_and_its_calibration(tmp_path):
    rig = RigConfig(camera=CameraSection(source="bag", left=str(stereo_bag(tmp_path)), encoding="raw"))
    camera = build(rig, "camera", "main")
    made = [output.message for output in camera.step(Tick(10**18)) if isinstance(output, Output)]
    assert [type(message) for message in made] == [StereoCalibration, StereoFrame, FrameNotice]
    assert made[1].stamp.calibration_id
