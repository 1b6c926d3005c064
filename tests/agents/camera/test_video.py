"""Videos that OpenCV wrote, with frames that are missing too, and devices behind the interface of cv2.VideoCapture."""

import itertools
import logging

import cv2
import numpy as np
import pytest

from agents.camera.sources import BrokenOffError, SourceError
from agents.camera.video import MOST_DROPPED, VideoSource
from tests.agents.camera.conftest import HEIGHT, WIDTH, levels, picture


def video(path, frames, rate_hz=10.0, numbers=None):
    """A file with these frames; `numbers` places them at that multiple of the period, which AVI cannot."""
    codec, size = cv2.VideoWriter.fourcc(*"MJPG"), frames[0].shape[1::-1]
    # stamps of one's own are only for frames that already are encoded
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, codec, rate_hz, size, [cv2.VIDEOWRITER_PROP_RAW_VIDEO, 1])
    for number, frame in zip(numbers or range(len(frames)), frames, strict=True):
        assert writer.set(cv2.VIDEOWRITER_PROP_PTS, number)
        assert writer.set(cv2.VIDEOWRITER_PROP_KEY_FLAG, 1)
        writer.write(cv2.imencode(".jpg", frame)[1].reshape(1, -1))
    writer.release()
    return str(path)


def film(path, rate_hz, numbers):
    """A clock whose grey grows by 100 levels a second, filmed by a camera that missed all frames but these."""
    return video(path, [picture(round(20 + 100 * n / rate_hz)) for n in numbers], rate_hz, list(numbers))


def all_of(source):
    found = []
    while (pair := source.read()) is not None:
        found.append((levels(pair), source.taken_ns))
    assert source.read() is None
    source.close()
    return found


def test_a_side_by_side_video_is_cut_in_its_middle_and_two_are_read_together_until_the_shorter_ends(tmp_path):
    both = video(tmp_path / "both.avi", [np.hstack([picture(v), picture(v + 60)]) for v in (20, 80, 140)])
    left = video(tmp_path / "l.avi", [picture(v) for v in (20, 80, 140)])
    right = video(tmp_path / "r.avi", [picture(v) for v in (30, 90)])
    for files, expected in (((both, None), [[20, 80], [80, 140], [140, 200]]), ((left, right), [[20, 30], [80, 90]])):
        found = all_of(VideoSource(*files))
        assert np.array([pair for pair, _ in found]) == pytest.approx(np.array(expected), abs=3)
        assert {taken for _, taken in found} == {(0, 0)}


@pytest.mark.parametrize(("suffix", "swapped"), [("mkv", False), ("mp4", True)])
def test_frames_that_one_of_two_cameras_missed_cost_their_partners_alone(tmp_path, caplog, suffix, swapped):
    whole = film(tmp_path / f"a.{suffix}", 30.0, range(12))
    holes = film(tmp_path / f"b.{suffix}", 30.0, [0, 1, 4, 5, 6, 9, 10, 11])
    source = VideoSource(*((holes, whole) if swapped else (whole, holes)))
    assert source.size() == (WIDTH, HEIGHT)
    with caplog.at_level(logging.WARNING, "suturegrasp.camera.main"):
        found = all_of(source)
    assert len(found) == 8
    assert source.dropped == ((0, 4) if swapped else (4, 0))
    assert all(abs(left - right) <= 3 for (left, right), _ in found)
    # said once, and then seldom
    assert [record.getMessage().split(" of ")[0] for record in caplog.records] == ["1 frames"]


def test_what_is_no_pair_of_videos_is_named(tmp_path):
    source = VideoSource(video(tmp_path / "l.avi", [picture(20)]), video(tmp_path / "r.avi", [picture(20, 2 * WIDTH)]))
    with pytest.raises(SourceError, match="differ in size: 64x48 and 128x48"):
        source.read()
    for name in ("/nowhere/film.avi", "97"):
        with pytest.raises(SourceError, match=f"OpenCV cannot open '{name}'"):
            VideoSource(name, None)
    with pytest.raises(SourceError, match=r"one of 'film\.avi' and '0' is a file and the other a device"):
        VideoSource("film.avi", "0")


class Clock:
    """Milliseconds that pass only where somebody waits for a frame."""

    def __init__(self):
        self.now_ms = 50_000.0

    def __call__(self):
        return 1e-3 * self.now_ms


class Device:
    """Delivers frames at these times of a clock, later or at once, as a driver with a queue does."""

    def __init__(self, clock, times_ms, rate_hz=30.0, stamp=lambda at_ms: at_ms):
        self.clock, self.times_ms, self.rate_hz, self.stamp = clock, iter(times_ms), rate_hz, stamp
        self.at_ms, self.released = 0.0, False

    def grab(self):
        at_ms = next(self.times_ms, None)
        if at_ms is None:
            return False
        self.at_ms, self.clock.now_ms = at_ms, max(at_ms, self.clock.now_ms)
        return True

    def retrieve(self):
        return True, picture(int(self.at_ms - 50_000.0) % 256)

    def get(self, property_id, /):
        return self.rate_hz if property_id == cv2.CAP_PROP_FPS else self.stamp(self.at_ms)

    def release(self):
        self.released = True


def paired(left, right, names=("0", "1")):
    one, other = names
    return VideoSource(one, other, {one: left, other: right}.__getitem__, left.clock)


def every(period_ms, start_ms, count):
    return [50_000.0 + start_ms + period_ms * n for n in range(count)]


def offsets_of(source, clock, count):
    """Right after left of so many pairs, in milliseconds, once each was checked against the clock."""
    offsets = []
    for _ in range(count):
        asked_ms, pair = clock.now_ms, source.read()
        for image, ns in zip(pair, source.taken_ns, strict=True):
            assert image[0, 0, 0] == int(asked_ms + 1e-6 * ns - 50_000.0 + 1e-6) % 256
        offsets.append(1e-6 * (source.taken_ns[1] - source.taken_ns[0]))
    return offsets


@pytest.mark.parametrize(("phase_ms", "offset_ms", "dropped"), [(10.0, 10.0, (0, 0)), (30.0, -10.0, (1, 0))])
def test_devices_that_are_out_of_step_are_paired_with_the_nearer_neighbour(phase_ms, offset_ms, dropped):
    clock = Clock()
    source = paired(Device(clock, every(40.0, 0.0, 30)), Device(clock, every(40.0, phase_ms, 30)))
    assert offsets_of(source, clock, 20) == pytest.approx([offset_ms] * 20, abs=1e-3)
    assert source.dropped == dropped


@pytest.mark.parametrize("rate_hz", [60.0, 0.0], ids=["says it is twice as fast", "says nothing"])
def test_a_device_that_is_slower_than_it_says_loses_a_few_frames_at_most(rate_hz):
    clock = Clock()
    source = paired(*(Device(clock, every(66.7, start_ms, 60), rate_hz) for start_ms in (0.0, 25.0)))
    assert offsets_of(source, clock, 40)[5:] == pytest.approx([25.0] * 35, abs=1e-3)
    assert sum(source.dropped) <= 2


def test_stamps_of_another_clock_than_the_hosts_are_replaced_by_the_time_of_arrival():
    clock = Clock()
    left = Device(clock, every(40.0, 0.0, 30), stamp=lambda at_ms: at_ms - 49_900.0)
    right = Device(clock, every(40.0, 5.0, 30), stamp=lambda _: 0.0)
    assert offsets_of(paired(left, right), clock, 10) == pytest.approx([5.0] * 10, abs=1e-3)


def test_what_waited_in_the_drivers_queue_is_as_old_as_it_is():
    clock = Clock()
    source = paired(Device(clock, every(40.0, 0.0, 9)), Device(clock, every(40.0, 1.0, 9)))
    clock.now_ms += 300.0
    source.read()
    assert source.taken_ns == pytest.approx((-300e6, -299e6), abs=1e3)


def test_a_device_that_breaks_off_is_named_with_what_to_do():
    clock = Clock()
    left, right = (Device(clock, every(40.0, 0.0, count)) for count in (9, 3))
    source = paired(left, right)
    offsets_of(source, clock, 3)
    for _ in range(2):
        with pytest.raises(BrokenOffError, match=r"^video device '1' has broken off after 3 frames; check its"):
            source.read()
    source.close()
    assert (left.released, right.released) == (True, True)


def test_devices_that_never_meet_or_never_deliver_are_told_apart_from_broken_ones():
    clock = Clock()
    stuck = Device(clock, (50_000.0 + 0.01 * n for n in itertools.count()))
    with pytest.raises(SourceError, match=f"after {MOST_DROPPED} dropped frames those of '0' and '1' still lie"):
        paired(Device(clock, every(40.0, 900.0, 3)), stuck).read()
    with pytest.raises(BrokenOffError, match=r"^video device '1' never gave a frame; check that no other program"):
        paired(Device(clock, every(40.0, 0.0, 9)), Device(clock, [])).read()


def test_a_file_without_stamps_is_counted_and_one_that_holds_no_frame_is_named():
    def unstamped(count):
        return Device(Clock(), every(40.0, 0.0, count), 25.0, stamp=lambda _: 0.0)

    assert len(all_of(paired(unstamped(4), unstamped(4), ("l", "r")))) == 4
    with pytest.raises(SourceError, match=r"^the video 'r' holds no frame that can be decoded"):
        paired(unstamped(3), unstamped(0), ("l", "r")).read()
