"""Types of the structs of arrays, which type checkers see, have the members of the structs that kernels take."""

import inspect

import pytest
import warp as wp

from warpcrete.dem.engine import struct_types
from warpcrete.dem.engine.state import STRUCTS, struct_of
from warpcrete.kernels.dem.grid import grid_struct
from warpcrete.kernels.dem.stiffness import estimate_struct
from warpcrete.kernels.dem.structs import array_structs, links_struct, subcycled_struct

STRUCTS_BY_NAME = {name.capitalize(): struct_of(array_structs(wp.float32), name) for name in STRUCTS}
STRUCTS_BY_NAME |= {"Links": links_struct(wp.float32), "Subcycled": subcycled_struct(wp.float32)}
STRUCTS_BY_NAME |= {"Grid": grid_struct(wp.float32), "Estimate": estimate_struct(wp.float32)}


@pytest.mark.parametrize("name", STRUCTS_BY_NAME)
def test_the_type_of_a_struct_has_its_members(name):
    assert list(inspect.get_annotations(getattr(struct_types, name))) == list(STRUCTS_BY_NAME[name].vars)


def test_every_type_belongs_to_a_struct():
    own = struct_types.__name__
    here = {name for name, each in vars(struct_types).items() if getattr(each, "__module__", "") == own}
    assert here == set(STRUCTS_BY_NAME)
