import pytest

from shared.units import metres_per_unit, unit_name


def test_a_unit_is_so_many_metres_and_has_its_name_back_and_an_unknown_one_is_refused_with_the_known_ones():
    for name, metres in (("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("um", 0.000001)):
        assert metres_per_unit(name) == metres
        assert unit_name(metres) == name
    with pytest.raises(ValueError, match="unknown unit 'MM'; choose from m, cm, mm, um"):
        metres_per_unit("MM")
    assert [unit_name(metres) for metres in (None, 0.3048)] == [None, None]
