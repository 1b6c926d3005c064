"""Published states of the field become images: true to the state, and the same for the same frame."""

from dataclasses import replace

import numpy as np
import pytest

from agents.camera.agent import CameraConfig, SceneCamera
from agents.camera.scene_source import SceneSource, calibration_of, camera_in_mm
from schemas.messages import RectifiedStereo, SimulatorState
from schemas.topics import CALIBRATION, FRAME_NOTICE, FRAMES, SIMULATOR_STATE
from shared.calibration.identity import calibration_id
from shared.rendering.render import Scene, render
from shared.rendering.sensor import NO_NOISE
from shared.rendering.surface import flat_surface
from shared.rendering.thread_shapes import thread_on
from shared.runtime.agent import Received, Tick, outputs_in

CAMERA = RectifiedStereo(960, 540, 1000.0, 1000.0, 479.5, 269.5, 5.5e-3, 1.0)
THREAD_MM = thread_on(camera_in_mm(CAMERA), flat_surface(95.0), "medium", 2)
STATE = SimulatorState(
    at_ns=1,
    camera=CAMERA,
    background="plain",
    colour="violet",
    seed=2,
    distance_m=0.095,
    radius_m=1e-3 * THREAD_MM.radius_mm,
    knots=THREAD_MM.knots,
    control_points_camera=1e-3 * THREAD_MM.control_points,
    held=None,
)
SMALL = replace(STATE, camera=RectifiedStereo(240, 135, 250.0, 250.0, 119.5, 67.0, 5.5e-3, 1.0))
"""The same view in a quarter of the pixels each way."""


def moved(state: SimulatorState, by_mm: tuple[float, float, float]) -> SimulatorState:
    return replace(state, control_points_camera=state.control_points_camera + 1e-3 * np.array(by_mm))


def test_without_noise_it_is_the_light_renderers_pair():
    pair = SceneSource(NO_NOISE).render(STATE, 0)
    expected = render(Scene(camera_in_mm(CAMERA), THREAD_MM, "violet", "plain", 95.0, 2, NO_NOISE))
    for ours, theirs in zip(pair, (expected.left_bgr, expected.right_bgr), strict=True):
        # metres and back again may round a grey level
        assert np.abs(ours.astype(int) - theirs).max() <= 1


def test_a_frame_depends_on_state_and_number_alone():
    other = moved(SMALL, (0.0, 0.0, -2.0))
    straight = SceneSource().render(SMALL, 7)
    source = SceneSource()
    for state, frame in ((other, 3), (SMALL, 6), (replace(SMALL, seed=5), 7), (other, 7)):
        source.render(state, frame)
    again = source.render(replace(SMALL, at_ns=99), 7)
    np.testing.assert_array_equal(again, straight)


def test_noise_is_new_in_every_frame_and_in_each_eye():
    source = SceneSource()
    plain = moved(SMALL, (500.0, 0.0, 0.0))
    images = [image.astype(float) for k in range(4) for image in source.render(plain, k)]
    flat = np.stack([(image - image.mean()).ravel() for image in images])
    assert np.abs(np.corrcoef(flat) - np.eye(len(images))).max() < 0.02
    assert flat.std() == pytest.approx(np.sqrt(1.4**2 + 2.2**2 * 206 / 255 + 1 / 12), rel=0.03)


def test_the_agent_films_the_newest_state_and_calibrates_anew_for_another_camera():
    rendered = []

    def render(state, number):
        rendered.append((state.at_ns, number))
        return np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4, 3), np.uint8)

    camera = SceneCamera(render, lambda state: calibration_of(state.camera), CameraConfig())
    wider = replace(SMALL, at_ns=7, camera=replace(SMALL.camera, fx_px=200.0, fy_px=200.0))

    def filmed(*states):
        for state in states:
            key = "suturegrasp/lab/simulator/main/state"
            assert list(camera.step(Received(SIMULATOR_STATE, key, 0, state))) == []
        return {output.topic: output.message for output in outputs_in(camera.step(Tick(1)))}

    said = [filmed(), filmed(replace(STATE, at_ns=5), replace(SMALL, at_ns=6)), filmed(), filmed(wider)]
    assert rendered == [(6, 0), (6, 1), (7, 2)]
    frames = {FRAMES, FRAME_NOTICE}
    assert [set(each) for each in said] == [set(), {CALIBRATION, *frames}, frames, {CALIBRATION, *frames}]
    first, again, second = said[1], said[2], said[3]
    assert (first[CALIBRATION].K_left[0, 0], second[CALIBRATION].K_left[0, 0]) == (250.0, 200.0)
    named = [each[FRAMES].stamp.calibration_id for each in (first, again, second)]
    assert named == [calibration_id(each[CALIBRATION]) for each in (first, first, second)]
