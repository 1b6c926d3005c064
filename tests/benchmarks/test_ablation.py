"""What the ablation takes away has to be there."""

from benchmarks.ablation import STEPS


def test_every_step_that_is_left_out_exists():
    missing = [
        (module.__name__, name) for changes in STEPS.values() for module, name, _ in changes if name not in vars(module)
    ]
    assert not missing
