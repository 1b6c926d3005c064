"""Thread, tissue and tools as they move: MuJoCo's state, stepped from one measured pose of an arm to the next."""

from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from agents.simulator.contact.engine import engine
from agents.simulator.contact.material import GRAVITY, NEWTON, SUTURE, Material
from agents.simulator.contact.model import FINGER_MM, PARKED, STITCH, WRIST_MM, Model, model_of
from agents.simulator.contact.rod import rod_of
from agents.simulator.contact.tissue import planes_beneath, press_n
from agents.simulator.field import DEGREE, MM, SAMPLES, Field, fitted_control_points, fitting_basis
from shared.splines import clamped_uniform_knots

REFRESH_S = 0.01
"""How often the tissue is laid anew beneath the thread."""
SETTLING_S, QUIET_MM_PER_S = 3.0, 0.5
NEAR_MM = 2.5
"""A tool that is farther from the thread leaves it alone until the next pose."""
LONGEST_S = 0.1
"""Of one stretch between two poses; an arm that is heard of less often is taken to have moved in that time."""
SAME_MM = 1e-4
OPPOSITE = 1.0
"""Samples of the thread within which two places on it are opposite each other."""

_AT_REST: WeakKeyDictionary[Field, tuple[Material, np.ndarray]] = WeakKeyDictionary()
"""Where the threads of fields come to rest: one that is laid for many grasps need sink but once."""


@dataclass(frozen=True)
class Pose:
    """Of a tool: in millimetres, in the camera's frame, with the opening of its jaw."""

    T_camera_tool: Float64[np.ndarray, "4 4"]
    jaw_rad: float


@dataclass(frozen=True)
class Touch:
    """What of the thread the fingers of a tool touch, as samples of the thread.

    Fields:
        left, right: the places that each of the fingers touches.
        squeeze_n: the lesser of the forces of the two fingers on the thread.
    """

    left: tuple[float, ...]
    right: tuple[float, ...]
    squeeze_n: float

    @property
    def between(self) -> float | None:
        """Where the thread is that both touch, or between the strands that each touches; None if one touches none."""
        if not self.left or not self.right:
            return None
        pairs = [(abs(a - b), 0.5 * (a + b)) for a in self.left for b in self.right]
        nearest = min(pairs)[0]
        # each bar of a finger touches it, opposite to one of the other finger
        return float(np.mean([middle for apart, middle in pairs if apart <= nearest + OPPOSITE]))


class ContactWorld:
    """A thread that has come to rest on its tissue, and tools that come and go.

    Raises:
        PhysicsError: where MuJoCo is not installed.
    """

    def __init__(self, field: Field, material: Material = SUTURE) -> None:
        self._drawn = field
        self._material = material
        rod = rod_of(field, material)
        self._fit = _fit_from_nodes(rod.segments + 1, field)
        self._tools: dict[str, Pose] = {}
        self._use(model_of(rod, 1, material))
        at_rest = _AT_REST.get(field)
        if at_rest is None or at_rest[0] != material:
            at_rest = _AT_REST[field] = material, self._settle()
        self._rest_qpos = at_rest[1]
        self.stepped_s = 0.0
        self.lay()

    @property
    def field(self) -> Field:
        """The field with the thread as it lies."""
        if self._field is None:
            control_points = MM * (self._fit @ self._nodes()[:: -1 if self._model.rod.backwards else 1])
            points = fitting_basis(len(control_points)) @ control_points
            self._field = replace(
                self._drawn,
                knots=clamped_uniform_knots(len(control_points), DEGREE),
                control_points=control_points,
                points=points,
            )
        return self._field

    def lay(self) -> None:
        """Put the thread where it came to rest at first, and the tools away."""
        self._tools = {}
        self._use(model_of(self._model.rod, 1, self._material))
        self._data.qpos[: self._model.thread_qpos] = self._rest_qpos
        self._quiet = True
        self._begin()

    def move(self, name: str, pose: Pose, elapsed_s: float) -> float:
        """Take a tool to a pose in so much time; the most force that it puts on the tissue, in newtons."""
        before = self._tools.get(name)
        if before is None:
            self._add(name, pose)
            before = pose
        still = self._quiet and _same(before, pose)
        near = self._is_near(before) or self._is_near(pose)
        tool = list(self._tools).index(name)
        pressed = 0.0
        if self._quiet and not near:
            self._put(tool, pose)
        elif not still:
            # a tool that stands keeps its fingers as they are: put shut, they would cut into what they hold
            pressed = self._step_to(tool, before, pose, min(max(elapsed_s, self._material.step_s), LONGEST_S))
        self._tools[name] = pose
        half = 0.5 * max(pose.jaw_rad, 0.0)
        return pressed + press_n(self._drawn.surface, pose.T_camera_tool, (half, half), self._material)

    def touch(self, name: str) -> Touch:
        """What of the thread a tool's fingers touch now."""
        model, data, tool = self._model, self._data, list(self._tools).index(name)
        force, fingers = np.zeros(6), (model.left[tool], model.right[tool])
        found: tuple[list[float], list[float]] = ([], [])
        squeeze = [0.0, 0.0]
        segment_of = {int(geom): i for i, geom in enumerate(model.segment)}
        for i in range(data.ncon):
            contact = data.contact[i]
            one, other = int(contact.geom1), int(contact.geom2)
            for side, bars in enumerate(fingers):
                segment = segment_of.get(other if one in bars else one)
                if (one in bars or other in bars) and segment is not None and contact.efc_address >= 0:
                    engine().mj_contactForce(model.compiled, data, i, force)
                    if force[0] > 0.0:
                        found[side].append(self._sample(segment, contact.pos))
                        squeeze[side] += force[0] / NEWTON
        return Touch(tuple(found[0]), tuple(found[1]), min(squeeze))

    def pressing_n(self) -> float:
        """Force with which the whole thread presses on the tissue."""
        model, data, force, total = self._model, self._data, np.zeros(6), 0.0
        feet = set(model.foot.tolist())
        for i in range(data.ncon):
            contact = data.contact[i]
            if contact.efc_address >= 0 and (contact.geom1 in feet or contact.geom2 in feet):
                engine().mj_contactForce(model.compiled, data, i, force)
                total += force[0]
        return total / NEWTON

    def energy_j(self) -> float:
        """Of the thread: its motion, its bending, and its height above the tissue."""
        material, rod, data = self._material, self._model.rod, self._data
        nodes = self._nodes()
        middles = 0.5 * (nodes[1:] + nodes[:-1])
        mass = material.weight(rod.radius) / GRAVITY * self._drawn.length_m / MM / rod.segments
        height = planes_beneath(self._drawn.surface, middles)[0][:, 2] - rod.radius - middles[:, 2]
        moving = 0.5 * float(data.qvel[: self._model.thread_qvel] @ self._momentum())
        stiffness = material.bending_modulus * material.second_moment(rod.radius) / material.segment_mm
        turned = 2.0 * np.arccos(np.clip(np.abs(data.qpos[STITCH : self._model.thread_qpos : 4]), 0.0, 1.0))
        return (mass * GRAVITY * float(height.sum()) + moving + 0.5 * stiffness * float((turned**2).sum())) * 1e-9

    def _momentum(self) -> Float64[np.ndarray, "v"]:
        whole = np.zeros(self._model.compiled.nv)
        engine().mj_mulM(self._model.compiled, self._data, whole, self._data.qvel)
        return whole[: self._model.thread_qvel]

    def _use(self, model: Model) -> None:
        self._model, self._data = model, engine().MjData(model.compiled)
        self._field: Field | None = None

    def _begin(self) -> None:
        engine().mj_forward(self._model.compiled, self._data)
        self._lay_tissue()
        engine().mj_forward(self._model.compiled, self._data)

    def _add(self, name: str, pose: Pose) -> None:
        """Rebuild the model with one more tool where there is none to spare; the thread stays as it is."""
        self._tools[name] = pose
        if len(self._tools) > len(self._model.left):
            before, data = self._model, self._data
            self._use(model_of(before.rod, len(self._tools), self._material))
            self._data.qpos[: before.thread_qpos] = data.qpos[: before.thread_qpos]
            self._data.qvel[: before.thread_qvel] = data.qvel[: before.thread_qvel]
            for tool, other in enumerate(self._tools.values()):
                self._put(tool, other)
            self._begin()
        self._put(list(self._tools).index(name), pose)

    def _put(self, tool: int, pose: Pose) -> None:
        model, data = self._model, self._data
        at, hinge = model.tool_qpos[tool], model.finger_qpos[tool]
        data.qpos[at : at + 3] = pose.T_camera_tool[:3, 3]
        data.qpos[at + 3 : at + 7] = Rotation.from_matrix(pose.T_camera_tool[:3, :3]).as_quat(scalar_first=True)
        data.qpos[hinge : hinge + 2] = 0.5 * max(pose.jaw_rad, 0.0)
        data.ctrl[2 * tool] = max(pose.jaw_rad, 0.0)
        at = model.tool_qvel[tool]
        data.qvel[at : at + 8] = 0.0

    def _step_to(self, tool: int, before: Pose, after: Pose, elapsed_s: float) -> float:
        """Move evenly from pose to pose, the others standing; the most force on the tissue by way of the thread."""
        model, data, compiled = self._model, self._data, self._model.compiled
        step_s = self._material.step_s
        steps = max(round(elapsed_s / step_s), 1)
        start, turn = Rotation.from_matrix(before.T_camera_tool[:3, :3]), _turn(before, after)
        share = np.arange(1, steps + 1)[:, None] / steps
        places = before.T_camera_tool[:3, 3] + share * (after.T_camera_tool[:3, 3] - before.T_camera_tool[:3, 3])
        attitudes = (Rotation.from_rotvec(share * turn) * start).as_quat(scalar_first=True)
        speed = (after.T_camera_tool[:3, 3] - before.T_camera_tool[:3, 3]) / (steps * step_s)
        spin = start.inv().apply(turn) / (steps * step_s)
        jaw = np.maximum(before.jaw_rad + share[:, 0] * (after.jaw_rad - before.jaw_rad), 0.0)
        at, moving = model.tool_qpos[tool], model.tool_qvel[tool]
        others = [i for i in range(len(self._tools)) if i != tool]
        held = data.qpos.copy()
        every = max(round(REFRESH_S / step_s), 1)
        most, was = 0.0, self._nodes()
        mj_step = engine().mj_step
        for k in range(steps):
            data.qvel[moving : moving + 3], data.qvel[moving + 3 : moving + 6] = speed, spin
            data.ctrl[2 * tool] = jaw[k]
            mj_step(compiled, data)
            data.qpos[at : at + 3], data.qpos[at + 3 : at + 7] = places[k], attitudes[k]
            for other in others:
                still, rest = model.tool_qpos[other], model.tool_qvel[other]
                data.qpos[still : still + 7], data.qvel[rest : rest + 6] = held[still : still + 7], 0.0
            if (k + 1) % every == 0 or k + 1 == steps:
                most = max(most, self._thread_press_n())
                self._lay_tissue()
        self.stepped_s += steps * step_s
        self._field = None
        moved = float(np.abs(self._nodes() - was).max()) / (steps * step_s)
        self._quiet = moved < QUIET_MM_PER_S and _same(before, after)
        return most

    def _settle(self) -> Float64[np.ndarray, "q"]:
        """Let the thread sink onto its tissue until it rests."""
        self._begin()
        steps = round(REFRESH_S / self._material.step_s)
        quiet = 0
        for _ in range(round(SETTLING_S / REFRESH_S)):
            was = self._nodes()
            engine().mj_step(self._model.compiled, self._data, steps)
            # a viscous bath: what swings by itself would go on for long
            self._data.qvel[: self._model.thread_qvel] *= 0.7
            self._park()
            self._lay_tissue()
            quiet = quiet + 1 if np.abs(self._nodes() - was).max() < QUIET_MM_PER_S * REFRESH_S else 0
            if quiet >= 5:
                break
        return self._data.qpos[: self._model.thread_qpos].copy()

    def _park(self) -> None:
        at, moving = self._model.tool_qpos[0], self._model.tool_qvel[0]
        self._data.qpos[at : at + 3] = PARKED
        self._data.qvel[moving : moving + 8] = 0.0

    def _lay_tissue(self) -> None:
        model = self._model
        at, attitude = planes_beneath(self._drawn.surface, self._data.geom_xpos[model.foot])
        model.compiled.geom_pos[model.tissue] = at
        model.compiled.geom_quat[model.tissue] = attitude

    def _thread_press_n(self) -> float:
        """Force with which the thread presses on the tissue beyond its own weight."""
        weight = self._material.weight(self._model.rod.radius) * self._drawn.length_m / MM
        return max(self.pressing_n() - weight / NEWTON, 0.0)

    def _nodes(self) -> Float64[np.ndarray, "n 3"]:
        return np.vstack((self._data.xpos[self._model.body], self._data.site("tip").xpos))

    def _sample(self, segment: int, point: Float64[np.ndarray, "3"]) -> float:
        """Which sample of the thread is nearest to a point at one of its segments."""
        nodes = self._nodes()[segment : segment + 2]
        step = nodes[1] - nodes[0]
        share = float(np.clip((point - nodes[0]) @ step / (step @ step), 0.0, 1.0))
        place = (segment + share) / self._model.rod.segments
        return (1.0 - place if self._model.rod.backwards else place) * (SAMPLES - 1)

    def _is_near(self, pose: Pose) -> bool:
        """Whether any part of the tool is near the thread, or about to be."""
        half = 0.5 * max(pose.jaw_rad, 0.0)
        y, z = FINGER_MM * np.sin(half), FINGER_MM * np.cos(half)
        ends = np.array([(0.0, y, z), (0.0, -y, z), (0.0, 0.0, -WRIST_MM)])
        pin = pose.T_camera_tool[:3, 3]
        nodes = self._nodes() - pin
        reach = NEAR_MM + 0.5 * self._material.segment_mm
        for end in ends @ pose.T_camera_tool[:3, :3].T:
            along = np.clip(nodes @ end / (end @ end), 0.0, 1.0)
            if (np.linalg.norm(nodes - along[:, None] * end, axis=1) < reach).any():
                return True
        return False


def _turn(before: Pose, after: Pose) -> Float64[np.ndarray, "3"]:
    return Rotation.from_matrix(after.T_camera_tool[:3, :3] @ before.T_camera_tool[:3, :3].T).as_rotvec()


def _same(a: Pose, b: Pose) -> bool:
    return bool(np.abs(a.T_camera_tool - b.T_camera_tool).max() < SAME_MM) and abs(a.jaw_rad - b.jaw_rad) < SAME_MM


def _fit_from_nodes(nodes: int, field: Field) -> Float64[np.ndarray, "m n"]:
    """What takes the rod's joints, from s = 0 on, to the control points of the spline through them."""
    place = np.linspace(0.0, 1.0, nodes)
    through = CubicSpline(place, np.eye(nodes))(np.linspace(0.0, 1.0, SAMPLES))
    return np.linalg.pinv(fitting_basis(fitted_control_points(field.length_m))) @ through
