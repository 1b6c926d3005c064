"""Commands, options and streams: every mistake is one line, help is there, and no stream is a surprise."""

import dataclasses
import importlib
import json
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import pytest

from agents.cli.commands import COMMANDS, loaded
from agents.cli.main import TOLD
from schemas import __version__
from tests.agents.cli.conftest import SCRIPT, of_pair, refused

NAMED = "reconstruct --calibration c.json --output o.json"
PAIR = f"{NAMED} --left l.png --right r.png"
HELP = "see suturegrasp reconstruct --help"

MISTAKES = [
    ("", "give a command: demo"),
    ("run", "give a command: run camera"),
    ("run planer", "did you mean run planner?"),
    ("run planner --config none.toml", "none.toml cannot be read"),
    ("camera", "suturegrasp camera is suturegrasp run camera now"),
    ("replay s.mcap --through planner", "suturegrasp replay --through is suturegrasp recompute --through now"),
    ("nonsense", "nonsense is no command; give one first: demo"),
    ("--left l.png", "--left is no command"),
    ("reconstruct", "--calibration PATH [PATH], --output JSON; see suturegrasp reconstruct --help"),
    (f"{NAMED} --bogus 1", f"unrecognized options: --bogus, 1; {HELP}"),
    ("reconstruct --calibraton c --output o", "missing from suturegrasp reconstruct: --calibration PATH [PATH]"),
    (f"{NAMED} --left", f"--left needs a value; {HELP}"),
    (f"{NAMED} --left l.png", "give either both --left and --right, or one side-by-side image with --stereo"),
    (f"{PAIR} --left-mask m.png", "both --left-mask and --right-mask"),
    (f"{PAIR} --segmenter mask", "--segmenter mask needs --left-mask and --right-mask"),
    (f"{PAIR} --segmenter magic", "invalid choice 'magic' for argument '--segmenter'"),
    (f"{PAIR} --method magic", "Expected one of ('paper', 'refined')"),
    (f"{PAIR} --left-mask a --right-mask b --segmenter network", "so --segmenter network would not be used"),
    (f"{PAIR} --left-mask a --right-mask b --pixel 1 2", "so --pixel would not be used"),
    (f"{PAIR} --segmenter promptable", "needs --promptable-encoder and --promptable-decoder"),
    (f"{PAIR} --promptable-encoder a.onnx", "give both --promptable-encoder and --promptable-decoder"),
    ("reconstruct --output o.json --left l --right r --calibration", "--calibration takes one path, or two"),
    ("reconstruct --output o.json --left l --right r --calibration a b c", "--calibration takes one path, or two"),
    (f"{NAMED} --bo\x07gus\x1b[31m", "unrecognized options: --bo?gus;"),
    ("goal", "give one of --s, --pixel, --point and --from-swage-mm"),
    ("goal --s 0.5 --pixel 1 2", "give one of --s, --pixel, --point and --from-swage-mm"),
    ("goal --s 1.5", "s runs from 0 to 1"),
    ("arm", "give the id of a plan, as goal prints it"),
    ("arm plan-1 --attempts 0", "at least one attempt"),
    ("prompt --pixel 1", "--pixel needs U V"),
    ("prompt --at 1,2", "suturegrasp prompt --at is suturegrasp prompt --pixel U V now"),
    ("prompt --pixel nan 2", "--pixel nan 2 is none; give two finite numbers"),
    ("set", "name an agent, such as perception"),
    ("set a b c d e", "give an agent, and to set a parameter its name and value"),
    ("demo --view hologram", "--view"),
    ("up --restart maybe", "suturegrasp up --help"),
    ("deploy rehearse --slow robot", "--slow needs 2 values"),
    ("scenes render --output . --count 0", "--count 0: give 1 or more"),
    ("scenes render --output . --size 20 960", "--size 20 960: give 64 to 3840 for either"),
    ("doctor --left a.png", "give the --calibration"),
    ("doctor --left a.png --calibration c.json", "give either both --left and --right"),
    ("doctor --stereo s.png --left a.png --calibration c.json", "give either both"),
    ("track-tool", "give a recording, or --live"),
    ("track-tool s.mcap --live", "--live"),
    ("experiment", "give a folder"),
    ("experiment new --threads easy", "--threads easy must read CONFIGURATION/BACKGROUND"),
    ("experiment new --threads easy/paper easy/paper", "each once"),
    ("experiment new --threads easy/paper --goals 0", "goals = 0"),
    ("experiment new --threads easy/paper --arm psm7", "no arm 'psm7'; its arms: psm1"),
    ("experiment new --report", "nothing to report"),
]


@pytest.mark.parametrize(("arguments", "told"), MISTAKES, ids=[arguments for arguments, _ in MISTAKES])
def test_a_mistake_is_told_in_one_line(suturegrasp, monkeypatch, tmp_path, arguments, told):
    monkeypatch.chdir(tmp_path)
    ended = suturegrasp(*arguments.split())
    refused(ended, told)
    assert ended.err.rstrip("\n").isprintable()
    assert not list(tmp_path.iterdir())


def test_every_error_that_is_told_in_one_line_is_one():
    for module, name in TOLD:
        assert issubclass(getattr(importlib.import_module(module), name), Exception)


@pytest.mark.slow
def test_a_mistake_is_told_alike_in_any_terminal(console_script):
    terminal = {"COLUMNS": "30", "PYTHONIOENCODING": "ascii", "FORCE_COLOR": "1"}
    ended = console_script("reconstruct", "--output", "o", "--wrong", **terminal)
    refused(
        ended, f"missing from suturegrasp reconstruct: --calibration PATH [PATH]; unrecognized options: --wrong; {HELP}"
    )


def test_help_and_version_go_to_standard_output(suturegrasp):
    for arguments, told in (("--help", "a stereo pair to a thread in 3D"), ("run --help", "run robot-bridge")):
        ended = suturegrasp(*arguments.split())
        assert (ended.status, ended.err) == (0, "")
        assert "usage: suturegrasp" in ended.out
        assert told in ended.out
    lines = suturegrasp("--help").out.splitlines()
    assert len(lines) <= 50, "it fits a screen"
    assert max(map(len, lines)) <= 80
    said = suturegrasp("reconstruct", "-h").out
    for told in ("--right-mask", "{m,cm,mm,um}", "{mask,threshold,network,promptable}", "{paper,refined}"):
        assert told in said
    ended = suturegrasp("--version")
    assert (ended.status, ended.out, ended.err) == (0, f"suturegrasp {__version__}\n", "")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_can_be_loaded_and_has_a_help(suturegrasp, name):
    assert dataclasses.is_dataclass(COMMANDS[name].options_type())
    assert callable(loaded(COMMANDS[name].runs))
    ended = suturegrasp(*name.split(), "--help")
    assert (ended.status, f"suturegrasp {name}" in ended.out) == (0, True)


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("bash"), reason="there is no bash")
def test_bash_completes_commands(console_script, tmp_path):
    ended = console_script("--tyro-print-completion", "bash")
    assert (ended.status, ended.err) == (0, "")
    (tmp_path / "suturegrasp").write_text(ended.out)
    function = re.search(r"^complete .*-F (\w+) suturegrasp$", ended.out, flags=re.M)
    assert function, ended.out[-500:]
    words = "COMP_WORDS=(suturegrasp dem); COMP_CWORD=1; COMP_LINE='suturegrasp dem'; COMP_POINT=15; COMP_TYPE=9"
    asked = f"source {tmp_path / 'suturegrasp'}; {words}; {function[1]}; echo ${{COMPREPLY[*]}}"
    done = subprocess.run(["bash", "-c", asked], capture_output=True, text=True, check=False)  # noqa: S607
    assert done.stdout.split() == ["demo"], done.stderr


@pytest.mark.slow
def test_a_result_can_be_piped_or_written_into_a_device(suturegrasp, console_script, small):
    ended = console_script(*of_pair(small), "--output", "/dev/stdout")
    assert (ended.status, ended.err) == (0, "")
    assert json.loads(ended.out)["status"] == "ok"
    (small / "pipe").symlink_to("/dev/null")
    assert suturegrasp(*of_pair(small), "--output", small / "pipe").status == 0
    assert (small / "pipe").is_symlink()


@pytest.mark.parametrize(
    ("script", "status", "complaint", "writes"),
    [
        ('"$1" reconstruct --help | true; exit ${PIPESTATUS[0]}', 0, "", False),
        ('"$@" --wrong >&-', 2, "suturegrasp: ", False),
        ('"$@" --output /nowhere/out.json 2>&-', 2, "", False),
        ('"$@" --output "$out" | true; exit ${PIPESTATUS[0]}', 0, "", True),
        pytest.param('"$@" --output "$out" >&-', 0, "", True, marks=pytest.mark.slow),
        pytest.param('"$@" --output "$out" >/dev/full', 0, "warning: standard output", True, marks=pytest.mark.slow),
    ],
)
def test_streams_that_lead_nowhere_do_no_harm(small, script, status, complaint, writes):
    command = ["bash", "-c", f"out={small}/out.json; {script}", "bash", SCRIPT, *map(str, of_pair(small))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (status, "")
    assert done.stderr.startswith(complaint)
    assert len(done.stderr.splitlines()) == (complaint != "")
    assert (small / "out.json").exists() == writes


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


def test_the_graph_has_every_topic_with_its_sender_and_those_who_hear_it(suturegrasp, tmp_path):
    output = tmp_path / "graph.svg"
    lines = [line.split() for line in suturegrasp("graph", "--output", output).out.splitlines()]
    assert ["perception", "observations", "30", "Hz", "reconstruction"] in lines
    (thread,) = (line[1:] for line in lines if line[:1] == ["reconstruction"])
    assert thread[:3] == ["thread", "30", "Hz"] and {"perception,", "planner"} <= set(thread)
    assert ["hold", "command", "robot_bridge", "ARM"] in lines
    told = [text.text for text in ElementTree.fromstring(output.read_text()).iter("{http://www.w3.org/2000/svg}text")]  # noqa: S314, our own
    assert {"camera", "tool_tracker ARM", "observations", "frames, calibration"} <= set(told)
