"""What a file says of itself: whole, cut off, with losses that were told before, derived from another."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.codec import encode
from schemas.messages import LogLevel, LogRecord
from schemas.topics import LOG, key
from shared.recording.completeness import completeness, completeness_of
from shared.recording.derivation import DERIVED, Anew, Derivation, derivations
from shared.recording.entry import Note
from shared.recording.losses import LOSSES, NO_ROOM, ON_THE_WAY, Loss, as_note, by_key, counts_of, joined, sentence
from shared.recording.mcap_file import Entry, finished_notes
from shared.recording.writer import RecordingWriter

KEY = key("lab", LOG, agent="camera")
TEXT = encode(LogRecord(0, "camera", "main", LogLevel.INFO, "x" * 100))
WHEN_NS = 1_800_000_000_000_000_000
LOST = (Loss(KEY, 3, 5, ON_THE_WAY, 0),)


def written(path, lost=(), complete=None):
    """Write a recording; its size before the end was written."""
    writer = RecordingWriter(path)
    for number in range(5):
        writer.write(LOG, Entry(KEY, 1, number, TEXT, WHEN_NS, WHEN_NS + number))
    if lost:
        note = as_note(lost, WHEN_NS)
        writer.note(note.name, note.facts)
    writer.flush()
    size = path.stat().st_size
    if complete is not None:
        writer.note(LOSSES, {loss.key: str(loss.count) for loss in lost} | {"complete": str(complete)})
    writer.close()
    return size


@pytest.mark.parametrize(
    ("lost", "complete", "told", "said"),
    [
        ((), True, True, "complete"),
        (LOST, False, False, "not complete: lost 3 of camera/main/log"),
        # one that does not say is not taken for complete
        ((), None, None, "nobody noted whether anything is missing"),
    ],
)
def test_a_recording_tells_each_loss_once_and_one_that_was_cut_off_until_when(tmp_path, lost, complete, told, said):
    path = tmp_path / "a.mcap"
    size = written(path, lost, complete)
    whole = completeness(path)
    assert (whole.finished, whole.complete, whole.lost, whole.sentence) == (True, told, by_key(lost), said)
    path.write_bytes(path.read_bytes()[:size])
    cut = completeness(path)
    assert (cut.finished, cut.complete, cut.last_ns) == (False, False if lost else None, WHEN_NS + 4)
    assert cut.sentence.startswith("cut off at 2027-01-1")
    assert ("lost 3 of camera/main/log" in cut.sentence) == bool(lost)


def test_a_recorder_that_stopped_early_is_told(tmp_path):
    written(tmp_path / "a.mcap", LOST, complete=False)
    notes = [Note("ended", {"reason": "4.2 MB are free"}), *finished_notes(tmp_path / "a.mcap")]
    said = completeness_of(notes, True, None).sentence
    assert said.endswith("lost 3 of camera/main/log; its recorder stopped early: 4.2 MB are free")


SOME_LOSSES = st.lists(
    st.builds(
        lambda key, first, count, why: Loss(key, first, first + count - 1, why, 0),
        st.sampled_from(["suturegrasp/lab/camera/main/frames", "operator/heartbeat"]),
        st.integers(0, 1000),
        st.integers(1, 20),
        st.sampled_from([ON_THE_WAY, NO_ROOM]),
    ),
    min_size=1,
    max_size=120,
)


@given(SOME_LOSSES)
def test_a_note_tells_as_many_as_were_lost_whatever_is_joined(losses):
    counts = Counter()
    for loss in losses:
        counts[loss.key] += loss.count
    assert by_key(losses) == by_key(joined(losses)) == counts_of(as_note(losses, 5)) == counts


def test_neighbours_are_one_stretch_with_its_reason_and_a_note_of_a_thousand_stretches_stays_short():
    losses = [Loss("k", 5, 5, NO_ROOM, 0), Loss("k", 3, 4, NO_ROOM, 0), Loss("k", 6, 7, ON_THE_WAY, 0)]
    assert sentence(losses) == "lost 5 of k (3-5 no room, 6-7 on the way)"
    note = as_note([Loss("k", 2 * n, 2 * n, ON_THE_WAY, 0) for n in range(1000)], 0)
    assert note.facts["k"].endswith("and 950 more")
    assert len(note.facts["k"]) < 1500


WORDS, COUNTS, MS = st.text(max_size=20), st.integers(1, 10**9), st.none() | st.floats(0, 1e6)
AGENTS = st.builds(Anew, st.lists(WORDS, max_size=3).map(tuple), COUNTS, st.just(0) | COUNTS, MS, MS)
TABLES = (st.dictionaries(WORDS, values, max_size=3) for values in (AGENTS, WORDS, COUNTS))
DERIVATIONS = st.builds(Derivation, *[WORDS] * 5, *TABLES, WORDS)


@given(st.lists(DERIVATIONS, max_size=3))
def test_how_a_recording_was_derived_is_read_back_in_order_among_other_notes(made):
    notes = [Note("run", {"rig": "lab"}), *(one.note for one in made), Note("losses", {"complete": "True"})]
    assert derivations(notes) == tuple(made)


@pytest.mark.parametrize("spoilt", ["{", "[]", "3", '{"perception": 3}', '{"perception": {"outputs": 3}}'])
def test_of_a_note_that_cannot_be_read_it_is_known_that_the_file_was_derived(spoilt):
    note = Note(DERIVED, {"how": "replayed through perception", "source": "a.mcap", "agents": spoilt})
    (told,) = derivations([note])
    assert (told.how, told.source, told.agents) == ("replayed through perception", "a.mcap", {})
