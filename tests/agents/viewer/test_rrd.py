"""What one reconstruction holds as a Rerun file."""

import dataclasses

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from agents.viewer import rrd, thread_mapping
from agents.viewer.colours import UNKNOWN, confidence_rgb
from agents.viewer.polyline import CORNERS
from agents.viewer.report import facts, markdown
from schemas.messages import ThreadCandidate, ThreadCourse
from tests.agents.viewer.conftest import STAMP, confidence_at, rows_of

PROPERTIES = "/__properties"


@pytest.fixture
def written(scene, tmp_path):
    """What the file of a reconstruction of the scene's images holds: entity to its one row."""

    def write(observations, reconstruction):
        path = tmp_path / "thread.rrd"
        rrd.write_rrd(path, scene.left, scene.right, observations, reconstruction)
        # of what is logged in several parts, all have the same row
        return {
            entity: {name: value for row in rows for name, value in row.items() if value is not None}
            for entity, rows in rows_of(path).items()
            if entity != PROPERTIES
        }

    return write


def test_a_file_has_a_layout_its_thread_in_the_colours_of_its_confidence_and_a_report(scene, written, tmp_path):
    rows = written(scene.observations, scene.reconstruction)
    reader = RrdReader(tmp_path / "thread.rrd")
    assert [store.application_id for store in reader.recordings()] == ["suturegrasp"]
    assert len(reader.blueprints()) == 1
    assert {(row["frame"], row["capture_time"]) for row in rows.values()} == {(42, STAMP.capture_left_ns)}
    curve = rows["/world/thread/curve"]
    strips = np.array(curve["LineStrips3D:strips"])
    assert strips.shape == (thread_mapping.CURVE_POINTS - 1, 2, 3)
    assert np.linalg.norm(strips[:, 0, None] - scene.curve[None], axis=2).min(axis=1).max() < 0.1
    rgba = np.array(curve["LineStrips3D:colors"], dtype=np.uint32)
    share = (np.arange(len(strips)) + 0.5) / len(strips)
    expected = confidence_rgb(confidence_at(share)).astype(int)
    red_green = np.stack((rgba >> 24, rgba >> 16 & 255), axis=1).astype(int)
    unseen = (share > 0.56) & (share < 0.66)
    assert np.abs(red_green[~unseen] - expected[~unseen, :2])[1:-1].max() <= 8
    assert (red_green[(share > 0.57) & (share < 0.65)] == UNKNOWN[:2]).all()
    (text,) = rows["/report"]["TextDocument:text"]
    for words in ("OK", "frame 42", "91.1", "mm", "FAULT SWAPPED", "Exchange the two images.", "NOTE SMALL"):
        assert words in text
    assert text.index("FAULT") < text.index("WARNING") < text.index("NOTE")


def test_how_far_a_thread_can_be_trusted_is_in_the_file_and_lines_lie_in_the_images_they_belong_to(scene, written):
    rows = written(scene.observations, scene.reconstruction)
    for entity, expected, within in (
        ("/residual_px/left/median", 0.3, 0.02),
        ("/residual_px/right/percentile_95", 4.0, 0.2),
        ("/share/unseen", 0.1, 0.01),
        ("/share/left_over_left", 0.0, 0.0),
        ("/deviation/mean", 0.45, 0.15),
        ("/deviation/worst", 0.8, 0.2),
    ):
        assert rows[entity]["Scalars:scalars"] == [pytest.approx(expected, abs=within)], entity
    tube = rows["/world/thread/posterior"]
    assert np.shape(tube["Mesh3D:vertex_positions"]) == (51 * CORNERS, 3)
    assert np.max(tube["Mesh3D:triangle_indices"]) == 51 * CORNERS - 1
    rgb = np.array(tube["Mesh3D:vertex_colors"], dtype=np.uint32).reshape(51, CORNERS)[:, 0] >> 8
    grey = UNKNOWN[0] << 16 | UNKNOWN[1] << 8 | UNKNOWN[2]
    assert set(range(29, 33)) <= set(np.flatnonzero(rgb == grey).tolist()) <= set(range(28, 34))
    assert rows["/world/right"]["Transform3D:translation"] == [[5.5, 0.0, 0.0]]
    for side, lines, off_px in (
        ("left", scene.observations.centrelines_left, 0.3),
        ("right", scene.observations.centrelines_right, 0.2),
    ):
        pieces = rows[f"/world/{side}/centrelines"]["LineStrips2D:strips"]
        assert [len(piece) for piece in pieces] == [280, 170]
        assert np.allclose(np.concatenate(pieces), lines.point_px + 0.5, atol=1e-3)
        whiskers = np.array(rows[f"/world/{side}/residuals_x20"]["LineStrips2D:strips"])
        assert np.allclose(np.linalg.norm(whiskers[5:60, 1] - whiskers[5:60, 0], axis=1), 20 * off_px, atol=0.8)


def test_a_failure_gives_the_same_entities_so_that_it_empties_the_last_frame(scene, failed, nothing_seen, written):
    rows = written(nothing_seen, failed)
    assert rows.keys() == written(scene.observations, scene.reconstruction).keys()
    assert np.isnan(rows["/deviation/mean"]["Scalars:scalars"][0])
    assert rows["/world/thread/curve"]["LineStrips3D:strips"] == []
    assert rows["/world/observations/points"]["Points3D:positions"] == []
    (text,) = rows["/report"]["TextDocument:text"]
    for words in ("FAILED", "is the thread in focus?", "No pixel was segmented as thread."):
        assert words in text


def test_what_was_missed_left_over_or_is_hidden_is_said_and_a_solvers_tolerance_is_not(scene):
    regions = dataclasses.replace(scene.reconstruction.regions, slack=np.full(36, 1e-7))
    close = dataclasses.replace(scene.reconstruction, regions=regions)
    assert "1 of 36 regions missed" in facts(scene.observations, scene.reconstruction, None)
    assert not any("missed" in fact for fact in facts(scene.observations, close, None))
    other = ThreadCandidate(0.25, np.ones((2, 2)), np.ones((2, 2)), 4.0, np.array([20, 30, 40]))
    thread = dataclasses.replace(
        close,
        left_over_share=0.12,
        left_over_px=np.array([[40.0, 61.0]]),
        hidden=np.array([[0.2, 0.5]]),
        ends_hidden=np.array([False, True]),
        other_threads=(other,),
    )
    document = markdown(dataclasses.replace(scene.observations, candidates=(other, other)), thread, None)
    for words in (
        "12% of what was segmented lies on no thread, about (40, 61)",
        "30% hidden by instruments; may go on hidden at s=1",
        "1 further thread",
        "Thread 2: score 0.25",
    ):
        assert words in document


def test_where_the_next_likeliest_course_leads_is_drawn_and_said_only_of_an_undecided_one(scene, written):
    joins = np.array([[0.0, 0.0], [0.3, 0.4], [0.6, 0.7], [1.0, 1.0]])
    other = np.array([[0.0, 0.3], [0.6, 0.4], [0.7, 1.0]])
    for least, links in ((0.6, [[0.3, 0.6], [0.4, 0.7]]), (0.97, [])):
        course = ThreadCourse(joins, np.array([1.0, least, least, 1.0]), other)
        thread = dataclasses.replace(scene.reconstruction, course=course)
        report = markdown(scene.observations, thread, None)
        assert ("may lead elsewhere at s=0.30 (40%)" in report) == bool(links)
        drawn = written(scene.observations, thread)["/world/thread/other_course"]["LineStrips3D:strips"]
        assert len(drawn) == len(links)
        assert course.elsewhere.tolist() == links


def test_all_strands_that_may_be_parts_of_one_thread_are_drawn(scene, written):
    strand = scene.reconstruction.as_strand
    for strands in ((strand, strand), ()):
        thread = dataclasses.replace(scene.reconstruction, strands=strands)
        drawn = written(scene.observations, thread)["/world/thread/strands"]["LineStrips3D:strips"]
        assert len(drawn) == len(strands)


def test_the_edges_of_a_region_are_the_twelve_of_a_block_within_its_bounds(scene):
    regions, centre = scene.reconstruction.regions, scene.reconstruction.regions.centre_camera
    edges = thread_mapping.region_edges(scene.reconstruction.camera, regions)
    px, centre_px = 1000.0 * edges[:, :, :2] / edges[:, :, 2:], 1000.0 * centre[:, :2] / centre[:, 2:]
    off = np.dstack((px - centre_px[:, None], edges[:, :, 2] - centre[:, None, 2]))
    assert np.allclose(np.abs(off), np.column_stack((regions.bound_px, regions.bound_depth))[:, None])
    changed = (off[:, 1:] > 0) != (off[:, :-1] > 0)
    assert (changed.sum(axis=2) == 1).all(), "a step of the tour must follow one edge"
    corners = (off[0] > 0) @ [1, 2, 4]
    assert len({frozenset(step) for step in zip(corners[1:].tolist(), corners[:-1].tolist(), strict=True)}) == 12


def test_bars_along_the_thread_are_what_rerun_makes_of_the_same_numbers():
    along = thread_mapping.ALONG
    heights, widths = np.linspace(0.0, 1.0, len(along)), np.full(len(along), 1 / len(along))
    expected = rr.BarChart(heights, abscissa=along, color=(1, 2, 3), widths=widths)
    assert thread_mapping.bars_along(heights, (1, 2, 3)) == expected
