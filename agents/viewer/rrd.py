"""One reconstruction as a Rerun file."""

import pathlib
from collections.abc import Iterable

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import UInt8

from agents.viewer.entity import LAST_FRAME, Entity
from agents.viewer.image_pane import decoded_mask
from agents.viewer.layout import FLAT, THREAD_DRAWN, arranged, looking_at, space_below
from agents.viewer.polyline import thread_polyline
from agents.viewer.report import unit_text
from agents.viewer.seen_mapping import candidate_entities, occluder_entities, score_entities
from agents.viewer.thread_mapping import (
    APPLICATION,
    BACKDROP,
    camera_entities,
    curve_looks,
    image_entities,
    mask_entities,
    observation_entities,
    reconstruction_entities,
    report_entities,
)
from schemas.messages import FrameStamp, ThreadObservations, ThreadReconstruction
from shared.camera import depth_of_disparity


def write_rrd(
    path: pathlib.Path,
    left_bgr: UInt8[np.ndarray, "h w *c"],
    right_bgr: UInt8[np.ndarray, "h w *c"],
    observations: ThreadObservations,
    reconstruction: ThreadReconstruction,
) -> None:
    """Write one reconstruction as a Rerun file with its layout inside.

    Raises:
        OSError: where the file cannot be written; Rerun's own file sink would wait for ever on a full disk.
    """
    recording = rr.RecordingStream(APPLICATION)
    stream = recording.binary_stream()
    recording.send_blueprint(layout(reconstruction), make_active=False, make_default=True)
    entities = [
        *camera_entities(observations.camera, BACKDROP * distance_of(reconstruction)),
        *image_entities(left_bgr, right_bgr),
        *mask_entities(decoded_mask(observations.mask_left), decoded_mask(observations.mask_right)),
        *observation_entities(observations),
        *candidate_entities(observations),
        *occluder_entities(observations),
        *score_entities(observations),
        *curve_looks(),
        *reconstruction_entities(reconstruction, observations),
        *report_entities(observations, reconstruction),
    ]
    _log(recording, reconstruction.stamp, entities)
    path.write_bytes(stream.read() or b"")


def _log(recording: rr.RecordingStream, stamp: FrameStamp, entities: Iterable[Entity]) -> None:
    """Log entities at the capture time of their frame."""
    recording.set_time("capture_time", timestamp=np.datetime64(stamp.capture_left_ns, "ns"))
    recording.set_time("frame", sequence=min(stamp.sequence, LAST_FRAME))
    for path, archetypes in entities:
        for archetype in archetypes:
            recording.log(path, archetype)


def layout(reconstruction: ThreadReconstruction) -> rrb.Blueprint:
    """Space to the left, both eyes and words to the right, charts along the thread below."""
    unit = unit_text(reconstruction.camera.metres_per_unit)
    drawn = ["$origin/**", *THREAD_DRAWN]
    left = rrb.Spatial2DView(origin="world/left", name="left", contents=[*drawn, "world/observations/points"])
    right = rrb.Spatial2DView(origin="world/right", name="right", contents=drawn)
    chart = rrb.Tabs(
        rrb.BarChartView(origin="deviation/along_s", name=f"deviation across the thread along s, {unit}"),
        rrb.BarChartView(origin="confidence", name="confidence along s"),
        rrb.Spatial2DView(origin="perception/score", name="score of the segmenter"),
        active_tab=0 if len(reconstruction.posterior_s) else 1,
    )
    space = space_below("world", f"space, {unit}", _eye_on(reconstruction), FLAT)
    words = rrb.TextDocumentView(origin="report", name="report")
    views = rrb.Vertical(
        rrb.Horizontal(space, rrb.Vertical(left, right), column_shares=[3, 2]),
        rrb.Horizontal(chart, words, column_shares=[3, 2]),
        row_shares=[3, 1],
    )
    return arranged(views, timeline="frame")


def distance_of(reconstruction: ThreadReconstruction) -> float:
    """How far away things are: the thread's depth, or what one disparity of a twentieth of the width would be."""
    thread = thread_polyline(reconstruction)
    if thread is not None:
        return float(np.median(thread.points_camera[:, 2]))
    camera = reconstruction.camera
    return float(depth_of_disparity(camera, np.array([0.05 * camera.image_width]))[0])


def _eye_on(reconstruction: ThreadReconstruction) -> rrb.EyeControls3D:
    thread, distance = thread_polyline(reconstruction), distance_of(reconstruction)
    target = np.array([0.0, 0.0, distance]) if thread is None else thread.points_camera.mean(axis=0)
    return looking_at(target, distance)
