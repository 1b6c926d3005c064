"""Weights become a network to learn on from, and come back as they were."""

import numpy as np
import pytest

from agents.perception.centrelines.learned import own_weights

pytest.importorskip("torch", reason="needs the extra `train`")

from agents.perception.training.middle_network import started_from, weights_of


def test_what_is_learned_on_from_begins_with_the_weights_that_were_given():
    given = own_weights()
    begun = weights_of(started_from(given))
    assert begun.keys() == given.keys()
    for name, weights in given.items():
        np.testing.assert_allclose(begun[name], weights, atol=1e-5, err_msg=name)
