"""Whatever is wrong with the input: one line that names it, nothing on standard output, and nothing destroyed."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from agents.cli.reconstruct import command as reconstruct
from tests.agents.cli.conftest import of_pair, refused


def encoded(suffix: str, image: np.ndarray) -> bytes:
    return cv2.imencode(suffix, image)[1].tobytes()


def noise(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(3).integers(0, 256, (height, width, 3), dtype=np.uint8)


@pytest.fixture
def command(small):
    """The command on the small pair and its masks, but for its outputs."""
    return (*of_pair(small), "--left-mask", small / "mask_left.png", "--right-mask", small / "mask_right.png")


@pytest.fixture
def out(small):
    return "--output", small / "out.json"


HALF_A_PNG = encoded(".png", noise(180, 320))[:9000]
OTHER_SIZE = b'{"K": [[330,0,160],[0,330,90],[0,0,1]], "baseline_mm": 5, "width": 640, "height": 360}'
EXCHANGED = b"""%YAML:1.0
---
K1: [330,0,160,0,330,90,0,0,1]
K2: [330,0,160,0,330,90,0,0,1]
D1: [0,0,0,0]
D2: [0,0,0,0]
R: [1,0,0,0,1,0,0,0,1]
T: [5,0,0]
"""
BAD_FILES = [
    ("left.png", b"", "is an empty file"),
    ("left.png", b"left image\n", "no image that can be decoded"),
    ("left.png", encoded(".tif", noise(180, 320))[:9000], "damaged"),
    ("left.png", encoded(".png", noise(180, 322)), "has 322x180 pixels"),
    ("left.png", encoded(".tif", noise(180, 320).astype(np.float32)), "holds float32 numbers"),
    ("mask_left.png", encoded(".png", np.zeros((180, 320), np.uint8)), "no pixel is marked as thread"),
    ("mask_right.png", HALF_A_PNG, "damaged"),
    ("mask_right.png", encoded(".png", np.ones((90, 160), np.uint8)), "160x90 pixels, its image 320x180"),
    ("calibration.json", b'{"K": [[330, 0', "not valid JSON"),
    ("calibration.json", b'{"name": "thread"}', "camera matrix"),
    ("calibration.json", OTHER_SIZE, "640x360"),
    ("calibration.json", EXCHANGED, "right camera stands to the left of the left one"),
]


@pytest.mark.parametrize(("name", "content", "told"), BAD_FILES, ids=[told for *_, told in BAD_FILES])
def test_a_bad_file_is_named_in_one_line_and_leaves_an_earlier_result(suturegrasp, command, small, name, content, told):
    outputs = [small / f"out{suffix}" for suffix in (".json", ".png", ".rrd")]
    for path in outputs:
        path.write_text("of an earlier run")
    (small / name).write_bytes(content)
    named = ("--output", outputs[0], "--picture", outputs[1], "--rrd", outputs[2])
    refused(suturegrasp(*command, *named), told, small / name)
    assert [path.read_text() for path in outputs] == ["of an earlier run"] * 3


def test_images_without_enough_pixels_or_two_halves_are_refused(suturegrasp, small, out):
    for shape in ((15, 320), (180, 15)):
        for name in ("left.png", "right.png"):
            cv2.imwrite(str(small / name), noise(*shape))
        refused(suturegrasp(*of_pair(small), *out), f"has only {shape[1]}x{shape[0]} pixels; at least 16 each way")
    for width, told in ((641, "641 pixels wide"), (30, "has only 15x180")):
        cv2.imwrite(str(small / "both.png"), noise(180, width))
        stereo = ("--stereo", small / "both.png", "--calibration", small / "calibration.json")
        refused(suturegrasp("reconstruct", *stereo, *out), told)


def test_a_mask_that_marks_everything_and_exchanged_eyes_fail_with_their_reason(suturegrasp, command, small, out):
    exchanged = ("--left", small / "right.png", "--right", small / "left.png")
    ended = suturegrasp("reconstruct", *exchanged, "--calibration", small / "calibration.json", *out)
    refused(ended, "exchange --left and --right", status=3)
    cv2.imwrite(str(small / "mask_left.png"), np.full((180, 320), 255, np.uint8))
    refused(suturegrasp(*command, *out), json.loads((small / "out.json").read_text())["reason"], status=3)


@pytest.mark.parametrize(
    ("name", "becomes"),
    [
        ("left.png", lambda _: None),
        ("right.png", Path.mkdir),
        ("mask_left.png", lambda path: path.symlink_to("nowhere")),
        ("mask_right.png", lambda path: path.symlink_to(path)),
        ("calibration.json", Path.mkdir),
    ],
)
def test_an_input_that_is_no_file_is_named(suturegrasp, command, small, out, name, becomes):
    (small / name).unlink()
    becomes(small / name)
    refused(suturegrasp(*command, *out), small / name)


@pytest.mark.parametrize(
    ("option", "name", "through"),
    [
        ("--output", "left.png", "itself"),
        ("--output", "mask_right.png", "a link"),
        ("--output", "calibration.json", "a hard link"),
        ("--picture", "right.png", "another spelling"),
        ("--rrd", "calibration.json", "a link"),
    ],
)
def test_an_input_is_never_overwritten(suturegrasp, command, small, out, option, name, through):
    path, link = small / name, (small / "link").with_suffix(Path(name).suffix)
    if through == "a link":
        link.symlink_to(name)
    elif through == "a hard link":
        link.hardlink_to(path)
    written = link if "link" in through else small / ".." / "small" / name if through == "another spelling" else path
    before = path.read_bytes()
    others = () if option == "--output" else out
    refused(suturegrasp(*command, *others, option, written), f"{option} ", " would overwrite --", path)
    assert path.read_bytes() == before


def test_neither_a_calibration_in_a_folder_nor_another_output_is_overwritten(suturegrasp, small):
    images = ("reconstruct", "--left", small / "left.png", "--right", small / "right.png", "--calibration", small)
    (small / "truth.json").unlink()
    refused(suturegrasp(*images, "--output", small / "calibration.json"), "would overwrite --calibration")
    ended = suturegrasp(*of_pair(small), "--output", small / "out", "--rrd", small / "out")
    refused(ended, "--rrd", "would overwrite --output")


def test_what_cannot_be_written_or_contradicts_the_files_is_refused(suturegrasp, small, out):
    (small / "folder.png").mkdir()
    (small / "full.png").symlink_to("/dev/full")
    for option in ("--output", "--picture", "--rrd"):
        command = of_pair(small) if option == "--output" else (*of_pair(small), *out)
        refused(suturegrasp(*command, option, small / "no" / "out.png"), "does not exist; create it first")
        refused(suturegrasp(*command, option, small / "folder.png"), "is a folder; give the name of a file")
        if option != "--rrd":
            refused(suturegrasp(*command, option, small / "full.png"), "full.png cannot be written", "No space left")
    assert (small / "full.png").is_symlink()
    refused(suturegrasp(*of_pair(small), *out, "--picture", small / "out.png.txt"), "must end in .png or .jpg")
    refused(suturegrasp(*of_pair(small), *out, "--unit", "cm"), "lengths in mm, which contradicts --unit cm")


@pytest.mark.parametrize(
    ("error", "status", "told"),
    [
        (MemoryError(), 2, "memory does not suffice"),
        (BrokenPipeError(32, "Broken pipe"), 2, "the system refused: "),
        (KeyboardInterrupt(), 130, "suturegrasp: interrupted\n"),
    ],
)
def test_what_ends_the_work_is_told_in_one_line(suturegrasp, small, out, monkeypatch, error, status, told):
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(reconstruct, "reconstruct_pair", fail)
    refused(suturegrasp(*of_pair(small), *out), told, status=status)
