"""What is lost, told in notes and read back from them."""

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from shared.recording.losses import NO_ROOM, ON_THE_WAY, Loss, as_note, by_key, counts_of, joined, sentence

LOSSES = st.lists(
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


@given(LOSSES)
def test_a_note_tells_as_many_as_were_lost_whatever_is_joined(losses):
    counts = Counter()
    for loss in losses:
        counts[loss.key] += loss.count
    assert by_key(losses) == counts
    assert by_key(joined(losses)) == counts
    assert counts_of(as_note(losses, 5)) == counts


def test_neighbours_are_one_stretch_and_the_reason_stands_with_it():
    losses = [Loss("k", 5, 5, NO_ROOM, 0), Loss("k", 3, 4, NO_ROOM, 0), Loss("k", 6, 7, ON_THE_WAY, 0)]
    assert sentence(losses) == "lost 5 of k (3-5 no room, 6-7 on the way)"
    assert as_note(losses, 9).facts == {"at_ns": "9", "k": "5: 3-5 no room, 6-7 on the way"}


def test_a_note_of_a_thousand_stretches_stays_short():
    note = as_note([Loss("k", 2 * n, 2 * n, ON_THE_WAY, 0) for n in range(1000)], 0)
    assert note.facts["k"].endswith("and 950 more")
    assert len(note.facts["k"]) < 1500
