"""Who says what to whom, as a table and as a drawing."""

import xml.etree.ElementTree as ElementTree

from agents.cli.graph.command import run
from agents.cli.graph.drawing import drawing
from agents.cli.graph.options import Graph

SVG = "{http://www.w3.org/2000/svg}"


def test_every_topic_has_its_sender_and_those_who_hear_it(capsys, tmp_path):
    output = tmp_path / "graph.svg"
    assert run(Graph(output)) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["perception", "observations", "30", "Hz", "reconstruction"] in lines
    (thread,) = (line[1:] for line in lines if line[:1] == ["reconstruction"])
    assert thread[:3] == ["thread", "30", "Hz"] and {"perception,", "planner"} <= set(thread)
    assert ["hold", "command", "robot_bridge", "ARM"] in lines
    told = [text.text for text in ElementTree.fromstring(output.read_text()).iter(f"{SVG}text")]  # noqa: S314, our own
    assert {"camera", "tool_tracker ARM", "observations", "frames, calibration"} <= set(told)


def test_arrows_go_down_on_the_right_and_up_on_the_left():
    root = ElementTree.fromstring(drawing(["a", "b<"], [("a", "b<", "there"), ("b<", "a", "back")]))  # noqa: S314, our own
    boxes = [float(box.attrib["x"]) for box in root.iter(f"{SVG}rect")]
    begins = [float(path.attrib["d"].split()[1]) for path in root.iter(f"{SVG}path") if "marker-end" in path.attrib]
    assert begins[0] > boxes[0] == begins[1]


def test_a_drawing_that_cannot_be_written_is_one_line(capsys, tmp_path):
    assert run(Graph(tmp_path / "nowhere" / "graph.svg")) == 2
    assert capsys.readouterr().err.count("\n") == 1
