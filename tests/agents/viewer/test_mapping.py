import dataclasses

import numpy as np
import pytest
from rerun.chunk import RrdReader

from agents.viewer import rrd, thread_mapping
from agents.viewer.colours import UNKNOWN, confidence_rgb
from agents.viewer.polyline import CORNERS
from agents.viewer.report import facts, markdown
from schemas.messages import (
    ThreadCandidate,
    ThreadCourse,
)


def columns(path, entity):
    """What a recording holds about an entity: component name to the value of its one row."""
    found = {}
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == entity:
            batch = chunk.to_record_batch()
            found |= {name: batch.column(name).to_pylist()[0] for name in batch.schema.names if ":" in name}
    return found


def entities_of(path):
    return {chunk.entity_path for chunk in RrdReader(path).stream()} - {"/__properties"}


@pytest.fixture(scope="module")
def recording(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("good") / "thread.rrd"
    rrd.write_rrd(path, scene.left, scene.right, scene.observations, scene.reconstruction)
    return path


def test_a_recording_has_a_layout_and_everything_in_it_stands_at_the_capture_time_of_its_frame(recording, scene):
    reader = RrdReader(recording)
    assert [store.application_id for store in reader.recordings()] == ["suturegrasp"]
    assert len(reader.blueprints()) == 1
    for chunk in reader.stream():
        if chunk.entity_path != "/__properties":
            batch = chunk.to_record_batch()
            assert batch.column("frame").to_pylist() == [42]
            captured = np.array(batch.column("capture_time").cast("int64"))
            assert captured.tolist() == [scene.observations.stamp.capture_left_ns]


def test_the_curve_is_the_thread_in_the_colours_of_its_confidence(recording, scene):
    curve = columns(recording, "/world/thread/curve")
    strips = np.array(curve["LineStrips3D:strips"])
    assert strips.shape == (thread_mapping.CURVE_POINTS - 1, 2, 3)
    nearest = np.linalg.norm(strips[:, 0, None] - scene.curve[None], axis=2).min(axis=1)
    assert nearest.max() < 0.1
    rgba = np.array(curve["LineStrips3D:colors"], dtype=np.uint32)
    share = (np.arange(len(strips)) + 0.5) / len(strips)
    expected = confidence_rgb(np.clip(1 - 0.95 * np.exp(-(((share - 0.62) / 0.12) ** 2)), 0, 1)).astype(int)
    red_green = np.stack((rgba >> 24, rgba >> 16 & 255), axis=1).astype(int)
    unseen = (share > 0.56) & (share < 0.66)
    assert np.abs(red_green[~unseen] - expected[~unseen, :2])[1:-1].max() <= 8
    assert (red_green[(share > 0.57) & (share < 0.65)] == UNKNOWN[:2]).all()


def test_the_report_names_status_findings_and_remedies(recording):
    (text,) = columns(recording, "/report")["TextDocument:text"]
    for words in ("OK", "frame 42", "91.1", "mm", "FAULT SWAPPED", "Exchange the two images.", "NOTE SMALL"):
        assert words in text
    assert text.index("FAULT") < text.index("WARNING") < text.index("NOTE")


@pytest.fixture(scope="module")
def refined_recording(refined, tmp_path_factory):
    path = tmp_path_factory.mktemp("refined") / "refined.rrd"
    rrd.write_rrd(path, refined.left, refined.right, refined.observations, refined.reconstruction)
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
    assert columns(refined_recording, "/world/right")["Transform3D:translation"] == [[5.5, 0.0, 0.0]]
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


def test_what_was_missed_left_over_or_is_hidden_is_said_and_a_solvers_tolerance_is_not(scene):
    regions = dataclasses.replace(scene.reconstruction.regions, slack=np.full(36, 1e-7))
    close = dataclasses.replace(scene.reconstruction, regions=regions)
    assert "1 of 36 regions missed" in facts(scene.observations, scene.reconstruction, None)
    assert not any("missed" in fact for fact in facts(scene.observations, close, None))
    left_over = dataclasses.replace(scene.reconstruction, left_over_share=0.12, left_over_px=np.array([[40.0, 61.0]]))
    said = "12% of what was segmented lies on no thread, about (40, 61)"
    assert said in facts(scene.observations, left_over, None)
    other = ThreadCandidate(0.25, np.ones((2, 2)), np.ones((2, 2)), 4.0, np.array([20, 30, 40]))
    hidden = dataclasses.replace(
        close, hidden=np.array([[0.2, 0.5]]), ends_hidden=np.array([False, True]), other_threads=(other,)
    )
    document = markdown(dataclasses.replace(scene.observations, candidates=(other, other)), hidden, None)
    for words in ("30% hidden by instruments; may go on hidden at s=1", "1 further thread", "Thread 2: score 0.25"):
        assert words in document


def test_where_the_next_likeliest_course_leads_is_drawn_and_said_only_of_an_undecided_one(scene, tmp_path):
    joins = np.array([[0.0, 0.0], [0.3, 0.4], [0.6, 0.7], [1.0, 1.0]])
    other = np.array([[0.0, 0.3], [0.6, 0.4], [0.7, 1.0]])
    for least, links in ((0.6, 2), (0.97, 0)):
        course = ThreadCourse(joins, np.array([1.0, least, least, 1.0]), other)
        thread = dataclasses.replace(scene.reconstruction, course=course)
        assert ("may lead elsewhere at s=0.30 (40%)" in markdown(scene.observations, thread, None)) == (links > 0)
        rrd.write_rrd(tmp_path / "x.rrd", scene.left, scene.right, scene.observations, thread)
        drawn = columns(tmp_path / "x.rrd", "/world/thread/other_course")["LineStrips3D:strips"]
        assert len(drawn) == links
        assert course.elsewhere.tolist() == ([[0.3, 0.6], [0.4, 0.7]] if links else [])


def test_a_failure_gives_the_same_entities_so_that_it_empties_the_last_frame(
    scene, failed, nothing_seen, refined_recording, tmp_path
):
    path = tmp_path / "failed.rrd"
    rrd.write_rrd(path, scene.left, scene.right, nothing_seen, failed)
    assert entities_of(path) == entities_of(refined_recording)
    assert np.isnan(columns(path, "/deviation/mean")["Scalars:scalars"][0])
    assert columns(path, "/world/thread/curve")["LineStrips3D:strips"] == []
    assert columns(path, "/world/observations/points")["Points3D:positions"] == []
    (text,) = columns(path, "/report")["TextDocument:text"]
    assert "FAILED" in text
    assert "is the thread in focus?" in text
    assert "No pixel was segmented as thread." in text


def test_the_edges_of_a_region_are_the_twelve_of_a_block_within_its_bounds(scene):
    regions, camera = scene.reconstruction.regions, scene.reconstruction.camera
    edges = thread_mapping.region_edges(camera, regions)
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


@pytest.mark.slow
def test_a_viewer_shows_the_recording_without_complaint(refined_recording, shown_by_rerun):
    shown_by_rerun(refined_recording, "frame")
