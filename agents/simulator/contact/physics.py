"""Grasps by contact, as the agent sees them: arms that are measured, and what comes of it."""

from agents.simulator.contact.grasp import Attempt, noted, outcome
from agents.simulator.contact.material import SUTURE, Material
from agents.simulator.contact.world import ContactWorld, Pose
from agents.simulator.field import MM, Field
from agents.simulator.judgement import MeasuredArm, Outcome

USUAL_NS = 10_000_000
"""Between two states of an arm that say nothing of when they were measured."""


class ContactPhysics:
    """A thread that fingers push, hold and lose by contact and friction.

    Raises:
        PhysicsError: where MuJoCo is not installed.
    """

    def __init__(self, field: Field, tissue_force_limit_n: float, material: Material = SUTURE) -> None:
        self._limit_n = tissue_force_limit_n
        self._world = ContactWorld(field, material)
        self._grasps: dict[str, tuple[str, Attempt]] = {}
        self._measured_ns: dict[str, int] = {}

    @property
    def field(self) -> Field:
        """The field as it is."""
        return self._world.field

    @property
    def stepped_s(self) -> float:
        """How much time has been computed, of all that passed."""
        return self._world.stepped_s

    @property
    def held_sample(self) -> int | None:
        """Where closed fingers hold the thread, by the arm that came first; None where none do."""
        for _, attempt in self._grasps.values():
            if attempt.closed_tip is not None and attempt.grip is not None:
                return round(attempt.grip)
        return None

    def lay(self) -> None:
        """Lay the thread as it came to rest at first; arms are followed from where they are seen next."""
        self._world.lay()
        self._grasps.clear()
        self._measured_ns.clear()

    def follow(self, arm: MeasuredArm) -> Outcome:
        """Move the arm's tool there, and read off what has become of its grasp."""
        T_camera_tool = arm.T_camera_tool.copy()
        T_camera_tool[:3, 3] /= MM
        pose = Pose(T_camera_tool, arm.jaw_rad)
        elapsed_ns = arm.measured_ns - self._measured_ns.get(arm.name, arm.measured_ns)
        self._measured_ns[arm.name] = arm.measured_ns
        force_n = self._world.move(arm.name, pose, 1e-9 * (elapsed_ns if elapsed_ns > 0 else USUAL_NS))
        plan_id, attempt = self._grasps.get(arm.name, ("", Attempt(arm.jaw_rad)))
        if plan_id != arm.plan_id:
            attempt = Attempt(arm.jaw_rad)
        touch = self._world.touch(arm.name)
        field = self._world.field
        attempt = noted(attempt, pose, touch, force_n, field)
        self._grasps[arm.name] = (arm.plan_id, attempt)
        return outcome(attempt, field, self._limit_n)

    def carry(self) -> None:
        """The thread is where it is."""
