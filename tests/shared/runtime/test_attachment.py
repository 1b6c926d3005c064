"""What goes beside each message: it comes back as it was, and nothing else passes for it."""

from hypothesis import given
from hypothesis import strategies as st

from shared.runtime.attachment import LAYOUT, Attachment, pack, unpack

uint64 = st.integers(0, 2**64 - 1)
attachments = st.builds(Attachment, uint64, uint64, st.integers(-(2**63), 2**63 - 1), st.floats(allow_nan=False))


@given(attachments)
def test_it_comes_back_as_it_was_and_is_small(attachment):
    assert unpack(pack(attachment)) == attachment
    assert len(pack(attachment)) == LAYOUT.size == 32


@given(st.binary(max_size=80).filter(lambda data: len(data) != LAYOUT.size))
def test_bytes_of_another_length_are_none(data):
    assert unpack(data) is None
