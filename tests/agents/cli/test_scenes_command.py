"""`suturegrasp scenes render`: what is refused at once, and batches that are made as a user makes them."""

import importlib.util
import re
import subprocess
import sys

import pytest

TRACES = importlib.util.find_spec("mitsuba") is not None


def scenes(*arguments):
    command = [sys.executable, "-m", "agents.cli", "scenes", "render", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--count", "0"), "--count 0: give 1 or more"),
        (("--workers", "-1"), "--workers -1: give 1 or more"),
        (("--size", "20", "960"), "--size 20 960: give 64 to 3840 for either"),
        (("--config", "knot"), "config"),
    ],
)
def test_what_makes_no_batch_is_said_in_one_sentence(suturegrasp, tmp_path, arguments, said):
    ended = suturegrasp("scenes", "render", "--output", tmp_path, *arguments)
    assert ended.status == 2
    assert said in ended.err
    assert len(ended.err.splitlines()) == 1


def test_a_file_in_place_of_the_folder_is_said(suturegrasp, tmp_path):
    (tmp_path / "file").write_text("")
    ended = suturegrasp("scenes", "render", "--output", tmp_path / "file")
    assert ended.status == 2
    assert "is a file; name a folder" in ended.err


@pytest.mark.skipif(TRACES, reason="the extra sim is installed")
def test_without_the_path_tracer_its_remedy_is_said(tmp_path):
    ended = scenes("--output", tmp_path)
    assert ended.returncode == 2
    assert "make sim" in ended.stderr


@pytest.mark.timeout(900)
@pytest.mark.skipif(not TRACES, reason="path tracing needs the extra sim: make sim")
def test_a_batch_is_made_by_two_processes_and_taken_up_again(tmp_path):
    batch = ("--output", tmp_path, "--config", "easy", "--size", 160, 90, "--samples", 1, "--seed", 3)
    first = scenes(*batch, "--count", 2, "--workers", 2)
    assert first.returncode == 0, first.stderr
    assert re.search(r"2 pairs in .*, 2 of them new: [\d.]+ s of processor time each", first.stdout)
    made = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert {"easy_chicken_0003.json", "easy_chicken_0004_mask_right.png"} <= set(made)
    again = scenes(*batch, "--count", 2)
    assert "all were there already" in again.stdout
    other = scenes(*batch, "--count", 2, "--with", "smoke")
    assert other.returncode == 2
    assert "was made otherwise (with: [], not ['smoke']); name another folder with --output" in other.stderr
    assert {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == made
