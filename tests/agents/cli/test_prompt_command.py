"""`suturegrasp prompt` into a rig that runs: a click reaches a promptable network, and its thread is observed."""

import numpy as np
import pytest

from agents.camera.agent import Camera, CameraConfig
from agents.perception.agent import Perception, PerceptionConfig
from schemas.codec import decode
from schemas.messages import ImageEncoding, Status, ThreadObservations
from schemas.topics import OBSERVATIONS
from shared.runtime.connection import connected
from tests.agents.perception.test_prompt import BLACK, DISPARITY, GREEN, calibration, columns, picture
from tests.agents.perception.tiny_promptable import write_tiny

PATIENT_S = 60.0


class Still:
    """A camera above two threads that lie still."""

    taken_ns = 0, 0

    def read(self):
        return picture(0, 0), picture(DISPARITY, 0)

    def close(self):
        pass


@pytest.fixture
def observed(settings, in_threads, until, tmp_path):
    """What a rig with a promptable network observes from now on, and meets a condition."""
    files = write_tiny(tmp_path, hq=True)
    perception = Perception(PerceptionConfig("promptable", promptable=files))
    camera = Camera(Still(), calibration(), CameraConfig(rate_hz=2.0, encoding=ImageEncoding.PNG))
    seen = []
    with connected(settings, PATIENT_S) as connection, in_threads(settings, perception, camera):
        connection.listen((OBSERVATIONS,), lambda tapped: seen.append(decode(ThreadObservations, tapped.payload)))

        def wait(condition=lambda _: True):
            seen.clear()
            return until(lambda: next(filter(condition, tuple(seen)), None))

        yield wait


@pytest.fixture
def prompt(suturegrasp, settings, tmp_path):
    config = tmp_path / "rig.toml"
    config.write_text(f'rig = "test"\n[router]\nendpoint = "{settings.endpoint}"\nstart = false\n')
    return lambda *options: suturegrasp("prompt", *options, "--config", config)


@pytest.mark.slow
def test_a_click_tells_a_running_rig_which_thread_is_meant_until_it_is_taken_back(prompt, observed):
    observed()
    for thread in (GREEN, BLACK):
        ended = prompt("--pixel", f"{thread[0]:.0f}", f"{thread[1]:.0f}")
        assert (ended.status, ended.err) == (0, "")
        assert ended.out.strip() == "this thread is meant from the next frame on"
        found = observed(lambda one, u=thread[0]: one.prompt_px is not None and abs(one.prompt_px[0] - u) < 30)
        assert (found.status, found.segmenter) == (Status.OK, "promptable")
        assert np.abs(columns(found) - thread[0]).max() < 6
    refused = prompt("--pixel", 700, 10)
    assert (refused.status, refused.out, len(refused.err.splitlines())) == (3, "", 1)
    assert "(700, 10) lies outside the left image of 640x360 pixels" in refused.err
    ended = prompt()
    assert (ended.status, ended.out.strip()) == (0, "perception chooses the thread")
    assert observed(lambda one: one.prompt_px is None).segmenter == "promptable"
