"""Training itself, where PyTorch is there (extra `train`): the loss, a few steps, and the export that OpenCV reads."""

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `train`")

from agents.perception.segmentation.classes import phases, scores_of  # noqa: E402
from agents.perception.training.architecture import ClassNet, Encoder, WeightsError, network_of, unfolded  # noqa: E402
from agents.perception.training.evaluate import main as evaluate  # noqa: E402
from agents.perception.training.export import convolutions, export_network  # noqa: E402
from agents.perception.training.losses import class_loss  # noqa: E402
from agents.perception.training.scenes import View  # noqa: E402
from agents.perception.training.train import main  # noqa: E402

pytestmark = pytest.mark.slow


def view():
    coverage = np.zeros((300, 300), np.uint8)
    cv2.line(coverage, (20, 40), (280, 250), 255, 6, cv2.LINE_AA)
    image = np.where(coverage[..., None] > 127, np.uint8(40), np.uint8(190)).repeat(3, axis=2)
    return View("drawn_left", image, coverage)


def encoder_file(path):
    """Random weights in the form of EfficientNet-Lite0's."""
    encoder, state = Encoder(), {}
    named = [("_conv_stem", "_bn0", encoder.stem)]
    blocks = [block for stage in encoder.stages for block in stage]
    for number, block in enumerate(blocks):
        names = [tuple(f"_blocks.{number}.{name}" for name in pair) for pair in block.names()]
        named += [(*pair, layer) for pair, layer in zip(names, block.layers, strict=True)]
    for convolution, normalisation, layer in named:
        state[f"{convolution}.weight"] = torch.randn_like(layer[0].weight) / layer[0].weight[0].numel() ** 0.5
        state |= {f"{normalisation}.{name}": value for name, value in layer[1].state_dict().items()}
    torch.save(state, path)
    return path


def test_the_loss_of_classes_is_least_at_the_truth():
    kind = torch.randint(4, (2, 4, 32, 32))
    shares = torch.nn.functional.one_hot(kind, 4).movedim(-1, 2).reshape(2, 16, 32, 32).float()
    right, wrong, unsure = 8 * shares, -8 * shares, torch.zeros_like(shares)
    assert class_loss(right, shares) < class_loss(unsure, shares) < class_loss(wrong, shares)


def test_opencv_gives_what_pytorch_gives(tmp_path):
    network = ClassNet((4, 6, 8, 10)).eval()
    exported = tmp_path / "classes.onnx"
    export_network(network, exported)
    image = np.tile(view().image[:288, :288], (1, 3, 1))
    with torch.no_grad():
        logits = network(torch.from_numpy(phases(np.ascontiguousarray(image))))
    expected = torch.softmax(logits.reshape(4, 4, 144, 432), dim=1).reshape(2, 2, 4, 144, 432)
    found = scores_of(image, exported).reshape(144, 2, 432, 2, 4).transpose(1, 3, 4, 0, 2)
    np.testing.assert_allclose(found, expected.numpy(), atol=2e-3)


def test_an_exported_network_is_gone_on_from(tmp_path):
    torch.manual_seed(4)
    network, pixels = ClassNet(), torch.rand(2, 12, 32, 64)
    for layer in network.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):
            layer.running_mean.uniform_(-0.5, 0.5)
            layer.running_var.uniform_(0.5, 2)
    export_network(network, tmp_path / "once.onnx")
    again = ClassNet()
    unfolded(again, convolutions(tmp_path / "once.onnx"), pixels)
    # as a batch in training normalises it, it still says the same
    assert np.allclose(again.train()(pixels).detach(), network.eval()(pixels).detach(), atol=0.05)


def test_weights_of_another_network_are_refused_in_a_sentence(tmp_path, capsys):
    (tmp_path / "one_left.png").write_bytes(cv2.imencode(".png", view().image)[1].tobytes())
    (tmp_path / "one_mask_left.png").write_bytes(cv2.imencode(".png", view().coverage)[1].tobytes())
    other, output = tmp_path / "other.pt", tmp_path / "classes.pt"
    torch.save({"weights": torch.zeros(3)}, other)
    with pytest.raises(WeightsError, match="another network"):
        network_of(torch.load(other, weights_only=True))
    for given, said in (
        (["--start", str(other)], "another network"),
        (["--encoder", str(other)], "no weights of EfficientNet-Lite0"),
        ([], "--encoder"),
    ):
        with pytest.raises(SystemExit):
            main(["--scenes", str(tmp_path), "--output", str(output), "--steps", "1", *given])
        assert said in capsys.readouterr().err


def test_the_command_trains_from_an_encoder_and_goes_on_and_evaluates(tmp_path, capsys):
    scene, instrument = view(), np.zeros((300, 300), np.uint8)
    instrument[:, 240:] = 255
    covered = np.where(instrument > 0, np.uint8(0), scene.coverage)
    for name, image in (("left", scene.image), ("mask_left", covered), ("instrument_left", instrument)):
        cv2.imwrite(str(tmp_path / f"one_{name}.png"), image)
    encoder, first, second = encoder_file(tmp_path / "lite0.pth"), tmp_path / "first.pt", tmp_path / "second.pt"
    asked = ["--scenes", str(tmp_path), "--batch", "2", "--threads", "2", "--float32"]
    assert main([*asked, "--steps", "1", "--encoder", str(encoder), "--output", str(first)]) == 0
    exported = first.with_suffix(".onnx")
    assert exported.stat().st_size < 3_000_000
    goes_on = ["--steps", "2", "--start", str(first), "--mistaken-by", str(exported), "--output", str(second)]
    assert main([*asked, *goes_on]) == 0
    assert "2 steps" in capsys.readouterr().out
    before, after = (torch.load(path, weights_only=True) for path in (first, second))
    stem, layer = "encoder.stem.0.weight", "encoder.stages.4.0.layers.0.0.weight"
    assert torch.equal(before[stem], after[stem])
    assert not torch.equal(before[layer], after[layer])
    assert evaluate(["--weights", str(second.with_suffix(".onnx")), "--scenes", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "1 views: thread recall" in said
    assert "needle none there, instrument" in said
