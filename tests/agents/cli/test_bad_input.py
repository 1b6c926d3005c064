"""Whatever is wrong with the input: one line that names it, nothing on standard output, and nothing destroyed."""

import contextlib
import functools
import json
import os
import re
import signal
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from agents.cli.reconstruct import command as reconstruct

SCRIPT = Path(sys.executable).with_name("suturegrasp")


def encoded(suffix: str, image: np.ndarray) -> bytes:
    return cv2.imencode(suffix, image)[1].tobytes()


def noise(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(3).integers(0, 256, (height, width, 3), dtype=np.uint8)


def png_claiming(width: int, height: int) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")


def torn_jpeg() -> bytes:
    data = bytearray(encoded(".jpg", noise(180, 320)))
    data[len(data) // 2 : len(data) // 2 + 40] = b"\x5a" * 40
    return bytes(data)


@pytest.fixture
def with_masks(pair, small):
    """The command on the small pair and its masks, but for its outputs."""
    return (*pair(small), "--left-mask", small / "mask_left.png", "--right-mask", small / "mask_right.png")


HALF_A_PNG = encoded(".png", noise(180, 320))[:9000]
BAD_FILES: dict[str, tuple[str, bytes, str]] = {
    "an empty file": ("left.png", b"", "is an empty file"),
    "text": ("left.png", b"left image\n", "no image that can be decoded"),
    "half a PNG": ("left.png", HALF_A_PNG, "damaged"),
    "half a TIFF": ("left.png", encoded(".tif", noise(180, 320))[:9000], "damaged"),
    "a torn JPEG": ("left.png", torn_jpeg(), "damaged"),
    "no pixel": ("left.png", png_claiming(0, 0), "damaged"),
    "60000x60000 in a header": ("left.png", png_claiming(60000, 60000), "million pixels"),
    "another size": ("left.png", encoded(".png", noise(180, 322)), "differ in size: .* 322x180 .* 320x180"),
    "float32": ("left.png", encoded(".tif", noise(180, 320).astype(np.float32)), "holds float32 numbers"),
    "no thread": ("mask_left.png", encoded(".png", np.zeros((180, 320), np.uint8)), "no pixel is marked as thread"),
    "half a mask": ("mask_right.png", HALF_A_PNG, "damaged"),
    "a mask of another size": (
        "mask_right.png",
        encoded(".png", np.ones((90, 160), np.uint8)),
        "160x90 pixels, its image 320x180",
    ),
    "broken JSON": ("calibration.json", b'{"K": [[330, 0', "not valid JSON"),
    "another document": ("calibration.json", b'{"name": "thread"}', "camera matrix"),
    "a calibration of another size": (
        "calibration.json",
        b'{"K": [[330,0,160],[0,330,90],[0,0,1]], "baseline_mm": 5, "width": 640, "height": 360}',
        "640x360",
    ),
    "exchanged cameras": (
        "calibration.json",
        b"%YAML:1.0\n---\nK1: [330,0,160,0,330,90,0,0,1]\nK2: [330,0,160,0,330,90,0,0,1]\nD1: [0,0,0,0]\n"
        b"D2: [0,0,0,0]\nR: [1,0,0,0,1,0,0,0,1]\nT: [5,0,0]\n",
        "right camera stands to the left of the left one",
    ),
}


@pytest.mark.parametrize("what", BAD_FILES)
def test_a_bad_file_is_named_in_one_line(suturegrasp, pair, with_masks, small, what):
    name, content, complaint = BAD_FILES[what]
    (small / name).write_bytes(content)
    command = with_masks if "mask" in name else pair(small)
    refused(suturegrasp(*command, "--output", small / "out.json"), complaint, small / name)
    assert not (small / "out.json").exists()


def test_images_that_are_too_small_are_refused(suturegrasp, pair, small):
    for shape in ((15, 320), (180, 15)):
        for name in ("left.png", "right.png"):
            cv2.imwrite(str(small / name), noise(*shape))
        ended = suturegrasp(*pair(small), "--output", small / "out.json")
        refused(ended, f"has only {shape[1]}x{shape[0]} pixels; at least 16 each way are needed")


def test_a_side_by_side_image_without_two_halves_is_refused(suturegrasp, small):
    options = ("--calibration", small / "calibration.json", "--output", small / "out.json")
    for width, complaint in ((641, "641 pixels wide"), (30, "each half .* has only 15x180")):
        cv2.imwrite(str(small / "both.png"), noise(180, width))
        refused(suturegrasp("reconstruct", "--stereo", small / "both.png", *options), complaint)


def test_a_mask_that_marks_everything_fails_with_its_reason(suturegrasp, with_masks, small):
    cv2.imwrite(str(small / "mask_left.png"), np.full((180, 320), 255, np.uint8))
    ended = suturegrasp(*with_masks, "--output", small / "out.json")
    assert (ended.status, ended.out, len(ended.err.splitlines())) == (3, "", 1)
    assert json.loads((small / "out.json").read_text())["reason"] in ended.err


@pytest.mark.parametrize(
    ("name", "becomes"),
    [
        ("left.png", "nothing"),
        ("right.png", "a folder"),
        ("mask_left.png", "a broken link"),
        ("mask_right.png", "a link to itself"),
        ("calibration.json", "a folder"),
    ],
)
def test_an_input_that_is_no_file_is_named(suturegrasp, with_masks, small, name, becomes):
    path = small / name
    path.unlink()
    if becomes == "a folder":
        path.mkdir()
    elif becomes != "nothing":
        path.symlink_to(path if becomes == "a link to itself" else "nowhere")
    refused(suturegrasp(*with_masks, "--output", small / "out.json"), "", path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_an_input_that_may_not_be_read_is_named(suturegrasp, with_masks, small):
    (small / "calibration.json").chmod(0)
    ended = suturegrasp(*with_masks, "--output", small / "out.json")
    refused(ended, "cannot be read", small / "calibration.json")


def test_a_name_that_is_too_long_and_a_device_that_never_ends_are_refused(suturegrasp, pair, small, monkeypatch):
    long = small / ("x" * 300)
    refused(suturegrasp(*pair(small), "--output", long), "File name too long")
    others = ("--right", small / "right.png", "--calibration", small / "calibration.json", "--output", small / "o.json")
    refused(suturegrasp("reconstruct", "--left", long, *others), "File name too long")
    monkeypatch.setattr("agents.camera.image_files.LARGEST_FILE_BYTES", 1 << 20)
    refused(suturegrasp("reconstruct", "--left", "/dev/zero", *others), "/dev/zero is larger than 1 MB")


def test_left_and_right_exchanged_is_told(suturegrasp, small):
    ended = suturegrasp(
        *("reconstruct", "--left", small / "right.png", "--right", small / "left.png"),
        *("--calibration", small / "calibration.json", "--output", small / "out.json"),
    )
    assert (ended.status, ended.out, len(ended.err.splitlines())) == (3, "", 1)
    assert "exchange --left and --right" in json.loads((small / "out.json").read_text())["reason"]


@pytest.mark.parametrize(
    ("option", "name", "through"),
    [
        ("--output", "left.png", "itself"),
        ("--output", "mask_right.png", "a link"),
        ("--output", "calibration.json", "a hard link"),
        ("--picture", "right.png", "another spelling"),
        ("--picture", "mask_left.png", "itself"),
        ("--rrd", "calibration.json", "a link"),
    ],
)
def test_an_input_is_never_overwritten(suturegrasp, with_masks, small, option, name, through):
    path = small / name
    if through == "a link":
        path = small / f"link{path.suffix}"
        path.symlink_to(name)
    elif through == "a hard link":
        path = small / f"link{path.suffix}"
        path.hardlink_to(small / name)
    elif through == "another spelling":
        path = small / ".." / "small" / name
    before = (small / name).read_bytes()
    output = () if option == "--output" else ("--output", small / "out.json")
    refused(suturegrasp(*with_masks, *output, option, path), f"{option} .* would overwrite --", small / name)
    assert (small / name).read_bytes() == before


def test_neither_a_calibration_in_a_folder_nor_another_output_is_overwritten(suturegrasp, pair, small):
    images = ("reconstruct", "--left", small / "left.png", "--right", small / "right.png", "--calibration", small)
    (small / "truth.json").unlink()
    refused(suturegrasp(*images, "--output", small / "calibration.json"), "would overwrite --calibration")
    ended = suturegrasp(*pair(small), "--output", small / "out", "--rrd", small / "out")
    refused(ended, "--rrd .* would overwrite --output")


@pytest.mark.parametrize("option", ["--output", "--picture", "--rrd"])
def test_an_output_without_a_place_is_refused(suturegrasp, pair, small, option):
    command = (*pair(small), *(() if option == "--output" else ("--output", small / "out.json")), option)
    refused(suturegrasp(*command, small / "no" / "out.png"), "does not exist; create it first")
    (small / "folder.png").mkdir()
    refused(suturegrasp(*command, small / "folder.png"), "is a folder; give the name of a file")


def test_options_that_contradict_the_files_are_refused(suturegrasp, pair, small):
    command = (*pair(small), "--output", small / "out.json")
    refused(suturegrasp(*command, "--picture", small / "out.png.txt"), "must end in .png or .jpg")
    refused(suturegrasp(*command, "--unit", "cm"), "states its lengths in mm, which contradicts --unit cm")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no device that is always full")
@pytest.mark.parametrize("option", ["--output", "--picture"])
def test_a_full_device_is_told(suturegrasp, pair, small, option):
    full = small / "full.png"
    full.symlink_to("/dev/full")
    output = () if option == "--output" else ("--output", small / "out.json")
    refused(suturegrasp(*pair(small), *output, option, full), "cannot be written: .*No space left on device", full)
    assert full.is_symlink()


def test_an_earlier_result_survives_unusable_input(suturegrasp, pair, small):
    outputs = [small / name for name in ("out.json", "out.png", "out.rrd")]
    for path in outputs:
        path.write_text("of an earlier run")
    (small / "left.png").write_bytes(b"damaged")
    named = ("--output", outputs[0], "--picture", outputs[1], "--rrd", outputs[2])
    refused(suturegrasp(*pair(small), *named), "damaged")
    assert [path.read_text() for path in outputs] == ["of an earlier run"] * 3


@pytest.mark.parametrize(
    ("error", "status", "complaint"),
    [
        (MemoryError(), 2, "memory does not suffice"),
        (BrokenPipeError(32, "Broken pipe"), 2, "the system refused: .*Broken pipe"),
        (KeyboardInterrupt(), 130, "suturegrasp: interrupted$"),
    ],
)
def test_what_ends_the_work_is_told_in_one_line(suturegrasp, pair, small, monkeypatch, error, status, complaint):
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(reconstruct, "reconstruct_pair", fail)
    ended = suturegrasp(*pair(small), "--output", small / "out.json")
    assert (ended.status, ended.out, len(ended.err.splitlines())) == (status, "", 1)
    assert re.search(complaint, ended.err)


@pytest.mark.slow
def test_an_interrupt_from_the_keyboard_ends_in_one_line(pair, small):
    """The process waits for its left image, a pipe that nobody fills, so the signal meets it at work."""
    (small / "left.png").unlink()
    os.mkfifo(small / "left.png")
    command = [str(SCRIPT), *map(str, pair(small)), "--output", str(small / "out.json")]
    # tests that a shell runs in the background ignore interrupts, and so would what they start
    as_in_front = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=as_in_front,  # noqa: PLW1509
    )
    # opening succeeds only once the command has opened the other end; a signal that comes just before it reads is told
    # by Python after that, so the pipe is closed in the end
    with process:
        with (small / "left.png").open("wb"), contextlib.suppress(subprocess.TimeoutExpired):
            process.send_signal(signal.SIGINT)
            process.wait(10)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, "", "suturegrasp: interrupted\n")


def refused(ended, complaint: str, path: Path | None = None) -> None:
    """Status 2, one line on standard error that says so (and names the path), nothing on standard output."""
    assert ended.status == 2
    assert ended.out == ""
    assert len(ended.err.splitlines()) == 1
    assert ended.err.startswith("suturegrasp: ")
    assert ended.err.endswith("\n")
    assert re.search(complaint, ended.err), ended.err
    assert path is None or str(path) in ended.err
