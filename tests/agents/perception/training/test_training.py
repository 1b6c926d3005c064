"""Training itself, where PyTorch is there (extra `train`): losses, a few steps, and the export that OpenCV reads."""

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `train`")

from agents.perception.segmentation.classes import scores_of  # noqa: E402
from agents.perception.segmentation.network import WEIGHTS, phases, thread_score  # noqa: E402
from agents.perception.training.ahead import made_ahead  # noqa: E402
from agents.perception.training.architecture import ThreadNet, network_of  # noqa: E402
from agents.perception.training.evaluate import main as evaluate  # noqa: E402
from agents.perception.training.export import export, export_network  # noqa: E402
from agents.perception.training.losses import LOSSES, class_loss, soft_skeleton  # noqa: E402
from agents.perception.training.scenes import View  # noqa: E402
from agents.perception.training.train import Chosen, main, train  # noqa: E402
from agents.perception.training.warm_start import WeightsError, first_weights, of_onnx, settle, widened  # noqa: E402


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


def test_the_loss_of_classes_is_least_at_the_truth():
    kind = torch.randint(4, (2, 4, 32, 32))
    shares = torch.nn.functional.one_hot(kind, 4).movedim(-1, 2).reshape(2, 16, 32, 32).float()
    right, wrong, unsure = 8 * shares, -8 * shares, torch.zeros_like(shares)
    assert class_loss(right, shares) < class_loss(unsure, shares) < class_loss(wrong, shares)


def test_the_exported_weights_begin_a_network_that_tells_thread_as_they_do(tmp_path):
    several = first_weights(WEIGHTS, None, classes=True).eval()
    exported = tmp_path / "classes.onnx"
    export_network(several, exported)
    assert exported.stat().st_size < 3_000_000
    image = view().image
    scores = scores_of(image, exported)
    np.testing.assert_allclose(255 * scores[..., 1], thread_score(image), atol=3)
    assert scores[..., 2:].max() < 0.02
    again = first_weights(exported, None, classes=True).eval()
    pixels = torch.from_numpy(phases(image[:288, :288]))
    with torch.no_grad():
        torch.testing.assert_close(again(pixels), several(pixels), atol=1e-3, rtol=1e-3)


def test_a_wider_network_begins_with_the_same_answer():
    several = first_weights(WEIGHTS, None, classes=True).eval()
    wider = widened(several, (16, 32, 64, 96)).eval()
    pixels = torch.rand(1, 12, 48, 64)
    with torch.no_grad():
        torch.testing.assert_close(wider(pixels), several(pixels), atol=1e-3, rtol=1e-3)
    with pytest.raises(WeightsError, match="cannot hold"):
        widened(several, (8, 24, 48, 64))


def test_settled_weights_give_the_same_answer_and_normalise_by_what_they_have_seen():
    network = of_onnx(WEIGHTS).eval()
    pixels = [torch.rand(2, 12, 64, 64) for _ in range(3)]
    with torch.no_grad():
        before = network(pixels[0])
        settle(network, pixels)
        torch.testing.assert_close(network(pixels[0]), before, atol=1e-3, rtol=1e-3)
        torch.testing.assert_close(
            network.train()(torch.cat(pixels)), network.eval()(torch.cat(pixels)), atol=0.1, rtol=0.1
        )


def test_weights_of_another_form_are_refused(tmp_path):
    (tmp_path / "other.onnx").write_bytes(b"none")
    with pytest.raises(WeightsError, match="no ONNX file"):
        of_onnx(tmp_path / "other.onnx")
    torch.save(ThreadNet((4, 6, 8, 10), 4).state_dict(), tmp_path / "classes.pt")
    with pytest.raises(WeightsError, match="--classes"):
        first_weights(tmp_path / "classes.pt", None, classes=False)


def test_items_made_ahead_come_in_their_order():
    several = made_ahead(iter(range(100)))
    assert [next(several) for _ in range(5)] == [0, 1, 2, 3, 4]


def test_the_command_trains_classes_from_exported_weights_and_evaluates_them(tmp_path, capsys):
    scene, instrument = view(), np.zeros((300, 300), np.uint8)
    instrument[:, 240:] = 255
    covered = np.where(instrument > 0, np.uint8(0), scene.coverage)
    for name, image in (("left", scene.image), ("mask_left", covered), ("instrument_left", instrument)):
        cv2.imwrite(str(tmp_path / f"one_{name}.png"), image)
    output = tmp_path / "classes.pt"
    asked = ["--classes", "--start", str(WEIGHTS), "--scenes", str(tmp_path), "--output", str(output)]
    assert main([*asked, "--steps", "2", "--batch", "2", "--threads", "2", "--float32"]) == 0
    assert "2 steps" in capsys.readouterr().out
    assert evaluate(["--classes", str(output.with_suffix(".onnx")), "--scenes", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "1 views: thread recall" in said
    assert "needle none there, instrument" in said
