"""Whether links between hosts bear what crosses them: the streams of a rig's file, and the judgement."""

import threading

import pytest

from agents.cli.live.doctor import weigh
from agents.configuration.rig import RigConfig
from agents.diagnostics.doctor.crossing import STREAMS, heard_by, traffic
from agents.diagnostics.doctor.network import networks
from agents.diagnostics.status.gathered import Gathered
from agents.diagnostics.status.health_watch import Fare
from schemas.topics import FRAMES, OBSERVATIONS, THREAD, Delivery, key, topic_of
from shared.recording.mcap_file import read_recording
from shared.runtime.attachment import Attachment, pack
from shared.runtime.config import load_config
from shared.runtime.connection import connected
from shared.runtime.delivery import declare_publisher
from shared.runtime.facts import Link
from tests.agents.cli.conftest import REPOSITORY
from tests.agents.cli.heard import health, heard
from tests.whole_rig import agents_of, whole_rig

LAB = load_config(REPOSITORY / "deploy" / "lab.toml", RigConfig)
BYTES = {"camera/frames": 1e5, "perception/observations": 2e5, "reconstruction/thread": 5e4}
"""At 30 Hz: 3, 6 and 1.5 MB/s."""


def found(here, gathered=None, bytes_of=BYTES, **passes):
    """What is found of each host, given what passes to and from agents; `camera=(from it, to it)`."""
    agents = ("camera/main", "perception/main", "robot_bridge/psm1")
    told = {name: passes.get(name.split("/")[0], (1e8, 1e8)) for name in agents}
    measured = {name: Link(1.0, 2.0, *ways) if ways else None for name, ways in told.items()}
    findings = networks(LAB.model_copy(update={"host": here}), measured, gathered or flowing(), bytes_of)
    return {finding.what.removeprefix("network of "): finding for finding in findings}


def flowing(rate_hz=None):
    """What flows at the moment: nothing, or what those on one host hear, at some rate."""
    hears = {"perception": FRAMES, "reconstruction": OBSERVATIONS, "planner": THREAD}
    fares = [
        Fare(name, health(name, inputs=[heard(str(topic), rate_hz)], uptime_s=1000.0), 0.1, True, placed="strong")
        for name, topic in hears.items()
        if rate_hz is not None
    ]
    return Gathered(0, "lab", "", fares=tuple(fares))


def test_what_each_agent_hears_and_how_large_it_is_is_known():
    rig, sizes = whole_rig(), {}
    for agent in agents_of(rig):
        steady = {i.topic for i in agent.inputs if i.topic in STREAMS and i.topic.delivery is Delivery.LATEST}
        assert steady == set(heard_by(rig, agent.kind, agent.instance)), agent.kind
    for message in read_recording(REPOSITORY / "docs" / "example" / "session.mcap"):
        sizes.setdefault(topic_of(message.key), []).append(len(message.payload))
    for topic in sizes.keys() & set(STREAMS):
        assert topic.typical_bytes == pytest.approx(sum(sizes[topic]) / len(sizes[topic]), rel=0.01)
    assert sizes.keys() & set(STREAMS) >= {OBSERVATIONS, THREAD}


def test_a_link_bears_each_stream_once_on_its_way_out_and_once_for_each_who_hears_it():
    crossing = traffic(LAB, BYTES)

    def mb(rates):
        return {topic: 1e-6 * rate for topic, rate in rates.items() if rate > 1e5}

    assert mb(crossing["strong"].out) == {"perception/observations": 6.0, "reconstruction/thread": 1.5}
    # perception, reconstruction and planner hear by connections of their own; perception and planner hear the thread
    into = {"camera/frames": 3.0, "perception/observations": 6.0, "reconstruction/thread": 3.0}
    assert mb(crossing["strong"].into) == into
    # the viewer hears everything, and who runs beside the router no link
    assert crossing["video"].out["camera/frames"] == 6e6
    assert crossing["desk"].out == {}
    told = LAB.model_dump()
    told["camera"]["rate_hz"] = 10.0
    told["hosts"]["desk"]["runs"] = ("operator", "recorder")
    told["topics"] = {"camera/frames": {"recorded": False}}
    told["viewer"] = None
    told["tool_tracker"] = {"psm1": {}}
    told["robot"]["psm1"]["correction"] = "tool_tracker"
    told["hosts"]["strong"]["runs"] = (*LAB.hosts["strong"].runs, "tool_tracker psm1")
    crossing = traffic(RigConfig.model_validate(told), BYTES)
    assert crossing["desk"].into["perception/observations"] == 2e6
    assert "camera/frames" not in crossing["desk"].into
    assert crossing["strong"].into["camera/frames"] == 2e6
    assert crossing["robot"].into["tool_tracker/correction"] > 0


def test_a_link_is_well_tight_or_too_slow_by_what_it_has_to_bear():
    strong = found("video")["strong"]
    assert strong.state == "ok"
    assert "100 MB/s pass out of it, and 7.9 MB/s are needed (perception/observations 6.3" in strong.found
    assert found("video")["robot"].found == "next to nothing of the rig's streams crosses it"
    for passes, word in (((1e6, 1e8), "too slow"), ((1e8, 1e6), "too slow"), ((1e7, 1e8), "tight")):
        strong = found("video", perception=passes)["strong"]
        assert (strong.state, strong.found.split(":")[0]) == ("WRONG", word)
        assert ("into" in strong.found) == (passes[1] < 1e8)
        assert "camera.rate_hz" in strong.remedy
    silent = found("video", perception=())["strong"]
    assert silent.state == "?"
    assert silent.found.startswith("unknown, for nothing that runs there answers; needed are 7.9 MB/s out of it")
    assert "sizes of camera/frames, perception/observations and" in found("video", bytes_of={})["strong"].found
    assert list(networks(RigConfig(), {}, flowing(), {})) == []


def test_what_flows_at_the_moment_is_borne_beside_what_was_measured():
    narrow = 6e6, 6e6
    strong = found("video", flowing(30.0), perception=narrow)["strong"]
    assert strong.state == "ok"
    assert "6.0 MB/s pass out of it beside 7.9 MB/s that flow" in strong.found
    assert found("video", perception=narrow)["strong"].state == "WRONG"
    # a link that hardly lets anything through carries no more because much is wanted of it
    assert found("video", flowing(1.0), perception=narrow)["strong"].state == "WRONG"


def test_which_link_of_two_is_slow_is_told_only_where_another_way_shows_it():
    # from the desk, what comes of strong passes the router's link and the desk's own
    narrow = 5e6, 1e8
    slow = found("desk", camera=narrow, perception=narrow, robot_bridge=narrow)
    assert slow["strong"].found.startswith("unknown, for another link on the way may be what is slow")
    assert "doctor on video" in slow["strong"].found
    assert (slow["desk"].state, slow["desk"].found.split(":")[0]) == ("WRONG", "too slow")
    # without an answer of the router's host, what is slow to several others is the desk's own
    others = found("desk", camera=(), perception=narrow, robot_bridge=narrow)
    assert (others["desk"].state, others["strong"].state) == ("WRONG", "?")
    assert found("desk", camera=(), robot_bridge=(), perception=narrow)["desk"].state == "?"
    alone = found("desk", perception=narrow)
    assert (alone["strong"].state, alone["desk"].state) == ("WRONG", "ok")
    # the port of the router's host bears what all others need
    told = found("video", camera=(1e9, 1e9), perception=(1e8, 2e7), robot_bridge=(1e8, 2e7))
    assert (told["strong"].state, told["video"].state, "needed" in told["video"].found) == ("ok", "?", True)
    assert found("video")["video"].state == "ok"


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
