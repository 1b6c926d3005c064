"""The options of `suturegrasp reconstruct` and `segment`, and what is wrong with them before any image is read."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.cli.on_rig import OptionalPath, OptionalUnit
from agents.cli.places import check_outputs
from agents.perception.segmenter_names import GIVEN_MASKS, PROMPTABLE
from agents.reconstruction.method_names import DEFAULT_METHOD
from shared.terminal import UsageError

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
TOO_LARGE = "the memory does not suffice for images of this size; give smaller ones"
CALIBRATION_SUFFIXES = (".yaml", ".yml", ".xml", ".json", ".txt")

Segmenter = Literal["mask", "threshold", "network", "promptable"]


@dataclass(frozen=True)
class Reconstruct:
    """Turn a stereo pair into a thread in 3D with its confidence.

    Give either --left and --right, or --stereo. Exit status: 0 ok, 2 unusable input, 3 no thread could be
    reconstructed (the output is written and holds the reason).
    """

    calibration: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="PATH [PATH]")]
    """OpenCV YAML or XML, ROS camera_info (a file, left and right, or a folder), a folder of text matrices, or JSON."""
    output: Annotated[Path, tyro.conf.arg(metavar="JSON")]
    """Where the result goes, as JSON."""
    left: OptionalPath = None
    """The left image."""
    right: OptionalPath = None
    """The right image."""
    stereo: OptionalPath = None
    """Both images side by side in one file, left first."""
    unit: OptionalUnit = None
    """The calibration's unit of length, where its file does not say."""
    left_mask: OptionalPath = None
    """Coverage of the left image by thread, 8 bits; leave both masks out to have the thread found."""
    right_mask: OptionalPath = None
    """Coverage of the right image by thread."""
    segmenter: Annotated[Segmenter | None, tyro.conf.arg(metavar="{mask,threshold,network,promptable}")] = None
    """How thread is found: as the masks say, by contrast to a plain ground, or as ridges of one colour on tissue,
    or by a network that is told which is meant.
    Default: what suits the image."""
    pixel: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="U V")] = None
    """A pixel of the rectified left image, on the thread that is meant."""
    promptable_encoder: OptionalPath = None
    """For segmenter `promptable`: the network's encoder, an ONNX file (docs/model_card.md)."""
    promptable_decoder: OptionalPath = None
    """And its decoder."""
    promptable_encoder_sha256: Annotated[str | None, tyro.conf.arg(metavar="HEX")] = None
    """What the encoder's hash must be."""
    promptable_decoder_sha256: Annotated[str | None, tyro.conf.arg(metavar="HEX")] = None
    """What the decoder's hash must be."""
    method: Literal["paper", "refined"] = DEFAULT_METHOD
    """How the curve is found."""
    picture: OptionalPath = None
    """Also draw both images with the thread, its confidence and its depth (PNG or JPEG)."""
    rrd: OptionalPath = None
    """Also write a Rerun recording that shows the thread in 3D."""

    @property
    def outputs(self) -> dict[str, Path]:
        """The files to be written, by option."""
        named = {"--output": self.output, "--picture": self.picture, "--rrd": self.rrd}
        return {option: path for option, path in named.items() if path is not None}

    @property
    def inputs(self) -> dict[str, Path]:
        """The images and masks to be read, by option."""
        named = {
            "--left": self.left,
            "--right": self.right,
            "--stereo": self.stereo,
            "--left-mask": self.left_mask,
            "--right-mask": self.right_mask,
            "--promptable-encoder": self.promptable_encoder,
            "--promptable-decoder": self.promptable_decoder,
        }
        return {option: path for option, path in named.items() if path is not None}


def check(options: Reconstruct) -> None:
    """Raise a UsageError for options that do not go together, and for outputs that must not be written."""
    _check_masks(options)
    _check_prompt(options)
    if not 1 <= len(options.calibration) <= 2:
        raise UsageError(f"--calibration takes one path, or two (left and right), not {len(options.calibration)}")
    if options.picture is not None and options.picture.suffix.lower() not in PICTURE_SUFFIXES:
        raise UsageError(f"--picture {options.picture} must end in .png or .jpg")
    calibration = (("--calibration", path) for path in _calibration_files(options.calibration))
    check_outputs(options.outputs, (*options.inputs.items(), *calibration))


def _check_masks(options: Reconstruct) -> None:
    if (options.left_mask is None) != (options.right_mask is None):
        raise UsageError("give both --left-mask and --right-mask, or neither")
    if options.left_mask is None and options.segmenter == GIVEN_MASKS:
        raise UsageError("--segmenter mask needs --left-mask and --right-mask")
    if options.left_mask is not None and options.segmenter not in (None, GIVEN_MASKS):
        raise UsageError(
            f"masks are given, so --segmenter {options.segmenter} would not be used; give one or the other"
        )


def _check_prompt(options: Reconstruct) -> None:
    files = options.promptable_encoder, options.promptable_decoder
    if files.count(None) == 1:
        raise UsageError("give both --promptable-encoder and --promptable-decoder, or neither")
    if options.segmenter == PROMPTABLE and files[0] is None:
        raise UsageError("--segmenter promptable needs --promptable-encoder and --promptable-decoder")
    if options.left_mask is not None and options.pixel is not None:
        raise UsageError("masks are given, so --pixel would not be used; give one or the other")


def _calibration_files(paths: Iterable[Path]) -> Iterator[Path]:
    """The files of a calibration; of a folder, all that may belong to it, unless an earlier run has written them."""
    # help and operator commands need none of what a result is made of
    from agents.cli.reconstruct.result_file import is_result

    for path in paths:
        if path.is_dir():
            files = (file for file in path.iterdir() if file.suffix.lower() in CALIBRATION_SUFFIXES)
            yield from (file for file in files if not is_result(file))
        else:
            yield path


@dataclass(frozen=True)
class Segment:
    """Say of each pixel of one image whether it shows ground, thread, needle or instrument.

    By the project's network, which perception looks by as well: docs/model_card.md says what it has learned.

    Grey images and those of 16 bits are taken as colour of 8 bits. Exit status: 0 ok, whether or not there is any
    thread, 2 unusable input.
    """

    image: Annotated[Path, tyro.conf.arg(metavar="PATH")]
    """The image, of one eye."""
    output: Annotated[Path, tyro.conf.arg(metavar="PNG")]
    """Where the classes go, 8 bits a pixel: 0 ground, 1 thread, 2 needle, 3 instrument."""
    scores: Annotated[Path | None, tyro.conf.arg(metavar="PNG")] = None
    """Also write how likely each pixel is thread (blue), needle (green) and instrument (red), 0 to 255."""
    picture: OptionalPath = None
    """Also draw the image with thread tinted green, needles yellow and instruments blue (PNG or JPEG)."""

    @property
    def outputs(self) -> dict[str, Path]:
        """The files to be written, by option."""
        named = {"--output": self.output, "--scores": self.scores, "--picture": self.picture}
        return {option: path for option, path in named.items() if path is not None}


def check_segment(options: Segment) -> None:
    """Raise a UsageError for files that must not or cannot be written."""
    for option, path in options.outputs.items():
        suffixes = PICTURE_SUFFIXES if option == "--picture" else (".png",)
        # a device such as /dev/stdout takes whatever it is given
        if path.suffix.lower() not in suffixes and (path.is_file() or not path.exists()):
            raise UsageError(f"{option} {path} must end in {' or '.join(suffixes)}")
    check_outputs(options.outputs, [("--image", options.image)])
