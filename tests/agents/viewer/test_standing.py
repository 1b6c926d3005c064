import rerun as rr

from agents.viewer.moment import Moment
from agents.viewer.standing import AGAIN_NS, Standing

START = 1_760_000_000_000_000_000


def line(x):
    return [rr.LineStrips3D([[(0, 0, 0), (x, 0, 1)]], colors=[(1, 2, 3)])]


def test_what_has_not_changed_stands_for_a_second_and_is_then_due_again():
    standing = Standing()
    stood = [standing.stands("tool", Moment(START + k * AGAIN_NS // 10), line(1)) for k in range(21)]
    assert [k for k, stands in enumerate(stood) if not stands] == [0, 10, 20]


def test_what_has_changed_never_stands():
    standing = Standing()
    assert not any(standing.stands("tool", Moment(START + k), line(k)) for k in range(5))
    assert not standing.stands("tool", Moment(START + 9), [rr.Clear(recursive=False)])
    assert not standing.stands("tool", Moment(START + 10), line(4))


def test_another_entity_timeline_or_an_earlier_time_does_not_stand():
    standing = Standing()
    assert not standing.stands("tool", Moment(START), line(1))
    assert not standing.stands("thread", Moment(START), line(1))
    assert not standing.stands("tool", Moment(START + 1, frame=3), line(1))
    assert not standing.stands("tool", Moment(START, frame=2), line(1))


def test_lines_of_the_log_are_never_left_out():
    standing = Standing()
    said = [rr.TextLog("the same again")]
    assert not any(standing.stands("log/viewer", Moment(START + k), said) for k in range(3))
