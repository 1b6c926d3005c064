"""Every file of the fuzz corpora is read, or refused by the one exception of its reader, and so are changed ones."""

import random

import pytest

from tests.fuzz.__main__ import CORPUS, NAMES, changed, fails
from tests.fuzz.targets import TARGETS, seeds

CHANGED = 200
pytestmark = pytest.mark.fuzz


@pytest.mark.parametrize("name", TARGETS)
def test_no_bytes_of_the_corpus_are_a_defect_nor_any_that_were_changed_a_little(name):
    assert name in NAMES
    kept = [path.read_bytes() for path in sorted((CORPUS / name).iterdir())]
    assert kept, f"python -m tests.fuzz {name}"
    rng, known = random.Random(1), seeds(name) + kept
    spoilt = [changed(rng.choice(known), rng.choice(known), rng) for _ in range(CHANGED)]
    assert [(why, data) for data in known + spoilt if (why := fails(TARGETS[name], data))] == []
