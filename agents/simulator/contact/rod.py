"""The thread as a chain of capsules on ball joints, stitched into the tissue where its lower end is.

A joint between two segments of length L resists bending with K = E I / L. At rest the chain has the shape in which the
thread was drawn, so that only gravity and contact bend it. Segments weigh so little that a joint would swing thousands
of times a second, so each is given an inertia K τ² of its own, and critical damping 2 K τ: it then comes to rest within
a few τ, which is a few milliseconds. Equilibria do not depend on it. The segment in the stitch cannot turn, but soft
tissue follows it: three springs, damped in the same way, let it be drawn out of its place.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from agents.simulator.contact.material import Material
from agents.simulator.field import MM, SAMPLES, Field
from shared.rendering.surface import depth_at_points


@dataclass(frozen=True)
class Rod:
    """The chain as drawn, in millimetres.

    Fields:
        nodes: its joints and ends, from the stitched end on.
        backwards: that end is s = 1 of the thread.
    """

    nodes: Float64[np.ndarray, "n 3"]
    radius: float
    backwards: bool

    @property
    def segments(self) -> int:
        """How many there are."""
        return len(self.nodes) - 1


def rod_of(field: Field, material: Material) -> Rod:
    """The chain along a field's thread; the end that lies nearer to the tissue is stitched into it."""
    points = field.points / MM
    height = depth_at_points(field.surface, points[[0, -1], :2]) - points[[0, -1], 2]
    backwards = bool(height[1] < height[0])
    segments = max(round(field.length_m / MM / material.segment_mm), 4)
    place = np.linspace(0.0, SAMPLES - 1.0, segments + 1)
    nodes = np.column_stack([np.interp(place, np.arange(SAMPLES), axis) for axis in points.T])
    return Rod(nodes[::-1] if backwards else nodes, field.radius_m / MM, backwards)


def rod_xml(rod: Rod, material: Material) -> str:
    """The chain as bodies within bodies."""
    steps = np.diff(rod.nodes, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    tangents = steps / lengths[:, None]
    turns = [_turn(np.array([1.0, 0.0, 0.0]), tangents[0])]
    attitude = turns[0]
    for tangent in tangents[1:]:
        ahead = _rotated_x(attitude)
        # the turn in the frame of the segment before
        turn = _product(_inverse(attitude), _product(_turn(ahead, tangent), attitude))
        turns.append(turn)
        attitude = _product(attitude, turn)
    stiffness = material.bending_modulus * material.second_moment(rod.radius) / float(lengths.mean())
    inertia = stiffness * material.joint_s**2
    damping = 2.0 * stiffness * material.joint_s
    joint = f'<joint type="ball" stiffness="{stiffness!r}" damping="{damping!r}" armature="{inertia!r}"/>'
    stitch = _stitch_xml(material)
    opened = []
    for i, (length, turn) in enumerate(zip(lengths, turns, strict=True)):
        at = rod.nodes[0] if i == 0 else np.array([lengths[i - 1], 0.0, 0.0])
        opened.append(
            f'<body name="segment{i}" pos="{_text(at)}" quat="{_text(turn)}">{joint if i else stitch}'
            f'<geom class="thread" name="segment{i}" type="capsule" fromto="0 0 0 {float(length)!r} 0 0"/>'
            f'<geom class="foot" name="foot{i}" type="sphere" pos="{0.5 * float(length)!r} 0 0"/>'
        )
    tip = f'<site name="tip" pos="{float(lengths[-1])!r} 0 0"/>'
    return "".join(opened) + tip + "</body>" * len(opened)


def _stitch_xml(material: Material) -> str:
    stiffness = material.stitch_stiffness
    own = (
        f'stiffness="{stiffness!r}" damping="{2.0 * stiffness * material.joint_s!r}" '
        f'armature="{stiffness * material.joint_s**2!r}"'
    )
    return "".join(f'<joint type="slide" axis="{axis}" {own}/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))


def _text(values: Float64[np.ndarray, "n"]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _turn(a: Float64[np.ndarray, "3"], b: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "4"]:
    """The shortest rotation from one unit vector to another, wxyz."""
    turn = np.concatenate(([1.0 + a @ b], np.cross(a, b)))
    if turn[0] < 1e-9:
        turn = np.concatenate(([0.0], np.cross(a, np.eye(3)[np.argmin(np.abs(a))])))
    return turn / np.linalg.norm(turn)


def _product(a: Float64[np.ndarray, "4"], b: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "4"]:
    real = a[0] * b[0] - a[1:] @ b[1:]
    product = np.concatenate(([real], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])))
    # rounding would grow along the chain
    return product / np.linalg.norm(product)


def _inverse(a: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "4"]:
    return a * (1.0, -1.0, -1.0, -1.0)


def _rotated_x(attitude: Float64[np.ndarray, "4"]) -> Float64[np.ndarray, "3"]:
    w, x, y, z = attitude
    return np.array([1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)])
