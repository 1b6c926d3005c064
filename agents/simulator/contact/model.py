"""The model that MuJoCo steps: the rod, a piece of tissue under each of its segments, and the tools.

A tool is a heavy free body that is put where the arm is at every step. Its fingers hinge at the pin; one servo
opens them as far as the jaw, with a limited torque, another keeps them in line with the tool. The piece of tissue
beneath a segment is a plane that is moved with it (tissue.py).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int64

from agents.simulator.contact.engine import engine
from agents.simulator.contact.material import GRAVITY, NEWTON, Material
from agents.simulator.contact.rod import Rod, rod_xml
from agents.simulator.field import MM
from agents.simulator.fingers import WIDTH_M
from shared.kinematics.psm import FINGER_M

FINGER_MM, WIDTH_MM, THICKNESS_MM = FINGER_M / MM, WIDTH_M / MM, 1.0
WRIST_RADIUS_MM, WRIST_MM = 2.5, 9.0
"""Of the clevis behind the pin."""

STIFFNESS, INERTIA = 3e9, 2e3
"""Of the jaw's servos, in g mm²/s², and of a finger, in g mm². So stiff a servo squeezes with all of its torque where a
thread keeps the jaw open by a hundredth of a radian; the inertia keeps it slow enough for the time step."""
TOOL_MASS, TOOL_INERTIA = 1e5, 1e7
"""Of a tool, in g and g mm². It is put back where the arm is after each step; at 100 g a pull of 0.3 N carries it away
by 1.5 mm/s within the steps, and the thread creeps out of it as fast."""
SOLVED_INERTIA = 1.0
"""In g mm²; that of a joint of the thread."""
SQUASH = 1e8
"""Stiffness of a contact of the thread with a bar of a finger, in g/s²: 3 N on four bars flatten it by 0.01 mm."""
SOFT = 0.98
"""Impedance of contacts with tissue: what share of a push into it is taken up at once."""
IMPRATIO = 100.0
"""How much stiffer friction is than what presses: without it, what is held creeps."""
BARS, EDGE_MM = 4, 0.25
"""Capsules that make up the face of a finger, and their radius, by which its edges and its tip are rounded."""
STITCH = 3
"""Coordinates of the thread's stitched end, which come first."""
PARKED = (0.0, 0.0, -500.0)


@dataclass(frozen=True)
class Model:
    """A compiled model, and where in it things are.

    Fields:
        segment, foot, tissue: geoms of the thread's segments, of the middles of those, and of the tissue beneath.
        left, right: geoms of each tool's fingers.
        tool_qpos, tool_qvel, finger_qpos, finger_qvel: where the first coordinate of each tool's body is, and those of
            its fingers.
        thread_qpos, thread_qvel: up to where those of the thread go.
    """

    compiled: Any
    rod: Rod
    material: Material
    body: Int64[np.ndarray, "n"]
    segment: Int64[np.ndarray, "n"]
    foot: Int64[np.ndarray, "n"]
    tissue: Int64[np.ndarray, "n"]
    left: tuple[frozenset[int], ...]
    right: tuple[frozenset[int], ...]
    tool_qpos: tuple[int, ...]
    tool_qvel: tuple[int, ...]
    finger_qpos: tuple[int, ...]
    finger_qvel: tuple[int, ...]
    thread_qpos: int
    thread_qvel: int


def model_of(rod: Rod, tools: int, material: Material) -> Model:
    """A rod on tissue with so many tools.

    Raises:
        PhysicsError: where MuJoCo is not installed.
    """
    mujoco = engine()
    compiled = mujoco.MjModel.from_xml_string(_xml(rod, tools, material))
    n = rod.segments

    def geoms(kind: str) -> Int64[np.ndarray, "n"]:
        return np.array([compiled.geom(f"{kind}{i}").id for i in range(n)])

    tissue, body = geoms("tissue"), np.array([compiled.body(f"segment{i}").id for i in range(n)])
    # these are moved, so they must not count as lying where their body does
    compiled.geom_sameframe[tissue] = 0
    # by default the solver's tolerance is relative to the mean inertia, which here is the tools': it would stop at once
    compiled.stat.meaninertia = SOLVED_INERTIA
    _make_soft(compiled, rod, material, body)
    _make_hard(compiled, material, body, geoms("segment"))
    free = [compiled.joint(f"tool{tool}") for tool in range(tools)]
    hinge = [compiled.joint(f"left{tool}") for tool in range(tools)]
    return Model(
        compiled,
        rod,
        material,
        body,
        geoms("segment"),
        geoms("foot"),
        tissue,
        tuple(_bars(compiled, f"left{tool}") for tool in range(tools)),
        tuple(_bars(compiled, f"right{tool}") for tool in range(tools)),
        tuple(int(joint.qposadr[0]) for joint in free),
        tuple(int(joint.dofadr[0]) for joint in free),
        tuple(int(joint.qposadr[0]) for joint in hinge),
        tuple(int(joint.dofadr[0]) for joint in hinge),
        STITCH + 4 * (n - 1),
        STITCH + 3 * (n - 1),
    )


def _bars(compiled: Any, finger: str) -> frozenset[int]:
    return frozenset(compiled.geom(f"{finger}bar{bar}").id for bar in range(BARS))


def _make_soft(compiled: Any, rod: Rod, material: Material, body: Int64[np.ndarray, "n"]) -> None:
    """Give each pair of segment and tissue the stiffness of a line that presses into an elastic half space.

    At rest a contact of impedance d carries k r d / ((1 − d) w) at the depth r, where w is the inverse weight of what
    touches; so k is what makes that the stiffness wanted.
    """
    length = float(np.linalg.norm(np.diff(rod.nodes, axis=0), axis=1).mean())
    wanted = material.line_stiffness(length) * compiled.body_invweight0[body, 0] * (1.0 - SOFT) / SOFT
    stiffness = np.minimum(wanted, (0.5 / material.step_s) ** 2)
    compiled.pair_solref[:] = np.column_stack((-stiffness, -2.0 * np.sqrt(stiffness)))


def _make_hard(
    compiled: Any, material: Material, body: Int64[np.ndarray, "n"], segment: Int64[np.ndarray, "n"]
) -> None:
    """Give each segment the same stiffness to fingers: by default, those at the free end would be as soft as gel."""
    stiffness = SQUASH * compiled.body_invweight0[body, 0]
    compiled.geom_solimp[segment, :2] = (stiffness / (stiffness + (0.5 / material.step_s) ** 2))[:, None]


def _xml(rod: Rod, tools: int, material: Material) -> str:
    n, solid = rod.segments, f'solref="{2.0 * material.step_s!r} 1"'
    grip = f'condim="3" friction="{material.finger_friction} 0.005 0.0001" {solid}'
    tissue = "".join(f'<geom class="tissue" name="tissue{i}"/>' for i in range(n))
    mu = material.tissue_friction
    pairs = "".join(
        f'<pair geom1="tissue{i}" geom2="foot{i}" condim="3" friction="{mu} {mu} 0.005 0.0001 0.0001" '
        f'solimp="{SOFT} {SOFT} 0.01"/>'
        for i in range(n)
    )
    torque = material.grip_n * NEWTON * FINGER_MM
    own = f'kp="{STIFFNESS}" kv="{2.0 * np.sqrt(STIFFNESS * INERTIA)}"'
    tendons = "".join(_jaw_xml(tool) for tool in range(tools))
    servos = "".join(
        f'<position tendon="opening{tool}" {own} forcerange="{-torque!r} {torque!r}"/>'
        f'<position tendon="aside{tool}" {own}/>'
        for tool in range(tools)
    )
    return f"""<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{material.step_s!r}" gravity="0 0 {GRAVITY}" integrator="implicitfast" cone="elliptic"
    impratio="{IMPRATIO}" iterations="30" tolerance="1e-10"/>
  <size memory="16M"/>
  <default>
    <default class="thread">
      <geom size="{rod.radius!r}" density="{material.density!r}" contype="1" conaffinity="3" priority="1" {grip}/>
    </default>
    <default class="foot"><geom size="{rod.radius!r}" mass="0" contype="0" conaffinity="0"/></default>
    <default class="tissue"><geom type="plane" size="5 5 1" contype="0" conaffinity="0"/></default>
    <default class="tool"><geom mass="1" contype="2" conaffinity="1" {grip}/></default>
  </default>
  <worldbody>{tissue}{rod_xml(rod, material)}{"".join(_tool_xml(tool) for tool in range(tools))}</worldbody>
  <contact>{pairs}</contact>
  <tendon>{tendons}</tendon>
  <actuator>{servos}</actuator>
</mujoco>"""


def _tool_xml(tool: int) -> str:
    fingers = "".join(_finger_xml(f"{name}{tool}", side) for name, side in (("left", 1), ("right", -1)))
    wrist = (
        f'<geom class="tool" type="capsule" size="{WRIST_RADIUS_MM}" '
        f'fromto="0 0 {-WRIST_RADIUS_MM - 0.5} 0 0 {-WRIST_MM}"/>'
    )
    x, y, z = PARKED
    return (
        f'<body name="tool{tool}" gravcomp="1" pos="{x} {y} {z - 50.0 * tool}"><joint name="tool{tool}" type="free"/>'
        f'<inertial pos="0 0 0" mass="{TOOL_MASS}" '
        f'diaginertia="{TOOL_INERTIA} {TOOL_INERTIA} {TOOL_INERTIA}"/>{wrist}{fingers}</body>'
    )


def _jaw_xml(tool: int) -> str:
    """How far the fingers are apart, and how far they are off to one side together."""
    return "".join(
        f'<fixed name="{name}{tool}"><joint joint="left{tool}" coef="1"/>'
        f'<joint joint="right{tool}" coef="{sign}"/></fixed>'
        for name, sign in (("opening", 1), ("aside", -1))
    )


def _finger_xml(name: str, side: int) -> str:
    """A bar with rounded edges whose inner face goes through the pin; it opens to its side as the joint turns.

    Its face is made of capsules side by side: these meet a thread across them at one steady place each, where the face
    of a box meets it now at one of its edges and now at the other. Two thicker ones behind them make its back.
    """
    radius = 0.5 * THICKNESS_MM
    face = "".join(
        _bar_xml(f'name="{name}bar{bar}"', EDGE_MM, x, side * EDGE_MM)
        for bar, x in enumerate(np.linspace(-1.0, 1.0, BARS) * (0.5 * WIDTH_MM - EDGE_MM))
    )
    # a hair behind the face, so that it alone touches what is between the fingers
    back = "".join(
        _bar_xml(f'name="{name}back{bar}"', radius - 0.05, x, side * (radius + 0.05))
        for bar, x in enumerate((radius - 0.5 * WIDTH_MM, 0.5 * WIDTH_MM - radius))
    )
    bars = face + back
    return (
        f'<body name="{name}" gravcomp="1"><joint name="{name}" type="hinge" axis="{-side} 0 0" range="-0.002 0.8" '
        f'armature="{INERTIA}"/>{bars}</body>'
    )


def _bar_xml(name: str, radius: float, x: float, y: float) -> str:
    return f'<geom class="tool" {name} type="capsule" size="{radius}" fromto="{x} {y} 0 {x} {y} {FINGER_MM - radius}"/>'
