"""Whatever its files hold, `reconstruct` ends with 0, 2 or 3, says at most one line, and raises nothing."""

import itertools
import json

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shared.calibration import read_calibration, write_calibration

pytestmark = pytest.mark.slow

NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.floats(-1000, 1000) | st.integers(-3, 3).map(float)
MATRICES = ("K_left", "K_right", "distortion_left", "distortion_right", "T_right_left")
KIND = st.sampled_from(("noise", "lines", "mask"))
fuzzed = settings(
    deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow], max_examples=25
)
counter = itertools.count()


@pytest.fixture
def ends_well(suturegrasp, small):
    """Runs the command with other files in place of the small pair's own."""

    def run(**replaced):
        files = {name: small / f"{name}.png" for name in ("left", "right")}
        files |= {"calibration": small / "calibration.json", "output": small / f"out_{next(counter)}.json"} | replaced
        ended = suturegrasp("reconstruct", *(part for name, path in files.items() for part in (f"--{name}", path)))
        assert ended.status in (0, 2, 3)
        assert len(ended.complaints) == (ended.status != 0), ended.err
        assert len([line for line in ended.out.splitlines() if "further thread" not in line]) == (ended.status == 0)
        assert files["output"].exists() == (ended.status != 2)
        if ended.status != 2:
            assert json.loads(files["output"].read_text())["status"] == ("ok" if ended.status == 0 else "failed")

    return run


@fuzzed
@given(st.sampled_from(MATRICES), st.integers(0, 11), NUMBERS, st.sampled_from((1.0, 1.0, 1e-3, 1e3, 1e-9, 1e9)))
def test_calibrations_with_any_number(ends_well, small, name, place, value, factor):
    changed = small / f"changed_{next(counter)}.json"
    read = read_calibration(small / "calibration.json", unit=None, image_size=(320, 180))
    write_calibration(changed, read.calibration)
    document = json.loads(changed.read_text())
    array = np.array(document[name] or [0.0] * 5)
    array.flat[place % array.size] = value
    document[name] = array.tolist()
    for row in document["T_right_left"][:3]:
        row[3] *= factor
    changed.write_text(json.dumps(document))
    ends_well(calibration=changed)


def blotches(rng, size, kind):
    """An image or a mask of that kind."""
    if kind == "noise":
        return rng.integers(0, 256, size, dtype=np.uint8)
    image = np.full(size, rng.integers(0, 256) * (kind != "mask"), np.uint8)
    for _ in range(rng.integers(1, 6)):
        points = rng.integers(-5, max(size) + 5, (rng.integers(2, 7), 1, 2)).astype(np.int32)
        cv2.polylines(image, [points], bool(rng.integers(2)), int(rng.integers(1, 256)), int(rng.integers(1, 9)))
    return image


@fuzzed
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.tuples(st.integers(16, 90), st.integers(16, 120)),
    kinds=st.tuples(KIND, KIND, KIND, KIND),
    masks=st.booleans(),
    shift=st.integers(-3, 12),
)
def test_images_and_masks_of_anything(ends_well, small, seed, size, kinds, masks, shift):
    rng, number = np.random.default_rng(seed), next(counter)
    files = {"calibration": small / f"calibration_{number}.json"}
    K = [[300.0, 0, size[1] / 2], [0, 300.0, size[0] / 2], [0, 0, 1]]
    files["calibration"].write_text(json.dumps({"K": K, "baseline_mm": 5.0}))
    for suffix, kind, other in (("", *kinds[:2]), ("-mask", *kinds[2:]))[: 1 + masks]:
        image = blotches(rng, size, kind)
        # half of the pairs show one thing from two places, so that there is something to match
        right = np.roll(image, -shift, axis=1) if kind == other else blotches(rng, size, other)
        for side, pixels in (("left", image), ("right", right)):
            files[side + suffix] = small / f"{side}{suffix}_{number}.png"
            cv2.imwrite(str(files[side + suffix]), pixels)
    ends_well(**files)
