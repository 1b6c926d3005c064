"""Needle drivers over a field: some stand by, and one may hold the needle or the thread's end in its jaws."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from shared.camera import project
from shared.rendering.path_traced.field import Field
from shared.rendering.path_traced.meshes import GRIP_MM, drawn_joints, driver, jaw_frame, placed, posed, turned_about
from shared.rendering.path_traced.placing import STRAY_SHARE, Maker, above_ground, hidden
from shared.rendering.path_traced.solids import Solid, pose_towards, silhouette
from shared.rendering.path_traced.splines import end_directions, sampled

ATTEMPTS, TRIED = 400, 40
RISE = (0.15, 1.1)
"""Of the shaft towards the camera, in radians; as instruments come in through ports."""
HELD_FROM_END_MM = 1.2
PRESSED = 0.9
NEEDLE_HELD = (0.35, 0.8)
MOST_HIDDEN, MOST_COVERED = 0.6, 0.25


def driver_maker(parts: dict[str, Solid]) -> Maker:
    """Makes needle drivers at random joint angles."""

    def made(tip: Float64[np.ndarray, "3"], rng: np.random.Generator) -> list[Solid]:
        rise, roll = rng.uniform(*RISE), rng.uniform(0.0, 2.0 * np.pi)
        return posed(parts, pose_towards(tip, rng.uniform(0.0, 2.0 * np.pi), rise, roll), drawn_joints(rng))

    return made


def holding_needle(field: Field, parts: dict[str, Solid], rng: np.random.Generator) -> Field:
    """The field with a driver whose jaws hold the needle, or as it was where there is none, or no room."""
    if field.needle is None:
        return field
    points, arc = sampled(field.needle.curve, 0.2)
    along = np.gradient(points, axis=0)
    for _ in range(TRIED):
        k = int(np.searchsorted(arc, rng.uniform(*NEEDLE_HELD) * arc[-1]))
        tools = _gripping(parts, points[k], along[k], 2.0 * field.needle.radius_mm, rng)
        pixels = project(field.camera, points)[0]
        if tools and above_ground(tools, field) and _leaves_view(field, tools, pixels, MOST_HIDDEN):
            return replace(field, tools=[*field.tools, *tools])
    return field


def holding_thread(field: Field, parts: dict[str, Solid], rng: np.random.Generator) -> Field:
    """The field with a driver whose jaws hold the end of the last thread, or as it was where there is no room."""
    strand = field.strands[-1]
    end = strand.curve.at(np.array([float(strand.curve.spans)]))[0]
    outward = end_directions(strand.curve)[1]
    pixels = project(field.camera, sampled(strand.curve, 0.5)[0])[0]
    for _ in range(TRIED):
        place = end - HELD_FROM_END_MM * outward
        tools = _gripping(parts, place, outward, 2.0 * strand.radius_mm, rng)
        if tools and above_ground(tools, field) and _leaves_view(field, tools, pixels, STRAY_SHARE):
            return replace(field, tools=[*field.tools, *tools])
    return field


def _leaves_view(field: Field, tools: list[Solid], pixels: Float64[np.ndarray, "n 2"], share: float) -> bool:
    """Whether tools hide less than a share of what they hold, and not much of the field."""
    cover = silhouette(field.camera, tools)
    return hidden(cover, pixels) < share and float((cover > 0).mean()) < MOST_COVERED


def _gripping(
    parts: dict[str, Solid],
    place: Float64[np.ndarray, "3"],
    along: Float64[np.ndarray, "3"],
    thickness_mm: float,
    rng: np.random.Generator,
) -> list[Solid]:
    """A driver whose jaws close on something that runs through a place in that direction; none where none comes in."""
    axis = along / np.linalg.norm(along)
    aside = np.cross(axis, [0.0, 0.0, 1.0])
    aside = aside / max(float(np.linalg.norm(aside)), 1e-6)
    first = np.column_stack((np.cross(aside, axis), aside, axis))
    for _ in range(ATTEMPTS):
        joints = drawn_joints(rng, PRESSED * thickness_mm / GRIP_MM)
        # its jaws' pin runs about along what they hold
        jaws = first @ turned_about(2, rng.uniform(0.0, 2.0 * np.pi)) @ turned_about(1, rng.normal(0.0, 0.25))
        frame, pin = jaw_frame(joints)
        turn = jaws @ frame.T
        towards = -turn[:, 2]
        if RISE[0] < np.arcsin(np.clip(-towards[2], -1.0, 1.0)) < RISE[1]:
            return placed(driver(parts, joints), turn, place - turn @ (pin + GRIP_MM * frame[:, 1]))
    return []
