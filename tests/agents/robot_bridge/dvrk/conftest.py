"""An arm behind an emulated console in virtual time, and somebody who arms it and stands by."""

from dataclasses import replace
from typing import Any

import pytest

from agents.robot_bridge.limits import MotionLimits
from schemas.messages import CommandAnswer, CommandHeader, GraspPlan, Outcome
from tests.agents.robot_bridge.drive import SHORT_GRASP, plan
from tests.rigs.robot.hostile import BRISK
from tests.rigs.robot.world import SECOND_NS, World

AT_ONCE = replace(BRISK, contact_share=1.0)


class Room(World):
    """Bridge, guard and console in virtual time, and somebody who arms and stands by."""

    def __init__(self, limits: MotionLimits = AT_ONCE, lag_s: float = 0.0, **jaw: Any) -> None:
        super().__init__(limits, lag_s, **jaw)
        self.stands_by = True

    def until(self, condition: Any) -> None:
        """Let time pass until a condition is true."""
        for _ in range(2000):
            if condition():
                return
            self.tick()
        raise AssertionError((self.verdict(), [event.reason for event in self.events]))

    def ready(self) -> None:
        self.until(lambda: self.backend.state(self.now_ns).reason == "")

    def plan(self) -> GraspPlan:
        """Of a frame that is taken now."""
        return plan("p", stamp=self.stamp(), waypoints=SHORT_GRASP)

    def try_to_arm(self) -> CommandAnswer:
        """With a new plan."""
        self.publish(self.plan())
        return self.arm_again()

    def arm_again(self) -> CommandAnswer:
        """With the plan that was published last."""
        answer = self.arm("p")
        assert answer is not None
        return answer

    def starts_moving(self) -> None:
        """Ready, armed, and under way."""
        self.ready()
        answer, sent = self.try_to_arm(), self.verdict()["set_points"]
        assert answer.outcome is Outcome.ACCEPTED, answer.reason
        self.until(lambda: self.verdict()["set_points"] > sent + 40)

    def header(self) -> CommandHeader:
        """Of a new command."""
        self.armings += 1
        return CommandHeader(f"command-{self.armings}", self.now_ns + SECOND_NS, "ann")

    def verdict(self) -> dict[str, Any]:
        return self.console.verdict()


@pytest.fixture
def room() -> Room:
    return Room()
