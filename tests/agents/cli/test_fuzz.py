"""Whatever its files hold, the command ends with 0, 2 or 3, says at most one line, and raises nothing."""

import itertools
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shared.calibration import read_calibration, write_calibration

SPLICES = (b"", b"\x00", b"\xff" * 4, b"\xff\xd9", b"\xff\xc0", b"IEND", b"IDAT", b"\x7f\xff\xff\xff")

fuzzed = settings(
    deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow], max_examples=25
)
counter = itertools.count()


@pytest.fixture
def folder(small: Path) -> Path:
    """The small pair, also as JPEG and with a calibration of our own form."""
    for side in ("left", "right"):
        image = cv2.imread(str(small / f"{side}.png"))
        assert image is not None
        cv2.imwrite(str(small / f"{side}.jpg"), image)
    calibration = read_calibration(small / "calibration.json", unit=None, image_size=(320, 180)).calibration
    write_calibration(small / "own.json", calibration)
    return small


def ends_well(suturegrasp, folder: Path, **replaced: Path) -> None:
    """Run with the given files in place of the small pair's own."""
    files = {
        "left": folder / "left.png",
        "right": folder / "right.png",
        "calibration": folder / "calibration.json",
        "output": folder / f"out_{next(counter)}.json",
    } | replaced
    ended = suturegrasp("reconstruct", *(part for name, path in files.items() for part in (f"--{name}", path)))
    assert ended.status in (0, 2, 3)
    assert len(ended.complaints) == (ended.status != 0), ended.err
    about_the_thread = [line for line in ended.out.splitlines() if "further thread" not in line]
    assert len(about_the_thread) == (ended.status == 0)
    assert files["output"].exists() == (ended.status != 2)
    if ended.status != 2:
        assert json.loads(files["output"].read_text())["status"] == ("ok" if ended.status == 0 else "failed")


EDITS = st.lists(
    st.tuples(st.floats(0, 1), st.integers(0, 30), st.sampled_from(SPLICES) | st.binary(max_size=6)),
    min_size=1,
    max_size=4,
)


def edited(path: Path, edits: list[tuple[float, int, bytes]]) -> Path:
    content = path.read_bytes()
    for place, removed, inserted in edits:
        start = int(place * len(content))
        content = content[:start] + inserted + content[start + removed :]
    damaged = path.with_name(f"damaged_{next(counter)}{path.suffix}")
    damaged.write_bytes(content)
    return damaged


@pytest.mark.slow
@fuzzed
@given(name=st.sampled_from(("left.png", "left.jpg")), edits=EDITS)
def test_damaged_images(suturegrasp, folder: Path, name: str, edits: list[tuple[float, int, bytes]]) -> None:
    ends_well(suturegrasp, folder, left=edited(folder / name, edits))


NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.floats(-1000, 1000) | st.integers(-3, 3).map(float)


@pytest.mark.slow
@fuzzed
@given(
    path=st.sampled_from(("K_left", "K_right", "distortion_left", "distortion_right", "T_right_left")),
    place=st.tuples(st.integers(0, 3), st.integers(0, 3)),
    value=NUMBERS,
    factor=st.sampled_from((1.0, 1.0, 1e-3, 1e3, 1e-9, 1e9)),
)
def test_calibrations_with_any_number(suturegrasp, folder: Path, path: str, place, value: float, factor: float) -> None:
    document = json.loads((folder / "own.json").read_text())
    array = np.array(document[path] or [0.0] * 5)
    array[tuple(at % size for at, size in zip(place, array.shape, strict=False))] = value
    document[path] = array.tolist()
    for row in document["T_right_left"][:3]:
        row[3] *= factor
    changed = folder / f"changed_{next(counter)}.json"
    changed.write_text(json.dumps(document))
    ends_well(suturegrasp, folder, calibration=changed)


def blotches(rng: np.random.Generator, height: int, width: int, kind: str) -> np.ndarray:
    """An image or a mask of that kind."""
    if kind == "noise":
        return rng.integers(0, 256, (height, width), dtype=np.uint8)
    image = np.full((height, width), rng.integers(0, 256) * (kind != "mask"), np.uint8)
    for _ in range(rng.integers(1, 6)):
        points = rng.integers(-5, max(height, width) + 5, (rng.integers(2, 7), 1, 2)).astype(np.int32)
        cv2.polylines(image, [points], bool(rng.integers(2)), int(rng.integers(1, 256)), int(rng.integers(1, 9)))
    return image


@pytest.mark.slow
@fuzzed
@given(
    seed=st.integers(0, 2**32 - 1),
    height=st.integers(16, 90),
    width=st.integers(16, 120),
    kinds=st.tuples(*[st.sampled_from(("noise", "lines", "mask"))] * 4),
    masks=st.booleans(),
    shift=st.integers(-3, 12),
)
def test_images_and_masks_of_anything(
    suturegrasp, folder: Path, seed: int, height: int, width: int, kinds: tuple[str, ...], masks: bool, shift: int
) -> None:
    rng = np.random.default_rng(seed)
    calibration = folder / f"calibration_{next(counter)}.json"
    K = [[300.0, 0, width / 2], [0, 300.0, height / 2], [0, 0, 1]]
    calibration.write_text(json.dumps({"K": K, "baseline_mm": 5.0}))
    files = {"calibration": calibration}
    for first, second, kind, other in (("left", "right", *kinds[:2]), ("left-mask", "right-mask", *kinds[2:])):
        image = blotches(rng, height, width, kind)
        # half of the pairs show one thing from two places, so that there is something to match
        pair = (image, np.roll(image, -shift, axis=1) if kind == other else blotches(rng, height, width, other))
        for name, pixels in zip((first, second), pair, strict=True):
            if masks or "mask" not in name:
                files[name] = folder / f"{name}_{next(counter)}.png"
                cv2.imwrite(str(files[name]), pixels)
    ends_well(suturegrasp, folder, **files)
