"""Views of a board from folders of images, and from the frames of a running camera."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2

from agents.camera.image_files import ImageFileError, read_pair, read_side_by_side
from agents.cli.calibrate.options import Calibrate
from schemas.checks import MessageError
from schemas.codec import decode
from schemas.messages import StereoFrame
from schemas.topics import FRAMES
from shared.calibration.estimation.board import Board
from shared.calibration.estimation.coverage import NoView, View, coverage, lacking, view_of, why_not
from shared.images import ImageDataError, decode_image
from shared.runtime.connection import Connection
from shared.runtime.taps import Tapped
from shared.terminal import UsageError, say

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
SILENT_S = 5.0
"""A camera that gives nothing for so long does not run."""

Files = tuple[Path, Path | None]


@dataclass(frozen=True)
class Seen:
    """What was seen of the board.

    Fields:
        files: of each view by its name: the left and the right image, or both in one.
    """

    views: tuple[View, ...]
    none: tuple[NoView, ...]
    image_size: tuple[int, int]
    files: dict[str, Files]


def views_in_folders(options: Calibrate, board: Board) -> Seen:
    """The views in the folders that the options name, one line for each.

    Raises:
        UsageError: where they name no pairs of images.
        ImageFileError: where an image cannot be read, or differs in size.
    """
    files = _pairs(options)
    views, none, sizes = list[View](), list[NoView](), dict[tuple[int, int], str]()
    for name, (first, second) in files.items():
        left, right = read_side_by_side(first) if second is None else read_pair(first, second)
        sizes.setdefault((left.shape[1], left.shape[0]), name)
        if len(sizes) > 1:
            told = " and ".join(f"{size[0]}x{size[1]} ({of})" for size, of in sizes.items())
            raise ImageFileError(f"the images have different sizes: {told}; take all with one setting of the camera")
        found = view_of(name, left, right, board)
        if isinstance(found, View):
            views.append(found)
            say(f"{name}: {len(found.number)} corners in both images")
        else:
            none.append(found)
            say(f"{name}: left out, {found.reason}")
    return Seen(tuple(views), tuple(none), next(iter(sizes)), files)


def views_of_camera(
    connection: Connection, board: Board, folder: Path, most: int, stopped: threading.Event
) -> Seen | None:
    """Views of the rig's camera, kept as images in a folder, until nothing is missing; None where no frame comes."""
    newest, came = list[StereoFrame](), threading.Event()

    def take(tapped: Tapped) -> None:
        try:
            newest[:] = [decode(StereoFrame, tapped.payload)]
        except MessageError:
            return
        came.set()

    kept, files = list[View](), dict[str, Files]()
    size, before, said = (0, 0), None, ""
    with connection.listening((FRAMES,), take):
        while not stopped.is_set() and len(kept) < most:
            if not came.wait(SILENT_S):
                break
            came.clear()
            frame = newest[0]
            try:
                left, right = decode_image(frame.left), decode_image(frame.right)
            except ImageDataError:
                continue
            size = left.shape[1], left.shape[0]
            name = f"view{len(kept):02d}"
            view = view_of(name, left, right, board, thorough=False)
            reason = view.reason if isinstance(view, NoView) else why_not(view, before, tuple(kept), size[0])
            before = view if isinstance(view, View) else None
            if isinstance(view, NoView) or reason:
                said = _said(reason, said)
                continue
            thorough = view_of(name, left, right, board)
            kept.append(thorough if isinstance(thorough, View) else view)
            files[name] = _write(folder, name, left, right)
            missing = lacking(coverage(tuple(kept), board, size))
            said = _said(f"{name} is kept; {missing[0] if missing else 'nothing is missing'}", "")
            if not missing:
                break
    return Seen(tuple(kept), (), size, files) if size[0] else None


def _said(sentence: str, before: str) -> str:
    """Say it, unless it was said last."""
    if sentence != before:
        say(sentence)
    return sentence


def _write(folder: Path, name: str, left: cv2.typing.MatLike, right: cv2.typing.MatLike) -> Files:
    paths = folder / "left" / f"{name}.png", folder / "right" / f"{name}.png"
    for path, image in zip(paths, (left, right), strict=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return paths


def _pairs(options: Calibrate) -> dict[str, Files]:
    match options.left, options.right, options.stereo:
        case None, None, Path() as stereo:
            return {path.name: (path, None) for path in _images(stereo)}
        case Path() as left, Path() as right, None:
            firsts, seconds = list(_images(left)), list(_images(right))
            if len(firsts) != len(seconds):
                raise UsageError(
                    f"{left} holds {len(firsts)} images and {right} holds {len(seconds)}; give equally many, which "
                    "pair up in the order of their names"
                )
            return {a.name: (a, b) for a, b in zip(firsts, seconds, strict=True)}
        case _:
            raise UsageError("give --left and --right, or --stereo, or --live")


def _images(folder: Path) -> Iterator[Path]:
    if not folder.is_dir():
        raise UsageError(f"{folder} is no folder; give one that holds the images of one eye, or of both side by side")
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    if not found:
        raise UsageError(f"{folder} holds no images ({', '.join(SUFFIXES)})")
    yield from found
