"""Outputs are there whole or not at all."""

import os
from pathlib import Path

import pytest

from agents.cli.whole_file import OutputError, whole_file


@pytest.mark.parametrize("name", ["out.json", "x" * 250 + ".json"])
def test_a_file_appears_when_it_is_complete(tmp_path: Path, name: str) -> None:
    with whole_file(tmp_path / name) as unfinished:
        unfinished.write_text("half")
        assert not (tmp_path / name).exists()
        unfinished.write_text("whole")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "whole")]


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_what_was_there_stays_when_writing_fails(tmp_path: Path, error: type[BaseException]) -> None:
    (tmp_path / "out.json").write_text("earlier")
    with pytest.raises(error), whole_file(tmp_path / "out.json") as unfinished:
        unfinished.write_text("half")
        raise error
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("out.json", "earlier")]


def test_the_error_names_the_file_and_the_reason(tmp_path: Path) -> None:
    complaint = r"no/out\.json cannot be written: No such file or directory"
    with pytest.raises(OutputError, match=complaint), whole_file(tmp_path / "no" / "out.json") as unfinished:
        unfinished.write_text("whole")


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "kept.json").write_text("earlier")
    (tmp_path / "out.json").symlink_to("kept.json")
    with whole_file(tmp_path / "out.json") as unfinished:
        unfinished.write_text("whole")
    assert (tmp_path / "out.json").is_symlink()
    assert (tmp_path / "kept.json").read_text() == "whole"


def test_a_pipe_is_written_directly(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    with whole_file(tmp_path / "pipe") as direct:
        direct.write_text("whole")
    assert os.read(reader, 100) == b"whole"
    os.close(reader)
    assert (tmp_path / "pipe").is_fifo()
