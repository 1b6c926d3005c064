"""What the page's server listens to, with somebody there to see it and without."""

import pytest

from agents.operator.heard import SHOWN, Heard
from schemas.codec import encode
from schemas.messages import FrameStamp, Image, ImageEncoding, StereoFrame
from schemas.topics import FRAMES, key
from shared.runtime.attachment import Attachment, pack
from shared.runtime.connection import connected

EYE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))
FRAME = StereoFrame(stamp=FrameStamp(1, 1, 1, "hand"), left=EYE, right=EYE)


@pytest.fixture
def heard(settings):
    with connected(settings, 5.0) as connection:
        listening = Heard(connection, lambda _topic: None)
        yield listening
        listening.rest(unless=lambda: False)


def test_what_is_shown_is_listened_to_while_somebody_is_there(heard, settings, session, until):
    publishers = [session.declare_publisher(key(settings.rig, topic)) for topic in SHOWN]

    def are_heard():
        return {publisher.matching_status.matching for publisher in publishers}

    until(lambda: session.info.routers_zid())
    assert are_heard() == {False}
    heard.attend()
    until(lambda: are_heard() == {True})
    session.put(key(settings.rig, FRAMES), encode(FRAME), attachment=pack(Attachment(1, 0, 0, 0.0)))
    until(lambda: heard._newest)
    heard.rest(unless=lambda: True)
    assert are_heard() == {True}
    heard.rest(unless=lambda: False)
    until(lambda: are_heard() == {False})
    # what was heard for those who have gone is not shown to those who come
    heard.attend()
    until(lambda: are_heard() == {True})
    assert heard.newest(FRAMES) == []
