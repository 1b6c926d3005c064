"""Outputs are there whole or not at all."""

import os

import pytest

from agents.cli.whole_file import OutputError, whole_file


@pytest.mark.parametrize("name", ["out.json", "x" * 250 + ".json"])
def test_a_file_appears_when_it_is_complete(tmp_path, name):
    with whole_file(tmp_path / name) as unfinished:
        unfinished.write_text("half")
        assert not (tmp_path / name).exists()
        unfinished.write_text("whole")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "whole")]


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_what_was_there_stays_when_writing_fails(tmp_path, error):
    (tmp_path / "out.json").write_text("earlier")
    with pytest.raises((error, OutputError)), whole_file(tmp_path / "out.json") as unfinished:
        unfinished.write_text("half")
        raise error
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("out.json", "earlier")]
    told = r"no/out\.json cannot be written: No such file or directory"
    with pytest.raises(OutputError, match=told), whole_file(tmp_path / "no" / "out.json") as unfinished:
        unfinished.write_text("whole")


def test_a_link_stays_and_its_file_is_replaced_and_a_pipe_is_written_directly(tmp_path):
    (tmp_path / "kept.json").write_text("earlier")
    (tmp_path / "out.json").symlink_to("kept.json")
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    for name in ("out.json", "pipe"):
        with whole_file(tmp_path / name) as unfinished:
            unfinished.write_text("whole")
    assert (tmp_path / "out.json").is_symlink()
    assert (tmp_path / "kept.json").read_text() == "whole"
    assert os.read(reader, 100) == b"whole"
    os.close(reader)
    assert (tmp_path / "pipe").is_fifo()
