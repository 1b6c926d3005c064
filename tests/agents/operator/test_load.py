"""What the page's server leaves out: what a host has no time for, and what nobody is there to see."""

from agents.operator.load import CALM_S, LoadMonitor, Processors, processors
from agents.operator.subscriptions import SHOWN, Subscriptions
from schemas.codec import encode
from schemas.messages import FrameStamp, Image, ImageEncoding, StereoFrame
from schemas.topics import FRAMES, key
from shared.runtime.attachment import Attachment, pack
from shared.runtime.connection import connected

EYE = Image(ImageEncoding.RAW, 4, 2, 1, bytes(8))
FRAME = StereoFrame(stamp=FrameStamp(1, 1, 1, "hand"), left=EYE, right=EYE)


class Host:
    """Two processors, of whose time so large a share is idle from now on."""

    def __init__(self):
        self._now_s, self._spent = 0.0, Processors(0, 0)
        self.spare = LoadMonitor(lambda: self._spent)

    def after(self, seconds, idle):
        """Whether it is full after so many looks, one a second."""
        for _ in range(round(seconds)):
            self._now_s += 1.0
            self._spent = Processors(self._spent.idle + round(200 * idle), self._spent.total + 200)
            self.spare.look(self._now_s)
        return self.spare.full


def test_a_host_is_full_as_soon_as_a_second_of_it_was_used_up_and_has_room_once_it_was_calm_for_a_while():
    host = Host()
    assert not host.after(3, idle=0.9)
    assert host.after(1, idle=0.05)
    # what stepping back itself sets free is not yet room, and the calm must last
    assert host.after(10 * CALM_S, idle=0.2)
    for _ in range(5):
        assert host.after(CALM_S / 2, idle=0.6)
        assert host.after(1, idle=0.25)
    assert host.after(CALM_S - 1, idle=0.5)
    assert not host.after(2, idle=0.5)


def test_processors_are_read_from_what_the_system_tells_and_without_it_no_host_is_full(tmp_path, monkeypatch):
    monkeypatch.setattr("agents.operator.load.STAT", tmp_path / "stat")
    assert processors() is None
    (tmp_path / "stat").write_text("cpu 1 2 x\n")
    assert processors() is None
    (tmp_path / "stat").write_text("cpu  10 20 30 40 50 60 70 80 90 100\ncpu0 1 2 3\n")
    assert processors() == Processors(90, 360), "what follows the eighth is counted already"
    host = LoadMonitor(lambda: None)
    host.look(1.0)
    assert not host.full


def test_what_is_shown_is_listened_to_while_somebody_is_there(settings, session, until):
    publishers = [session.declare_publisher(key(settings.rig, topic)) for topic in SHOWN]

    def are_heard():
        return {publisher.matching_status.matching for publisher in publishers}

    with connected(settings, 5.0) as connection:
        heard = Subscriptions(connection, lambda _topic: None)
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
        heard.rest(unless=lambda: False)
