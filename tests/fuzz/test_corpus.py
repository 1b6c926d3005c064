"""Every file of the fuzz corpora is read, or refused by the one exception of its reader, and so are changed ones."""

import random

import pytest

from tests.fuzz.__main__ import CORPUS, NAMES, changed, fails
from tests.fuzz.targets import TARGETS, seeds

CHANGED = 200
pytestmark = pytest.mark.fuzz


@pytest.mark.parametrize("name", NAMES)
def test_no_bytes_of_the_corpus_are_a_defect(name):
    kept = sorted(path for path in (CORPUS / name).iterdir())
    assert kept, f"python -m tests.fuzz {name}"
    defects = {path.name: why for path in kept if (why := fails(TARGETS[name], path.read_bytes()))}
    assert not defects


@pytest.mark.parametrize("name", NAMES)
def test_what_was_changed_a_little_is_no_defect_either(name):
    rng = random.Random(1)
    known = seeds(name) + [path.read_bytes() for path in sorted((CORPUS / name).iterdir())]
    for _ in range(CHANGED):
        data = changed(rng.choice(known), rng.choice(known), rng)
        assert fails(TARGETS[name], data) is None, data


def test_each_target_reads_what_it_should():
    assert set(NAMES) == set(TARGETS)
    for name in NAMES:
        for seed in seeds(name):
            assert fails(TARGETS[name], seed) is None, (name, seed)
