"""Functions of the particle method, called alone: inverses, forces of slip layers, and grains at a wall."""

import numpy as np
import pytest
import warp as wp
from flows import flow_of

from warpcrete.kernels.mps.operators import wall_law_function
from warpcrete.kernels.mps.rigid import places_kernel
from warpcrete.kernels.mps.structs import array_structs, flow_struct, mps_functions, mps_types
from warpcrete.mps.probes import measured
from warpcrete.theory import laws
from warpcrete.theory.laws import FlowLaw


@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_inverse_of_few_neighbours_is_that_of_a_lattice_of_the_same_trace(device, dimensions):
    """Neighbours on one line give a singular matrix; a multiple of the identity with the same trace replaces it."""
    t, inverse = mps_types(wp.float64, dimensions), mps_functions(wp.float64, dimensions).inverse

    @wp.kernel(module="unique")
    def invert(given: wp.array(dtype=t.mat), found: wp.array(dtype=t.mat)):
        found[wp.tid()] = inverse(given[wp.tid()])

    line = np.array([1.0, 2.0, -2.0])[:dimensions]
    full = np.eye(dimensions) + 0.1 * np.arange(dimensions**2).reshape(dimensions, dimensions) % 0.7
    given = np.stack([full, 1e-4 * full, np.outer(line, line), 0 * full])
    found = wp.zeros(len(given), dtype=t.mat, device=device)
    wp.launch(invert, len(given), [wp.array(given, dtype=t.mat, device=device), found], device=device)
    mean = line @ line / dimensions
    exact = [np.linalg.inv(full), 1e4 * np.linalg.inv(full), np.eye(dimensions) / mean, 0 * full]
    assert found.numpy() == pytest.approx(np.stack(exact), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(("law", "index"), [(laws.BINGHAM, 1.0), (laws.HERSCHEL_BULKLEY, 0.6)])
def test_the_force_of_a_layer_is_its_stress_times_the_area_whether_it_sticks_or_slips(device, law, index):
    """Slip and shear add up to the speed; the layer sticks below its yield stress, and the wall bears its stress."""
    t, force_of = mps_types(wp.float64, 2), wall_law_function(wp.float64, 2, law)
    Flow, area, compliance = flow_struct(wp.float64), 40.0, 2e-4

    @wp.kernel(module="unique")
    def ask(flow: Flow, v: wp.array(dtype=t.vec), area: wp.float64, compliance: wp.float64,
            force: wp.array(dtype=t.vec), out: wp.array2d(dtype=wp.float64)):  # fmt: skip
        i = wp.tid()
        x = t.vec(wp.float64(0.04), wp.float64(0.1))
        found, resist, stress = force_of(flow, x, v[i], area, compliance, force[i])
        force[i] = found
        out[i, 0] = resist
        out[i, 1] = stress

    flow = Flow()
    flow.radius, flow.slip_yield, flow.slip_viscosity, flow.slip_index, flow.slip_quadratic = (
        0.05,
        60.0,
        900.0,
        index,
        0.0,
    )
    # The layer slips above 60 Pa times the compliance, 12 mm/s. The velocity normal to the wall has no effect.
    speeds = np.array([-0.3, -0.011, -1e-6, 1e-6, 0.011, 0.013, 0.3])
    step = 1e-7
    every = np.concatenate([speeds, speeds - step, speeds + step])
    v, begin = np.stack([0.2 + 0 * every, every], 1), np.tile([3.0, -5.0], (len(every), 1))
    force, out = wp.array(begin, dtype=t.vec, device=device), wp.zeros((len(v), 2), dtype=wp.float64, device=device)
    wp.launch(ask, len(v), [flow, wp.array(v, dtype=t.vec, device=device), area, compliance, force, out], device=device)
    push, (resist, stress) = force.numpy() - begin, out.numpy().T
    assert push == pytest.approx(np.stack([0 * every, -area * stress * np.sign(every)], 1), rel=1e-9, abs=1e-12)
    # Newton's method, which laws other than Bingham's need, ends at a step of 1e-6 of the stress.
    slip = FlowLaw(60.0, 900.0, index).rate(stress)
    assert slip + compliance * stress == pytest.approx(np.abs(every), rel=1e-6)
    slope = -(push[14:, 1] - push[7:14, 1]) / (2 * step)
    assert resist[:7] == pytest.approx(slope, rel=1e-5)


def test_a_grain_in_a_tube_is_moved_back_by_the_depth_of_its_deepest_particle(device):
    """The deepest particle moves straight towards the axis, up to a quarter of a spacing before the wall."""
    t, structs = mps_types(wp.float64, 3), array_structs(wp.float64, 3)

    def array(values, dtype=t.vec):
        return wp.array(np.asarray(values), dtype=dtype, device=device)

    flow, particles, grains = flow_struct(wp.float64)(), structs.Particles(), structs.Grains()
    flow.radius, flow.spacing, flow.dt = 0.05, 0.004, 1.0
    offset, begin = np.array([[0.005, 0.012, 0.001], [-0.005, -0.012, -0.001]]), np.array([0.03, 0.02, 0.2])
    step = np.array([0.006, 0.003, 0.002])
    grains.first, grains.offset = array([0, 2], wp.int32), array(offset)
    grains.middle, grains.middle_rounding, grains.step = array([begin]), array(np.zeros((1, 3))), array([step])
    grains.turn, grains.spin = array(np.eye(3)[None], t.mat), array(np.zeros((1, 3)), wp.vec3d)
    particles.position = array(np.zeros((2, 3)))
    flags = wp.zeros(8, dtype=wp.int32, device=device)
    wp.launch(places_kernel(wp.float64, 3), 1, [flow, flags, particles, grains], device=device)
    target = begin + step + offset
    across, limit = np.hypot(*target[0, :2]), 0.049
    assert across > limit > np.hypot(*target[1, :2])
    back = (across - limit) * np.array([*target[0, :2], 0.0]) / across
    found = particles.position.numpy()
    assert found == pytest.approx(target - back, abs=1e-15)
    assert np.hypot(*found[0, :2]) == pytest.approx(limit, rel=1e-12)
    assert grains.middle.numpy()[0] == pytest.approx(begin + step - back, abs=1e-15)


def test_the_first_row_of_a_column_is_that_of_a_full_pipe(device):
    """The front is the surface of the topmost particles, half a spacing above their centres."""
    flow = flow_of(device, length=0.3)
    row = measured(flow, None)
    top = flow.state.layout.fluid[:, -1].max() + 0.5 * flow.state.layout.spacing
    assert row["front"] == pytest.approx(top, rel=1e-12) and top == pytest.approx(0.3, rel=1e-12)
    assert row["time"] == row["travel"] == 0.0
    # The particles are shaken by up to a hundredth of their spacing; measured 1e-5.
    assert abs(row["volume_error"]) < 2e-5
