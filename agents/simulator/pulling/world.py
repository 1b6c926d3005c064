"""A thread through tissue and the jaw that pulls it, stepped from one pose of the tool to the next.

Each strand comes to rest by itself (strand.py). What joins them is the thread in the tissue (passage.py): where the
tension of one strand is more than friction holds back, thread runs from the other one to it. A jaw that holds a strand
is a node of it in a given place, and thread runs through the jaw where friction of both fingers does not hold it.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from agents.simulator.contact.material import NEWTON, SUTURE, Material
from agents.simulator.contact.tissue import press_n
from agents.simulator.contact.world import Pose
from agents.simulator.field import MM
from agents.simulator.judgement import OPEN_RAD, Grip, first_grip, followed, touching_rad
from agents.simulator.pulling.passage import Passage, bite, most_tension
from agents.simulator.pulling.strand import (
    CREEP_MM_PER_S,
    Anchor,
    Law,
    Strand,
    meshed,
    rested,
    strand_along,
    tensions,
    with_place,
)
from agents.simulator.world import LET_GO_RAD
from schemas.messages import Verdict
from shared.rendering.stitches import Stitch
from shared.rendering.surface import Surface
from shared.rigid_transforms import apply, inverse

TAIL, STANDING = "tail", "standing"
DRAG_N_PER_MM = 0.01
"""With which tissue holds back thread that runs through it; assumed."""
SEGMENT_MM = 2.0
STEP_S, STEP_MM = 0.02, 0.3
"""The longest step of time, and the farthest that a tool goes in one."""
SETTLING_S = 2.0
CENTRED_MM_PER_S = 20.0
"""How fast fingers that have closed bring a thread into their middle."""
SAMPLE_MM = 0.2
ENOUGH_N, ROUNDS = 1e-3, 6
"""Thread that runs does so until tension is so near to friction, or for so many rounds in a step."""
LEAST_MM = 0.05
"""Of a strand: what is shorter is gone."""


@dataclass(frozen=True)
class Pulled:
    """The true state of a pulled thread. Millimetres in the camera's frame, newtons.

    Fields:
        tail, standing: centrelines of both strands, each from its hole to its end; no points where there is none left.
        tail_mm: length of the tail along the thread, without stretch.
        jaw_n: tension of the thread between hole and jaw; 0 where no jaw holds it.
        tail_n, standing_n: tension of the strands at their holes.
        tissue_n: force on the tissue, of the thread in its holes and of the fingers.
        held: which strand a jaw holds, None where none does; `held_mm`: how far along from its hole.
        slipped_mm: how much thread has run through closed fingers.
        pulled_out: whether the tail has gone through its hole; `out`: whether all of the thread has.
        at_knot: whether a knot is at the hole.
    """

    tail: Float64[np.ndarray, "n 3"]
    standing: Float64[np.ndarray, "m 3"]
    tail_mm: float
    jaw_n: float
    tail_n: float
    standing_n: float
    tissue_n: float
    held: str | None
    held_mm: float | None
    slipped_mm: float
    pulled_out: bool
    out: bool
    at_knot: bool


@dataclass(frozen=True)
class _Side:
    """One side of the bite: its strand, None once it has gone, and where its hole is at rest.

    Fields:
        grip: the fingers about the strand, as for a grasp.
        rests: nothing has happened to it since it came to rest.
    """

    strand: Strand | None
    hole: Float64[np.ndarray, "3"]
    grip: Grip | None = None
    rests: bool = False


@dataclass(frozen=True)
class _Hold:
    """A jaw on a strand: at which of its nodes, where in the tool's frame, and the opening at which it lets go.

    Fields:
        moves: the tool does, or brings the thread into the middle of its fingers.
    """

    side: str
    node: int
    place_tool: Float64[np.ndarray, "3"]
    let_go_rad: float
    moves: bool = True


@dataclass(frozen=True)
class _Samples:
    """A strand as the fingers meet it: dense samples in metres."""

    points: Float64[np.ndarray, "n 3"]
    radius_m: float
    way_mm: Float64[np.ndarray, "n"] = field(repr=False)


class PullWorld:
    """A stitch whose thread has come to rest on the tissue, and one tool. The same moves give the same states."""

    def __init__(
        self, stitch: Stitch, surface: Surface, material: Material = SUTURE, drag: float = DRAG_N_PER_MM
    ) -> None:
        gap = float(np.linalg.norm(stitch.holes[1] - stitch.holes[0]))
        self.passage: Passage = bite(gap, material.tissue_friction, drag)
        self.law = law_of(material, stitch.radius_mm)
        self._stitch, self._surface, self._material = stitch, surface, material
        # a bite is drawn out of its place as a disc of its size would be (Sneddon 1965)
        self._give = 2.0 * material.plane_strain_modulus * 0.5 * gap / NEWTON
        self._inside = self.passage.length
        self._sides = {
            TAIL: _Side(strand_along(stitch.tail, self.law), stitch.tail[0]),
            STANDING: _Side(strand_along(stitch.standing, self.law), stitch.standing[0]),
        }
        self._hold: _Hold | None = None
        self._tool: Pose | None = None
        self._slipped, self._pulled_out, self._press_n = 0.0, False, 0.0
        self.peak_tissue_n = 0.0
        for _ in range(round(SETTLING_S / STEP_S)):
            self._step(STEP_S)

    def move(self, pose: Pose, elapsed_s: float) -> Pulled:
        """Move the tool evenly to a pose, in so much time; the pose in millimetres."""
        before = pose if self._tool is None else self._tool
        went = float(np.linalg.norm(pose.T_camera_tool[:3, 3] - before.T_camera_tool[:3, 3]))
        steps = max(int(np.ceil(elapsed_s / STEP_S - 1e-9)), int(np.ceil(went / STEP_MM)), 1)
        for k in range(1, steps + 1):
            was, self._tool = self._tool, _between(before, pose, k / steps)
            self._grasp(self._tool, elapsed_s / steps, was)
            self._step(elapsed_s / steps)
            half = 0.5 * max(self._tool.jaw_rad, 0.0)
            self._press_n = press_n(self._surface, self._tool.T_camera_tool, (half, half), self._material)
            self.peak_tissue_n = max(self.peak_tissue_n, self.state.tissue_n)
        return self.state

    @property
    def state(self) -> Pulled:
        """All that is true of the thread now."""
        tail, standing = self._sides[TAIL].strand, self._sides[STANDING].strand
        held = None if self._hold is None else self._hold.side
        none = np.zeros((0, 3))
        return Pulled(
            tail=none if tail is None else tail.points,
            standing=none if standing is None else standing.points,
            tail_mm=0.0 if tail is None else tail.length,
            jaw_n=self._jaw_tensions()[0],
            tail_n=self._hole_tension(TAIL),
            standing_n=self._hole_tension(STANDING),
            tissue_n=self._hole_force() + self._press_n,
            held=held,
            held_mm=self._held_mm(),
            slipped_mm=self._slipped,
            pulled_out=self._pulled_out,
            out=self._inside <= 0.0,
            at_knot=tail is not None and self._stitch.knot_mm is not None and self._left(TAIL) <= LEAST_MM,
        )

    @property
    def length_mm(self) -> float:
        """Of the whole thread at rest, which stays."""
        return self._inside + sum(side.strand.length for side in self._sides.values() if side.strand is not None)

    def _step(self, elapsed_s: float) -> None:
        """Come to rest, and let thread run where friction does not hold it; each round has all of the time for it."""
        self._rest(elapsed_s)
        for _ in range(ROUNDS):
            if not (self._run_through_jaw() | self._run_through_tissue()):
                break
            self._rest(elapsed_s)

    def _rest(self, elapsed_s: float) -> None:
        for name, side in self._sides.items():
            if side.strand is not None and not (side.rests and not self._is_led(name)):
                strand = rested(side.strand, self.law, self._surface, self._anchors(name), elapsed_s)
                moved = float(np.abs(strand.points - side.strand.points).max())
                # what creeps is held by friction, until something happens to it
                self._sides[name] = replace(side, strand=strand, rests=moved < CREEP_MM_PER_S * elapsed_s)

    def _is_led(self, name: str) -> bool:
        """Whether a jaw that holds the strand has come to another place."""
        return self._hold is not None and self._hold.side == name and self._hold.moves

    def _anchors(self, name: str) -> tuple[Anchor, ...]:
        anchors = [Anchor(0, self._sides[name].hole, self._give)] if self._inside > 0.0 else []
        if self._hold is not None and self._hold.side == name and self._tool is not None:
            place = apply(self._tool.T_camera_tool, self._hold.place_tool[None])[0]
            anchors.append(Anchor(self._hold.node, place))
        return tuple(anchors)

    def _run_through_tissue(self) -> bool:
        """Let thread run through the bite; whether any did."""
        for pulls, gives in ((STANDING, TAIL), (TAIL, STANDING)):
            pulling = self._sides[pulls].strand
            if pulling is None or self._inside <= 0.0:
                continue
            share = replace(self.passage, length=self._inside, turn=self.passage.turn * self._share_inside)
            directions = self._direction(gives), self._direction(pulls)
            over = self._hole_tension(pulls) - most_tension(share, self._hole_tension(gives), *directions)
            if over > ENOUGH_N:
                return self._run(pulls, gives, over / self._stiffness(pulling, pulls))
        return False

    @property
    def _share_inside(self) -> float:
        return self._inside / self.passage.length

    def _stiffness(self, strand: Strand, name: str) -> float:
        """At most how fast the tension at a hole falls as thread comes out of it, in N/mm."""
        taut = strand.rest[: self._hold.node].sum() if self._hold and self._hold.side == name else strand.length
        return 1.0 / (1.0 / self._give + taut / self.law.axial)

    def _run(self, pulls: str, gives: str, wanted: float) -> bool:
        """Take so much thread from one strand, or from the tissue once that has gone, to the other."""
        giving, pulling = self._sides[gives].strand, self._sides[pulls].strand
        assert pulling is not None  # noqa: S101 - what pulls is there
        runs = min(wanted, 0.5 * self.law.segment, self._left(gives) if giving is not None else self._inside)
        if runs <= 0.0:
            return False
        if giving is None:
            self._inside = max(float(self._inside - runs), 0.0)
        elif giving.length - runs < LEAST_MM:
            runs = giving.length
            self._lose(gives)
        else:
            self._lengthen(gives, -runs)
        self._lengthen(pulls, runs)
        return True

    def _left(self, name: str) -> float:
        """How much of a strand may go into its hole: up to a knot, or to the jaw."""
        strand = self._sides[name].strand
        if strand is None:
            return 0.0
        if self._hold is not None and self._hold.side == name:
            return max(float(strand.rest[: self._hold.node].sum()) - LEAST_MM, 0.0)
        knot = self._stitch.knot_mm if name == TAIL else None
        return max(strand.length - (knot or 0.0), 0.0)

    def _lose(self, name: str) -> None:
        self._sides[name] = replace(self._sides[name], strand=None, grip=None)
        self._pulled_out = self._pulled_out or name == TAIL
        if self._hold is not None and self._hold.side == name:
            self._hold = None

    def _lengthen(self, name: str, by: float) -> None:
        """Give thread to a strand at its hole, or take it there."""
        strand = self._sides[name].strand
        assert strand is not None  # noqa: S101 - what has gone is not lengthened
        while by < 0.0 and strand.rest[0] + by < LEAST_MM and len(strand.rest) > 1:
            # what is left of the first segment goes in, and its place is taken by the next node
            by += strand.rest[0]
            strand = Strand(strand.points[1:], strand.rest[1:], strand.bend[1:])
            if self._hold is not None and self._hold.side == name:
                self._hold = replace(self._hold, node=self._hold.node - 1)
        rest = strand.rest.copy()
        rest[0] += by
        self._remeshed(name, replace(strand, rest=rest))

    def _remeshed(self, name: str, strand: Strand) -> None:
        hold = self._hold if self._hold is not None and self._hold.side == name else None
        strand, node = meshed(strand, self.law, None if hold is None else hold.node)
        self._sides[name] = replace(self._sides[name], strand=strand, rests=False)
        if hold is not None:
            self._hold = replace(hold, node=node)

    def _run_through_jaw(self) -> bool:
        """Let thread run through closed fingers, towards the greater tension; whether any did."""
        hold = self._hold
        strand = None if hold is None else self._sides[hold.side].strand
        if hold is None or strand is None:
            return False
        inner, outer = self._jaw_tensions()
        over = abs(inner - outer) - 2.0 * self._material.finger_friction * self._material.grip_n
        if over <= ENOUGH_N:
            return False
        k, towards = hold.node, -1 if inner > outer else 1
        gives = k if towards < 0 else k - 1
        taut = float(strand.rest[:k].sum() if towards < 0 else strand.rest[k:].sum())
        runs = min(over / (1.0 / (1.0 / self._give + taut / self.law.axial)), 0.5 * strand.rest[gives])
        rest = strand.rest.copy()
        rest[gives] -= runs
        rest[gives + towards] += runs
        self._slipped += float(runs)
        if (rest[k:] if towards < 0 else rest[:k]).sum() < 0.05:
            # its end has run through
            self._let_go()
        self._remeshed(hold.side, replace(strand, rest=rest))
        return True

    def _jaw_tensions(self) -> tuple[float, float]:
        """Between hole and jaw, and beyond the jaw."""
        strand = None if self._hold is None else self._sides[self._hold.side].strand
        if self._hold is None or strand is None:
            return 0.0, 0.0
        along, node = tensions(strand, self.law), self._hold.node
        return float(along[node - 1]) if node else 0.0, float(along[node]) if node < len(along) else 0.0

    def _hole_tension(self, name: str) -> float:
        strand = self._sides[name].strand
        return 0.0 if strand is None else float(tensions(strand, self.law)[0])

    def _direction(self, name: str) -> Float64[np.ndarray, "3"] | None:
        strand = self._sides[name].strand
        if strand is None:
            return None
        way = strand.points[1] - strand.points[0]
        return way / max(float(np.linalg.norm(way)), 1e-9)

    def _hole_force(self) -> float:
        """What both strands together pull at the tissue with."""
        pull = np.zeros(3)
        for name in self._sides:
            direction = self._direction(name)
            if direction is not None and self._inside > 0.0:
                pull += self._hole_tension(name) * direction
        return float(np.linalg.norm(pull))

    def _held_mm(self) -> float | None:
        strand = None if self._hold is None else self._sides[self._hold.side].strand
        return None if self._hold is None or strand is None else float(strand.rest[: self._hold.node].sum())

    def _grasp(self, tool: Pose, elapsed_s: float, was: Pose | None) -> None:
        """Take a strand between closing fingers, keep it, or let it go."""
        if self._hold is None:
            self._close(tool)
        elif tool.jaw_rad > self._hold.let_go_rad:
            self._let_go()
        else:
            x, y, z = self._hold.place_tool
            middle = np.array((x, 0.0, np.hypot(y, z)))
            off = middle - self._hold.place_tool
            share = min(1.0, CENTRED_MM_PER_S * elapsed_s / max(float(np.linalg.norm(off)), 1e-9))
            stands = was is not None and np.array_equal(was.T_camera_tool, tool.T_camera_tool) and not off.any()
            self._hold = replace(self._hold, place_tool=self._hold.place_tool + share * off, moves=not stands)

    def _let_go(self) -> None:
        assert self._hold is not None  # noqa: S101 - only what is held is let go
        self._sides[self._hold.side] = replace(self._sides[self._hold.side], rests=False)
        self._hold = None

    def _close(self, tool: Pose) -> None:
        T_camera_tool = tool.T_camera_tool.copy()
        T_camera_tool[:3, 3] *= MM
        for name in (STANDING, TAIL):
            side = self._sides[name]
            if side.strand is None:
                continue
            samples = _samples(side.strand, self.law.radius)
            reopened = side.grip is not None and side.grip.verdict is not None and tool.jaw_rad >= OPEN_RAD
            if side.grip is None or reopened:
                side = replace(side, grip=first_grip(T_camera_tool, tool.jaw_rad))
            assert side.grip is not None  # noqa: S101 - just made
            was, grip = side.grip.verdict, followed(side.grip, T_camera_tool, tool.jaw_rad, samples)
            self._sides[name] = replace(side, grip=grip)
            if grip.verdict is Verdict.HELD and was is None and grip.sample is not None and self._hold is None:
                self._take(name, samples, grip.sample, tool)

    def _take(self, name: str, samples: _Samples, sample: int, tool: Pose) -> None:
        side = self._sides[name]
        assert side.strand is not None  # noqa: S101 - it is between the fingers
        strand, node = with_place(side.strand, float(samples.way_mm[sample]), self.law)
        place = apply(inverse(tool.T_camera_tool), strand.points[node][None])[0]
        lets_go = touching_rad(MM * float(np.hypot(*place[1:])), samples) + LET_GO_RAD
        self._sides[name] = replace(side, strand=strand, grip=None, rests=False)
        self._hold = _Hold(name, node, place, lets_go)


def law_of(material: Material, radius_mm: float) -> Law:
    """How a strand of that thread behaves on its tissue, in newtons."""
    return Law(
        axial=material.bending_modulus * np.pi * radius_mm**2 / NEWTON,
        bending=material.bending_modulus * material.second_moment(radius_mm) / NEWTON,
        weight=material.weight(radius_mm) / NEWTON,
        tissue=material.line_stiffness(1.0) / NEWTON,
        friction=material.tissue_friction,
        radius=radius_mm,
        segment=SEGMENT_MM,
    )


def _samples(strand: Strand, radius_mm: float) -> _Samples:
    way = np.concatenate(([0.0], np.cumsum(strand.rest)))
    even = np.linspace(0.0, way[-1], max(round(way[-1] / SAMPLE_MM), 2) + 1)
    points = np.column_stack([np.interp(even, way, axis) for axis in strand.points.T])
    return _Samples(MM * points, MM * radius_mm, even)


def _between(before: Pose, after: Pose, share: float) -> Pose:
    T = after.T_camera_tool.copy()
    a, b = before.T_camera_tool, after.T_camera_tool
    T[:3, 3] = a[:3, 3] + share * (b[:3, 3] - a[:3, 3])
    turn = Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T).as_rotvec()
    T[:3, :3] = Rotation.from_rotvec(share * turn).as_matrix() @ a[:3, :3]
    return Pose(T, before.jaw_rad + share * (after.jaw_rad - before.jaw_rad))
