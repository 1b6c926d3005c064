"""The page's server before a real planner, a real bridge and real clients of a WebSocket; and hostile ones."""

import asyncio
import contextlib
import itertools
import json
import random
import ssl
import struct
import typing

import aiohttp
import pytest
import yarl

from agents.cli.page.command import run
from agents.cli.page.options import Page
from agents.configuration.rig import simulated_rig
from agents.operator.load import Processors
from agents.operator.operator import ask_for_grasp
from agents.operator.wire import Said
from schemas.codec import decode
from schemas.messages import Arm, CommandRecord, ExecutionEvent, ExecutionKind, Heartbeat, Policy
from schemas.topics import COMMANDS, EXECUTION, HEARTBEAT, ROBOT_STATE
from shared.clock import now_ns
from shared.runtime.config import ConfigError
from shared.runtime.connection import connected
from shared.runtime.identity import AUTHORITY_FILE
from tests.agents.operator.by_hand import (
    PATIENT_S,
    QUICK,
    HandMadeCamera,
    HandMadeThread,
    RealPsm,
    desk_of,
    patient_bridge,
    patient_planner,
)

HOSTILE = 60
SLOW_ECHOES = {"CHALLENGE_EVERY_S": 0.05, "BEAT_S": 2.0}
"""A test machine may stall."""


class Client:
    """What the page's own code does, as far as it matters here."""

    def __init__(self, socket):
        self.socket, self.answers, self.secret, self.echoes = socket, True, "", {}

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
                    self.echoes = header["echoes"]
                    await self.say("shown", frame=header["frame"])
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

    async def refused(self):
        """What the next refusal says."""
        return (await self.heard(lambda said: said["kind"] == "refused"))["text"]

    async def planned(self):
        """Ask for a grasp until there is a plan."""
        await self.state(lambda s: s["arms"])
        while True:
            await self.say("place", s=0.2, arm="psm1", policy="direct")
            said = await self.heard(lambda m: m["kind"] in ("plan", "refused"))
            if said["kind"] == "plan" and said["plan"]["ok"]:
                return said["plan"]

    async def presses(self):
        """Press for a plan."""
        plan = await self.planned()
        await self.say("press", arm="psm1", plan_id=plan["id"])
        return plan

    async def armed(self):
        """Press until the arm is armed."""
        plan = await self.presses()
        await self.state(lambda s: s["press"] and s["press"]["stage"] == "armed")
        return plan


class Served:
    """A server with what it wrote down, and what reached the agents."""

    def __init__(self, desk, audit, connection):
        (_, self.address, self.access), self.audit, self.connection = desk, audit, connection
        self.ours = {"Origin": self.address.rstrip("/")}
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
    async def page(self):
        """A page that has entered."""
        async with aiohttp.ClientSession(headers=self.ours) as session:
            answer = await session.post(f"{self.address}session", json={"token": self.access.link})
            async with self.entered(session, (await answer.json())["secret"]) as (page, _):
                yield page

    @contextlib.asynccontextmanager
    async def entered(self, session, secret):
        """A page that enters by a secret, and who it is."""
        async with session.ws_connect(f"{self.address}ws") as socket:
            page = Client(socket)
            await page.say("hello", secret=secret)
            welcome = await page.heard(lambda m: m["kind"] == "welcome")
            page.secret = welcome["secret"]
            yield page, welcome["you"]

    async def held(self):
        """Wait until the arm holds because it was told to."""
        async with asyncio.timeout(PATIENT_S):
            while not (held := [event.code for event in self.events if event.kind is ExecutionKind.HELD]):
                await asyncio.sleep(0.02)
        assert set(held) == {"hold_command"}


@pytest.fixture
def serve(patient, monkeypatch):
    """Run a scenario against a server of its own."""
    for name, seconds in SLOW_ECHOES.items():
        monkeypatch.setattr(f"agents.operator.control.{name}", seconds)

    def serve(scenario, **around):
        async def run():
            audit = []
            with connected(patient, PATIENT_S) as connection:
                written = around | {"audit": lambda what, **told: audit.append((what, told))}
                async with desk_of(connection, **written) as desk:
                    await scenario(Served(desk, audit, connection))

        asyncio.run(run())

    return serve


@pytest.fixture
def rig(request, patient, in_threads):
    """Agents in threads, an arm that says that it is real, and a bridge that waits for long: what holds is the server.

    A parameter tells of anything else: whether frames echo challenges, and the bridge's settings.
    """
    settings = {"echoes": True} | getattr(request, "param", {})
    echoes = settings.pop("echoes")
    agents = patient_planner(), patient_bridge(RealPsm(), **settings)
    with in_threads(patient, HandMadeThread(echoes=echoes), HandMadeCamera(echoes=echoes), *agents):
        yield


pytestmark = pytest.mark.usefixtures("rig")


@pytest.mark.parametrize("rig", [{"limits": QUICK}], indirect=True)
def test_a_press_is_carried_out_while_it_answers_the_bridges_own_challenges_and_everything_is_written_down(serve):
    async def scenario(served):
        async with served.page() as page:
            state = await page.state(lambda s: s["arms"] and s["arms"][0]["at_ns"] != "0")
            # by what the page is to judge its picture
            assert (state["arms"][0]["real"], state["arms"][0]["limit_ms"]) == (True, 1e3 * PATIENT_S)
            plan = await page.presses()
            asked = await page.heard(lambda said: said["kind"] == "challenge")
            assert (asked["arm"], asked["real"], asked["limit_ms"]) == ("psm1", True, 1e3 * PATIENT_S)
            assert abs(int(asked["at_ns"]) - int(state["arms"][0]["at_ns"])) < PATIENT_S * 1e9
            await page.state(lambda s: "has finished" in " ".join(s["lines"]))
            # more digits than a browser's numbers hold
            assert int(page.echoes["psm1"]) in served.asked
        (arming,) = served.armings
        assert arming.pressed
        assert arming.challenge_ns in served.asked
        assert len(served.beats) > 5
        assert all(served.asked[beat.challenge_ns] == beat.guard_challenge > 1 << 63 for beat in served.beats)
        assert all(beat.pressed and beat.arming_id == arming.header.id for beat in served.beats)
        assert len({beat.challenge_ns for beat in served.beats}) == len(served.beats)
        told = [what for what, _ in served.audit if what in ("goal", "pressed", "arm", "answer")]
        assert told[-3:] == ["pressed", "arm", "answer"]
        assert ("pressed", {"screen": "screen 1", "arm": "psm1", "plan_id": plan["id"]}) in served.audit

    serve(scenario)


@pytest.mark.parametrize("rig", [{"echoes": False}], indirect=True)
def test_what_the_bridge_says_against_arming_is_passed_on(serve):
    async def scenario(served):
        async with served.page() as page:
            await page.presses()
            why = await page.refused()
            assert why.startswith("psm1 was not armed: ")
            assert "echoes no challenge of psm1, so that nobody knows how old it is" in why
            await page.state(lambda s: s["words"]["psm1"].startswith("psm1 was not armed: ") and s["press"] is None)

    serve(scenario)


async def released(_served, page):
    await page.say("release", why="the button was released")


async def closed(_served, page):
    await page.socket.close()


async def silent(_served, page):
    page.answers = False
    await page.state(lambda s: s["press"] is None)


async def held_by_another(served, page):
    """By a flood of holds, which leaves room for others."""
    async with served.page() as flooding:
        for _ in range(500):
            await flooding.say("hold")
        await served.held()
        await page.state(lambda s: s["press"] is None)
        await page.say("hold")
        await page.state(lambda s: any("screen 1 said hold" in line for line in s["lines"]))
    assert 2 <= len([what for what, _ in served.audit if what == "hold"]) < 50


@pytest.mark.parametrize("end", [released, closed, silent, held_by_another])
def test_however_a_press_ends_the_server_holds_the_arm(serve, end):
    async def scenario(served):
        async with served.page() as page:
            await page.armed()
            await end(served, page)
            await served.held()

    serve(scenario)


async def planned_elsewhere(served):
    await asyncio.to_thread(ask_for_grasp, served.connection, "psm1", Policy.DIRECT, s=0.8)
    return "psm1 has another plan by now"


async def held_elsewhere(served):
    held = ExecutionEvent("", "psm1", now_ns(), ExecutionKind.HELD, None, "hold_command", "operator said hold")
    with served.connection.publishing(EXECUTION, "psm1") as publish:
        publish(held, held.at_ns)
        await asyncio.sleep(0.5)
    return "psm1 holds (operator said hold)"


@pytest.mark.parametrize("meanwhile", [planned_elsewhere, held_elsewhere])
def test_a_press_ends_unarmed_where_another_plan_or_a_hold_comes_meanwhile(serve, monkeypatch, meanwhile):
    monkeypatch.setattr("agents.operator.control.PRESS_S", 2 * PATIENT_S)

    async def scenario(served):
        async with served.page() as page:
            await page.presses()
            await page.state(lambda s: s["press"])
            elsewhere = asyncio.create_task(meanwhile(served))
            why = await page.refused()
            assert why.startswith(await elsewhere)
            await page.state(lambda s: s["press"] is None)
            assert not served.armings

    serve(scenario)


def test_pages_that_do_not_control_move_nothing_and_control_is_handed_over(serve):
    spent = itertools.count(1)

    async def scenario(served):
        async with served.page() as first, served.page() as second:
            plan = await first.planned()
            for said in ({"kind": "press", "arm": "psm1", "plan_id": plan["id"]}, {"kind": "prompt", "pixel": None}):
                await second.socket.send_json(said)
                assert "screen 1 controls" in await second.refused()
            # nor does whoever controls, once another goal was named
            await first.say("place", s=0.8, arm="psm1", policy="direct")
            await first.say("press", arm="psm1", plan_id=plan["id"])
            assert "not the newest plan" in await first.refused()
            await second.say("take")
            await first.state(lambda s: s["asking"] == "screen 2")
            await first.say("give", yes=True)
            await second.state(lambda s: s["controller"] == "screen 2" and s["full"])

    # no processor of this host was idle, whenever it is asked
    serve(scenario, processors=lambda: Processors(0, next(spent)))


def test_a_page_that_comes_back_takes_the_place_of_its_dead_connection_which_is_let_go_of(serve):
    async def scenario(served):
        async with served.page() as page, aiohttp.ClientSession(headers=served.ours) as session:
            await page.armed()
            async with served.entered(session, page.secret) as (again, you):
                assert you == "screen 1"
                await served.held()
                await page.say("place", s=0.8, arm="psm1", policy="direct")  # nobody listens to it any more
                state = await again.state(lambda s: s["controller"] == "screen 1")
                assert state["screens"] == ["screen 1"]
                assert (await again.planned())["s_goal"] == pytest.approx(0.2)

    serve(scenario)


def test_what_is_hostile_gets_no_command_through(serve):
    async def scenario(served):
        address, ours, rng = served.address, served.ours, random.Random(7)
        used = served.access.link
        async with served.page() as page, aiohttp.ClientSession() as session:
            await page.state(lambda s: s["arms"])
            before = list(served.commands)
            evil = {}, {"Origin": "http://evil.example"}, {"Origin": "null"}, ours | {"Host": "evil.example"}
            for headers in evil:
                token = {"token": served.access.link}
                assert (await session.post(f"{address}session", json=token, headers=headers)).status in (403, 421)
                with pytest.raises(aiohttp.WSServerHandshakeError):
                    await session.ws_connect(f"{address}ws", headers=headers)
            assert (await session.post(f"{address}session", json={"token": used}, headers=ours)).status == 403
            for path in ("%2e%2e%2fdesk.py", "..%2fdesk.py", "__init__.py", "%00", "page.css%2f"):
                assert (await session.get(yarl.URL(f"{address}page/{path}", encoded=True))).status == 404
            for _ in range(HOSTILE):
                body = rng.randbytes(rng.randrange(200))
                assert (await session.post(f"{address}session", data=body, headers=ours)).status in (400, 403)
            for first in (page.secret[::-1], "", "\ud800", None):
                async with session.ws_connect(f"{address}ws", headers=ours) as socket:
                    await socket.send_str(json.dumps({"kind": "hello", "secret": first}))
                    assert (await socket.receive()).type is aiohttp.WSMsgType.CLOSE
            for _ in range(HOSTILE // 3):
                async with session.ws_connect(f"{address}ws", headers=ours) as socket:
                    kind = rng.choice([said.kind for said in typing.get_args(Said)])
                    with contextlib.suppress(ConnectionError):
                        await socket.send_str(json.dumps({"kind": kind, "arm": "psm1", "plan_id": "x", "s": 0.5}))
                        await socket.send_bytes(rng.randbytes(50))
            for _ in range(3):
                await page.socket.send_bytes(b"\0" * 100)
            with pytest.raises(AssertionError):
                await page.state(lambda _: False)  # it was thrown out
        assert served.commands == before
        assert not [what for what, _ in served.audit if what in ("goal", "arm", "prompt", "pressed", "hold")]

    serve(scenario)


def test_off_loopback_it_is_served_with_the_operators_certificate_which_browsers_accept(serve, tls):
    context, home = tls

    async def scenario(served):
        assert served.address.startswith("https://127.0.0.1:")
        trusting = ssl.create_default_context(cafile=home / AUTHORITY_FILE)
        async with aiohttp.ClientSession() as session:
            answer = await session.get(served.address, ssl=trusting)
            assert "SutureGrasp" in await answer.text()
            with pytest.raises(aiohttp.ClientConnectorError):
                await session.get(served.address, ssl=ssl.create_default_context())

    serve(scenario, tls=context)
    with pytest.raises(ConfigError, match="leaves this machine, which needs TLS"):
        run(simulated_rig(), Page(listen="192.0.2.1", open=False))
