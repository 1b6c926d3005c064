import dataclasses
import pathlib
import subprocess
import sys

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader

from agents.viewer import mapping
from agents.viewer.candidate_mapping import verdict
from agents.viewer.colours import UNKNOWN, confidence_rgb
from agents.viewer.cross_sections import CORNERS
from agents.viewer.picture import draw_picture
from agents.viewer.report import facts
from schemas.messages import Image, ImageEncoding, Occluder, Occluders, ThreadCandidate
from shared.images import encode_image

SPACE = {
    "/world",
    "/world/left",
    "/world/right",
    "/world/left/image",
    "/world/right/image",
    "/world/left/mask",
    "/world/right/mask",
    "/world/left/bounds",
    "/world/observations/points",
    "/world/observations/matched",
    "/world/thread/curve",
    "/world/thread/ends",
    "/world/thread/control_points",
    "/world/thread/regions",
    "/world/left/centrelines",
    "/world/right/centrelines",
    "/world/left/candidates",
    "/world/left/candidates/scores",
    "/world/right/candidates",
    "/world/left/occluders",
    "/world/right/occluders",
    "/world/left/residuals_x20",
    "/world/right/residuals_x20",
    "/world/thread/posterior",
    "/residual_px/left/median",
    "/residual_px/left/percentile_95",
    "/residual_px/right/median",
    "/residual_px/right/percentile_95",
    "/deviation/along_s",
    "/deviation/mean",
    "/deviation/worst",
    "/share/unseen",
    "/share/left_over_left",
    "/share/left_over_right",
    "/confidence",
    "/report",
}
SOFTWARE_VULKAN = pathlib.Path("/usr/share/vulkan/icd.d")
REPOSITORY = pathlib.Path(__file__).parents[3]


def columns(path, entity):
    """What a recording holds about an entity: component name to the value of its one row."""
    found = {}
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == entity:
            batch = chunk.to_record_batch()
            found |= {name: batch.column(name).to_pylist()[0] for name in batch.schema.names if ":" in name}
    return found


@pytest.fixture
def recording(scene, tmp_path):
    path = tmp_path / "thread.rrd"
    mapping.write_rrd(path, scene.left, scene.right, scene.observations, scene.reconstruction)
    return path


def test_a_recording_holds_every_entity_and_its_layout(recording):
    reader = RrdReader(recording)
    assert [store.application_id for store in reader.recordings()] == ["suturegrasp"]
    assert len(reader.blueprints()) == 1
    assert {chunk.entity_path for chunk in reader.stream()} - {"/__properties"} == SPACE


def test_everything_is_logged_at_the_capture_time_of_its_frame(recording, scene):
    for chunk in RrdReader(recording).stream():
        if chunk.entity_path == "/__properties":
            continue
        batch = chunk.to_record_batch()
        assert batch.column("frame").to_pylist() == [42]
        captured = np.array(batch.column("capture_time").cast("int64"))
        assert captured.tolist() == [scene.observations.stamp.capture_left_ns]


def test_the_curve_is_the_thread_in_the_colours_of_its_confidence(recording, scene):
    curve = columns(recording, "/world/thread/curve")
    strips = np.array(curve["LineStrips3D:strips"])
    assert strips.shape == (mapping.CURVE_POINTS - 1, 2, 3)
    nearest = np.linalg.norm(strips[:, 0, None] - scene.curve[None], axis=2).min(axis=1)
    assert nearest.max() < 0.1
    rgba = np.array(curve["LineStrips3D:colors"], dtype=np.uint32)
    share = (np.arange(len(strips)) + 0.5) / len(strips)
    expected = confidence_rgb(np.clip(1 - 0.95 * np.exp(-(((share - 0.62) / 0.12) ** 2)), 0, 1)).astype(int)
    red_green = np.stack((rgba >> 24, rgba >> 16 & 255), axis=1).astype(int)
    unseen = (share > 0.56) & (share < 0.66)
    assert np.abs(red_green[~unseen] - expected[~unseen, :2])[1:-1].max() <= 8
    assert (red_green[(share > 0.57) & (share < 0.65)] == UNKNOWN[:2]).all()


def test_the_right_camera_sits_a_baseline_to_the_right(recording):
    assert columns(recording, "/world/right")["Transform3D:translation"] == [[5.5, 0.0, 0.0]]


def test_the_report_names_status_findings_and_remedies(recording):
    (text,) = columns(recording, "/report")["TextDocument:text"]
    for words in ("OK", "frame 42", "91.1", "mm", "FAULT SWAPPED", "Exchange the two images.", "NOTE SMALL"):
        assert words in text
    assert text.index("FAULT") < text.index("WARNING") < text.index("NOTE")


@pytest.fixture
def refined_recording(refined, tmp_path):
    path = tmp_path / "refined.rrd"
    mapping.write_rrd(path, refined.left, refined.right, refined.observations, refined.reconstruction)
    return path


def test_how_far_a_thread_can_be_trusted_is_in_the_recording(refined_recording):
    def number(entity):
        return columns(refined_recording, entity)["Scalars:scalars"][0]

    assert number("/residual_px/left/median") == pytest.approx(0.3, abs=0.02)
    assert number("/residual_px/right/percentile_95") == pytest.approx(4.0, abs=0.2)
    assert number("/share/unseen") == pytest.approx(0.1, abs=0.01)
    assert number("/share/left_over_left") == 0
    assert 0.3 < number("/deviation/mean") < 0.6 < number("/deviation/worst") < 1.01
    tube = columns(refined_recording, "/world/thread/posterior")
    corners = np.array(tube["Mesh3D:vertex_positions"])
    assert corners.shape == (51 * CORNERS, 3)
    assert np.array(tube["Mesh3D:triangle_indices"]).max() == 51 * CORNERS - 1
    rgb = np.array(tube["Mesh3D:vertex_colors"], dtype=np.uint32).reshape(51, CORNERS)[:, 0] >> 8
    grey = UNKNOWN[0] << 16 | UNKNOWN[1] << 8 | UNKNOWN[2]
    assert set(range(29, 33)) <= set(np.flatnonzero(rgb == grey).tolist()) <= set(range(28, 34))


def test_centrelines_and_whiskers_stand_in_the_images_they_belong_to(refined_recording, refined):
    for side, lines in (
        ("left", refined.observations.centrelines_left),
        ("right", refined.observations.centrelines_right),
    ):
        pieces = columns(refined_recording, f"/world/{side}/centrelines")["LineStrips2D:strips"]
        assert [len(piece) for piece in pieces] == [280, 170]
        assert np.allclose(np.concatenate(pieces), lines.point_px + 0.5, atol=1e-3)
        whiskers = np.array(columns(refined_recording, f"/world/{side}/residuals_x20")["LineStrips2D:strips"])
        shift_px = np.linalg.norm(whiskers[5:60, 1] - whiskers[5:60, 0], axis=1)
        assert np.allclose(shift_px, 20 * {"left": 0.3, "right": 0.2}[side], atol=0.8)


def test_where_a_method_predicts_nothing_there_is_no_tube_and_no_number(recording):
    assert "Mesh3D:vertex_positions" not in columns(recording, "/world/thread/posterior")
    for entity in ("/deviation/mean", "/residual_px/left/median", "/share/left_over_right"):
        assert np.isnan(columns(recording, entity)["Scalars:scalars"][0])


def test_a_solvers_tolerance_is_no_missed_region(scene):
    regions = dataclasses.replace(scene.reconstruction.regions, slack=np.full(36, 1e-7))
    close = dataclasses.replace(scene.reconstruction, regions=regions)
    assert "1 of 36 regions missed" in facts(scene.observations, scene.reconstruction, None)
    assert not any("missed" in fact for fact in facts(scene.observations, close, None))
    left_over = dataclasses.replace(scene.reconstruction, left_over_share=0.12, left_over_px=np.array([[40.0, 61.0]]))
    said = "12% of what was segmented lies on no thread, about (40, 61)"
    assert said in facts(scene.observations, left_over, None)


def test_a_failure_gives_the_same_entities_so_that_it_empties_the_last_frame(scene, failed, nothing_seen, tmp_path):
    path = tmp_path / "failed.rrd"
    mapping.write_rrd(path, scene.left, scene.right, nothing_seen, failed)
    assert {chunk.entity_path for chunk in RrdReader(path).stream()} - {"/__properties"} == SPACE
    assert columns(path, "/world/thread/curve")["LineStrips3D:strips"] == []
    assert columns(path, "/world/observations/points")["Points3D:positions"] == []
    (text,) = columns(path, "/report")["TextDocument:text"]
    assert "FAILED" in text
    assert "is the thread in focus?" in text
    assert "No pixel was segmented as thread." in text


def test_several_threads_what_hides_them_and_the_score_are_shown_and_said(scene, tmp_path):
    thread = ThreadCandidate(0.9, np.array([[5.0, 5.0], [9.0, 7.0]]), np.zeros((0, 2)), 4.0, np.array([20, 30, 40]))
    other = dataclasses.replace(thread, score=0.25, left_px=np.array([[50.0, 60.0], [70.0, 65.0]]))
    tool = np.zeros((54, 96), np.uint8)
    tool[:20, :30] = Occluder.TOOL.value
    image, nothing = encode_image(tool, ImageEncoding.PNG), encode_image(np.zeros_like(tool), ImageEncoding.PNG)
    score = encode_image(tool, ImageEncoding.JPEG)
    occluders = Occluders(image, nothing, 0)
    seen = dataclasses.replace(scene.observations, candidates=(thread, other), occluders=occluders, score_map=score)
    hidden = dataclasses.replace(
        scene.reconstruction, hidden=np.array([[0.2, 0.5]]), ends_hidden=np.array([False, True]), other_threads=(other,)
    )
    path = tmp_path / "several.rrd"
    mapping.write_rrd(path, scene.left, scene.right, seen, hidden)
    assert len(columns(path, "/world/left/candidates")["LineStrips2D:strips"]) == 2
    assert columns(path, "/world/left/candidates/scores")["Points2D:labels"] == ["1: 0.90", "2: 0.25"]
    drawn = np.frombuffer(bytes(columns(path, "/world/left/occluders")["EncodedImage:blob"][0]), np.uint8)
    alpha = np.asarray(cv2.imdecode(drawn, cv2.IMREAD_UNCHANGED))[..., 3]
    assert (alpha > 0).mean() == pytest.approx(20 * 30 / tool.size, rel=0.05)
    assert not any("blob" in name for name in columns(path, "/world/right/occluders"))
    assert columns(path, "/perception/score")["EncodedImage:media_type"] == ["image/jpeg"]
    words = verdict(seen)
    assert "Thread 1 (meant): score 0.90" in words
    assert "Instruments cover 12% of the left image." in words
    assert {"30% hidden by instruments; may go on hidden at s=1", "1 further thread"} <= set(facts(seen, hidden, None))
    draw_picture(scene.left, scene.right, seen, hidden)


def test_odd_images_and_masks_do_not_stop_a_recording(scene, failed, tmp_path):
    broken = Image(ImageEncoding.PNG, 2**31, 2**31, 1, b"no image")
    observations = dataclasses.replace(scene.observations, mask_left=broken)
    for shape in ((1, 1), (3, 2, 1), (40, 60, 3)):
        path = tmp_path / "odd.rrd"
        mapping.write_rrd(path, np.zeros(shape, np.uint8), np.zeros(shape, np.uint8), observations, failed)
        assert path.stat().st_size > 0


def test_the_edges_of_a_region_are_the_twelve_of_a_block_within_its_bounds(scene):
    regions, camera = scene.reconstruction.regions, scene.reconstruction.camera
    edges = mapping.region_edges(camera, regions)
    x, y, z = np.moveaxis(edges, 2, 0)
    centre = regions.centre_camera
    u = 1000.0 * x / z - (1000.0 * centre[:, 0] / centre[:, 2])[:, None]
    v = 1000.0 * y / z - (1000.0 * centre[:, 1] / centre[:, 2])[:, None]
    assert np.allclose(np.abs(u), regions.bound_px[:, :1])
    assert np.allclose(np.abs(v), regions.bound_px[:, 1:])
    assert np.allclose(np.abs(z - centre[:, 2:]), regions.bound_depth[:, None])
    sides = np.stack((u > 0, v > 0, z > centre[:, 2:]), axis=2)
    changed = (sides[:, 1:] != sides[:, :-1]).sum(axis=2)
    assert (changed == 1).all(), "a step of the tour must follow one edge"
    for region in sides:
        walked = {frozenset(map(tuple, step)) for step in zip(region[:-1].tolist(), region[1:].tolist(), strict=True)}
        assert len(walked) == 12


@pytest.mark.parametrize("shown_recording", ["recording", "refined_recording"])
def test_a_viewer_shows_the_recording_without_complaint(shown_recording, request, tmp_path):
    recording = request.getfixturevalue(shown_recording)
    shot = REPOSITORY / "../shared/tools/rerun_shot.py"
    if not shot.exists() or not list(SOFTWARE_VULKAN.glob("lvp_icd*.json")):
        pytest.skip("needs shared/tools/rerun_shot.py and a software Vulkan driver (mesa-vulkan-drivers, libvulkan1)")
    picture = tmp_path / "shot.png"
    shown = subprocess.run(
        [sys.executable, shot, recording, picture, "--timeline", "frame", "--size", "800x450"],
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert shown.returncode == 0, shown.stdout + shown.stderr
    assert picture.stat().st_size > 10_000
