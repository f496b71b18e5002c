"""Kernel that computes how the yield stress of a lubrication layer decreases while the concrete slips along the wall.

The layer gained yield stress while the concrete was at rest, and slip reduces this gain.
"""

import functools

import warp as wp

from .structs import array_structs


@functools.cache
def breakdown_kernel(scalar, law) -> wp.Kernel:
    """Return a kernel, with one thread per scene, that updates the yield stress of the contact law `law`.

    The law is a :class:`LubricationLayer`, which gains yield stress at rest. This gain decays with the slip as
    exp(-slip / breakdown). The slip is the distance that one wall has travelled since slip began. `slip_wall` holds the
    index of this wall in an array of the walls of all scenes of the batch. Each launch computes the yield stress from
    the whole slip, so the kernel may run at any interval.
    """
    structs = array_structs(scalar)
    Scenes, Walls = structs.Scenes, structs.Walls
    Parameters = law.functions(scalar).Parameters

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def break_down_structure(
        # yield stress of the layer without its gain at rest [Pa], one value per entry of `wall_parameters`
        own_yield: wp.array(dtype=scalar),
        # yield stress gained at rest [Pa], one value per scene; 0 until the concrete has been at rest
        gained: wp.array(dtype=wp.float64),
        # slip distance after which 1/e of the gained yield stress is left [m], one value per scene
        breakdown: wp.array(dtype=wp.float64),
        # distance that the wall had travelled when slip began [m], one value per scene
        begun: wp.array(dtype=wp.float64),
        # index in the batch of the wall whose travel counts as slip, one per scene
        slip_wall: wp.array(dtype=wp.int32),
        # The next arguments are arrays of the simulated state that this kernel only reads.
        scenes: Scenes,
        walls: Walls,
        # The next arguments are arrays that this kernel reads and writes.
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

    return break_down_structure
