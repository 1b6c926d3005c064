"""`suturegrasp segment`: what each pixel of one image is held to be, as files."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from agents.camera.image_files import read_image
from agents.cli.reconstruct.options import TOO_LARGE, Segment, check_segment
from agents.cli.whole_file import whole_file
from agents.perception.segmentation.classes import Kind, highest, scores_of
from shared.terminal import UsageError, say

TINTS = {Kind.THREAD: (80, 255, 80), Kind.NEEDLE: (60, 230, 255), Kind.INSTRUMENT: (255, 140, 40)}
"""Blue, green, red."""
TINT_SHARE = 0.55
Bgr = UInt8[np.ndarray, "h w 3"]
Classes = UInt8[np.ndarray, "h w"]


def run(options: Segment) -> int:
    """Segment as the options say and return the exit status; the one line about a failure goes to stderr."""
    check_segment(options)
    image = read_image(options.image)
    try:
        scores = scores_of(image)
    except MemoryError:
        raise UsageError(TOO_LARGE) from None
    classes = highest(scores)
    _write(options, image, scores, classes)
    # whoever has the classes written to standard output wants nothing else there
    if options.output.is_file():
        say(f"{_summary(classes)}: {', '.join(map(str, options.outputs.values()))}")
    return 0


def tinted(image: Bgr, classes: Classes) -> Bgr:
    """The image with what is no ground tinted."""
    drawn = image.astype(np.float32)
    for kind, colour in TINTS.items():
        shown = classes == kind
        drawn[shown] += TINT_SHARE * (np.array(colour, np.float32) - drawn[shown])
    return np.rint(drawn).astype(np.uint8)


def _write(options: Segment, image: Bgr, scores: Float32[np.ndarray, "h w 4"], classes: Classes) -> None:
    _write_image(options.output, classes)
    if options.scores is not None:
        _write_image(options.scores, np.rint(255 * scores[..., Kind.THREAD :]).astype(np.uint8))
    if options.picture is not None:
        _write_image(options.picture, tinted(image, classes))


def _write_image(path: Path, image: UInt8[np.ndarray, "h w *c"]) -> None:
    data = cv2.imencode(path.suffix or ".png", image)[1]
    with whole_file(path) as place:
        place.write_bytes(data.tobytes())


def _summary(classes: Classes) -> str:
    shares = np.bincount(classes.ravel(), minlength=len(Kind)) / classes.size
    told = ", ".join(f"{kind.name.lower()} {shares[kind]:.2%}" for kind in Kind)
    return f"{told} of {classes.shape[1]}x{classes.shape[0]} pixels"
