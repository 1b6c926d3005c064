"""One reconstruction as a Rerun file."""

import pathlib

import numpy as np
import rerun as rr
from jaxtyping import UInt8

from agents.viewer.image_pane import decoded_mask
from agents.viewer.layout import distance_of, layout
from agents.viewer.seen_mapping import candidate_entities, occluder_entities, score_entities
from agents.viewer.thread_mapping import (
    APPLICATION,
    BACKDROP,
    camera_entities,
    curve_looks,
    image_entities,
    log,
    mask_entities,
    observation_entities,
    reconstruction_entities,
    report_entities,
)
from schemas.messages import ThreadObservations, ThreadReconstruction


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
    log(recording, reconstruction.stamp, entities)
    path.write_bytes(stream.read() or b"")
