"""Whether links between hosts bear what crosses them: the streams of a rig's file, and the judgement."""

import threading
from pathlib import Path

import pytest

from agents.cli.live.doctor import weigh
from agents.configuration.rig import RigConfig
from agents.diagnostics.doctor.crossing import STREAMS, heard_by, traffic
from agents.diagnostics.doctor.network import networks
from agents.diagnostics.status.gathered import Gathered
from agents.diagnostics.status.health_watch import Fare
from schemas.messages import AgentHealth, InputHealth
from schemas.topics import FRAMES, OBSERVATIONS, THREAD, Delivery, key, topic_of
from shared.recording.mcap_file import read_recording
from shared.runtime.attachment import Attachment, pack
from shared.runtime.config import load_config, parse_config
from shared.runtime.connection import connected
from shared.runtime.delivery import declare_publisher
from shared.runtime.facts import Link
from tests.whole_rig import agents_of, whole_rig

REPOSITORY = Path(__file__).parents[3]
LAB = load_config(REPOSITORY / "deploy" / "lab.toml", RigConfig)
BYTES = {"camera/frames": 1e5, "perception/observations": 2e5, "reconstruction/thread": 5e4}
"""At 30 Hz: 3, 6 and 1.5 MB/s."""
AGENTS = ("camera/main", "perception/main", "robot_bridge/psm1")


def found(here, gathered=None, bytes_of=BYTES, rig=LAB, **passes):
    """What is found of each host, given what passes to and from agents; `camera=(from it, to it)`."""
    told = {name: passes.get(name.split("/")[0], (1e8, 1e8)) for name in AGENTS}
    measured = {name: Link(1.0, 2.0, *ways) if ways else None for name, ways in told.items()}
    at = rig.model_copy(update={"host": here})
    findings = networks(at, measured, gathered or Gathered(0, "lab", ""), bytes_of)
    return {finding.what.removeprefix("network of "): finding for finding in findings}


def test_what_each_agent_hears_is_what_it_subscribes_to():
    rig = whole_rig()
    for agent in agents_of(rig):
        steady = {i.topic for i in agent.inputs if i.topic in STREAMS and i.topic.delivery is Delivery.LATEST}
        assert steady == set(heard_by(rig, agent.kind, agent.instance)), agent.kind


def test_sizes_that_are_assumed_are_those_of_the_example():
    sizes = {}
    for message in read_recording(REPOSITORY / "docs" / "example" / "session.mcap"):
        sizes.setdefault(topic_of(message.key), []).append(len(message.payload))
    for topic in sizes.keys() & set(STREAMS):
        assert topic.typical_bytes == pytest.approx(sum(sizes[topic]) / len(sizes[topic]), rel=0.01)
    assert sizes.keys() & set(STREAMS) >= {OBSERVATIONS, THREAD}


def test_a_link_bears_each_stream_once_on_its_way_out_and_once_for_each_who_hears_it():
    crossing = traffic(LAB, BYTES)
    strong = crossing["strong"]
    assert {topic: 1e-6 * rate for topic, rate in strong.out.items() if rate > 1e5} == {
        "perception/observations": 6.0,
        "reconstruction/thread": 1.5,
    }
    # perception, reconstruction and planner hear by connections of their own; perception and planner hear the thread
    assert {topic: 1e-6 * rate for topic, rate in strong.into.items() if rate > 1e5} == {
        "camera/frames": 3.0,
        "perception/observations": 6.0,
        "reconstruction/thread": 3.0,
    }
    # the viewer hears everything, and who runs beside the router no link
    assert crossing["video"].out["camera/frames"] == 6e6
    assert crossing["desk"].out == {}


def test_streams_follow_the_rate_of_the_camera_and_what_is_recorded():
    slow = load_config(REPOSITORY / "deploy" / "lab.toml", RigConfig).model_dump()
    slow["camera"]["rate_hz"] = 10.0
    slow["hosts"]["desk"]["runs"] = ("operator", "recorder")
    slow["topics"] = {"camera/frames": {"recorded": False}}
    slow["viewer"] = None
    into = traffic(RigConfig.model_validate(slow), BYTES)["desk"].into
    assert into["perception/observations"] == 2e6
    assert "camera/frames" not in into


def test_a_link_that_bears_what_is_needed_is_well_and_says_how_much_that_is():
    strong = found("video")["strong"]
    assert strong.state == "ok"
    assert "100 MB/s pass out of it, and 7.9 MB/s are needed (perception/observations 6.3" in strong.found
    assert found("video")["robot"].found == "next to nothing of the rig's streams crosses it"


@pytest.mark.parametrize(
    ("passes", "word"), [((1e6, 1e8), "too slow"), ((1e8, 1e6), "too slow"), ((1e7, 1e8), "tight")]
)
def test_a_link_that_is_too_slow_or_tight_is_wrong_with_what_to_do(passes, word):
    strong = found("video", perception=passes)["strong"]
    assert (strong.state, strong.found.split(":")[0]) == ("WRONG", word)
    assert ("into" in strong.found) == (passes[1] < 1e8)
    assert "camera.rate_hz" in strong.remedy


def health(topic, rate_hz):
    heard = InputHealth(topic, rate_hz, 1.0, 100, 0, 0, 0)
    return AgentHealth("a", "main", "h", "0.2.0", "c", 0, 1000.0, 1, None, None, (heard,), (), "")


def flowing_at(rate_hz):
    heard = {"perception": "camera/frames", "reconstruction": "perception/observations"}
    heard |= {"planner": "reconstruction/thread"}
    return tuple(Fare(name, health(topic, rate_hz), 0.1, True, placed="strong") for name, topic in heard.items())


def test_what_flows_at_the_moment_is_borne_beside_what_was_measured():
    narrow = 6e6, 6e6
    flowing = found("video", Gathered(0, "lab", "", fares=flowing_at(30.0)), perception=narrow)["strong"]
    assert flowing.state == "ok"
    assert "6.0 MB/s pass out of it beside 7.9 MB/s that flow" in flowing.found
    assert found("video", perception=narrow)["strong"].state == "WRONG"
    # a link that hardly lets anything through carries no more because much is wanted of it
    assert found("video", Gathered(0, "lab", "", fares=flowing_at(1.0)), perception=narrow)["strong"].state == "WRONG"


def test_which_link_of_two_is_slow_is_told_only_where_another_way_shows_it():
    # from the desk, what comes of strong passes the router's link and the desk's own
    slow = found("desk", camera=(5e6, 1e8), perception=(5e6, 1e8), robot_bridge=(5e6, 1e8))
    assert slow["strong"].found.startswith("unknown, for another link on the way may be what is slow")
    assert "doctor on video" in slow["strong"].found
    assert (slow["desk"].state, slow["desk"].found.split(":")[0]) == ("WRONG", "too slow")
    # without an answer of the router's host, what is slow to several others is the desk's own
    others = found("desk", camera=(), perception=(5e6, 1e8), robot_bridge=(5e6, 1e8))
    assert (others["desk"].state, others["strong"].state) == ("WRONG", "?")
    assert found("desk", camera=(), robot_bridge=(), perception=(5e6, 1e8))["desk"].state == "?"
    assert found("desk", perception=(5e6, 1e8))["strong"].state == "WRONG"
    assert found("desk", perception=(5e6, 1e8))["desk"].state == "ok"


def test_the_port_of_the_routers_host_bears_what_all_others_need():
    one_at_a_time = found("video", camera=(1e9, 1e9), perception=(1e8, 2e7), robot_bridge=(1e8, 2e7))
    assert one_at_a_time["strong"].state == "ok"
    assert one_at_a_time["video"].state == "?"
    assert "needed" in one_at_a_time["video"].found
    assert found("video")["video"].state == "ok"


def test_what_cannot_be_measured_or_weighed_is_said():
    silent = found("video", perception=())["strong"]
    assert silent.state == "?"
    assert silent.found.startswith("unknown, for nothing that runs there answers; needed are 7.9 MB/s out of it")
    assert found("video", bytes_of={})["strong"].found.endswith(
        "sizes of camera/frames, perception/observations and reconstruction/thread as the simulated field has them, "
        "for none came"
    )
    on_one_machine = parse_config("[planner]", RigConfig, "r.toml")
    assert list(networks(on_one_machine, {}, Gathered(0, "lab", ""), {})) == []


def test_a_tool_tracker_and_a_bridge_that_is_corrected_hear_what_they_need():
    told = LAB.model_dump()
    told["tool_tracker"] = {"psm1": {}}
    told["robot"]["psm1"]["correction"] = "tool_tracker"
    told["hosts"]["strong"]["runs"] = (*LAB.hosts["strong"].runs, "tool_tracker psm1")
    rig = RigConfig.model_validate(told)
    assert traffic(rig, BYTES)["strong"].into["camera/frames"] == 6e6
    assert traffic(rig, BYTES)["robot"].into["tool_tracker/correction"] > 0


def test_messages_are_weighed_as_they_come(settings, session, until):
    publisher = declare_publisher(session, key("test", FRAMES), FRAMES)
    ended = threading.Event()

    def film():
        while not ended.wait(0.02):
            publisher.put(bytes(1234), attachment=pack(Attachment(1, 0, 0, 0.0)))

    filming = threading.Thread(target=film)
    with connected(settings, 60.0) as connection:
        filming.start()
        try:
            assert until(lambda: weigh(connection, 0.2)) == {"camera/frames": 1234.0}
        finally:
            ended.set()
            filming.join()
        publisher.undeclare()
        # what is under way comes yet
        until(lambda: weigh(connection, 0.1) == {})
