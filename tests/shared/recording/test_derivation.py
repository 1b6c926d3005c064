"""How a recording came from another, as its notes tell."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.recording.derivation import DERIVED, Anew, Derivation, derivations
from shared.recording.entry import Note

WORDS, COUNTS = st.text(max_size=20), st.integers(1, 10**9)
MS = st.none() | st.floats(0, 1e6)
AGENTS = st.builds(Anew, st.lists(WORDS, max_size=3).map(tuple), COUNTS, st.just(0) | COUNTS, MS, MS)
DERIVATIONS = st.builds(
    Derivation,
    WORDS,
    WORDS,
    WORDS,
    WORDS,
    WORDS,
    st.dictionaries(WORDS, AGENTS, max_size=3),
    st.dictionaries(WORDS, WORDS, max_size=3),
    st.dictionaries(WORDS, COUNTS, max_size=3),
    WORDS,
)


@given(st.lists(DERIVATIONS, max_size=3))
def test_what_was_noted_is_read_back_in_order_among_other_notes(made):
    notes = [Note("run", {"rig": "lab"}), *(one.note for one in made), Note("losses", {"complete": "True"})]
    assert derivations(notes) == tuple(made)


@pytest.mark.parametrize("spoilt", ["{", "[]", "3", '{"perception": 3}', '{"perception": {"outputs": 3}}'])
def test_of_a_note_that_cannot_be_read_it_is_known_that_the_file_was_derived(spoilt):
    note = Note(DERIVED, {"how": "replayed through perception", "source": "a.mcap", "agents": spoilt})
    (told,) = derivations([note])
    assert (told.how, told.source, told.agents) == ("replayed through perception", "a.mcap", {})


def test_a_sentence_tells_source_agents_settings_and_what_was_left_out():
    told = Derivation(
        "replayed through perception, reconstruction",
        "session.mcap",
        sha256="abcdef" * 10,
        agents={"perception": Anew(("k",), 20, 2, 21.0, 40.0), "reconstruction": Anew(("l",), 22, 0, 1.0, 2.0)},
        settings={"reconstruction.method": "refined -> paper"},
        left_out={"frames of which nothing was made": 7},
    )
    for words in (
        "of session.mcap (sha256 abcdefabcdef)",
        "ran anew: perception, reconstruction; what other agents said is as of the source",
        "2 outputs of perception as of the source too",
        "settings: reconstruction.method refined -> paper",
        "left out on purpose: 7 frames of which nothing in it was made",
    ):
        assert words in told.sentence
