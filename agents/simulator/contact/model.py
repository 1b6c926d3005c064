"""The model that MuJoCo steps: the rod, a piece of tissue under each of its segments, and the tools.

A tool is a heavy free body that is put where the arm is at every step. Its fingers hinge at the pin and follow the jaw
by servos of limited force. The piece of tissue beneath a segment is a plane that is moved with it (tissue.py).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int64

from agents.simulator.contact.engine import engine
from agents.simulator.contact.material import GRAVITY, Material
from agents.simulator.contact.rod import Rod, rod_xml
from agents.simulator.field import MM
from agents.simulator.fingers import WIDTH_M
from shared.kinematics.psm import FINGER_M

FINGER_MM, WIDTH_MM, THICKNESS_MM = FINGER_M / MM, WIDTH_M / MM, 1.0
WRIST_RADIUS_MM, WRIST_MM = 2.5, 9.0
"""Of the clevis behind the pin."""

STIFFNESS, INERTIA, LARGEST_TORQUE = 7e6, 20.0, 1e6
"""Of a finger's servo, in g mm²/s² and g mm²: jaws that are told to shut squeeze a thread by some 0.02 N.

Real jaws have newtons, and thread is harder: what matters is that friction between them carries a hundred times what a
thread weighs, and that closed jaws stop at the thread.
"""
SOLID, SOFT = 0.98, 0.98
"""Impedance of contacts between solids, and with tissue: what share of a push into each other is taken up at once."""
BARS = 3
"""Capsules that make up a finger."""
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
    _make_soft(compiled, rod, material, body)
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
        4 * (n - 1),
        3 * (n - 1),
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


def _xml(rod: Rod, tools: int, material: Material) -> str:
    n, solid = rod.segments, f'solref="{2.0 * material.step_s!r} 1" solimp="{SOLID} {SOLID} 0.01"'
    grip = f'condim="3" friction="{material.finger_friction} 0.005 0.0001" {solid}'
    tissue = "".join(f'<geom class="tissue" name="tissue{i}"/>' for i in range(n))
    mu = material.tissue_friction
    pairs = "".join(
        f'<pair geom1="tissue{i}" geom2="foot{i}" condim="3" friction="{mu} {mu} 0.005 0.0001 0.0001" '
        f'solimp="{SOFT} {SOFT} 0.01"/>'
        for i in range(n)
    )
    servo = (
        f'kp="{STIFFNESS}" kv="{2.0 * np.sqrt(STIFFNESS * INERTIA)}" forcerange="{-LARGEST_TORQUE} {LARGEST_TORQUE}"'
    )
    servos = "".join(f'<position joint="{side}{tool}" {servo}/>' for tool in range(tools) for side in ("left", "right"))
    return f"""<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{material.step_s!r}" gravity="0 0 {GRAVITY}" integrator="implicitfast" cone="elliptic"
    impratio="10" iterations="30" tolerance="1e-10"/>
  <size memory="16M"/>
  <default>
    <default class="thread">
      <geom size="{rod.radius!r}" density="{material.density!r}" contype="1" conaffinity="3" {grip}/>
    </default>
    <default class="foot"><geom size="{rod.radius!r}" mass="0" contype="0" conaffinity="0"/></default>
    <default class="tissue"><geom type="plane" size="5 5 1" contype="0" conaffinity="0"/></default>
    <default class="tool"><geom mass="1" contype="2" conaffinity="1" {grip}/></default>
  </default>
  <worldbody>{tissue}{rod_xml(rod, material)}{"".join(_tool_xml(tool) for tool in range(tools))}</worldbody>
  <contact>{pairs}</contact>
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
        f'<inertial pos="0 0 0" mass="100" diaginertia="1e4 1e4 1e4"/>{wrist}{fingers}</body>'
    )


def _finger_xml(name: str, side: int) -> str:
    """A bar with rounded edges whose inner face goes through the pin; it opens to its side as the joint turns.

    It is made of capsules side by side: these meet a thread across them at one steady place each, where the face of a
    box meets it now at one of its edges and now at the other.
    """
    radius = 0.5 * THICKNESS_MM
    bars = "".join(
        f'<geom class="tool" name="{name}bar{bar}" type="capsule" size="{radius}" '
        f'fromto="{x} {side * radius} 0 {x} {side * radius} {FINGER_MM - radius}"/>'
        for bar, x in enumerate(np.linspace(-1.0, 1.0, BARS) * (0.5 * WIDTH_MM - radius))
    )
    return (
        f'<body name="{name}" gravcomp="1"><joint name="{name}" type="hinge" axis="{-side} 0 0" range="-0.002 0.8" '
        f'armature="{INERTIA}"/>{bars}</body>'
    )
