"""What is done to crops before the network learns from them, where PyTorch is there (extra `train`)."""

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `train`")

from agents.perception.segmentation.classes import phases, together  # noqa: E402
from agents.perception.training.appearance import (  # noqa: E402
    with_other_ground,
    with_other_steel,
    with_other_texture,
)
from agents.perception.training.augmentation import varied  # noqa: E402
from agents.perception.training.clutter import with_blood, with_glints, with_tools, with_vessels  # noqa: E402
from agents.perception.training.crops import (  # noqa: E402
    CROP_PX,
    batches,
    crops_of,
    phases_of,
    pixels_of,
    shares_of,
)
from agents.perception.training.drawn_layers import drawn_layers  # noqa: E402
from agents.perception.training.dyeing import with_other_dye, with_second_strand  # noqa: E402
from agents.perception.training.jpeg import compressed  # noqa: E402
from agents.perception.training.lots import lots_of  # noqa: E402
from agents.perception.training.scenes import View  # noqa: E402

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


def test_a_second_strand_shows_and_is_covered_too():
    images, coverages = crops(4)
    images[0], coverages[0] = images[0].flip(2), coverages[0].flip(2)
    both, covered = with_second_strand(images, coverages, torch.arange(4), lots_of(2, CPU))
    added = (covered > coverages + 200).expand_as(images)
    assert added.flatten(1).any(dim=1).all()
    assert both[added].mean() < 80 < images[added].mean()
    assert (covered >= coverages - 1).all()


def test_a_crop_that_is_not_resampled_is_exact():
    view = View("drawn_left", *drawn(400))
    image, coverage = crops_of(pixels_of([[view]], CPU, 1), 40, lots_of(1, CPU))
    at_integers = (image == image.round()).flatten(1).all(dim=1)
    assert 8 <= at_integers.sum() < 40
    # what is only turned and mirrored has the very pixels of the view
    darkest = drawn(400)[0].reshape(-1, 3).min(axis=0)
    exact, covered = image[at_integers], coverage[at_integers]
    assert (exact.amin(dim=(0, 2, 3)).numpy() == darkest).all()
    assert covered.max() == 255
    assert coverage.shape == (40, 3, CROP_PX, CROP_PX)
    assert not coverage[:, 1:].any()


def test_needle_and_instrument_are_cropped_with_the_image():
    needle, instrument = (np.zeros((400, 400), np.uint8) for _ in range(2))
    cv2.circle(needle, (250, 100), 30, 255, -1)
    instrument[300:] = 255
    # each is shown by a channel of the image itself
    view = View("drawn_left", np.dstack((needle, instrument, needle)), np.zeros_like(needle), needle, instrument)
    image, coverage = crops_of(pixels_of([[view]], CPU, 1), 30, lots_of(1, CPU))
    torch.testing.assert_close(coverage[:, 1:], image[:, :2])
    assert (coverage[:, 1:].amax(dim=(2, 3)) == 255).any(dim=0).all()


def test_shares_of_classes_are_one_together():
    coverage = torch.tensor([[0, 0, 0], [255, 0, 0], [51, 102, 0], [200, 0, 200]]).float()[..., None, None]
    shares = shares_of(coverage)[..., 0, 0]
    expected = torch.tensor([[1, 0, 0, 0], [0, 1, 0, 0], [0.4, 0.2, 0.4, 0], [0, 0.5, 0, 0.5]])
    torch.testing.assert_close(shares, expected)


@pytest.mark.parametrize(
    ("clutter", "name"), [(with_glints, "glints"), (with_vessels, "vessels"), (with_blood, "blood")]
)
def test_what_lies_beneath_leaves_the_thread_as_it_is(clutter, name, layers):
    images, coverages = crops(4)
    changed = clutter(images, coverages, getattr(layers, name), lots_of(3, CPU))
    assert not torch.equal(changed, images)
    on_thread = (coverages == 255).expand_as(images)
    torch.testing.assert_close(changed[on_thread], images[on_thread])


def test_a_tool_over_a_thread_takes_its_coverage_and_one_beneath_leaves_it():
    images, coverages = crops(12)
    _, left = with_tools(images, coverages, lots_of(1, CPU))
    assert (left <= coverages).all()
    whole = (left == coverages).flatten(1).all(dim=1)
    assert whole.any()
    assert not whole.all()


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


def test_a_second_strand_hides_needle_and_instrument():
    images, coverages = classes_drawn(4)
    _, covered = with_second_strand(images, coverages, torch.arange(4), lots_of(2, CPU))
    assert covered.sum(dim=1).max() < 255.5
    assert (covered[:, 1:] <= coverages[:, 1:]).all()
    assert (covered[:, 2] < coverages[:, 2] - 200).any()


def test_other_grounds_and_textures_leave_thread_needle_and_instrument_as_they_are():
    images, coverages = classes_drawn(6)
    shown = (coverages.sum(dim=1, keepdim=True) >= 255).expand_as(images)
    for change in (with_other_ground, with_other_texture):
        changed = change(images, coverages, lots_of(2, CPU))
        torch.testing.assert_close(changed[shown], images[shown])
        apart = (changed - images).abs()[~shown]
        assert apart.mean() > 3
        assert 0 <= changed.min() <= changed.max() <= 255


def test_other_steel_leaves_ground_and_thread_as_they_are():
    images, coverages = classes_drawn(6)
    changed = with_other_steel(images, coverages, lots_of(2, CPU))
    steel = (coverages[:, 1:].sum(dim=1, keepdim=True) > 0).expand_as(images)
    torch.testing.assert_close(changed[~steel], images[~steel])
    assert (changed - images).abs()[steel].mean() > 3


def test_compression_keeps_what_it_shows():
    images, _ = crops(4)
    apart = (compressed(images, lots_of(1, CPU)) - images).abs()
    assert 0.3 < apart.mean() < 8


def test_the_network_s_four_coverages_are_the_image_s_pixels():
    image, coverage = drawn()
    given = phases_of(torch.from_numpy(coverage)[None, None].float() / 255).numpy()
    np.testing.assert_allclose(together(given.reshape(4, 1, 128, 128))[..., 0], coverage / 255, atol=1e-6)
    taken = phases_of(torch.from_numpy(image).permute(2, 0, 1)[None].float() / 255).numpy()
    np.testing.assert_allclose(taken, phases(image), atol=1e-6)


def test_batches_follow_from_their_seed():
    view = View("drawn_left", *drawn(300))
    first, again, other = (next(batches([[view]], 3, seed, CPU, 0.5)) for seed in (1, 1, 2))
    assert first[0].shape == (3, 12, CROP_PX // 2, CROP_PX // 2)
    assert first[1].shape == (3, 16, CROP_PX // 2, CROP_PX // 2)
    for one, same, differing in zip(first, again, other, strict=True):
        torch.testing.assert_close(one, same)
        assert not torch.equal(one, differing)


def test_batches_of_classes_give_shares_of_each_pixel():
    image, coverage = drawn(300)
    instrument = np.zeros_like(coverage)
    instrument[200:] = 255
    view = View("drawn_left", image, np.where(instrument > 0, np.uint8(0), coverage), None, instrument)
    pixels, shares = next(batches([[view]], 6, 1, CPU, 0.5))
    assert pixels.shape == (6, 12, CROP_PX // 2, CROP_PX // 2)
    assert shares.shape == (6, 16, CROP_PX // 2, CROP_PX // 2)
    of_classes = shares.reshape(6, 4, 4, CROP_PX // 2, CROP_PX // 2)
    torch.testing.assert_close(of_classes.sum(dim=2), torch.ones(6, 4, CROP_PX // 2, CROP_PX // 2))
    assert (of_classes.amax(dim=(0, 1, 3, 4)) > 0.9).tolist() == [True, True, False, True]
