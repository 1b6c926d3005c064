"""Training itself, where PyTorch is there (extra `train`): crops, a few steps, and what is said at run time."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `train`")

from agents.perception.both_eyes.apart import apart_px  # noqa: E402
from agents.perception.both_eyes.network_inputs import Eye, together  # noqa: E402
from agents.perception.centrelines.along import Pieces  # noqa: E402
from agents.perception.centrelines.learned import reach_px  # noqa: E402
from agents.perception.segmentation.classes import phases, scores_of  # noqa: E402
from benchmarks.training.architecture import ClassNet, Encoder, unfolded  # noqa: E402
from benchmarks.training.crops import CROP_PX, batches  # noqa: E402
from benchmarks.training.evaluate import main as evaluate  # noqa: E402
from benchmarks.training.export import convolutions, export_network  # noqa: E402
from benchmarks.training.middle_apart import ApartNet, aside_px, told, weights_of  # noqa: E402
from benchmarks.training.middle_pairs import INNER, WIDE_PLACES, PairProfiles, features  # noqa: E402
from benchmarks.training.scenes import View  # noqa: E402
from benchmarks.training.train import main  # noqa: E402

pytestmark = pytest.mark.slow

CPU = torch.device("cpu")


def view() -> Any:
    """A dark thread over a bright ground, which goes below an instrument."""
    coverage = np.zeros((300, 300), np.uint8)
    cv2.line(coverage, (30, 40), (220, 200), 255, 7, cv2.LINE_AA)
    ground = np.random.default_rng(1).normal(180, 3, (300, 300, 3))
    image = ground + coverage[..., None] / 255 * (np.array([60, 30, 50]) - ground)
    instrument = np.zeros_like(coverage)
    instrument[190:], coverage[190:] = 255, 0
    return View("one_left", np.clip(image, 0, 255).astype(np.uint8), coverage, None, instrument)


def test_batches_follow_from_their_seed_and_give_shares_of_each_pixel():
    first, again, other = (next(batches([[view()]], 6, seed, CPU, 0.5)) for seed in (1, 1, 2))
    side = CROP_PX // 2
    assert (first[0].shape, first[1].shape) == ((6, 12, side, side), (6, 16, side, side))
    for one, same, differing in zip(first, again, other, strict=True):
        torch.testing.assert_close(one, same)
        assert not torch.equal(one, differing)
    shares = first[1].reshape(6, 4, 4, side, side)
    torch.testing.assert_close(shares.sum(dim=2), torch.ones(6, 4, side, side))
    assert (shares.amax(dim=(0, 1, 3, 4)) > 0.9).tolist() == [True, True, False, True]


def test_opencv_gives_what_pytorch_gives_and_an_exported_network_is_gone_on_from(tmp_path):
    torch.manual_seed(4)
    network, exported = ClassNet(), tmp_path / "classes.onnx"
    for layer in network.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):
            layer.running_mean.uniform_(-0.5, 0.5)
            layer.running_var.uniform_(0.5, 2)
    export_network(network.eval(), exported)
    image = np.tile(view().image[:288, :288], (1, 3, 1))
    logits = network(torch.from_numpy(phases(np.ascontiguousarray(image)))).detach()
    expected = torch.softmax(logits.reshape(4, 4, 144, 432), dim=1).reshape(2, 2, 4, 144, 432)
    found = scores_of(image, exported).reshape(144, 2, 432, 2, 4).transpose(1, 3, 4, 0, 2)
    np.testing.assert_allclose(found, expected.numpy(), atol=2e-3)
    again, pixels = ClassNet(), torch.rand(2, 12, 32, 64)
    unfolded(again, convolutions(exported), pixels)
    # as a batch in training normalises it, it still says the same
    assert np.allclose(again.train()(pixels).detach(), network(pixels).detach(), atol=0.05)


def encoder_file(path):
    """Random weights in the form of EfficientNet-Lite0's."""
    encoder, state = Encoder(), {}
    named = [("_conv_stem", "_bn0", encoder.stem)]
    for number, block in enumerate(block for stage in encoder.stages for block in stage):
        names = [tuple(f"_blocks.{number}.{name}" for name in pair) for pair in block.names()]
        named += [(*pair, layer) for pair, layer in zip(names, block.layers, strict=True)]
    for convolution, normalisation, layer in named:
        state[f"{convolution}.weight"] = torch.randn_like(layer[0].weight) / layer[0].weight[0].numel() ** 0.5
        state |= {f"{normalisation}.{name}": value for name, value in layer[1].state_dict().items()}
    torch.save(state, path)
    return str(path)


def test_the_command_trains_from_an_encoder_goes_on_evaluates_and_refuses_other_weights(tmp_path, capsys):
    one, first, second = view(), tmp_path / "first.pt", tmp_path / "second.pt"
    for name, image in (("left", one.image), ("mask_left", one.coverage), ("instrument_left", one.instrument)):
        cv2.imwrite(str(tmp_path / f"one_{name}.png"), image)
    asked = ["--scenes", str(tmp_path), "--batch", "2", "--threads", "2", "--float32"]
    encoder = ["--encoder", encoder_file(tmp_path / "lite0.pth")]
    assert main([*asked, "--steps", "1", *encoder, "--output", str(first)]) == 0
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
    other = tmp_path / "other.pt"
    torch.save({"weights": torch.zeros(3)}, other)
    for option, refused in (("--start", "another network"), ("--encoder", "no weights of EfficientNet-Lite0")):
        with pytest.raises(SystemExit):
            main([*asked, "--steps", "1", "--output", str(second), option, str(other)])
        assert refused in capsys.readouterr().err


def test_what_is_trained_for_both_eyes_says_the_same_at_run_time():
    rng, n = np.random.default_rng(1), 51
    off, ground = aside_px(n, rng), rng.uniform(120, 200, 3)
    width, normal = np.full(n, 5.0), np.tile([1.0, 0.0], (n, 1))
    away = (WIDE_PLACES[:, None] * reach_px(width) - off[:, None]) / 2
    colour = ground - 100 * np.exp(-(away**2))[..., None] + rng.normal(0, 6, (2, len(WIDE_PLACES), n, 3))
    eyes: Any = tuple(Eye(each.astype(np.float32), width, np.full(n, -2.0), normal) for each in colour)
    stretches = Pieces(np.repeat([0, 1], (20, 31)))
    pair = PairProfiles("drawn", eyes, (off[0] - off[1]).astype(np.float32), np.ones(n, bool), stretches)
    torch.manual_seed(3)
    networks = [ApartNet(features(pair)[0].shape[1]) for _ in range(2)]
    for network in networks:
        torch.nn.init.normal_(network.out.weight, 0, 0.1)
    one, other = (weights_of(network) for network in networks)
    weights = {name: np.stack((one[name], other[name])).astype(np.float32) for name in one}
    said = told(networks, pair)
    assert np.ptp(said) > 0.01
    left, right = (replace(eye, colour=eye.colour[INNER]) for eye in eyes)
    np.testing.assert_allclose(apart_px(together(left, right), stretches, weights), said, atol=1e-3)
