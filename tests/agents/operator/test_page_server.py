"""The page's server before a real planner, a real bridge and real clients of a WebSocket; and hostile ones."""

import asyncio
import contextlib
import datetime
import itertools
import json
import random
import ssl
import struct

import aiohttp
import pytest
import yarl

from agents.cli.page.command import run
from agents.cli.page.options import Page
from agents.deployment.certificates import issue
from agents.deployment.layout import Host, Layout, Process
from agents.operator.access import Access
from agents.operator.desk import Desk
from agents.operator.page_server import server_tls, serving
from agents.operator.spare import Processors
from agents.operator.surroundings import Surroundings
from agents.operator.wire import KINDS
from agents.planner.agent import Planner
from agents.planner.config import PlannerConfig
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.codec import decode
from schemas.messages import Arm, CommandRecord, ExecutionEvent, ExecutionKind, Heartbeat
from schemas.topics import COMMANDS, EXECUTION, HEARTBEAT, ROBOT_STATE
from shared.runtime.commands import new_header
from shared.runtime.connection import connected
from shared.runtime.identity import AUTHORITY_FILE

PATIENT_S = 60.0
BEAT_S = 2.0
"""A test machine may stall."""
HOSTILE = 60


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    for name in ("BEAT_S", "CHALLENGE_EVERY_S"):
        monkeypatch.setattr(f"agents.operator.control.{name}", {"BEAT_S": BEAT_S}.get(name, 0.05))
    monkeypatch.setattr("agents.operator.choosing.AGAIN_FOR_S", PATIENT_S)
    monkeypatch.setattr("agents.operator.carrying_out.PLAN_ARRIVES_S", PATIENT_S)
    monkeypatch.setattr("agents.operator.carrying_out.new_header", lambda sender: new_header(sender, PATIENT_S))
    monkeypatch.setattr("shared.runtime.commands.FARTHEST_DEADLINE_S", 2 * PATIENT_S)


@pytest.fixture
def rig(settings, limits, in_threads, hand_made_thread, hand_made_camera):
    """Agents in threads, whose bridge waits longer for heartbeats than anybody who tests: what holds is the server."""
    names = "dead_man_s", "first_heartbeat_s", "maximum_plan_age_s", "maximum_frame_age_s"
    slow = RobotBridgeConfig(**dict.fromkeys(names, PATIENT_S), limits=limits)
    planner = Planner(PlannerConfig(arm_age_ms=1e3 * PATIENT_S))
    with in_threads(settings, hand_made_thread(), hand_made_camera(), planner, RobotBridge(slow, SimulatedPsm())):
        yield settings


@pytest.fixture
def echoes():
    """Whether frames echo challenges."""
    return True


@pytest.fixture
def real_rig(settings, in_threads, hand_made_thread, hand_made_camera, real_arm, bridge_of_real_arm, echoes):
    """The same with an arm that says that it is real."""
    names = "dead_man_s", "first_heartbeat_s", "maximum_plan_age_s", "maximum_frame_age_s"
    bridge = bridge_of_real_arm(real_arm, **dict.fromkeys(names, PATIENT_S))
    planner = Planner(PlannerConfig(arm_age_ms=1e3 * PATIENT_S))
    with in_threads(settings, hand_made_thread(echoes=echoes), hand_made_camera(echoes=echoes), planner, bridge):
        yield settings


class Served:
    """A server with what it wrote down, and what reached the agents."""

    def __init__(self, server, address, access, audit, connection):
        self.server, self.address, self.access, self.audit = server, address, access, audit
        self.commands, self.armings, self.events, self.beats, self.asked = [], [], [], [], {}
        connection.listen((COMMANDS, EXECUTION, HEARTBEAT, ROBOT_STATE), self._take)

    def _take(self, tapped):
        message = decode(tapped.topic.message, tapped.payload)
        match message:
            case CommandRecord():
                self.commands.append(message.topic)
                self.armings += [decode(Arm, message.payload)] if message.topic.endswith("/arm") else []
            case ExecutionEvent():
                self.events.append(message)
            case Heartbeat():
                self.beats.append(message)
            case _:
                self.asked[message.challenge_ns] = message.guard_challenge

    @contextlib.asynccontextmanager
    async def page(self, **headers):
        """A page that has entered."""
        origin = {"Origin": self.address.rstrip("/")} | headers
        async with aiohttp.ClientSession(headers=origin) as session:
            answer = await session.post(f"{self.address}session", json={"token": self.access.link})
            secret = (await answer.json())["secret"]
            async with session.ws_connect(f"{self.address}ws") as socket:
                page = Client(socket)
                await page.say("hello", secret=secret)
                page.secret = (await page.heard(lambda m: m["kind"] == "welcome"))["secret"]
                yield page


class Client:
    """What the page's own code does, as far as it matters here."""

    def __init__(self, socket):
        self.socket, self.answers, self.pictures, self.secret = socket, True, 0, ""
        self.echoes = {}

    async def say(self, kind, **rest):
        await self.socket.send_json({"kind": kind} | rest)

    async def heard(self, wanted):
        """The next message that is wanted; challenges are answered and pictures shown meanwhile."""
        async with asyncio.timeout(PATIENT_S):
            while True:
                message = await self.socket.receive()
                if message.type is aiohttp.WSMsgType.BINARY:
                    (length,) = struct.unpack("<I", message.data[:4])
                    header = json.loads(message.data[4 : 4 + length])
                    assert message.data[4 + length :][:2] == b"\xff\xd8"
                    self.pictures, self.echoes = self.pictures + 1, header["echoes"]
                    await self.say("shown", frame=header["frame"], at_ms=0)
                    continue
                assert message.type is aiohttp.WSMsgType.TEXT, message
                said = json.loads(message.data)
                if said["kind"] == "challenge" and self.answers:
                    await self.say("beat", challenge=said["challenge"])
                if wanted(said):
                    return said

    async def state(self, wanted):
        """The next state that is wanted."""
        return await self.heard(lambda said: said["kind"] == "state" and wanted(said))

    async def planned(self):
        """Ask for a grasp until there is a plan."""
        await self.state(lambda s: s["arms"])
        while True:
            await self.say("place", s=0.2, arm="psm1", policy="direct")
            said = await self.heard(lambda m: m["kind"] in ("plan", "refused"))
            if said["kind"] == "plan" and said["plan"]["ok"]:
                return said["plan"]

    async def armed(self):
        """Press until the arm is armed."""
        plan = await self.planned()
        await self.say("press", arm="psm1", plan_id=plan["id"])
        await self.state(lambda s: s["press"] and s["press"]["stage"] == "armed")
        return plan


def served(rig, scenario, tls=None, **around):
    """Run a scenario against a server of its own."""

    async def run():
        audit, here = [], "127.0.0.1"
        with connected(rig, PATIENT_S) as connection:
            told = Surroundings("test", ("psm1",), lambda what, **told: audit.append((what, told)), **around)
            access = Access()
            async with serving(Desk(connection, told), access, here, 0, (here,), tls) as (server, address):
                await scenario(Served(server, address, access, audit, connection))

    asyncio.run(run())


async def held(served, code):
    """Wait until the arm holds, and why."""
    async with asyncio.timeout(PATIENT_S):
        while not [event for event in served.events if event.kind is ExecutionKind.HELD]:
            await asyncio.sleep(0.02)
    assert {event.code for event in served.events if event.kind is ExecutionKind.HELD} == {code}


@pytest.mark.slow
@pytest.mark.parametrize("limits", ["quick"], indirect=True)
def test_a_press_is_carried_out_while_it_is_answered_and_everything_is_written_down(rig):
    async def scenario(served):
        async with served.page() as page:
            plan = await page.armed()
            await page.state(lambda s: "has finished" in " ".join(s["lines"]))
            assert page.pictures > 0
        told = [what for what, _ in served.audit]
        assert [what for what in told if what in ("goal", "pressed", "arm", "answer")][-3:] == [
            "pressed",
            "arm",
            "answer",
        ]
        assert ("pressed", {"screen": "screen 1", "arm": "psm1", "plan_id": plan["id"]}) in served.audit

    served(rig, scenario)


def test_a_press_answers_the_bridges_own_challenges_and_its_page_is_told_by_what_to_judge_its_picture(real_rig):
    async def scenario(served):
        async with served.page() as page:
            state = await page.state(lambda s: s["arms"] and s["arms"][0]["at_ns"] != "0")
            assert (state["arms"][0]["real"], state["arms"][0]["limit_ms"]) == (True, 1e3 * PATIENT_S)
            plan = await page.planned()
            await page.say("press", arm="psm1", plan_id=plan["id"])
            asked = await page.heard(lambda said: said["kind"] == "challenge")
            assert (asked["arm"], asked["real"], asked["limit_ms"]) == ("psm1", True, 1e3 * PATIENT_S)
            assert abs(int(asked["at_ns"]) - int(state["arms"][0]["at_ns"])) < PATIENT_S * 1e9
            async with asyncio.timeout(PATIENT_S):
                while len(served.beats) < 5 or not page.echoes:
                    await page.heard(lambda _: True)
            # more digits than a browser's numbers hold
            assert int(page.echoes["psm1"]) in served.asked
            await page.say("release", why="the button was released")
            await held(served, "hold_command")
        (arming,) = served.armings
        assert arming.pressed
        assert arming.challenge_ns in served.asked
        assert all(served.asked[beat.challenge_ns] == beat.guard_challenge > 1 << 63 for beat in served.beats)
        assert all(beat.pressed and beat.arming_id == arming.header.id for beat in served.beats)
        assert len({beat.challenge_ns for beat in served.beats}) == len(served.beats)

    served(real_rig, scenario)


@pytest.mark.parametrize("echoes", [False])
def test_what_the_bridge_says_against_arming_is_passed_on(real_rig):
    why = (
        "echoes no challenge of psm1, so that nobody knows how old it is: see that the camera's agent hears the bridge"
    )

    async def scenario(served):
        async with served.page() as page:
            plan = await page.planned()
            await page.say("press", arm="psm1", plan_id=plan["id"])
            refused = await page.heard(lambda said: said["kind"] == "refused")
            assert refused["text"].startswith("psm1 was not armed: ")
            assert why in refused["text"]
            await page.state(lambda s: s["words"]["psm1"].startswith("psm1 was not armed: ") and s["press"] is None)

    served(real_rig, scenario)


def test_a_flood_of_holds_holds_at_once_and_leaves_room_for_others(rig):
    async def scenario(served):
        async with served.page() as pressing, served.page() as flooding:
            await pressing.armed()
            for _ in range(500):
                await flooding.say("hold")
            await held(served, "hold_command")
            await pressing.state(lambda s: s["press"] is None)
            # whoever else says so does not wait until that is over
            await pressing.say("hold")
            await pressing.state(lambda s: any("screen 1 said hold" in line for line in s["lines"]))
        said = [told for what, told in served.audit if what == "hold"]
        assert 2 <= len(said) < 50

    served(rig, scenario)


async def released(_served, page):
    await page.say("release", why="the button was released")


async def closed(_served, page):
    await page.socket.close()


async def silent(_served, page):
    page.answers = False
    await page.state(lambda s: s["press"] is None)


async def held_by_another(served, _page):
    async with served.page() as watching:
        await watching.say("hold")
        await watching.state(lambda s: s["press"] is None)


@pytest.mark.parametrize("ends", [(released, closed), pytest.param((silent, held_by_another), marks=pytest.mark.slow)])
def test_however_a_press_ends_the_server_holds_the_arm(rig, ends):
    async def scenario(served):
        for end in ends:
            served.events.clear()
            async with served.page() as page:
                await page.armed()
                await end(served, page)
                await held(served, "hold_command")

    served(rig, scenario)


def test_pages_that_do_not_control_move_nothing_and_control_is_handed_over(rig):
    async def scenario(served):
        async with served.page() as first, served.page() as second:
            plan = await first.planned()
            for said in ({"kind": "press", "arm": "psm1", "plan_id": plan["id"]}, {"kind": "prompt", "pixel": None}):
                await second.socket.send_json(said)
                assert "screen 1 controls" in (await second.heard(lambda m: m["kind"] == "refused"))["text"]
            # nor does whoever controls, once another goal was named
            await first.say("place", s=0.8, arm="psm1", policy="direct")
            await first.say("press", arm="psm1", plan_id=plan["id"])
            assert "not the newest plan" in (await first.heard(lambda m: m["kind"] == "refused"))["text"]
            await second.say("take")
            await first.state(lambda s: s["asking"] == "screen 2")
            await first.say("give", yes=True)
            await second.state(lambda s: s["controller"] == "screen 2")

    served(rig, scenario)


@pytest.mark.slow
def test_on_a_full_host_who_watches_is_told_and_shown_less_and_who_controls_goes_on(rig):
    spent = itertools.count(1)

    async def scenario(served):
        async with served.page() as controlling, served.page() as watching:
            for page in (controlling, watching):
                await page.state(lambda s: s["full"] and s["arms"])
                page.pictures = 0
            # both take all that they are sent while the one sees so many
            taking = asyncio.ensure_future(watching.heard(lambda _: False))
            async with asyncio.timeout(PATIENT_S):
                while controlling.pictures < 16:
                    await controlling.heard(lambda _: True)
            taking.cancel()
            assert 0 < watching.pictures <= 0.75 * controlling.pictures

    # no processor of this host was idle, whenever it is asked
    served(rig, scenario, processors=lambda: Processors(0, next(spent)))


def test_a_page_that_comes_back_takes_the_place_of_its_dead_connection_which_is_let_go_of(rig):
    async def scenario(served):
        async with served.page() as page, aiohttp.ClientSession(headers={"Origin": served.address[:-1]}) as session:
            await page.armed()
            async with session.ws_connect(f"{served.address}ws") as socket:
                again = Client(socket)
                await again.say("hello", secret=page.secret)
                assert (await again.heard(lambda m: m["kind"] == "welcome"))["you"] == "screen 1"
                await held(served, "hold_command")
                await page.say("place", s=0.8, arm="psm1", policy="direct")  # nobody listens to it any more
                state = await again.state(lambda s: s["controller"] == "screen 1")
                assert state["screens"] == ["screen 1"]
                assert (await again.planned())["s_goal"] == pytest.approx(0.2)

    served(rig, scenario)


def test_what_is_hostile_gets_no_command_through(rig):
    async def scenario(served):
        address, rng = served.address, random.Random(7)
        used = served.access.link
        async with served.page() as page:
            await page.state(lambda s: s["arms"])
            before = list(served.commands)
            old_secret = page.secret
            async with aiohttp.ClientSession() as session:
                ours = {"Origin": address.rstrip("/")}
                for headers in (
                    {},
                    {"Origin": "http://evil.example"},
                    {"Origin": "null"},
                    ours | {"Host": "evil.example"},
                ):
                    answer = await session.post(
                        f"{address}session", json={"token": served.access.link}, headers=headers
                    )
                    assert answer.status in (403, 421)
                    with pytest.raises(aiohttp.WSServerHandshakeError):
                        await session.ws_connect(f"{address}ws", headers=headers)
                replay = await session.post(f"{address}session", json={"token": used}, headers=ours)
                assert replay.status == 403
                for path in ("%2e%2e%2fdesk.py", "..%2fdesk.py", "__init__.py", "%00", "page.css%2f"):
                    assert (await session.get(yarl.URL(f"{address}page/{path}", encoded=True))).status == 404
                for _ in range(HOSTILE):
                    body = rng.randbytes(rng.randrange(200))
                    answer = await session.post(f"{address}session", data=body, headers=ours)
                    assert answer.status in (400, 403)
                for first in (old_secret[::-1], "", "\ud800", None):
                    async with session.ws_connect(f"{address}ws", headers=ours) as socket:
                        await socket.send_str(json.dumps({"kind": "hello", "secret": first}))
                        assert (await socket.receive()).type is aiohttp.WSMsgType.CLOSE
                for _ in range(HOSTILE // 3):
                    async with session.ws_connect(f"{address}ws", headers=ours) as socket:
                        kind = rng.choice(list(KINDS))
                        with contextlib.suppress(ConnectionError):
                            await socket.send_str(json.dumps({"kind": kind, "arm": "psm1", "plan_id": "x", "s": 0.5}))
                            await socket.send_bytes(rng.randbytes(50))
            for _ in range(3):
                await page.socket.send_bytes(b"\0" * 100)
            with pytest.raises(AssertionError):
                await page.state(lambda _: False)  # it was thrown out
        assert served.commands == before
        assert not [what for what, _ in served.audit if what in ("goal", "arm", "prompt", "pressed", "hold")]

    served(rig, scenario)


def test_off_loopback_it_is_served_with_the_operators_certificate_which_browsers_accept(settings, tmp_path):
    host = Host("desk", "127.0.0.1", (Process("operator", "desk"),))
    issue(Layout("test", "", (host,), leaf_days=30, authority_days=365), tmp_path, datetime.datetime.now(datetime.UTC))  # noqa: TID251
    home = tmp_path / "desk" / "certificates"
    tls = server_tls(str(home / "operator.desk.pem"), str(home / "operator.desk.key"))

    async def scenario(served):
        assert served.address.startswith("https://127.0.0.1:")
        trusting = ssl.create_default_context(cafile=home / AUTHORITY_FILE)
        async with aiohttp.ClientSession() as session:
            answer = await session.get(served.address, ssl=trusting)
            assert "SutureGrasp" in await answer.text()
            with pytest.raises(aiohttp.ClientConnectorError):
                await session.get(served.address, ssl=ssl.create_default_context())

    served(settings, scenario, tls)


def test_off_loopback_without_certificates_it_is_not_served(capsys):
    assert run(Page(listen="192.0.2.1", open=False)) == 2
    assert "leaves this machine, which needs TLS" in capsys.readouterr().err
