"""Hosts whose file of the rig is another one: digests of its sections, and what status and doctor say of them."""

from pathlib import Path

import pytest

from agents.configuration.digest import differing, rig_sections
from agents.configuration.rig import RigConfig
from agents.configuration.this_host import at_host, certificates_of
from agents.diagnostics.doctor.rig import files
from agents.diagnostics.status.files import judge_files
from agents.diagnostics.status.gathered import Gathered
from agents.diagnostics.status.health_watch import Fare
from agents.diagnostics.status.judgement import judge
from schemas.messages import AgentFacts
from shared.runtime.config import parse_config

LAB = (Path(__file__).parents[3] / "deploy" / "lab.toml").read_text(encoding="utf-8")
PLACED = {"camera/main": "video", "perception/main": "strong", "planner/main": "strong", "robot_bridge/psm1": "robot"}


def rig(text=LAB, name="rig.toml"):
    return parse_config(text, RigConfig, name)


def facts(name, text: str | None = LAB):
    kind, instance = name.split("/")
    sections = () if text is None else rig_sections(rig(text))
    return AgentFacts(
        kind, instance, "machine", 1, "0.2.0", "s", "c", "3.11", "1", False, "", None, None, "", "", None, None, None,
        1.0, 1, (), sections,
    )  # fmt: skip


def gathered(here=LAB, **theirs):
    """What is heard of a rig of which each host has its own file, by the host's name; others have the lab's."""
    told = {name: facts(name, theirs.get(host, LAB)) for name, host in PLACED.items()}
    called = {name: name.replace("/main", "").replace("/", " ") for name in told}
    fares = tuple(Fare(called[name], None, 0.1, True, placed=host) for name, host in PLACED.items())
    return Gathered(0, "lab", "", fares=fares, facts=told, rig_sections=rig_sections(rig(here)))


SLOW = LAB.replace("rate_hz = 30.0", "rate_hz = 25.0")
OTHER = LAB.replace("leaf_days = 30", "leaf_days = 20")


@pytest.mark.parametrize(
    ("old", "new", "sections"),
    [
        ("leaf_days = 30", "leaf_days = 20", ("security",)),
        ("rate_hz = 30.0", "rate_hz = 25.0", ("camera",)),
        ('address = "10.0.0.12"', 'address = "10.0.0.22"', ("hosts.strong",)),
        ("[perception]", '[perception]\nsegmenter = "network"', ("perception",)),
        ('backend = "simulated"', "speed_share = 0.5", ("robot.psm1",)),
    ],
)
def test_the_section_that_differs_is_named(old, new, sections):
    changed = LAB.replace(old, new, 1)
    assert changed != LAB
    assert differing(rig_sections(rig()), rig_sections(rig(changed))) == sections


def test_what_each_host_has_of_its_own_and_how_a_file_is_written_make_no_difference(tmp_path):
    plain = rig_sections(rig())
    commented = LAB.replace("rate_hz = 30.0", "# as it films\nrate_hz = 30")
    own = rig_sections(certificates_of(at_host(rig(), "robot"), tmp_path / "rig.toml"))
    as_json = rig_sections(rig(rig().model_dump_json(exclude_none=True), "rig.json"))
    assert plain == rig_sections(rig(commented)) == own == as_json
    assert differing(plain, rig_sections(rig(f'{LAB}\n[topics."*/log"]\nkept = 2000\n'))) == ()


def test_the_host_whose_file_differs_is_named_with_its_agents_and_the_sections():
    both = SLOW.replace("leaf_days = 30", "leaf_days = 20")
    (wrong,) = judge_files(gathered(strong=both))
    assert (wrong.code, wrong.about, wrong.grave) == ("file", "strong", True)
    assert wrong.text == (
        "perception and planner on strong began with another file of the rig than the one here, and they differ in "
        "[camera] and [security]; take the right one there and restart them"
    )
    assert wrong in judge(gathered(strong=both))
    assert list(judge_files(gathered())) == []


def test_where_all_others_agree_it_is_the_file_here_that_differs():
    (wrong,) = judge_files(gathered(here=SLOW))
    assert wrong.about == "here"
    assert "differs from the one that every agent began with, in [camera]" in wrong.text
    # two that disagree with each other say nothing of which is right
    assert len(list(judge_files(gathered(here=SLOW, strong=OTHER)))) == 3


def test_doctor_says_so_and_what_it_cannot_tell():
    assert [(f.state, f.found) for f in files(gathered())] == [("ok", "every agent began with the same as here")]
    (wrong,) = files(gathered(robot=SLOW))
    assert (wrong.state, wrong.what) == ("WRONG", "file of the rig on robot")
    assert next(files(gathered(here=SLOW))).what == "file of the rig here"
    assert list(files(Gathered(0, "lab", ""))) == []
    (unknown,) = files(gathered(robot=None))
    assert (unknown.state, unknown.found) == ("?", "unknown of robot_bridge psm1, whose version does not tell")


def test_a_file_of_0_2_means_what_it_meant():
    hosts = '[hosts.one]\naddress = "10.0.0.11"\nruns = ["perception", "perception psm1", "robot_bridge psm1"]\n'
    arm = '[robot.psm1]\ncorrection = "perception"\n'
    old = rig(f'[perception]\ntrack_tool = ["psm1"]\n{arm}{hosts}[router]\nhost = "one"\n[security]\n', "lab.toml")
    assert old.agents() == [("perception", "main"), ("tool_tracker", "psm1"), ("robot_bridge", "psm1")]
    assert old.hosts["one"].runs == ("perception", "tool_tracker psm1", "robot_bridge psm1")
    assert old.robot["psm1"].correction == "tool_tracker"
