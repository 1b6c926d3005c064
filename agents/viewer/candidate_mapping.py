"""Several threads, what may hide them, and what is judged of the input, as Rerun shows it.

world/{side}/candidates     the threads that perception tells apart, each in its colour; the left ones with their score
world/{side}/occluders      what may hide thread, as translucent regions: tool, needle, unknown
perception/score            how much of each pixel the segmenter takes for thread, when the whole was last looked at
perception/score/pieces     the left image's pieces of thread on that map, each with the mean log-odds of its pixels
perception/verdict          in words: what is judged of the images, which threads there are, what hides them
"""

import cv2
import numpy as np
import rerun as rr
from jaxtyping import UInt8

from agents.viewer import colours
from agents.viewer.entity import HALF_PX, Entity
from agents.viewer.image_pane import decoded_mask, enlarged
from agents.viewer.report import finding_text, findings, stereo_text, threads_text
from schemas.messages import Image, ImageEncoding, Status, ThreadCandidate, ThreadObservations
from shared.right_eye import IN_LINE, Affine, moved

SIDES = ("left", "right")
OPACITY = 60
"""Of 255."""
LARGEST_PIXELS = 1 << 26
THICK = 1.2
"""In pixels of the screen; the reconstructed curve lies over the candidate that it is."""


def candidate_entities(observations: ThreadObservations, to_shown: Affine = IN_LINE) -> list[Entity]:
    """Every candidate as a line of its own colour, with its number and score in the left image.

    Args:
        to_shown: from pixels of the right image in line to those of the one that is shown.
    """
    listed = observations.candidates
    return [
        ("world/left/candidates", [_lines([c.left_px for c in listed])]),
        ("world/left/candidates/scores", [_scores(listed)]),
        ("world/right/candidates", [_lines([moved(c.right_px, to_shown) for c in listed])]),
    ]


def occluder_entities(observations: ThreadObservations, to_shown: Affine = IN_LINE) -> list[Entity]:
    """Regions that may hide thread, over each image; empty where there are none.

    Args:
        to_shown: from pixels of the right image in line to those of the one that is shown.
    """
    found = observations.occluders
    maps = (None, IN_LINE), (None, IN_LINE)
    if found is not None:
        maps = (found.left, IN_LINE), (found.right, to_shown)
    size = observations.camera.image_width, observations.camera.image_height
    return [
        (f"world/{side}/occluders", [_regions(image, size, by)]) for side, (image, by) in zip(SIDES, maps, strict=True)
    ]


def score_entities(observations: ThreadObservations) -> list[Entity]:
    """The map of the segmenter's score, where the message has one: the last one stands until the next."""
    score = observations.score_map
    if score is None or score.encoding is ImageEncoding.RAW:
        return []
    media_type = "image/jpeg" if score.encoding is ImageEncoding.JPEG else "image/png"
    shown: list[Entity] = [("perception/score", [rr.EncodedImage(contents=score.data, media_type=media_type)])]
    levels = decoded_mask(score)
    return shown if levels is None else [*shown, ("perception/score/pieces", [_pieces(observations, levels)])]


def verdict_entities(observations: ThreadObservations) -> list[Entity]:
    """What is judged of the input, and what was seen, in words."""
    return [("perception/verdict", [rr.TextDocument(verdict(observations), media_type=rr.MediaType.MARKDOWN)])]


def verdict(observations: ThreadObservations) -> str:
    """The same as text, in Markdown."""
    said = [f"**{finding_text(judgement)}**" for judgement in findings(observations)]
    if observations.status is not Status.OK:
        said.insert(0, f"**No thread:** {observations.reason}")
    elif not said:
        said = ["Nothing is wrong with the images."]
    return "\n\n".join([*said, *stereo_text(observations), *threads_text(observations)])


def _lines(lines: list[np.ndarray]) -> rr.LineStrips2D:
    rgb = [colours.candidate_rgb(number) for number in range(len(lines))]
    return rr.LineStrips2D([line + HALF_PX for line in lines], colors=rgb, radii=[-THICK])


def _scores(listed: tuple[ThreadCandidate, ...]) -> rr.Points2D:
    """Number and score at a place on each thread, another one for each, so that they do not meet where threads do."""
    places = [c.left_px[int((len(c.left_px) - 1) * (k + 1) / (len(listed) + 1))] for k, c in enumerate(listed)]
    return rr.Points2D(
        np.array(places).reshape(-1, 2) + HALF_PX,
        colors=[colours.candidate_rgb(number) for number in range(len(listed))],
        labels=[f"{number}: {candidate.score:.2f}" for number, candidate in enumerate(listed, 1)],
        show_labels=True,
        radii=[-2.0],
    )


def _pieces(observations: ThreadObservations, score: UInt8[np.ndarray, "r c"]) -> rr.LineStrips2D:
    """Each piece of the left centreline in a copy of the score, with what it scores."""
    lines, rows, columns = observations.centrelines_left, *score.shape
    at = (lines.point_px + HALF_PX) * (columns / observations.camera.image_width)
    column, row = (np.clip(at[:, k], 0, size - 1).astype(np.intp) for k, size in enumerate((columns, rows)))
    share = (score[row, column] + 0.5) / 256
    each = [lines.piece == number for number in np.unique(lines.piece)]
    log_odds = [float(np.log(share[some] / (1 - share[some])).mean()) for some in each]
    return rr.LineStrips2D(
        [at[some] for some in each],
        colors=[colours.candidate_rgb(number) for number in range(len(each))],
        labels=[f"{value:+.1f}" for value in log_odds],
        show_labels=True,
        radii=[-THICK],
    )


def _regions(image: Image | None, size: tuple[int, int], by: Affine) -> rr.AsComponents:
    kinds = None if image is None else decoded_mask(image)
    # a camera may claim any size
    if kinds is None or not kinds.any() or size[0] * size[1] > LARGEST_PIXELS:
        return rr.Clear(recursive=False)
    drawn = np.zeros((size[1], size[0], 4), np.uint8)
    for kind, rgb in colours.OCCLUDERS.items():
        drawn[enlarged(kinds == kind.value, size)] = (*rgb[::-1], OPACITY)
    if by is not IN_LINE:
        drawn = np.asarray(cv2.warpAffine(drawn, by, size, flags=cv2.INTER_NEAREST))
    return rr.EncodedImage(contents=cv2.imencode(".png", drawn)[1].tobytes(), media_type="image/png", draw_order=1.0)
