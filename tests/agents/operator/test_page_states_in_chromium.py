"""What the page shows of states that a running demo does not come to: an arm with a fault, a recording that lacks
something, a tool that is followed in the images, an old thread; and that it is all there over TLS.

What tells of them is emulated; the page's server, the planner, one arm's bridge and the browser are real.
"""

import base64
import datetime
import hashlib

import numpy as np
import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from agents.deployment.certificates import issue
from agents.deployment.layout import Host, Layout, Process
from agents.operator.page_server import server_tls
from agents.robot_bridge.agent import RobotBridge, RobotBridgeConfig
from agents.robot_bridge.simulated import SimulatedPsm
from schemas.messages import RobotMode, RobotState
from schemas.topics import ROBOT_STATE, TOOL
from tests.rigs.browser import found

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(found() is None, reason="there is no chromium here (apt-get install chromium)"),
]

PATIENT_S, HERE = 60.0, "127.0.0.1"
READY = "window.suturegrasp?.presented.length > 3 && suturegrasp.picture.thread && suturegrasp.panel.state"


def text_of(element):
    return f"document.getElementById('{element}').textContent"


def says(element, words):
    return f"{text_of(element)}.includes({words!r})"


def faulty(at_ns):
    """A second arm, a palm's breadth beside the first."""
    pose = np.eye(4)
    pose[:3, 3] = 0.0, 0.0, 0.06
    return RobotState("psm2", at_ns, RobotMode.FAULT, pose, np.zeros(6), 0.3, np.eye(4), "")


@pytest.fixture
def followed(tool_correction):
    """The first arm's tool, seen 4 mm off its registration."""
    outline = np.column_stack((np.linspace(420, 520, 60), 200 + 30 * np.sin(np.linspace(0, 6, 60))))
    return lambda at_ns: tool_correction(off_m=0.0042, measured_ns=at_ns, outline_px=outline)


@pytest.fixture
def most_threads(request):
    """After so many no more is seen of the thread."""
    return getattr(request, "param", None)


@pytest.fixture
def rig(settings, in_threads, hand_made_thread, hand_made_camera, most_threads):
    with in_threads(
        settings, hand_made_thread(most_threads), hand_made_camera(), RobotBridge(RobotBridgeConfig(), SimulatedPsm())
    ):
        yield settings


def test_an_arm_with_a_fault_says_why_and_what_to_do_and_cannot_be_armed(rig, looked_at):
    async def look(page, emulated):
        emulated.repeats(ROBOT_STATE, "psm2", faulty)
        emulated.log_of("robot_bridge", "psm2").warning("the arm is FAULT: its operating state is FAULT, not ENABLED")
        await page.until("[...document.getElementById('arm').options].some((o) => o.value === 'psm2')", PATIENT_S)
        # several arms can be chosen, and each is told of by itself
        await page.value("document.getElementById('arm').value = 'psm2'")
        why = "psm2 has a fault and cannot be armed (the arm is FAULT: its operating"
        await page.until(says("words", why), PATIENT_S)
        assert "suturegrasp state" in await page.value(text_of("words"))
        assert await page.value("document.getElementById('words').className") == "grave"
        await page.until(says("press-text", "psm2 cannot be armed"))
        assert await page.value("document.getElementById('press').disabled")
        await page.value("document.getElementById('arm').value = 'psm1'")
        await page.until(says("press-text", "Press and hold to arm psm1"))
        assert await page.value("document.getElementById('words').className") == ""

    looked_at(rig, look)


def test_what_a_recording_lacks_is_told_beside_it(rig, looked_at):
    async def look(page, emulated):
        await page.until(says("recording", "nothing is recorded"))
        assert not await page.value("document.getElementById('record').hidden")
        log = emulated.log_of("recorder", "main")
        await page.until(says("recording", "the rig's own recorder keeps this session: nothing is known to be lost"))
        assert await page.value("document.getElementById('record').hidden"), "it ends with the rig alone"
        log.warning("12 messages of camera/main/frames were lost")
        await page.until(says("recording", "12 messages of camera/main/frames were lost"), PATIENT_S)
        assert await page.value("document.getElementById('recording').className") == "refused"

    looked_at(rig, look)


def test_a_followed_tool_is_drawn_and_says_how_far_off_its_registration_it_is(rig, followed, looked_at):
    async def look(page, emulated):
        emulated.repeats(TOOL, "psm1", followed)
        await page.until(says("arms", "by the images its tool is 4.2 mm off its registration"), PATIENT_S)
        await page.until("suturegrasp.picture.tools[0]?.outline?.length === 60", PATIENT_S)
        assert await page.value("suturegrasp.picture.tools[0].off_mm") == 4.2
        assert await page.value(says("legend", "tool as the images show it"))

    looked_at(rig, look)


@pytest.mark.parametrize("most_threads", [200], indirect=True)
def test_a_thread_that_is_not_seen_any_more_is_drawn_as_an_old_one(rig, looked_at):
    async def look(page, _emulated):
        await page.until("suturegrasp.picture.isOld()", PATIENT_S)
        await page.until(f"/The thread was seen \\d+ s ago/.test({text_of('words')})", PATIENT_S)

    looked_at(rig, look)


def test_over_tls_the_page_is_all_there_where_its_authority_is_trusted(rig, looked_at, tmp_path):
    host = Host("desk", HERE, (Process("operator", "desk"),))
    issue(Layout("test", "", (host,), leaf_days=30, authority_days=365), tmp_path, datetime.datetime.now(datetime.UTC))  # noqa: TID251
    home = tmp_path / "desk" / "certificates"
    certificate = home / "operator.desk.pem"
    tls = server_tls(str(certificate), str(home / "operator.desk.key"))
    public = x509.load_pem_x509_certificate(certificate.read_bytes()).public_key()
    spki = hashlib.sha256(public.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)).digest()

    async def look(page, _emulated):
        assert await page.value("location.protocol") == "https:"
        assert await page.value("isSecureContext")
        await page.until(says("control", "screen 1: you control"), PATIENT_S)
        # the token is gone from the address, and a reload goes on with the next secret
        assert await page.value("location.hash") == ""
        await page.value("window.before = true")
        await page.call("Page.reload")
        await page.until(f"!window.before && {READY}", PATIENT_S)
        await page.until(says("control", "screen 1: you control"), PATIENT_S)

    trusted = f"--ignore-certificate-errors-spki-list={base64.b64encode(spki).decode()}"
    looked_at(rig, look, trusted, tls=tls)
