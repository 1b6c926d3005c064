"""Training for both eyes, where PyTorch is there (extra `train`): what is learned is what is said at run time."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `train`")

from agents.perception.both_eyes.apart import apart_px  # noqa: E402
from agents.perception.both_eyes.shown import Eye, together  # noqa: E402
from agents.perception.centrelines.along import Pieces  # noqa: E402
from agents.perception.centrelines.learned import own_weights  # noqa: E402
from agents.perception.centrelines.straightened import reach_px  # noqa: E402
from agents.perception.training import middle_network  # noqa: E402
from agents.perception.training.middle_apart import (  # noqa: E402
    ApartNet,
    aside_px,
    shared,
    told,
    weights_of,
)
from agents.perception.training.middle_pairs import INNER, WIDE_PLACES, PairProfiles, features  # noqa: E402

pytestmark = pytest.mark.slow

COUNTS = 20, 31


def pair_of(seed):
    """Dark threads in a bright ground, whose lines lie as far from their middles as is to be said."""
    rng = np.random.default_rng(seed)
    n = sum(COUNTS)
    width = np.full(n, 5.0)
    off = aside_px(n, rng)
    ground = rng.uniform(120, 200, 3)
    left, right = (
        Eye(
            (
                ground
                - 100 * np.exp(-(((WIDE_PLACES[:, None] * reach_px(width) - by) / 2) ** 2))[..., None]
                + rng.normal(0, 6, (len(WIDE_PLACES), n, 3))
            ).astype(np.float32),
            width,
            np.full(n, -2.0),
            np.tile([1.0, 0.0], (n, 1)),
        )
        for by in off
    )
    apart = (off[0] - off[1]).astype(np.float32)
    return PairProfiles(f"drawn_{seed}", (left, right), apart, np.ones(n, bool), Pieces(np.repeat([0, 1], COUNTS)))


def test_what_is_trained_says_the_same_at_run_time():
    pair = pair_of(1)
    torch.manual_seed(3)
    networks = [ApartNet(features(pair)[0].shape[1]) for _ in range(2)]
    for network in networks:
        torch.nn.init.normal_(network.out.weight, 0, 0.1)
    one, other = (weights_of(network) for network in networks)
    weights = {name: np.stack((one[name], other[name])).astype(np.float32) for name in one}
    left, right = (replace(eye, colour=eye.colour[INNER]) for eye in pair.eyes)
    said = told(networks, pair)
    assert np.ptp(said) > 0.01
    np.testing.assert_allclose(apart_px(together(left, right), pair.pieces, weights), said, atol=1e-3)


def test_what_neighbours_err_by_together_counts_and_what_goes_to_and_fro_does_not():
    stretches = Pieces(np.repeat([0, 1], 8))
    alike, to_and_fro = torch.ones(16), torch.tensor([1.0, -1.0]).repeat(8)
    assert torch.allclose(shared(alike, stretches, 4), torch.ones(4))
    assert torch.allclose(shared(to_and_fro, stretches, 4), torch.zeros(4))
    # of a stretch that is shorter there is less
    assert torch.allclose(shared(alike, stretches, 16), torch.full((2,), 0.5))


def test_what_is_learned_on_from_begins_with_the_weights_that_were_given():
    given = own_weights()
    begun = middle_network.weights_of(middle_network.started_from(given))
    assert begun.keys() == given.keys()
    for name, weights in given.items():
        np.testing.assert_allclose(begun[name], weights, atol=1e-5, err_msg=name)
