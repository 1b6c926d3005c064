"""The options of `suturegrasp segment`, and what is wrong with them before any image is read."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents.cli.reconstruct.options import PICTURE_SUFFIXES, OptionalPath, check_place, is_one_file
from shared.terminal import UsageError


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


def check(options: Segment) -> None:
    """Raise a UsageError for files that must not or cannot be written."""
    there = [("--image", options.image)]
    for option, path in options.outputs.items():
        suffixes = PICTURE_SUFFIXES if option == "--picture" else (".png",)
        # a device such as /dev/stdout takes whatever it is given
        if path.suffix.lower() not in suffixes and (path.is_file() or not path.exists()):
            raise UsageError(f"{option} {path} must end in {' or '.join(suffixes)}")
        check_place(option, path)
        for other_option, other in there:
            if is_one_file(path, other):
                raise UsageError(f"{option} {path} would overwrite {other_option} {other}; give another name")
        there.append((option, path))
