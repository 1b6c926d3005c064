"""What other programs see of a recording: the same images, cameras, poses and curves."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.reader import make_reader

from agents.recorder.cutting import cut
from agents.recorder.foxglove import BYTES_PER_SECOND, FoxgloveCopies
from agents.recorder.parts import FileSettings
from agents.recorder.recorder import RecorderSettings
from schemas.codec import decode
from schemas.messages import Image, ImageEncoding, Status
from schemas.topics import THREAD, topic_of
from shared.recording import foxglove_schemas
from shared.recording.entry import Entry
from shared.recording.mcap_file import read_recording
from shared.rigid_transforms import exp_so3, rotation_from_quaternion

POINTS_M = 1e-3 * np.array([[0.0, 0.0, 90.0], [8.0, -5.0, 100.0], [-10.0, 6.0, 80.0]])


def copies(tapped, at_ns=0, maker=None):
    entry = Entry(tapped.key, 1, 0, tapped.payload, at_ns, at_ns)
    return {
        one.channel: getattr(foxglove_schemas, one.schema.removeprefix("foxglove.")).FromString(one.payload)
        for one in (maker or FoxgloveCopies()).of(tapped.topic, entry)
    }


def matrix(transform):
    q, t = transform.rotation, transform.translation
    T = np.eye(4)
    T[:3, :3] = rotation_from_quaternion(np.array([q.w, q.x, q.y, q.z]))
    T[:3, 3] = t.x, t.y, t.z
    return T


def test_images_are_those_of_the_frame(messages):
    jpeg = Image(ImageEncoding.JPEG, 64, 48, 3, b"some jpeg")
    raw = Image(ImageEncoding.RAW, 64, 48, 1, bytes(range(64)) * 48)
    found = copies(messages.frame(5, (jpeg, raw)))
    left, right = found["/camera/left/image"], found["/camera/right/image"]
    assert (left.data, left.format, left.frame_id) == (b"some jpeg", "jpeg", "camera_left")
    assert (left.timestamp.seconds, left.timestamp.nanos) == (1, 5)
    assert (right.data, right.encoding, right.step, right.width, right.height) == (raw.data, "mono8", 64, 64, 48)
    assert (right.timestamp.seconds, right.frame_id) == (2, "camera_right")


def test_cameras_and_their_poses_project_points_as_the_calibration_does(messages):
    R = exp_so3(np.array([0.01, -0.03, 0.02]))
    found = copies(messages.calibration(R=R, distortion=(0.1, -0.05, 0.001, 0.002, 0.01)))
    T_camera_left, T_camera_right = (matrix(found[f"/transforms/camera_{eye}"]) for eye in ("left", "right"))
    T_right_left = np.linalg.inv(T_camera_right) @ T_camera_left
    np.testing.assert_allclose(T_right_left[:3, :3], R, atol=1e-9)
    # lengths are in metres, the calibration's are in millimetres
    np.testing.assert_allclose(T_right_left[:3, 3], [-0.005, 0, 0], atol=1e-9)
    points = np.c_[POINTS_M, np.ones(3)].T
    for eye, T in (("left", T_camera_left), ("right", T_camera_right)):
        camera = found[f"/camera/{eye}/calibration"]
        K, R_rect = (np.array(values).reshape(3, 3) for values in (camera.K, camera.R))
        P, D = np.array(camera.P).reshape(3, 4), np.array(camera.D)
        raw, _ = cv2.projectPoints((np.linalg.inv(T) @ points)[:3].T, np.zeros(3), np.zeros(3), K, D)
        rectified = cv2.undistortPoints(raw, K, D, R=R_rect, P=P)[:, 0]
        u, v, w = P @ points
        np.testing.assert_allclose(rectified, np.column_stack((u / w, v / w)), atol=0.02)


def test_poses_lead_from_the_camera_by_way_of_the_base_to_the_tool(messages):
    T_camera_base, T_base_tool = np.eye(4), np.eye(4)
    T_camera_base[:3, :3], T_camera_base[:3, 3] = exp_so3(np.array([0.4, 1.2, -0.3])), [0.1, -0.2, 0.3]
    T_base_tool[:3, 3] = [0.01, 0.02, 0.03]
    found = copies(messages.state(0, T_camera_base=T_camera_base, T_base_tool=T_base_tool))
    for child, parent, T in (("psm1_base", "camera", T_camera_base), ("psm1_tool", "psm1_base", T_base_tool)):
        pose = found[f"/transforms/{child}"]
        assert (pose.parent_frame_id, pose.child_frame_id) == (parent, child)
        np.testing.assert_allclose(matrix(pose), T, atol=1e-12)


def test_copies_are_thinned_by_time_and_large_ones_more(messages):
    maker = FoxgloveCopies()
    assert sum(bool(copies(messages.state(n), n * 10_000_000, maker)) for n in range(100)) == 10
    big = Image(ImageEncoding.RAW, 1200, 1200, 3, bytes(1200 * 1200 * 3))
    frame, period_ns = messages.frame(0, (big, big)), 33_000_000
    count = sum(bool(copies(frame, n * period_ns, maker)) for n in range(300))
    assert 1 <= count <= 300 * 0.033 * BYTES_PER_SECOND / len(frame.payload) + 1


def as_rerun_reads(path, folder):
    rerun, rrd = str(Path(sys.executable).with_name("rerun")), str(folder / "a.rrd")
    subprocess.run([rerun, "mcap", "convert", str(path), "-o", rrd], check=True, capture_output=True)
    return subprocess.run([rerun, "rrd", "print", "-vvv", rrd], check=True, capture_output=True, text=True).stdout


def test_own_messages_alone_are_read_back_rerun_shows_the_copies_and_they_can_be_left_out(record, messages, tmp_path):
    jpeg = Image(ImageEncoding.JPEG, 64, 48, 3, cv2.imencode(".jpg", np.full((48, 64, 3), 99, np.uint8))[1].tobytes())
    again = messages.calibration(1)
    # what cannot be read has no copy, and is recorded all the same
    damaged = type(again)(again.topic, again.key, b"no calibration", again.beside)
    put = [messages.calibration(), messages.state(0), messages.frame(0, (jpeg, jpeg)), damaged]
    for foxglove in (True, False):
        path = tmp_path / f"{foxglove}.mcap"
        recorder = record(path, settings=RecorderSettings(FileSettings(foxglove=foxglove)))
        for one in put:
            recorder.put(one)
        assert recorder.close().complete
        assert [(e.key, e.payload) for e in read_recording(path)] == [(one.key, one.payload) for one in put]
        shown = as_rerun_reads(path, tmp_path)
        for component in ("EncodedImage:blob", "Pinhole:image_from_camera", "Transform3D:translation"):
            assert (component in shown) == foxglove


def test_the_curve_of_a_derived_recording_is_in_metres_and_rerun_shows_it(tmp_path):
    source, target = Path(__file__).parents[2] / "goldens" / "crossing.mcap", tmp_path / "cut.mcap"
    cut(source, target, 0, 1 << 62)
    entries = (e for e in read_recording(source) if topic_of(e.key) is THREAD)
    thread = next(one for one in (decode(THREAD.message, e.payload) for e in entries) if one.status is Status.OK)
    with target.open("rb") as file:
        seen = next(m.data for s, _, m in make_reader(file).iter_messages() if s and s.name == "foxglove.PointCloud")
    cloud: Any = foxglove_schemas.PointCloud.FromString(seen)
    assert [(one.name, one.offset, one.type) for one in cloud.fields] == [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)]
    points = np.frombuffer(cloud.data, "<f4").reshape(-1, 3)
    ends = thread.control_points_camera[[0, -1]] * thread.camera.metres_per_unit
    np.testing.assert_allclose(points[[0, -1]], ends, atol=1e-6)
    assert "Points3D:positions" in as_rerun_reads(target, tmp_path)
