"""Training itself, where PyTorch is there (extra `train`): losses, a few steps, and the export that OpenCV reads."""

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `train`")

from agents.perception.training.architecture import network_of  # noqa: E402
from agents.perception.training.export import export  # noqa: E402
from agents.perception.training.losses import LOSSES, soft_skeleton  # noqa: E402
from agents.perception.training.scenes import View  # noqa: E402
from agents.perception.training.train import Chosen, train  # noqa: E402


def view():
    coverage = np.zeros((300, 300), np.uint8)
    cv2.line(coverage, (20, 40), (280, 250), 255, 6, cv2.LINE_AA)
    image = np.where(coverage[..., None] > 127, np.uint8(40), np.uint8(190)).repeat(3, axis=2)
    return View("drawn_left", image, coverage)


@pytest.mark.parametrize("name", sorted(LOSSES))
def test_each_loss_is_least_at_the_truth(name):
    coverage = torch.rand(2, 4, 32, 32).round()
    right, wrong = 8 * (2 * coverage - 1), 8 * (1 - 2 * coverage)
    unsure = torch.zeros_like(coverage)
    assert LOSSES[name](right, coverage) < LOSSES[name](unsure, coverage) < LOSSES[name](wrong, coverage)


def test_a_skeleton_is_a_line_along_the_middle_of_a_strip():
    strip = torch.zeros(1, 1, 40, 40)
    strip[:, :, 18:23] = 1.0
    skeleton = soft_skeleton(strip)[0, 0, :, 5:-5]
    assert (skeleton[20] > 0.9).all()
    assert skeleton[[0, 17, 18, 22, 23]].sum() == 0


def test_opencv_gives_what_pytorch_gives_with_the_weights_that_training_keeps(tmp_path):
    weights, onnx = tmp_path / "network.pt", tmp_path / "network.onnx"
    train([[view()]], Chosen([], weights, "bce", steps=1, batch=2, channels=(4, 6, 8, 10)))
    network = network_of(torch.load(weights, weights_only=True))
    export(weights, onnx)
    pixels = torch.rand(1, 12, 48, 64)
    with torch.no_grad():
        expected = torch.sigmoid(network.eval()(pixels)).numpy()
    net = cv2.dnn.readNetFromONNX(str(onnx), cv2.dnn.ENGINE_CLASSIC)
    net.setInput(pixels.numpy())
    np.testing.assert_allclose(net.forward(), expected, atol=1e-4)
