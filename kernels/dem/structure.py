"""What a lubrication layer gained at rest, and how slip wears it off."""

import functools

import warp as wp

from .structs import array_structs


@functools.cache
def wear_kernel(scalar, law):
    """One thread a scene: yield stress of a :class:`LubricationLayer` `law` after the slip so far.

    What is left of it depends on the travel of one wall alone, so it may be worked out at any time.
    """
    structs = array_structs(scalar)
    Scenes, Walls = structs.Scenes, structs.Walls
    Parameters = law.functions(scalar).Parameters

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def wear_structure(
        own_yield: wp.array(dtype=scalar),  # of each law [Pa]
        gained: wp.array(dtype=wp.float64),  # of each scene [Pa]; 0: nothing yet
        breakdown: wp.array(dtype=wp.float64),  # slip by which it falls to 1/e [m]
        begun: wp.array(dtype=wp.float64),  # travel at which slip began [m]
        slip_wall: wp.array(dtype=wp.int32),  # whose travel it is, of the batch
        # state, read
        scenes: Scenes,
        walls: Walls,
        # read and written
        wall_parameters: wp.array(dtype=Parameters),
    ):
        s = wp.tid()
        if gained[s] > wp.float64(0.0):
            slip = wp.max(walls.travel[slip_wall[s]] - begun[s], wp.float64(0.0))
            left = scalar(gained[s] * wp.exp(-slip / breakdown[s]))
            row = scenes.row[s]
            for k in range(row.laws, row.laws + row.materials * row.materials):
                law_row = wall_parameters[k]
                law_row.yield_stress = own_yield[k] + left
                wall_parameters[k] = law_row

    return wear_structure
