"""A thread that is pulled through tissue: capstan, stretch, beam and conservation in closed form, and what ends it."""

from dataclasses import replace

import numpy as np
import pytest

from agents.simulator.contact.material import NEWTON, SUTURE
from agents.simulator.contact.world import Pose
from agents.simulator.pulling.passage import Passage, bite, most_tension
from agents.simulator.pulling.strand import Anchor, meshed, rested, strand_along, tensions, with_place
from agents.simulator.pulling.world import STANDING, TAIL, PullWorld, law_of
from shared.rendering.stitches import Stitch
from shared.rendering.surface import Surface, flat_surface

GROUND = flat_surface(95.0)
FAR = flat_surface(500.0)
RADIUS = 0.2
LAW = law_of(SUTURE, RADIUS)
GAP = 6.0
HELD_MM = 20.0


def stitch_with(tail_mm=30.0, standing_mm=60.0, knot_mm=None):
    """Both strands straight on level tissue, along x."""

    def strand(first, towards, length):
        x = first + towards * np.linspace(0.0, length, round(length) + 1)
        points = np.column_stack((x, np.zeros_like(x), np.full_like(x, 95.0 - RADIUS)))
        points[0, 2] = 95.0
        return points

    return Stitch(strand(0.0, -1, tail_mm), strand(GAP, 1, standing_mm), RADIUS, knot_mm)


def over(x_mm, jaw_rad, z_mm=95.0 - RADIUS, y_mm=0.0):
    """The tool above a place of the thread, which runs along the pin, 9 mm along the fingers."""
    T = np.eye(4)
    T[:3, 3] = x_mm, y_mm, z_mm - 9.0
    return Pose(T, jaw_rad)


def held_world(material=SUTURE, drag=0.01, **others):
    """A world whose standing strand a jaw holds, close above the tissue."""
    world = PullWorld(stitch_with(**others), GROUND, material, drag)
    x = GAP + HELD_MM
    world.move(over(x, 0.9, 80.0), 0.1)
    world.move(over(x, 0.9, 94.0), 0.5)
    state = world.move(over(x, 0.0, 94.0), 0.3)
    assert (state.held, state.held_mm) == (STANDING, pytest.approx(HELD_MM, abs=0.3))
    return world


def pulled(world, by_mm, speed=10.0):
    """The states while the jaw goes on along x."""
    return [world.move(over(GAP + HELD_MM + x, 0.0, 94.0), 0.5 / speed) for x in np.arange(0.5, by_mm + 0.25, 0.5)]


def test_tension_grows_through_a_bite_as_the_capstan_equation_with_a_drag_says():
    level, friction = np.array([1.0, 0.0, 0.0]), 0.3
    bare = Passage(10.0, np.pi, friction, 0.0)
    # flat on the tissue, half a circle through it, and straight up: a quarter turn more
    assert most_tension(bare, 2.0, -level, np.array([0.0, 0.0, -1.0])) == pytest.approx(2 * np.exp(0.3 * 1.5 * np.pi))
    assert most_tension(replace(bare, turn=0.0, drag=0.02), 0.5, None, None) == pytest.approx(0.5 + 0.2)
    dragged = bite(GAP, friction, 0.01)
    tension, steps = 0.4, 20_000
    for _ in range(steps):
        tension += (friction * dragged.turn * tension + dragged.drag * dragged.length) / steps
    assert most_tension(dragged, 0.4, None, None) == pytest.approx(tension, rel=1e-3)


def test_a_strand_stretches_by_its_length_times_the_force_over_e_a():
    strand = strand_along(np.array([(0.0, 0.0, 50.0), (60.0, 0.0, 50.0)]), LAW)
    ends = Anchor(0, strand.points[0]), Anchor(len(strand.rest), strand.points[-1] + (0.05, 0.0, 0.0))
    force = LAW.axial * 0.05 / strand.length
    taut = rested(strand, replace(LAW, weight=0.0), FAR, ends, 10.0)
    assert LAW.axial == pytest.approx(1e9 * np.pi * RADIUS**2 / NEWTON)
    assert tensions(taut, LAW) == pytest.approx(force, rel=1e-3)


def test_a_clamped_strand_sags_as_a_beam_does():
    length, x = 30.0, np.arange(0.0, 31.0)
    strand = strand_along(np.column_stack((x, 0 * x, np.full_like(x, 50.0))), LAW)
    clamped = Anchor(0, strand.points[0]), Anchor(1, strand.points[1])
    for _ in range(400):
        strand = rested(strand, LAW, FAR, clamped, 0.1)
    sag = LAW.weight * (length - LAW.segment / 2) ** 4 / (8 * LAW.bending)
    assert strand.points[-1, 2] - 50.0 == pytest.approx(sag, rel=0.1)


@pytest.mark.parametrize(("slope_deg", "stays"), [(16.0, True), (17.5, False)])
def test_a_strand_on_a_slope_stays_below_the_angle_of_friction_and_slides_above_it(slope_deg, stays):
    y = np.arange(-40.0, 41.0)
    depth = np.tile(95.0 + np.tan(np.radians(slope_deg)) * y[:, None], (1, 2)).astype(np.float32)
    slope = Surface(depth, 0.0, -40.0, 1.0)
    x = np.arange(0.0, 31.0)
    strand = strand_along(np.column_stack((x, 0 * x, np.full_like(x, 95.0 - RADIUS))), LAW)
    hole = (Anchor(0, strand.points[0]),)
    for _ in range(500):
        strand = rested(strand, LAW, slope, hole, 0.02)
    assert np.degrees(np.arctan(LAW.friction)) == pytest.approx(16.7, abs=0.1)
    fell_mm = strand.points[-1, 1]
    assert fell_mm < 1.0 if stays else fell_mm > 2.0


def test_dividing_and_joining_segments_keeps_length_and_the_fixed_node():
    strand = strand_along(stitch_with().standing, LAW)
    divided, node = with_place(strand, 20.3, LAW)
    assert divided.rest[:node].sum() == pytest.approx(20.3) and divided.length == pytest.approx(strand.length)
    longer = replace(divided, rest=np.concatenate(([5.0], divided.rest[1:])))
    again, at = meshed(longer, LAW, node)
    assert again.length == pytest.approx(longer.length)
    assert again.rest.max() <= 1.6 * LAW.segment and np.array_equal(again.points[at], divided.points[node])


def test_thread_runs_at_the_tension_of_the_capstan_equation_and_none_of_it_is_lost():
    world = held_world()
    length = world.length_mm
    states = pulled(world, 20.0)
    last = states[-1]
    tail, standing = (way / np.linalg.norm(way) for way in (s[1] - s[0] for s in (last.tail, last.standing)))
    assert last.standing_n == pytest.approx(most_tension(world.passage, last.tail_n, tail, standing), abs=3e-3)
    assert last.jaw_n == pytest.approx(last.standing_n, abs=2e-3)
    assert last.held_mm is not None
    # the rest of the way is what the tissue gives; once it does no more, thread comes as fast as the jaw goes
    assert states[19].tail_mm - last.tail_mm == pytest.approx(10.0, abs=0.1)
    assert last.tail_mm + last.held_mm + world.passage.length < length
    assert world.length_mm == pytest.approx(length, abs=1e-9)
    assert last.tissue_n == pytest.approx(world.peak_tissue_n, rel=0.1) and last.tissue_n < 0.5
    ends = np.linalg.norm(np.diff(last.tail, axis=0), axis=1).sum()
    assert ends == pytest.approx(last.tail_mm, abs=0.05)


def test_a_tail_that_comes_to_its_hole_is_pulled_out_and_then_all_of_the_thread():
    world = held_world(tail_mm=10.0)
    states = pulled(world, 35.0)
    first = next(i for i, state in enumerate(states) if state.pulled_out)
    assert states[first].tail_mm == 0.0 and len(states[first].tail) == 0 and not states[first].out
    # friction becomes less as less is in the tissue, and none is left
    tension = [state.standing_n for state in states[first:]]
    assert all(np.diff(tension) < 1e-3)
    assert states[-1].out and states[-1].standing_n < 1e-3 and states[-1].tissue_n < 0.05


def test_a_knot_stops_the_thread_and_tension_rises_until_the_jaw_lets_thread_run():
    weak = replace(SUTURE, grip_n=1.0)
    world = held_world(weak, tail_mm=15.0, knot_mm=8.0)
    states = pulled(world, 30.0)
    knotted = [state for state in states if state.at_knot]
    assert knotted[-1].tail_mm == pytest.approx(8.0, abs=0.06) and not knotted[-1].pulled_out
    # 2 μ N of the jaw
    assert max(state.jaw_n for state in states) == pytest.approx(2 * 0.5 * 1.0, rel=0.02)
    assert states[-1].slipped_mm > 1.0 and states[-1].tail_mm == pytest.approx(8.0, abs=0.06)
    # before it slips, tissue and stretch are springs one after the other
    rise = np.diff([state.jaw_n for state in knotted[2:7]])
    give = 2 * SUTURE.plane_strain_modulus * 0.5 * GAP / NEWTON
    held_mm = knotted[3].held_mm or 0.0
    assert np.mean(rise) == pytest.approx(0.5 / (1 / give + held_mm / LAW.axial), rel=0.05)


def test_a_thread_that_is_let_go_relaxes_and_can_be_taken_again_by_either_strand():
    world = held_world()
    before = pulled(world, 10.0)[-1]
    x = GAP + HELD_MM + 10.0
    world.move(over(x, 0.9, 94.0), 0.3)
    free = world.move(over(x, 0.9, 70.0), 1.0)
    assert (free.held, free.jaw_n) == (None, 0.0) and free.standing_n < 0.05
    assert free.tail_mm == pytest.approx(before.tail_mm, abs=0.2)
    assert np.ptp(free.standing[1:, 2]) < 1.0
    tail_x = free.tail[4, 0]
    world.move(over(tail_x, 0.9, 94.0), 1.0)
    held = world.move(over(tail_x, 0.0, 94.0), 0.3)
    assert held.held == TAIL
    for back in np.arange(1.0, 11.0):
        held = world.move(over(tail_x - back, 0.0, 94.0), 0.1)
    assert held.tail_mm > before.tail_mm + 5.0


def test_fingers_that_close_beside_the_thread_hold_nothing():
    world = PullWorld(stitch_with(), GROUND)
    world.move(over(26.0, 0.9, 94.0, y_mm=8.0), 0.5)
    assert world.move(over(26.0, 0.0, 94.0, y_mm=8.0), 0.3).held is None


def test_the_same_moves_give_the_same_states_bit_by_bit():
    one, other = (pulled(held_world(), 5.0)[-1] for _ in range(2))
    assert np.array_equal(one.standing, other.standing) and one.jaw_n == other.jaw_n
