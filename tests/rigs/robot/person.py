"""A person who presses the page's button, and a camera, as far as a bridge and a guard can tell: for measurements.

python -m tests.rigs.robot.person press RIG ENDPOINT ARM PLAN     # arms the plan and answers; SIGUSR1 lets go
python -m tests.rigs.robot.person watch RIG ENDPOINT ARM          # 30 frame notices a second; SIGUSR1 freezes it
"""

import json
import signal
import sys
import threading
from typing import Any

from schemas.codec import decode
from schemas.messages import Arm, ChallengeEcho, FrameNotice, FrameStamp, Heartbeat, Outcome, RobotState
from schemas.topics import ARM, FRAME_NOTICE, HEARTBEAT, MAIN, ROBOT_STATE
from shared.clock import now_ns
from shared.runtime.commands import new_header
from shared.runtime.connection import Connection
from shared.runtime.session import SessionSettings, open_session
from shared.runtime.taps import Tapped

ANSWERS_EVERY_S, FRAMES_HZ = 0.04, 30.0
CALIBRATION = "bench"


class Newest:
    """The newest state of an arm that was heard."""

    def __init__(self, connection: Connection, arm: str) -> None:
        self._arm, self._payload, self.came = arm, b"", threading.Event()
        connection.listen((ROBOT_STATE,), self._take)

    def state(self) -> RobotState | None:
        """That state; None before the first."""
        return decode(RobotState, self._payload) if self._payload else None

    def _take(self, tapped: Tapped) -> None:
        if f"/{self._arm}/" in tapped.key:
            self._payload = tapped.payload
            self.came.set()


class Person:
    """Presses the button on a plan until let go."""

    def __init__(self, connection: Connection, arm: str) -> None:
        self._connection, self._arm, self._newest = connection, arm, Newest(connection, arm)
        self._released, self.arming_id, self.released_ns = threading.Event(), "", 0
        self._answering: threading.Thread | None = None

    def press(self, plan_id: str) -> Any:
        """Arm a plan, and answer challenges from then on; the answer to the arming."""
        if self._answering is not None and self._released.is_set():
            self._answering.join()
        self._newest.came.wait(10.0)
        state, header = self._newest.state(), new_header("a person")
        echo_ns = 0 if state is None else state.challenge_ns
        self._released.clear()
        self.arming_id = header.id
        answer = self._connection.command(ARM, Arm(header, self._arm, plan_id, echo_ns, pressed=True), self._arm)
        if answer.outcome is Outcome.ACCEPTED:
            self._answering = threading.Thread(target=self._answer, args=(plan_id, header.id), daemon=True)
            self._answering.start()
        return answer

    def release(self) -> None:
        """Let go: nothing is answered from now on."""
        self.released_ns = now_ns()
        self._released.set()

    def close(self) -> None:
        """Let go, and answer nothing that is still under way, so that the session may be closed."""
        self.release()
        if self._answering is not None:
            self._answering.join()

    def _answer(self, plan_id: str, arming_id: str) -> None:
        with self._connection.publishing(HEARTBEAT, self._arm) as publish:
            while not self._released.is_set():
                if (state := self._newest.state()) is not None:
                    of = state.challenge_ns, state.guard_challenge
                    publish(Heartbeat(self._arm, plan_id, now_ns(), arming_id, *of, pressed=True), now_ns())
                self._released.wait(ANSWERS_EVERY_S)


class Camera:
    """Tells of frames, each with the newest challenge."""

    def __init__(self, connection: Connection, arm: str, calibration_id: str = CALIBRATION) -> None:
        self._connection, self._arm, self._newest = connection, arm, Newest(connection, arm)
        self._calibration_id, self._stopped, self.frozen = calibration_id, threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stamp(self, sequence: int = 0) -> FrameStamp:
        """Of a frame that is taken now."""
        state, at_ns = self._newest.state(), now_ns()
        echoes = () if state is None else (ChallengeEcho(self._arm, state.challenge_ns),)
        return FrameStamp(sequence, at_ns, at_ns, self._calibration_id, echoes)

    def close(self) -> None:
        """Take no frame any more."""
        self._stopped.set()
        self._thread.join()

    def _run(self) -> None:
        with self._connection.publishing(FRAME_NOTICE, MAIN) as publish:
            sequence = 0
            while not self._stopped.wait(1 / FRAMES_HZ):
                sequence += 1
                if not self.frozen.is_set():
                    publish(FrameNotice(self.stamp(sequence)), now_ns())


def main(role: str, rig: str, endpoint: str, arm: str, plan_id: str = "") -> None:
    """Until killed; each thing done is a line of JSON."""
    let_go = threading.Event()
    signal.signal(signal.SIGUSR1, lambda *_: let_go.set())
    settings = SessionSettings(rig, endpoint)
    with open_session(settings) as session:
        connection = Connection(session, settings)
        person, camera = Person(connection, arm), None
        if role == "watch":
            camera = Camera(connection, arm)
        else:
            answer = person.press(plan_id)
            told = {"outcome": answer.outcome.name, "code": answer.code, "reason": answer.reason}
            print(json.dumps(told), flush=True)
        # a signal's handler runs when the main thread wakes
        while not let_go.wait(0.005):
            pass
        if camera is not None:
            camera.frozen.set()
        else:
            person.release()
            print(json.dumps({"released_ns": person.released_ns}), flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
