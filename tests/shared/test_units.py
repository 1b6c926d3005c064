import pytest

from shared.units import METRES_PER_UNIT, metres_per_unit, unit_name


@pytest.mark.parametrize(("name", "metres"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("um", 0.000001)])
def test_a_unit_is_so_many_metres_and_has_its_name_back(name, metres):
    assert metres_per_unit(name) == metres
    assert unit_name(metres) == name


def test_an_unknown_unit_is_refused_with_the_known_ones_and_a_size_that_nobody_named_has_no_name():
    for name in ("inch", "", "MM"):
        with pytest.raises(ValueError, match="unknown unit") as raised:
            metres_per_unit(name)
        assert repr(name) in str(raised.value)
        assert all(known in str(raised.value) for known in METRES_PER_UNIT)
    assert [unit_name(metres) for metres in (None, 0.3048, 0.0)] == [None, None, None]
