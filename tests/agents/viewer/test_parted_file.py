"""A file of a long session is continued in others, which are one recording together."""

import random

import rerun as rr

from agents.viewer.layout import DEFAULT, Scene, live_layout
from agents.viewer.sinks import FLUSHED_EVERY, Moment, file_sink
from tests.agents.viewer.test_live import rows_of

MOMENTS = 6 * FLUSHED_EVERY


def test_every_moment_is_in_one_of_the_files_and_what_always_holds_in_each(tmp_path):
    path = tmp_path / "session.rrd"
    sink = file_sink(path, "long", live_layout(DEFAULT, Scene()), part_bytes=200_000)
    sink.log(Moment(0), [("curve", [rr.SeriesLines(names="a name")])])
    noise = random.Random(1)
    for number in range(1, MOMENTS):
        blob = rr.EncodedImage(contents=noise.randbytes(4096), media_type="image/jpeg")
        sink.log(Moment(number), [("image", [blob])])
    sink.close()
    parts = sorted(tmp_path.glob("session*.rrd"))
    assert [part.name for part in parts[:3]] == ["session.rrd", "session_part2.rrd", "session_part3.rrd"]
    found = [rows_of(part) for part in parts]
    moments = [row["capture_time"] for rows in found for row in rows.get("/image", ())]
    assert sorted(moments) == list(range(1, MOMENTS))
    assert all("/curve" in rows for rows in found)
