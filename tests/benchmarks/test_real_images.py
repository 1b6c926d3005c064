"""Real pictures: the judge knows a right curve from a wrong one, and what is wrong is not called ok."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import real_images
from benchmarks.real_images import Options, pad, without_thread

DATA = Path("../shared/data")
STEREO = DATA / "real_stereo"
pytestmark = [
    pytest.mark.renders,
    pytest.mark.skipif(not STEREO.is_dir(), reason=f"the real pictures are not under {STEREO}"),
]


@pytest.mark.parametrize("name", ["pad_0", "pad_2", "pad_3"])
@pytest.mark.parametrize("width", [1280, 540])
def test_no_curve_beside_the_thread_of_a_pad_is_called_ok(name, width):
    row = pad(STEREO / f"{name}.json", width, Options(DATA))
    if row["status"] == "ok":
        assert row["on thread %"] >= 90, row
    else:
        assert row["why"], "who is refused is told why"


@pytest.mark.parametrize(("name", "width"), [("pad_0", 1280), ("pad_0", 540), ("pad_2", 540), ("pad_3", 540)])
def test_a_pads_thread_that_was_drawn_is_followed_by_a_rig_that_is_no_endoscope(name, width):
    row = pad(STEREO / f"{name}.json", width, Options(DATA, masks=True))
    assert row["verdict"] == "right", row


@pytest.mark.parametrize("name", ["flesh_1", "flesh_3", "flesh_5"])
def test_flesh_holds_no_thread(name):
    assert not without_thread(STEREO / f"{name}_left.png", Options(DATA))["false thread"]


@pytest.mark.parametrize(("off_px", "verdict"), [(0.0, "right"), (30.0, "wrong though ok")])
def test_a_curve_on_the_drawn_thread_is_right_and_one_beside_it_is_wrong(monkeypatch, off_px, verdict):
    drawn = json.loads((STEREO / "pad_0.json").read_text())
    eyes = tuple(real_images._along(drawn[eye], 1.0) + off_px for eye in ("left", "right"))
    ok = type("Ok", (), {"status": real_images.Status.OK, "reason": ""})
    found = type("Found", (), {"reconstruction": ok})
    monkeypatch.setattr(real_images, "reconstructed", lambda *_given: found)
    monkeypatch.setattr(real_images, "curve_of", lambda *_given: eyes)
    assert np.ptp(eyes[0], axis=0).min() > 100
    assert pad(STEREO / "pad_0.json", 1280, Options(DATA))["verdict"] == verdict
