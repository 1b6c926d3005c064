import rerun as rr

from agents.viewer.entity import Moment
from agents.viewer.sinks import AGAIN_NS, Standing

START = 1_760_000_000_000_000_000


def line(x):
    return [rr.LineStrips3D([[(0, 0, 0), (x, 0, 1)]], colors=[(1, 2, 3)])]


def test_what_has_not_changed_stands_for_a_second_and_is_then_due_again():
    standing = Standing()
    stood = [standing.stands("tool", Moment(START + k * AGAIN_NS // 10), line(1)) for k in range(21)]
    assert [k for k, stands in enumerate(stood) if not stands] == [0, 10, 20]


def test_what_changes_or_is_of_another_entity_timeline_or_earlier_time_does_not_stand_nor_does_a_line_of_the_log():
    standing, said = Standing(), [rr.TextLog("the same again")]
    for path, moment, archetypes in (
        ("tool", Moment(START), line(1)),
        ("tool", Moment(START + 1), line(2)),
        ("tool", Moment(START + 2), [rr.Clear(recursive=False)]),
        ("tool", Moment(START + 3), line(2)),
        ("thread", Moment(START + 3), line(2)),
        ("tool", Moment(START + 4, frame=3), line(2)),
        ("tool", Moment(START, frame=2), line(2)),
        ("log/viewer", Moment(START), said),
        ("log/viewer", Moment(START + 1), said),
    ):
        assert not standing.stands(path, moment, archetypes), moment
