"""Contact physics against closed forms, and whole grasps that contact decides; skipped where MuJoCo is missing."""

import importlib.util
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from agents.simulator.agent import Simulator, SimulatorConfig
from agents.simulator.contact.engine import PhysicsError
from agents.simulator.contact.grasp import Attempt, noted, outcome
from agents.simulator.contact.material import NEWTON, SUTURE, Material
from agents.simulator.contact.model import FINGER_MM, WIDTH_MM
from agents.simulator.contact.tissue import planes_beneath, press_n
from agents.simulator.contact.world import ContactWorld, Pose, Touch
from agents.simulator.field import Field, field_with
from schemas.codec import encode
from schemas.messages import Verdict
from shared.rendering.centreline import Thread
from shared.rendering.surface import Surface, flat_surface
from shared.rigid_transforms import transform
from shared.splines import clamped_uniform_knots
from tests.agents.simulator.test_agent import Run, direct, raised, tool_at

DOWN = np.diag((1.0, 1.0, 1.0))
MISSING = importlib.util.find_spec("mujoco") is None
needs_mujoco = pytest.mark.skipif(MISSING, reason="contact physics needs the extra sim: make sim")


def straight(above_mm: float, length_mm: float = 60.0) -> Field:
    """A straight thread of 0.2 mm so far above a plane that faces the camera."""
    ends = np.linspace((0.0, 0.0, 95.0 - 0.2 - above_mm), (length_mm, 0.0, 95.0 - 0.2 - above_mm), 6)
    return field_with(Thread(clamped_uniform_knots(6), ends, 0.2), flat_surface(95.0))


def over(x_mm: float, lift_mm: float = 0.0, aside_mm: float = 0.0) -> np.ndarray:
    """The tool 8.2 mm above the plane's thread, in millimetres, its pin along it."""
    return transform(DOWN, np.array([x_mm, aside_mm, 95.0 - 0.2 - 8.2 - lift_mm]))


@pytest.mark.skipif(not MISSING, reason="MuJoCo is installed")
def test_without_mujoco_one_sentence_names_the_remedy():
    with pytest.raises(PhysicsError, match="run make sim"):
        Simulator(SimulatorConfig(background="plain", physics="contact"))


@needs_mujoco
def test_a_clamped_thread_sags_as_beam_theory_has_it():
    length, material = 30.0, Material()
    w, EI = material.weight(0.2), material.bending_modulus * material.second_moment(0.2)
    world = ContactWorld(straight(10.0, length))
    # the clamp is a segment, and the first joint stands for half of it
    free = length - 0.5 * length / round(length / material.segment_mm)
    sag = 1e3 * (world.field.points[:, 2].max()) - (95.0 - 0.2 - 10.0)
    assert sag == pytest.approx(w * free**4 / (8.0 * EI), rel=0.1)


@needs_mujoco
def test_a_thread_at_rest_presses_on_tissue_with_its_weight_and_hardly_sinks_in():
    world = ContactWorld(straight(0.0))
    weight_n = SUTURE.weight(0.2) * 60.0 / NEWTON
    carried_n = world.pressing_n()
    assert carried_n == pytest.approx(weight_n * 19 / 20, rel=0.1)
    assert np.abs(1e3 * world.field.points[:, 2] - 94.8).max() < 0.02


@needs_mujoco
def test_closed_fingers_lift_a_thread_without_slip_and_open_ones_let_it_fall():
    world = ContactWorld(straight(0.05))
    for jaw in np.linspace(0.4, 0.0, 30):
        world.move("psm1", Pose(over(30.0), float(jaw)), 0.01)
    gripped = world.touch("psm1")
    assert gripped.between is not None
    # a jaw of limited torque, 8.2 mm from its pin
    assert gripped.squeeze_n == pytest.approx(SUTURE.grip_n * FINGER_MM / 8.2, rel=0.05)
    for lift in np.linspace(0.0, 4.0, 40):
        world.move("psm1", Pose(over(30.0, lift), 0.0), 0.01)
    held = world.touch("psm1")
    assert held.between == pytest.approx(gripped.between, abs=8)
    assert world.field.points[round(held.between or 0), 2] == pytest.approx(90.8e-3, abs=0.3e-3)
    energies = []
    for jaw in [*np.linspace(0.0, 0.6, 20), *[0.6] * 40]:
        world.move("psm1", Pose(over(30.0, 4.0), float(jaw)), 0.01)
        energies.append(world.energy_j())
    assert world.touch("psm1").between is None
    assert 1e3 * world.field.points[:, 2].min() > 93.5
    # what falls ends with less than it had, and what is gone stays gone
    assert energies[-1] < 0.9 * energies[0]
    assert all(after < before + 0.05 * energies[0] for before, after in pairwise(energies))


@pytest.mark.slow
@needs_mujoco
def test_a_held_thread_does_not_creep_and_slips_when_pulled_with_the_friction_of_both_fingers():
    weak = replace(SUTURE, grip_n=0.2)
    world = ContactWorld(straight(0.05), weak)
    for jaw in np.linspace(0.4, 0.0, 30):
        world.move("psm1", Pose(over(30.0), float(jaw)), 0.01)
    squeeze_n, first = world.touch("psm1").squeeze_n, world.touch("psm1").between
    for _ in range(20):
        world.move("psm1", Pose(over(30.0), 0.0), 0.01)
    # nothing was computed at last, and nothing has come of that
    stood = world.stepped_s
    world.move("psm1", Pose(over(30.0), 0.0), 0.01)
    assert world.stepped_s == stood
    assert world.touch("psm1").squeeze_n == pytest.approx(squeeze_n, rel=0.02)
    drawn_n = []
    for pulled in np.linspace(0.1, 6.0, 60):
        world.move("psm1", Pose(over(30.0 + float(pulled)), 0.0), 0.01)
        # the stitch is the spring balance
        drawn_n.append(1e3 * world.field.points[0, 0] * weak.stitch_stiffness / NEWTON)
        if drawn_n[-1] < 0.8 * 2 * weak.finger_friction * squeeze_n:
            assert world.touch("psm1").between == pytest.approx(first, abs=2)
    assert max(drawn_n) == pytest.approx(2 * weak.finger_friction * squeeze_n, rel=0.2)
    assert max(drawn_n) < 0.8 * 6.0 * weak.stitch_stiffness / NEWTON


def test_a_fingertip_presses_as_a_flat_punch_does_in_proportion_to_its_depth():
    # Sneddon: 2 E* a δ for a punch of the finger's end; closed fingers are two of them
    pressed = [press_n(flat_surface(95.0), over(0.0, 1.8 - d), (0.0, 0.0), SUTURE) for d in (1.0, 2.0)]
    radius = np.sqrt(WIDTH_MM * 1.0 / np.pi)
    assert pressed[0] == pytest.approx(2 * 2 * SUTURE.plane_strain_modulus * radius * 1.0 / NEWTON, rel=1e-5)
    assert pressed[1] == pytest.approx(2 * pressed[0], rel=1e-5)
    assert press_n(flat_surface(95.0), over(0.0, 3.0), (0.3, 0.3), SUTURE) == 0.0


def test_planes_touch_a_sloping_surface_and_face_the_camera():
    x = np.arange(0.0, 40.0, 0.1)
    sloping = Surface(np.tile(95.0 + 0.2 * x, (400, 1)).astype(np.float32), 0.0, 0.0, 0.1)
    at, attitude = planes_beneath(sloping, np.array([[10.0, 20.0, 90.0]]))
    assert at[0] == pytest.approx((10.0, 20.0, 97.0), abs=1e-3)
    w, qx, qy, qz = attitude[0]
    normal = (2 * (qx * qz + w * qy), 2 * (qy * qz - w * qx), 1 - 2 * (qx**2 + qy**2))
    assert normal == pytest.approx(np.array([0.2, 0.0, -1.0]) / np.hypot(0.2, 1.0), abs=1e-3)


def test_a_grasp_is_settled_by_what_is_touched_after_a_lift_of_5_mm_and_not_before():
    field, touching, nothing = straight(0.05), Touch((400.0,), (400.0,), 1.0), Touch((), (), 0.0)
    for slips_at_mm, verdict in ((None, Verdict.HELD), (4.0, Verdict.LOST), (6.0, Verdict.HELD)):
        attempt = Attempt(0.6)
        for jaw in np.linspace(0.6, 0.0, 20):
            attempt = noted(attempt, Pose(over(30.0), float(jaw)), touching, 0.0, field)
        for risen_mm in np.arange(0.0, 8.0, 0.5):
            slipped = slips_at_mm is not None and risen_mm >= slips_at_mm
            attempt = noted(attempt, Pose(over(30.0, risen_mm), 0.0), nothing if slipped else touching, 0.0, field)
            assert outcome(attempt, field, 1.0).settled == (risen_mm >= 5.0)
        assert outcome(attempt, field, 1.0).verdict is verdict


@pytest.mark.slow
@needs_mujoco
def test_whole_grasps_are_judged_after_the_lift_the_same_each_time():
    config = SimulatorConfig(seed=3, config="medium", background="plain", tool_error_mm=0.0, physics="contact")
    limited = replace(config, tissue_force_limit_n=1e-3)
    held, forced, missed = (
        Run(config).carry_out(direct(tool_at(0.5))),
        Run(limited).carry_out(direct(tool_at(0.5))),
        Run(config).carry_out(direct(raised(tool_at(0.5), 6.0))),
    )
    (judged,), (refused,) = held.judgements, forced.judgements
    assert (judged.verdict, judged.code) == (Verdict.HELD, "HELD")
    assert judged.s_caught == pytest.approx(0.5, abs=0.03)
    assert [encode(state) for state in held.states] == [encode(state) for state in forced.states]
    assert (refused.verdict, refused.peak_tissue_force_n) == (Verdict.FORCE_EXCEEDED, judged.peak_tissue_force_n)
    assert "where 0.001 N are allowed; the thread was held" in refused.sentence
    assert [judgement.verdict for judgement in missed.judgements] == [Verdict.MISSED]
