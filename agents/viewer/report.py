"""What is said about one reconstruction, in words: the same in the picture and in Rerun."""

import numpy as np
from jaxtyping import Bool

from agents.viewer.image_pane import decoded_mask
from agents.viewer.polyline import Polyline
from schemas.messages import (
    SURE,
    Image,
    Judgement,
    ReliabilityRegions,
    Severity,
    Status,
    ThreadObservations,
    ThreadReconstruction,
)
from shared.calibration.uncertainty import displacements
from shared.right_eye import right_eye_of
from shared.units import unit_name

LEAST_SAID = 0.005
"""Share of the thread from which on it is said to be hidden, and of what was segmented to lie on none."""

MISSED = 1e-3
"""Slack from which a region counts as missed, as a multiple of its bounds; less is a solver's tolerance."""


def missed(regions: ReliabilityRegions) -> Bool[np.ndarray, "n"]:
    """Which regions the curve does not pass through."""
    return regions.slack > MISSED


def unit_text(metres_per_unit: float | None) -> str:
    """The name of a calibration's unit, as it stands behind a number or on an axis."""
    if metres_per_unit is None:
        return "units (size unknown)"
    return unit_name(metres_per_unit) or f"units of {metres_per_unit:g} m"


def facts(observations: ThreadObservations, reconstruction: ThreadReconstruction, thread: Polyline | None) -> list[str]:
    """What was measured and how, a few words each."""
    unit = unit_text(reconstruction.camera.metres_per_unit)
    lines = [f"frame {reconstruction.stamp.sequence}", _observed(observations)]
    if thread is not None:
        lines.append(f"length {thread.length:.4g} {unit}")
    if len(reconstruction.confidence):
        low, high = reconstruction.confidence.min(), reconstruction.confidence.max()
        lines.append(f"confidence {low:.2f} to {high:.2f}")
    if calibration := calibration_text(reconstruction):
        lines.append(calibration)
    if outside := int(missed(reconstruction.regions).sum()):
        lines.append(f"{outside} of {len(reconstruction.regions.s)} regions missed")
    if hidden := hidden_text(reconstruction):
        lines.append(hidden)
    if undecided := undecided_text(reconstruction):
        lines.append(undecided)
    if left_over := left_over_text(reconstruction):
        lines.append(left_over)
    if others := len(reconstruction.other_threads):
        lines.append(f"{others} further thread{'s' if others > 1 else ''}")
    lines.append(f"method {reconstruction.method or 'unnamed'}")
    lines.append(f"segmenter {observations.segmenter or 'unnamed'}")
    return lines


def calibration_text(reconstruction: ThreadReconstruction) -> str:
    """By how much the calibration leaves the depth of the whole thread open; empty where it is exact or untold."""
    covariance, points = reconstruction.calibration_covariance, reconstruction.control_points_camera
    if covariance is None or not covariance.any() or len(points) == 0:
        return ""
    depth = displacements(reconstruction.camera, points)[:, 2]
    deviation = float(np.sqrt(np.median(np.einsum("ni,ij,nj->n", depth, covariance, depth))))
    return f"depth as a whole ± {deviation:.2g} {unit_text(reconstruction.camera.metres_per_unit)} by the calibration"


def _observed(observations: ThreadObservations) -> str:
    """How many observations there are, or points of centrelines where pixels were not matched."""
    lines = observations.centrelines_left, observations.centrelines_right
    points = sum(len(line.point_px) for line in lines)
    if points and not len(observations.matched_px):
        return f"{points} points of centrelines"
    return f"{len(observations.points_camera)} observations"


def reasons(observations: ThreadObservations, reconstruction: ThreadReconstruction) -> list[str]:
    """Why there is no thread; nothing where there is one."""
    texts = [reconstruction.reason]
    if observations.reason not in reconstruction.reason:
        texts.append(f"Perception: {observations.reason}")
    return [text for text in texts if text]


def findings(observations: ThreadObservations) -> list[Judgement]:
    """The judgements that lessen trust in the result, the gravest first."""
    grave = [judgement for judgement in observations.judgements if judgement.severity is not Severity.NOTE]
    return sorted(grave, key=lambda judgement: -judgement.severity.value)


def finding_text(judgement: Judgement) -> str:
    """One finding in one line."""
    remedy = f" Remedy: {judgement.remedy}" if judgement.remedy else ""
    return f"{judgement.severity.name} {judgement.code}: {judgement.finding}{remedy}"


def stereo_text(observations: ThreadObservations) -> list[str]:
    """How the eyes lie to each other, as far as the pair shows it, a sentence each."""
    lines: list[str] = []
    if (eye := right_eye_of(observations)) is not None:
        lines.append(
            f"The right eye was put in line: {eye.rows_px:.2f} px lower, turned by {eye.turned_deg:.3f} degrees, "
            f"{eye.magnified:.4f} times as large."
        )
    if observations.disparities_px is not None:
        least, most = observations.disparities_px
        lines.append(f"Thread is looked for at disparities of {least:.0f} to {most:.0f} px.")
    return lines


def threads_text(observations: ThreadObservations) -> list[str]:
    """Which threads perception tells apart, and what may hide them, a sentence each."""
    lines = [
        f"Thread {number}{' (meant)' if number == 1 else ''}: score {candidate.score:.2f}, "
        f"{candidate.width_px:.1f} px wide"
        for number, candidate in enumerate(observations.candidates, 1)
    ]
    if observations.occluders is None:
        return [*lines, "What may hide thread is not known: nobody looked, or the ground is of one colour."]
    covered = " and ".join(
        f"{share:.0%} of the {side} image"
        for side, image in (("left", observations.occluders.left), ("right", observations.occluders.right))
        if (share := _covered_share(image)) > 0
    )
    return [*lines, f"Instruments cover {covered}." if covered else "No instrument is in view."]


def left_over_text(reconstruction: ThreadReconstruction) -> str:
    """What of the segmented thread the result does not explain, empty where that is next to nothing."""
    share, at_px = reconstruction.left_over_share, reconstruction.left_over_px
    if share is None or share < LEAST_SAID:
        return ""
    where = (
        f", about {' and '.join(f'({u:.0f}, {v:.0f})' for u, v in at_px[:3])}"
        if at_px is not None and len(at_px)
        else ""
    )
    return f"{share:.0%} of what was segmented lies on no thread{where}"


def hidden_text(reconstruction: ThreadReconstruction) -> str:
    """What of the thread is hidden, empty where nothing is or nobody knows."""
    if reconstruction.hidden is None or reconstruction.ends_hidden is None:
        return ""
    share = float(np.diff(reconstruction.hidden).sum())
    ends = [name for name, hidden in zip(("s=0", "s=1"), reconstruction.ends_hidden, strict=True) if hidden]
    said = [f"{share:.0%} hidden by instruments"] if share >= LEAST_SAID else []
    if ends:
        said.append(f"may go on hidden at {' and '.join(ends)}")
    return "; ".join(said)


def undecided_text(reconstruction: ThreadReconstruction) -> str:
    """Where the thread may take another course, empty where it does not or nobody knows."""
    course = reconstruction.course
    if course is None:
        return ""
    doubtful = course.probability < SURE
    is_end = np.zeros(len(doubtful), bool)
    is_end[[0, -1] if len(is_end) else []] = True
    said: list[str] = []
    for words, which in (("may lead elsewhere", doubtful & ~is_end), ("may go on", doubtful & is_end)):
        places = [
            f"{s:.2f} ({1 - p:.0%})" for s, p in zip(course.joins[which, 0], course.probability[which], strict=True)
        ]
        if places:
            said.append(f"{words} at s={', '.join(places)}")
    return "; ".join(said)


def _covered_share(image: Image) -> float:
    kinds = decoded_mask(image)
    return 0.0 if kinds is None else float((kinds > 0).mean())


def markdown(observations: ThreadObservations, reconstruction: ThreadReconstruction, thread: Polyline | None) -> str:
    """Everything above as one document."""
    lines = [f"## {'OK' if reconstruction.status is Status.OK else 'FAILED'}"]
    lines += [f"**{reason}**" for reason in reasons(observations, reconstruction)]
    lines.append(" · ".join(facts(observations, reconstruction, thread)))
    if observations.candidates:
        lines += threads_text(observations)
    for judgement in sorted(observations.judgements, key=lambda judgement: -judgement.severity.value):
        lines.append(f"**{judgement.severity.name} {judgement.code}:** {judgement.finding} *{judgement.remedy}*")
    return "\n\n".join(lines)
