"""Whatever is wrong with the input: one line that names it, nothing on standard output, and nothing destroyed."""

import json
import os
import re
import signal
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
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


LEFT_IMAGES: dict[str, tuple[bytes, str]] = {
    "an empty file": (b"", "is an empty file"),
    "text": (b"left image\n", "no image that can be decoded"),
    "half a PNG": (encoded(".png", noise(180, 320))[:9000], "damaged"),
    "half a JPEG": (encoded(".jpg", noise(180, 320))[:9000], "damaged"),
    "a JPEG header": (encoded(".jpg", noise(180, 320))[:40], "damaged"),
    "half a TIFF": (encoded(".tif", noise(180, 320))[:9000], "damaged"),
    "half a BMP": (encoded(".bmp", noise(180, 320))[:9000], "damaged"),
    "half a WebP": (encoded(".webp", noise(180, 320))[:9000], "damaged"),
    "half a JPEG 2000": (encoded(".jp2", noise(180, 320))[:9000], "damaged"),
    "a torn JPEG": (torn_jpeg(), "damaged"),
    "an SVG": (b'<svg xmlns="http://www.w3.org/2000/svg"/>', "no image that can be decoded"),
    "a PDF": (b"%PDF-1.7\n%\xe2\xe3", "no image that can be decoded"),
    "no pixel": (png_claiming(0, 0), "damaged"),
    "60000x60000 in a header": (png_claiming(60000, 60000), "million pixels"),
    "more in a header than a PNG may have": (png_claiming(2**31 - 1, 2), "damaged"),
    "one pixel": (encoded(".png", noise(1, 1)), "differ in size"),
    "another size": (encoded(".png", noise(180, 322)), "differ in size: .* 322x180 .* 320x180"),
    "floating-point numbers": (encoded(".tif", noise(180, 320).astype(np.float32)), "holds float32 numbers"),
    "a high dynamic range": (encoded(".hdr", noise(180, 320).astype(np.float32)), "holds float32 numbers"),
}


@pytest.mark.parametrize("name", LEFT_IMAGES)
def test_a_bad_image_is_named_in_one_line(suturegrasp, pair, small, name):
    content, complaint = LEFT_IMAGES[name]
    (small / "left.png").write_bytes(content)
    refused(suturegrasp(*pair(small), "--output", small / "out.json"), complaint, small / "left.png")
    assert not (small / "out.json").exists()


@pytest.mark.parametrize("shape", [(1, 1), (15, 320), (180, 8), (3, 5000)])
def test_a_pair_of_tiny_images_is_refused(suturegrasp, pair, small, shape):
    for name in ("left.png", "right.png"):
        cv2.imwrite(str(small / name), noise(*shape))
    ended = suturegrasp(*pair(small), "--output", small / "out.json")
    refused(ended, f"has only {shape[1]}x{shape[0]} pixels; at least 16 each way are needed")


@pytest.mark.parametrize("shape", [(16, 16), (16, 6000), (6000, 16), (17, 33)])
def test_strange_shapes_of_images_end_in_a_status(suturegrasp, pair, small, shape):
    for name in ("left.png", "right.png"):
        cv2.imwrite(str(small / name), noise(*shape))
    calibration = json.loads((small / "calibration.json").read_text())
    calibration.update(width=shape[1], height=shape[0])
    (small / "calibration.json").write_text(json.dumps(calibration))
    ended = suturegrasp(*pair(small), "--output", small / "out.json")
    assert ended.status in (0, 3)
    assert len(ended.complaints) == (ended.status != 0)
    assert json.loads((small / "out.json").read_text())["status"] == ("ok" if ended.status == 0 else "failed")


@pytest.mark.parametrize("width,complaint", [(641, "641 pixels wide"), (30, "each half .* has only 15x180")])
def test_a_side_by_side_image_without_two_halves_is_refused(suturegrasp, small, width, complaint):
    cv2.imwrite(str(small / "both.png"), noise(180, width))
    options = ("--calibration", small / "calibration.json", "--output", small / "out.json")
    refused(suturegrasp("reconstruct", "--stereo", small / "both.png", *options), complaint)


MASKS: dict[str, tuple[bytes, str]] = {
    "an empty file": (b"", "is an empty file"),
    "nothing marked": (encoded(".png", np.zeros((180, 320), np.uint8)), "is empty: no pixel is marked as thread"),
    "another size": (encoded(".png", np.ones((90, 160), np.uint8)), "160x90 pixels, its image 320x180"),
    "half a PNG": (encoded(".png", noise(180, 320))[:9000], "damaged"),
    "floating-point numbers": (encoded(".tif", np.ones((180, 320, 3), np.float32)), "holds float32 numbers"),
}


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("name", MASKS)
def test_a_bad_mask_is_named_in_one_line(suturegrasp, pair, small, name, side):
    content, complaint = MASKS[name]
    bad = small / f"mask_{side}.png"
    bad.write_bytes(content)
    masks = ("--left-mask", small / "mask_left.png", "--right-mask", small / "mask_right.png")
    refused(suturegrasp(*pair(small), *masks, "--output", small / "out.json"), complaint, bad)


def test_a_mask_that_marks_everything_fails_with_its_reason(suturegrasp, pair, small):
    cv2.imwrite(str(small / "mask_left.png"), np.full((180, 320), 255, np.uint8))
    masks = ("--left-mask", small / "mask_left.png", "--right-mask", small / "mask_right.png")
    ended = suturegrasp(*pair(small), *masks, "--output", small / "out.json")
    assert (ended.status, ended.out, len(ended.err.splitlines())) == (3, "", 1)
    assert json.loads((small / "out.json").read_text())["reason"] in ended.err


def replaced_by_nothing(path: Path) -> None:
    path.unlink()


def replaced_by_a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def replaced_by_a_broken_link(path: Path) -> None:
    path.unlink()
    path.symlink_to("nowhere")


def replaced_by_a_link_to_itself(path: Path) -> None:
    path.unlink()
    path.symlink_to(path)


REPLACEMENTS = (
    replaced_by_nothing,
    replaced_by_a_folder,
    replaced_by_a_broken_link,
    replaced_by_a_link_to_itself,
)


@pytest.mark.parametrize("name", ["left.png", "right.png", "mask_left.png", "mask_right.png", "calibration.json"])
@pytest.mark.parametrize("replace", REPLACEMENTS)
def test_an_input_that_is_no_file_is_named(suturegrasp, pair, small, name, replace: Callable[[Path], None]):
    replace(small / name)
    masks = ("--left-mask", small / "mask_left.png", "--right-mask", small / "mask_right.png")
    refused(suturegrasp(*pair(small), *masks, "--output", small / "out.json"), "", small / name)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
@pytest.mark.parametrize("name", ["left.png", "mask_right.png", "calibration.json"])
def test_an_input_that_may_not_be_read_is_named(suturegrasp, pair, small, name):
    (small / name).chmod(0)
    masks = ("--left-mask", small / "mask_left.png", "--right-mask", small / "mask_right.png")
    refused(suturegrasp(*pair(small), *masks, "--output", small / "out.json"), "cannot be read", small / name)


def test_a_name_that_is_too_long_is_refused(suturegrasp, pair, small):
    long = small / ("x" * 300)
    refused(suturegrasp(*pair(small), "--output", long), "File name too long")
    images = ("--left", long, "--right", small / "right.png", "--calibration", small / "calibration.json")
    refused(suturegrasp("reconstruct", *images, "--output", small / "out.json"), "File name too long")


def test_a_device_that_never_ends_is_refused(suturegrasp, small):
    options = ("--calibration", small / "calibration.json", "--output", small / "out.json")
    ended = suturegrasp("reconstruct", "--left", "/dev/zero", "--right", small / "right.png", *options)
    refused(ended, "/dev/zero is larger than 512 MB")


CALIBRATIONS: dict[str, tuple[bytes, str]] = {
    "an empty file": (b"", "empty"),
    "an image": (encoded(".png", noise(20, 20)), "not a text file"),
    "broken JSON": (b'{"K": [[330, 0', "not valid JSON"),
    "broken YAML": (b"%YAML:1.0\n---\nK1: [1, 2\n", "not valid YAML"),
    "broken XML": (b"<opencv_storage><K1>", "not valid XML"),
    "another document": (b'{"name": "thread"}', "camera matrix"),
    "a list": (b"[1, 2, 3]", ""),
    "another size": (
        b'{"K": [[330,0,160],[0,330,90],[0,0,1]], "baseline_mm": 5, "width": 640, "height": 360}',
        "640x360",
    ),
    "no baseline": (b'{"K": [[330,0,160],[0,330,90],[0,0,1]], "baseline_mm": 0}', "positive"),
    "infinity": (b'{"K": [[1e999,0,160],[0,330,90],[0,0,1]], "baseline_mm": 5}', ""),
    "cameras above one another": (
        b"%YAML:1.0\n---\nK1: [330,0,160,0,330,90,0,0,1]\nK2: [330,0,160,0,330,90,0,0,1]\nD1: [0,0,0,0]\n"
        b"D2: [0,0,0,0]\nR: [1,0,0,0,1,0,0,0,1]\nT: [0,-5,0]\n",
        "above one another",
    ),
    "right camera on the left": (
        b"%YAML:1.0\n---\nK1: [330,0,160,0,330,90,0,0,1]\nK2: [330,0,160,0,330,90,0,0,1]\nD1: [0,0,0,0]\n"
        b"D2: [0,0,0,0]\nR: [1,0,0,0,1,0,0,0,1]\nT: [5,0,0]\n",
        "the right camera stands to the left of the left one",
    ),
}


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_a_bad_calibration_is_named_in_one_line(suturegrasp, pair, small, name):
    content, complaint = CALIBRATIONS[name]
    (small / "calibration.json").write_bytes(content)
    ended = suturegrasp(*pair(small), "--output", small / "out.json")
    refused(ended, f"(?i){complaint}", small / "calibration.json")


def test_a_unit_that_contradicts_the_calibration_is_refused(suturegrasp, pair, small):
    ended = suturegrasp(*pair(small), "--unit", "cm", "--output", small / "out.json")
    refused(ended, "states its lengths in mm, which contradicts --unit cm")


def test_left_and_right_exchanged_is_told(suturegrasp, small):
    ended = suturegrasp(
        *("reconstruct", "--left", small / "right.png", "--right", small / "left.png"),
        *("--calibration", small / "calibration.json", "--output", small / "out.json"),
    )
    assert (ended.status, ended.out, len(ended.err.splitlines())) == (3, "", 1)
    assert "exchange --left and --right" in json.loads((small / "out.json").read_text())["reason"]


OVERWRITING = {
    "--output": ("left.png", "right.png", "mask_left.png", "mask_right.png", "calibration.json"),
    "--picture": ("left.png", "right.png", "mask_left.png", "mask_right.png"),
    "--rrd": ("left.png", "calibration.json"),
}


@pytest.mark.parametrize("option,name", [(option, name) for option, names in OVERWRITING.items() for name in names])
@pytest.mark.parametrize("through", ["itself", "a link", "a hard link", "another spelling"])
def test_an_input_is_never_overwritten(suturegrasp, pair, small, option, name, through):
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
    masks = ("--left-mask", small / "mask_left.png", "--right-mask", small / "mask_right.png")
    output = () if option == "--output" else ("--output", small / "out.json")
    refused(suturegrasp(*pair(small), *masks, *output, option, path), f"{option} .* would overwrite --", small / name)
    assert (small / name).read_bytes() == before


def test_a_calibration_in_a_folder_is_not_overwritten_but_an_earlier_result_is(suturegrasp, small):
    images = ("reconstruct", "--left", small / "left.png", "--right", small / "right.png", "--calibration", small)
    (small / "truth.json").unlink()
    refused(suturegrasp(*images, "--output", small / "calibration.json"), "would overwrite --calibration")
    for side in ("left", "right"):
        (small / f"{side}.json").write_bytes((small / "calibration.json").read_bytes())
    assert suturegrasp(*images[:5], "--calibration", small / "left.json", "--output", small / "out.json").status == 0
    ended = suturegrasp(*images, "--output", small / "out.json")
    assert "would overwrite" not in ended.err


def test_two_outputs_are_two_files(suturegrasp, pair, small):
    ended = suturegrasp(*pair(small), "--output", small / "out", "--rrd", small / "out")
    refused(ended, "--rrd .* would overwrite --output")


@pytest.mark.parametrize("option", ["--output", "--picture", "--rrd"])
def test_an_output_without_a_place_is_refused(suturegrasp, pair, small, option):
    output = () if option == "--output" else ("--output", small / "out.json")
    refused(suturegrasp(*pair(small), *output, option, small / "no" / "out.png"), "does not exist; create it first")
    refused(suturegrasp(*pair(small), *output, option, small / "left.png" / "out.png"), "does not exist")
    (small / "folder.png").mkdir()
    refused(suturegrasp(*pair(small), *output, option, small / "folder.png"), "is a folder; give the name of a file")


@pytest.mark.parametrize("name", ["out.gif", "out", "out.png.txt"])
def test_a_picture_of_another_kind_is_refused(suturegrasp, pair, small, name):
    ended = suturegrasp(*pair(small), "--output", small / "out.json", "--picture", small / name)
    refused(ended, "must end in .png or .jpg")


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


def test_a_lack_of_memory_is_told(suturegrasp, pair, small, monkeypatch):
    def exhaust(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(reconstruct, "reconstruct_pair", exhaust)
    refused(suturegrasp(*pair(small), "--output", small / "out.json"), "memory does not suffice")


@pytest.mark.parametrize("error", [BrokenPipeError(32, "Broken pipe"), ConnectionResetError(104, "reset by peer")])
def test_an_error_of_the_system_at_work_is_no_success(suturegrasp, pair, small, monkeypatch, error):
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(reconstruct, "reconstruct_pair", fail)
    refused(suturegrasp(*pair(small), "--output", small / "out.json"), f"the system refused: .*{error.strerror}")


def test_an_interrupt_ends_in_one_line(suturegrasp, pair, small, monkeypatch):
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(reconstruct, "reconstruct_pair", interrupt)
    ended = suturegrasp(*pair(small), "--output", small / "out.json")
    assert (ended.status, ended.out, ended.err) == (130, "", "suturegrasp: interrupted\n")


def test_an_interrupt_from_the_keyboard_ends_in_one_line(pair, small):
    """The process waits for its left image, a pipe that nobody fills, so the signal meets it at work."""
    (small / "left.png").unlink()
    os.mkfifo(small / "left.png")
    command = [str(SCRIPT), *map(str, pair(small)), "--output", str(small / "out.json")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    # opening succeeds only once the command has opened the other end; a signal that comes just before it reads is told
    # by Python after that, so the pipe is closed then
    with process:
        with (small / "left.png").open("wb"):
            process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, "", "suturegrasp: interrupted\n")


def test_decoders_say_nothing_in_a_process_of_their_own(console_script, pair, small):
    for content in (LEFT_IMAGES[name][0] for name in ("half a PNG", "a torn JPEG", "60000x60000 in a header")):
        (small / "left.png").write_bytes(content)
        refused(console_script(*pair(small), "--output", small / "out.json"), "", small / "left.png")


def refused(ended, complaint: str, path: Path | None = None) -> None:
    """Status 2, one line on standard error that says so (and names the path), nothing on standard output."""
    assert ended.status == 2
    assert ended.out == ""
    assert len(ended.err.splitlines()) == 1
    assert ended.err.startswith("suturegrasp: ")
    assert ended.err.endswith("\n")
    assert 30 < len(ended.err) < 1200
    assert re.search(complaint, ended.err), ended.err
    assert path is None or str(path) in ended.err
