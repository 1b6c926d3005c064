"""Grasps by geometry alone: fast, and validated against contact physics (docs/simulator.md)."""

from agents.simulator.field import Field, s_of
from agents.simulator.judgement import Grip, code, never_closed, sentence, slid_m
from agents.simulator.outcome import MeasuredArm, Outcome
from agents.simulator.world import World, held_sample, moved, thread_carried
from schemas.messages import Verdict


class GeometricPhysics:
    """A thread that goes where a jaw takes it, and is caught where it runs between the fingers as they close."""

    def __init__(self, field: Field) -> None:
        self._drawn = field
        self.lay()

    @property
    def field(self) -> Field:
        """The field as it is."""
        return self._world.field

    @property
    def held_sample(self) -> int | None:
        """Which sample of the thread the jaw that leads it holds, None where none does."""
        return held_sample(self._world)

    def lay(self) -> None:
        """Lay the thread as it was drawn; arms are followed from where they are seen next."""
        self._world = World(self._drawn, self._drawn, {})

    def follow(self, arm: MeasuredArm) -> Outcome:
        """What becomes of the arm's grasp when it has been measured there."""
        self._world = moved(self._world, arm.name, arm.plan_id, arm.T_camera_tool, arm.jaw_rad)
        grip = self._world.arms[arm.name].grip
        return _outcome(grip, self._world.field) if grip.verdict else _outcome(never_closed(grip), self.field, False)

    def carry(self) -> None:
        """Have the thread follow the jaw that leads it."""
        self._world = thread_carried(self._world)


def _outcome(grip: Grip, field: Field, settled: bool = True) -> Outcome:
    verdict = grip.verdict or Verdict.MISSED
    caught = grip.sample if verdict is Verdict.HELD else None
    s_caught = None if caught is None else s_of(caught)
    return Outcome(settled, verdict, code(grip), sentence(grip, field), s_caught, slid_m(grip, field))
