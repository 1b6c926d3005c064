"""What is done to crops before the network learns from them, where PyTorch is there (extra `train`)."""

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `train`")

from agents.perception.training.augmentation import varied  # noqa: E402
from agents.perception.training.clutter import with_blood, with_glints, with_tools, with_vessels  # noqa: E402
from agents.perception.training.crops import (  # noqa: E402
    CROP_PX,
    batches,
)
from agents.perception.training.drawn_layers import drawn_layers  # noqa: E402
from agents.perception.training.dyeing import with_other_dye, with_second_strand  # noqa: E402
from agents.perception.training.jpeg import compressed  # noqa: E402
from agents.perception.training.lots import lots_of  # noqa: E402
from agents.perception.training.scenes import View  # noqa: E402

pytestmark = pytest.mark.slow

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def layers():
    return drawn_layers(1, CPU, count=6)


def drawn(side=256):
    """A dark thread over a bright ground, and its coverage."""
    coverage = np.zeros((side, side), np.uint8)
    cv2.line(coverage, (30, 40), (220, 200), 255, 7, cv2.LINE_AA)
    ground = np.random.default_rng(1).normal(180, 3, (side, side, 3))
    image = ground + coverage[..., None] / 255 * (np.array([60, 30, 50]) - ground)
    return np.clip(image, 0, 255).astype(np.uint8), coverage


def crops(count=1):
    image, coverage = (torch.from_numpy(part).float() for part in drawn())
    return image.permute(2, 0, 1).repeat(count, 1, 1, 1), coverage.repeat(count, 1, 1, 1)


def test_what_is_covered_still_shows_the_thread_after_a_variation(layers):
    told = 0
    image, thread = crops(16)
    alone = torch.cat((thread, torch.zeros_like(thread), torch.zeros_like(thread)), dim=1)
    images, coverages = varied(image, alone, lots_of(3, CPU), layers, red_share=0.5)
    assert images.shape == (16, 3, 256, 256)
    for image, coverage in zip(images.numpy(), coverages.numpy(), strict=True):
        seen, covered = cv2.GaussianBlur(image.transpose(1, 2, 0), (0, 0), 1.0), coverage[0].astype(np.uint8)
        beside = cv2.dilate(covered, np.ones((25, 25), np.uint8)) > 0
        outside = beside & (cv2.dilate(covered, np.ones((9, 9), np.uint8)) == 0)
        away = np.median(seen[covered > 200], axis=0) - np.median(seen[outside], axis=0)
        # dyed anew it may be brighter than the ground
        told += np.abs(away).max() > 5
    assert told >= 15


def test_another_dye_leaves_the_ground_and_the_edges_as_they_are():
    images, coverages = crops(8)
    dyed = with_other_dye(images, coverages, 0.5, lots_of(1, CPU))
    coverage = coverages[0, 0].numpy()
    colours = []
    for image in dyed.permute(0, 2, 3, 1).numpy():
        np.testing.assert_array_equal(image[coverage == 0], drawn()[0][coverage == 0])
        thread, ground = (np.median(image[part], axis=0) for part in (coverage == 255, coverage == 0))
        colours.append(thread)
        # a half covered pixel still shows half of each
        half = (coverage > 110) & (coverage < 145)
        np.testing.assert_allclose(np.median(image[half], axis=0), (thread + ground) / 2, atol=25)
    assert np.ptp(colours, axis=0).min() > 60
    no_thread = torch.zeros_like(coverages)
    torch.testing.assert_close(with_other_dye(images, no_thread, 0.5, lots_of(1, CPU)), images)


def classes_drawn(count):
    images, threads = crops(count)
    needle, instrument = torch.zeros_like(threads), torch.zeros_like(threads)
    needle[:, :, 20:24], instrument[..., :60] = 255, 255
    needle[..., :60] = 0
    left = 1 - torch.maximum(needle, instrument) / 255
    return images, torch.cat((threads * left, needle, instrument), dim=1)


def test_a_tool_adds_to_what_is_instrument_and_hides_thread_and_needle_where_it_is_over_them():
    images, coverages = classes_drawn(12)
    _, left = with_tools(images, coverages, lots_of(1, CPU))
    assert (left[:, :2] <= coverages[:, :2]).all()
    assert (left[:, 2] >= coverages[:, 2] - 0.01).all()
    assert (left[:, 2] > coverages[:, 2] + 200).any()
    assert (left[:, :2] < coverages[:, :2] - 200).flatten(2).any(dim=2).any(dim=0).all()
    assert left.sum(dim=1).max() < 255.5


def test_a_second_strand_shows_is_covered_too_and_hides_needle_and_instrument():
    images, coverages = classes_drawn(4)
    images[0], coverages[0] = images[0].flip(2), coverages[0].flip(2)
    both, covered = with_second_strand(images, coverages, torch.arange(4), lots_of(2, CPU))
    added = (covered[:, :1] > coverages[:, :1] + 200).expand_as(images)
    assert added.flatten(1).any(dim=1).all()
    assert both[added].mean() < 80 < images[added].mean()
    assert covered.sum(dim=1).max() < 255.5
    assert (covered[:, 1:] <= coverages[:, 1:]).all()
    assert (covered[:, 2] < coverages[:, 2] - 200).any()


def test_what_lies_beneath_leaves_the_thread_as_it_is_and_compression_what_is_shown(layers):
    images, coverages = crops(4)
    on_thread = (coverages == 255).expand_as(images)
    for clutter, layer in ((with_glints, layers.glints), (with_vessels, layers.vessels), (with_blood, layers.blood)):
        changed = clutter(images, coverages, layer, lots_of(3, CPU))
        assert not torch.equal(changed, images)
        torch.testing.assert_close(changed[on_thread], images[on_thread])
    assert 0.3 < (compressed(images, lots_of(1, CPU)) - images).abs().mean() < 8


def test_batches_follow_from_their_seed_and_give_shares_of_each_pixel():
    image, coverage = drawn(300)
    instrument = np.zeros_like(coverage)
    instrument[200:] = 255
    view = View("drawn_left", image, np.where(instrument > 0, np.uint8(0), coverage), None, instrument)
    first, again, other = (next(batches([[view]], 6, seed, CPU, 0.5)) for seed in (1, 1, 2))
    side = CROP_PX // 2
    assert (first[0].shape, first[1].shape) == ((6, 12, side, side), (6, 16, side, side))
    for one, same, differing in zip(first, again, other, strict=True):
        torch.testing.assert_close(one, same)
        assert not torch.equal(one, differing)
    of_classes = first[1].reshape(6, 4, 4, side, side)
    torch.testing.assert_close(of_classes.sum(dim=2), torch.ones(6, 4, side, side))
    assert (of_classes.amax(dim=(0, 1, 3, 4)) > 0.9).tolist() == [True, True, False, True]
