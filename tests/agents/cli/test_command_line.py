"""Commands, options and streams: help stays as it is, every mistake is one line, and no stream is a surprise."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import pytest

from agents.cli.command_line import condensed
from agents.cli.commands import COMMANDS, loaded
from schemas import __version__

SCRIPT = Path(sys.executable).with_name("suturegrasp")
NAMED = ("--calibration", "c.json", "--output", "o.json")
PAIR = ("--left", "l.png", "--right", "r.png")

MISTAKES: dict[tuple[str, ...], tuple[str, ...]] = {
    ("deploy", "rehearse", "--slow", "robot"): ("--slow needs 2 values",),
    (): ("give a command: demo", "suturegrasp --help"),
    ("run",): ("give a command: run camera", "suturegrasp --help"),
    ("run", "nonsense"): ("run nonsense is no command", "run camera"),
    ("camera",): ("suturegrasp camera is suturegrasp run camera now",),
    ("replay", "s.mcap", "--through", "planner"): (
        "suturegrasp replay --through is suturegrasp recompute --through now",
    ),
    ("nonsense",): ("nonsense is no command", "reconstruct"),
    PAIR: ("--left is no command", "reconstruct"),
    ("reconstruct",): ("--calibration PATH [PATH], --output JSON", "suturegrasp reconstruct --help"),
    ("reconstruct", *NAMED, "--bogus", "1"): ("unrecognized", "--bogus, 1", "suturegrasp reconstruct --help"),
    ("reconstruct", "--calibraton", "c", "--output", "o"): ("missing", "--calibration", "--calibraton"),
    ("reconstruct", *NAMED, "--left"): ("--left needs a value", "--left", "suturegrasp reconstruct --help"),
    ("reconstruct", *NAMED, "--left", "l.png"): ("give both --left and --right", "--stereo"),
    ("reconstruct", *NAMED, *PAIR, "--stereo", "s.png"): ("either --stereo or --left and --right",),
    ("reconstruct", *NAMED, *PAIR, "--left-mask", "m.png"): ("both --left-mask and --right-mask",),
    ("reconstruct", *NAMED, *PAIR, "--segmenter", "mask"): ("--segmenter mask needs --left-mask and --right-mask",),
    ("reconstruct", *NAMED, *PAIR, "--segmenter", "magic"): ("--segmenter magic is unknown", "threshold, network"),
    ("reconstruct", *NAMED, *PAIR, "--method", "magic"): ("--method magic is unknown", "paper, refined"),
    ("reconstruct", *NAMED, *PAIR, "--unit", "km"): ("--unit km is unknown", "m, cm, mm, um"),
    ("reconstruct", *NAMED, *PAIR, "--left-mask", "a", "--right-mask", "b", "--segmenter", "network"): (
        "masks are given, so --segmenter network would not be used",
    ),
    ("reconstruct", "--calibration", "--output", "o.json", *PAIR): ("--calibration takes one path, or two",),
    ("reconstruct", "--calibration", "a", "b", "c", "--output", "o.json", *PAIR): ("--calibration takes one path",),
    ("reconstruct", *NAMED, "--bo\ngus\x1b[31m"): ("--bo gus",),
}


@pytest.mark.parametrize("arguments", MISTAKES, ids=" ".join)
def test_a_mistake_is_told_in_one_line(suturegrasp, monkeypatch, tmp_path, arguments):
    monkeypatch.chdir(tmp_path)
    ended = suturegrasp(*arguments)
    assert (ended.status, ended.out, len(ended.err.splitlines())) == (2, "", 1)
    assert ended.err.startswith("suturegrasp: ")
    assert ended.err.rstrip("\n").isprintable()
    for told in MISTAKES[arguments]:
        assert told in ended.err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_mistake_is_told_alike_in_any_terminal(console_script):
    terminal = {"COLUMNS": "30", "PYTHONIOENCODING": "ascii", "FORCE_COLOR": "1"}
    ended = console_script("reconstruct", "--output", "o", "--wrong", **terminal)
    assert (ended.status, ended.out) == (2, "")
    assert ended.err == (
        "suturegrasp: missing from suturegrasp reconstruct: --calibration PATH [PATH]; unrecognized options: --wrong; "
        "see suturegrasp reconstruct --help\n"
    )


def test_words_outside_any_box_are_kept():
    assert condensed("some error\n", "goal") == "some error; see suturegrasp goal --help"
    assert condensed("", "goal") == "; see suturegrasp goal --help"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--help",), "a stereo pair to a thread in 3D"),
        (("run", "--help"), "run robot-bridge"),
        (("reconstruct", "-h"), "Turn a stereo pair into a thread in 3D"),
    ],
)
def test_help_and_version_go_to_standard_output(suturegrasp, arguments, told):
    ended = suturegrasp(*arguments)
    assert (ended.status, ended.err) == (0, "")
    assert "usage: suturegrasp" in ended.out
    assert told in ended.out
    ended = suturegrasp("--version")
    assert (ended.status, ended.out, ended.err) == (0, f"suturegrasp {__version__}\n", "")


def test_the_list_of_all_commands_fits_a_screen(suturegrasp):
    lines = suturegrasp("--help").out.splitlines()
    assert len(lines) <= 50
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_can_be_loaded_and_says_what_it_does(name):
    options = COMMANDS[name].options_type()
    assert dataclasses.is_dataclass(options) and options.__doc__
    assert callable(loaded(COMMANDS[name].runs))


def test_help_names_every_option_and_choice(suturegrasp):
    said = suturegrasp("reconstruct", "--help").out
    pairs = ("--left", "--right", "--stereo", "--left-mask", "--right-mask", "--calibration", "--unit")
    choices = ("{m,cm,mm,um}", "{mask,threshold,network,promptable}", "{paper,refined}")
    for told in (*pairs, "--segmenter", "--method", "--output", "--picture", "--rrd", *choices):
        assert told in said


def test_a_result_can_be_written_into_a_device(suturegrasp, pair, small):
    (small / "pipe").symlink_to("/dev/null")
    assert suturegrasp(*pair(small), "--output", small / "pipe").status == 0
    assert (small / "pipe").is_symlink()


@pytest.mark.slow
def test_a_result_can_be_piped(console_script, pair, small):
    ended = console_script(*pair(small), "--output", "/dev/stdout")
    assert (ended.status, ended.err) == (0, "")
    assert json.loads(ended.out)["status"] == "ok"


SHELL = {
    "nobody reads the help": ('"$1" reconstruct --help | true; exit ${PIPESTATUS[0]}', 0, ""),
    "no standard output for a mistake": ('"$@" --wrong >&-', 2, "suturegrasp: "),
    "no standard error": ('"$@" --output /nowhere/out.json 2>&-', 2, ""),
}
SHELL_WITH_RESULT = {
    "nobody reads the summary": ('"$@" --output "$out" | true; exit ${PIPESTATUS[0]}', 0, ""),
    "no standard output": ('"$@" --output "$out" >&-', 0, ""),
    "a full standard output": ('"$@" --output "$out" >/dev/full', 0, "warning: standard output cannot be written"),
}


@pytest.mark.parametrize("name", [*SHELL, *(pytest.param(name, marks=pytest.mark.slow) for name in SHELL_WITH_RESULT)])
def test_streams_that_lead_nowhere_do_no_harm(pair, small, name):
    script, status, complaint = (SHELL | SHELL_WITH_RESULT)[name]
    done = subprocess.run(
        ["bash", "-c", f"out={small}/out.json; {script}", "bash", str(SCRIPT), *map(str, pair(small))],  # noqa: S607
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (status, "")
    assert done.stderr.startswith(complaint)
    assert len(done.stderr.splitlines()) == (complaint != "")
    if name in SHELL_WITH_RESULT:
        assert json.loads((small / "out.json").read_text())["status"] == "ok"


@pytest.mark.slow
def test_what_asks_or_starts_agents_loads_nothing_that_they_compute_with():
    """Of `--help`, then of an operator's command, then of what starts a rig."""
    code = (
        "import sys, agents.cli.commands, agents.cli.command_line\n"
        "print({'numpy', 'zenoh', 'pydantic', 'schemas.messages'} & set(sys.modules))\n"
        "import agents.cli.live.command\n"
        "print({'cv2', 'scipy', 'rerun', 'mcap'} & set(sys.modules))\n"
        "import agents.cli.live.up, agents.launch.builders\n"
        "print({'cv2', 'scipy'} & set(sys.modules))"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.split() == ["set()", "set()", "set()"]
