"""On the shared data: no alarm on any pair that is whole, and what is done to many of them is found."""

import os
from pathlib import Path

import pytest

from agents.diagnostics.doctor.image_answers import answers_about
from benchmarks.judging import STORZ, TEXTURED, codes_of, undamaged
from benchmarks.judging_damages import damages
from schemas.messages import Severity

DATA = Path(__file__).parents[2] / "../shared/data"
DAMAGES = {f"{damage.name} {damage.size}".strip(): damage for damage in damages()}
CERTAIN = (
    "right eye lower 2 px",
    "right eye turned 0.5 deg",
    "right eye larger 1.0%",
    "exchanged",
    "one image twice",
    "both cropped 5%",
    "both too dark x 0.1",
    "both out of focus 3 px",
    "both interlaced 2 px",
)
REFUSED = ("right eye lower 40 px", "both upside down", "right eye black")

pytestmark = [
    pytest.mark.renders,
    pytest.mark.skipif(not DATA.is_dir() and "CI" not in os.environ, reason="needs shared/data beside the checkout"),
]


@pytest.fixture(scope="module")
def pairs():
    return [(kind, name, images, calibration) for kind, name, images, calibration in undamaged(DATA)]


def test_no_whole_pair_raises_an_alarm(pairs):
    """Of every third: all of them are looked at by `python -m benchmarks.judging`."""
    some = [*pairs[::3], *(pair for pair in pairs if pair[0] == STORZ)]
    said = {name: codes_of(answers_about(images, calibration)) for _, name, images, calibration in some}
    assert len(said) > 15
    assert {name: codes for name, codes in said.items() if codes} == {}


@pytest.mark.parametrize("name", [*CERTAIN, *REFUSED])
def test_damage_is_found_on_scenes_of_every_kind(pairs, name):
    damage = DAMAGES[name]
    textured = [pair for pair in pairs if pair[0] == TEXTURED]
    for _, scene, images, calibration in textured[:: len(textured) // 2]:
        codes = codes_of(answers_about(damage.do(images, textured[-1][2]), calibration))
        assert damage.codes & codes.keys(), f"{scene}: {codes}"
        assert name not in REFUSED or Severity.FAULT in codes.values(), f"{scene}: {codes}"
