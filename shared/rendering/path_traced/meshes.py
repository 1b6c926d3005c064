"""The da Vinci Large Needle Driver from its meshes (jhu-dvrk/dvrk_model), at any joint angles.

It is built along z, its shaft at negative z and its jaws at positive z, in mm. Where its parts hang in each other is
read off the meshes.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float64

from shared.rendering.path_traced.solids import Pose, Solid, loft
from shared.rendering.render import SceneError

FORK, WRIST, JAW, WRIST_PIN, FORK_PIN = (
    "roll_4162",
    "wrist_pitch_0091_archived",
    "tip_006",
    "wrist_yaw_0091",
    "roll_4162_yaw",
)
SPACE = "{http://www.collada.org/2005/11/COLLADASchema}"
MM_PER_METRE = 1000.0
LONGEST_EDGE_MM = 1.2
FORK_TO_PIN_MM = 9.6
"""From the beginning of the fork to its pin, along the shaft."""
HANGS_AT, JAWS_AT = np.array((5.25, 0.0, 3.15)), np.array((-3.85, 0.0, 3.15))
"""In the wrist's mesh: where it hangs in the fork, and where the jaws hang in it."""
WRIST_TO_FORK = np.array(((0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0)))
JAW_TO_WRIST = np.array(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
JAW_MM, GRIP_MM = 10.6, 8.8
"""From the jaws' pin to their tip, and to where they hold something."""
TEETH_FROM_MM = 4.5
PLATE_MM = np.array((6.0, 4.0))
"""From the corner of the wrist's finish to the middle of its mesh."""
SHAFT_MM, SHAFT_RADIUS_MM = 330.0, 4.15


@dataclass(frozen=True)
class Joints:
    """Angles in radians: the wrist's two, and how far the jaws are open."""

    pitch: float
    yaw: float
    opening: float


def driver_parts(folder: str | Path) -> dict[str, Solid]:
    """The driver's meshes by name, each in its own frame.

    Raises:
        SceneError: where one of them is absent or cannot be read; the text names it.
    """
    return _read_all(str(folder))


def driver(parts: dict[str, Solid], joints: Joints) -> list[Solid]:
    """The driver along z at these joint angles."""
    finger = _finger(parts[JAW])
    hang, shift = _wrist_frame(joints)
    distal = [_engraved(parts[WRIST]), _moved(parts[WRIST_PIN], np.eye(3), JAWS_AT * (1.0, 1.0, 0.0))]
    for half, flip in ((0.5 * joints.opening, 0.0), (-0.5 * joints.opening, np.pi)):
        turn = JAW_TO_WRIST @ turned_about(2, joints.yaw + half) @ turned_about(1, flip)
        distal += [_moved(part, turn, JAWS_AT) for part in finger]
    pin = _moved(parts[FORK_PIN], turned_about(1, 0.5 * np.pi), np.array((-4.01, 0.0, FORK_TO_PIN_MM)))
    return [*(_moved(part, hang, shift) for part in distal), parts[FORK], pin, *_wheels(), *_shaft()]


def jaw_frame(joints: Joints) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]]:
    """Of the jaws' middle in the driver's frame: x across them, y towards their tip, z along their pin; and the pin."""
    hang, shift = _wrist_frame(joints)
    return hang @ JAW_TO_WRIST @ turned_about(2, joints.yaw), hang @ JAWS_AT + shift


def placed(parts: list[Solid], turn: Float64[np.ndarray, "3 3"], shift: Float64[np.ndarray, "3"]) -> list[Solid]:
    """Solids turned, then shifted."""
    return [_moved(part, turn, shift) for part in parts]


def posed(parts: dict[str, Solid], pose: Pose, joints: Joints) -> list[Solid]:
    """The driver whose jaws end at the pose's tip, its shaft as the pose says."""
    along = -pose.towards_shaft
    turn = np.column_stack((pose.across, np.cross(along, pose.across), along))
    frame, pin = jaw_frame(joints)
    tip = pin + JAW_MM * frame[:, 1]
    return placed(driver(parts, joints), turn, pose.tip - turn @ tip)


def drawn_joints(rng: np.random.Generator, opening: float | None = None) -> Joints:
    """Joint angles as they are at work; the jaws closed in a third unless `opening` is given."""
    pitch, yaw = np.clip(rng.normal(0.0, 0.5, 2), -1.2, 1.2)
    drawn = float(rng.choice((0.0, 1.0), p=(0.35, 0.65)) * rng.uniform(0.1, 1.0))
    return Joints(float(pitch), float(yaw), drawn if opening is None else opening)


def turned_about(axis: int, angle: float) -> Float64[np.ndarray, "3 3"]:
    """Rotation about x, y or z by an angle in radians."""
    turn, (a, b) = np.eye(3), ((1, 2), (2, 0), (0, 1))[axis]
    turn[a, a] = turn[b, b] = np.cos(angle)
    turn[a, b], turn[b, a] = -np.sin(angle), np.sin(angle)
    return turn


@lru_cache(maxsize=2)
def _read_all(folder: str) -> dict[str, Solid]:
    return {name: read_mesh(Path(folder) / f"{name}.dae") for name in (FORK, WRIST, JAW, WRIST_PIN, FORK_PIN)}


def read_mesh(path: Path) -> Solid:
    """A COLLADA file's first body, every triangle with corners of its own, none with an edge longer than 1.2 mm.

    Raises:
        SceneError: where it is absent or in another form.
    """
    try:
        root = ElementTree.parse(path).getroot()  # noqa: S314
        body = next(one for one in root.iter(f"{SPACE}geometry") if one.get("id", "").startswith("Actor"))
        listed = [_numbers(one) for one in list(body.iter(f"{SPACE}float_array"))[:2]]
        points, normals = (values.reshape(-1, 3) for values in listed)
        which = _numbers(next(next(body.iter(f"{SPACE}triangles")).iter(f"{SPACE}p"))).astype(int).reshape(-1, 3, 2)
    except OSError as error:
        raise SceneError(f"cannot read {path} ({error.strerror}); --meshes names the folder of the *.dae") from error
    except (ElementTree.ParseError, StopIteration, ValueError) as error:
        raise SceneError(f"{path} is no mesh of triangles with normals as dvrk_model has them") from error
    return _of_corners(*_split(MM_PER_METRE * points[which[..., 0]], normals[which[..., 1]]))


def _numbers(element: ElementTree.Element) -> Float64[np.ndarray, "n"]:
    return np.array((element.text or "").split(), dtype=np.float64)


def _split(
    corners: Float64[np.ndarray, "t 3 3"], normals: Float64[np.ndarray, "t 3 3"]
) -> tuple[Float64[np.ndarray, "u 3 3"], Float64[np.ndarray, "u 3 3"]]:
    """Long triangles cut in two at their longest edge until none is long."""
    for _ in range(14):
        edges = np.linalg.norm(corners - np.roll(corners, -1, 1), axis=2)
        long = edges.max(axis=1) > LONGEST_EDGE_MM
        if not long.any():
            break
        order = (edges[long].argmax(axis=1)[:, None] + np.arange(3)) % 3
        halves: list[np.ndarray] = []
        for values in (corners, normals):
            a, b, c = (values[long][np.arange(long.sum()), order[:, at]] for at in range(3))
            middle = 0.5 * (a + b)
            halves.append(np.concatenate((np.stack((a, middle, c), 1), np.stack((middle, b, c), 1))))
        corners = np.concatenate((corners[~long], halves[0]))
        normals = np.concatenate((normals[~long], halves[1]))
    return corners, normals


def _of_corners(corners: Float64[np.ndarray, "t 3 3"], normals: Float64[np.ndarray, "t 3 3"]) -> Solid:
    """A solid of triangles that share no corners, with a texture that lies flat on each of its six sides, in mm."""
    facing = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    side = facing.argmax(axis=1)
    axes = np.array(((1, 2), (0, 2), (0, 1)))
    texture = np.take_along_axis(corners, np.repeat(axes[side][:, None], 3, axis=1), axis=2)
    unit = normals / np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-9)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    flat = corners.reshape(-1, 3)
    return Solid(flat, faces, "worn", 1.0, unit.reshape(-1, 3), texture.reshape(-1, 2), "worn")


def _engraved(wrist: Solid) -> Solid:
    """The wrist, whose finish has a beginning: letters are on it once."""
    texture = None if wrist.texture is None else wrist.texture + PLATE_MM
    return replace(wrist, texture=texture, finish="engraved")


def _finger(jaw: Solid) -> list[Solid]:
    """A jaw as thick as real ones are, which its mesh is not, narrowing towards its tip; its teeth are a part apart."""
    x, y, z = jaw.vertices.T
    outer = np.clip((y - 2.6) / 1.8, 0.0, 1.0)
    narrow = 1.0 - 0.3 * np.clip((y - 3.0) / 7.6, 0.0, 1.0)
    narrow *= np.sqrt(1.0 - 0.8 * np.clip((y - 9.8) / 0.8, 0.0, 1.0) ** 2)
    thick = 2.3 * narrow * (np.minimum(z, 0.0) + 0.3)
    points = np.column_stack((x * narrow, y, z + outer * (thick - z)))
    corners = points[jaw.faces]
    inner = (np.abs(corners[..., 0]).max(axis=1) < 0.12) & (corners[..., 1].min(axis=1) > TEETH_FROM_MM)
    whole = replace(jaw, vertices=points)
    teeth = replace(whole, faces=jaw.faces[inner], texture=points[:, 1:], finish="toothed")
    return [replace(whole, faces=jaw.faces[~inner]), teeth] if inner.any() else [whole]


def _wrist_frame(joints: Joints) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "3"]]:
    hang = turned_about(0, joints.pitch) @ WRIST_TO_FORK
    return hang, np.array((0.0, 0.0, FORK_TO_PIN_MM)) - hang @ HANGS_AT


def _wheels() -> list[Solid]:
    """The wheels in the fork over which the cables run."""
    across, wide = np.array((0.0, 1.0, 0.0)), np.array((0.9, 1.0, 1.0, 0.9))
    ends = [np.array([(x + 0.2 * k, 0.0, FORK_TO_PIN_MM) for k in range(4)]) for x in (-2.9, -2.0, 1.4, 2.3)]
    return [loft(line, 2.3 * wide, 2.3 * wide, across, "steel", 1.0) for line in ends]


def _shaft() -> list[Solid]:
    """The black shaft; its end towards the fork is rounded."""
    across = np.array((1.0, 0.0, 0.0))
    along = np.array((0.0, -0.15, -0.4, -3.0, -0.5 * SHAFT_MM, -SHAFT_MM))
    wide = SHAFT_RADIUS_MM * np.array((0.92, 0.98, 1.0, 1.0, 1.0, 1.0))
    line = np.column_stack((0.0 * along, 0.0 * along, along))
    return [replace(loft(line, wide, wide, across, "black", 0.0), finish="shaft")]


def _moved(solid: Solid, turn: Float64[np.ndarray, "3 3"], shift: Float64[np.ndarray, "3"]) -> Solid:
    normals = None if solid.normals is None else solid.normals @ turn.T
    return replace(solid, vertices=solid.vertices @ turn.T + shift, normals=normals)
