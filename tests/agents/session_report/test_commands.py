"""`suturegrasp inspect` and `suturegrasp export` as a person, a pipe and another program meet them."""

import json
import re
from pathlib import Path

import pytest
from mcap.writer import Writer
from rich.text import Text

from agents.cli.main import main
from agents.session_report.document import lines
from agents.session_report.session import read_session
from agents.session_report.tables import session_tables


@pytest.fixture
def suturegrasp(capfd):
    """Runs the command within this process: its status, what it said, what it complained of."""

    def run(*arguments):
        capfd.readouterr()
        with pytest.raises(SystemExit) as end:
            main([str(argument) for argument in arguments])
        said = capfd.readouterr()
        return end.value.code, said.out, said.err

    return run


@pytest.fixture
def refused(suturegrasp):
    """Runs the command, which says why not in one line."""

    def run(*arguments, status=2):
        ended, out, err = suturegrasp(*arguments)
        assert (ended, len(err.splitlines())) == (status, 1)
        return out, err

    return run


def test_in_a_pipe_lines_are_whole_and_plain(suturegrasp, recording):
    status, out, err = suturegrasp("inspect", recording)
    assert (status, err) == (0, "")
    assert "\x1b" not in out
    assert "…" not in out
    assert [line for line in out.splitlines() if line != line.rstrip()] == []
    assert any("held" in line and "capture 0.400, slide 4.0 mm" in line for line in out.splitlines())
    assert "goal refused (thread_stale): the thread was seen 2000 ms ago" in out
    assert "<script>alert(1)</script> [bold]?[31m" in out


@pytest.mark.parametrize("width", [60, 200])
def test_a_terminal_gets_lines_that_fit(recording, width):
    plain = [Text.from_ansi(line).plain for line in lines([], session_tables(read_session(recording)), width)]
    assert max(map(len, plain)) <= width
    assert "thread_stale" in "".join("".join(plain).split())


def test_json_is_one_document_that_says_the_same(suturegrasp, recording):
    told = json.loads(suturegrasp("inspect", recording, "--json")[1])
    assert told["stages"]["reconstruction/thread"]["latency_ms"]["p99"] == pytest.approx(60)
    assert told["stages"]["reconstruction/thread"]["count"] == 57
    assert [grasp["outcome"] for grasp in told["grasps"]] == ["goal refused", "held"]
    assert told["grasps"][1]["armings"][0]["judgement"]["error_m"] == 0.001
    assert told["contents"][0]["key"].startswith("suturegrasp/lab/")
    assert told["complete"] is False


def test_two_recordings_are_set_side_by_side(suturegrasp, recording, slower, tmp_path):
    page = tmp_path / "both.html"
    status, out, _ = suturegrasp("inspect", recording, slower, "--html", page)
    rows = [line.split() for line in out.splitlines()]
    assert status == 0
    assert ["reconstruction/thread", "p50", "60.0", "110.0", "+83%"] in rows
    assert ["run.settings.planner.depth_m", "0.002", "0.005"] in rows
    assert not any(row and row[0] == "run.rig" for row in rows)
    assert ["camera/main/frames", "3", "3", "+0%"] in rows
    assert page.read_text().count("<svg") == 5
    both = json.loads(suturegrasp("inspect", recording, slower, "--json")[1])
    assert [one["recording"] for one in both] == [str(recording), str(slower)]


def test_a_page_is_written_and_nothing_is_overwritten(suturegrasp, refused, recording, tmp_path):
    page, before = tmp_path / "report.html", recording.read_bytes()
    assert suturegrasp("inspect", recording, "--html", page)[0] == 0
    assert page.read_text().startswith("<!doctype html>")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    for command, options, said in (
        ("inspect", ("--html", recording), "would overwrite"),
        ("inspect", ("--html", tmp_path), "is a folder"),
        ("inspect", ("--html", tmp_path / "no" / "a"), "no"),
        ("export", ("--output", tmp_path), "holds something already"),
        ("export", ("--output", page), "is a file"),
        ("export", ("--output", tmp_path / "out", "--format", "xlsx"), "Expected one of ('csv', 'npz', 'json')"),
        ("export", ("--output", tmp_path / "out", "--points", "1"), "must lie within 2 and 10000"),
    ):
        assert said in refused(command, recording, *options)[1]
    assert recording.read_bytes() == before


def test_damage_is_said_once_and_what_can_be_read_is_told(refused, recording, tmp_path):
    data, path = bytearray(recording.read_bytes()), tmp_path / "bad.mcap"
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(bytes(data))
    out, err = refused("inspect", path, status=3)
    assert "is damaged; only what lies before the damage can be read" in err
    assert "camera/main/frames" in out
    refused("export", path, "--output", tmp_path / "out", status=3)
    assert "is damaged" in (tmp_path / "out" / "README.txt").read_text()
    assert 5 < len((tmp_path / "out" / "frames.csv").read_text().splitlines()) < 57


@pytest.mark.parametrize("command", ["inspect", "export"])
def test_what_is_no_recording_is_one_line(refused, command, tmp_path):
    foreign, text = tmp_path / "foreign.mcap", tmp_path / "text.mcap"
    with foreign.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="other")
        writer.finish()
    text.write_text("a text")
    more = ("--output", tmp_path / "out") if command == "export" else ()
    for path, said in ((foreign, "of another program"), (text, "no recording"), (tmp_path / "none", "none")):
        out, err = refused(command, path, *more)
        assert (out, said in err) == ("", True)
    assert not (tmp_path / "out").exists()


def test_the_page_of_the_manual_names_every_option_and_table_and_its_example_runs(
    suturegrasp, recording, tmp_path, monkeypatch
):
    manual = (Path(__file__).parents[3] / "docs" / "recordings.md").read_text(encoding="utf-8")
    manual = manual.partition("\n## Inspect and export\n")[2].partition("\n## ")[0]
    for command in ("inspect", "export"):
        for option in set(re.findall(r"--(?!no-|help)[a-z-]+", suturegrasp(command, "--help")[1])):
            assert f"`{option}`" in manual, option
    for table in session_tables(read_session(recording)):
        assert table.title.split(",")[0] in manual
    assert suturegrasp("export", recording, "--output", tmp_path / "tables")[0] == 0
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(re.findall(r"```python\n(.*?)```", manual, re.DOTALL)[0], names)  # noqa: S102
    assert names["points"].shape == (50, 3)
    assert names["surest"] == pytest.approx([-0.02, 0, 0.1])
