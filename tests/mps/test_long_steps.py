"""Long time steps in stiff concrete: they must not make it flow farther than short steps do."""

import pytest

from warpcrete.mps.free.scene import FreeScene
from warpcrete.mps.free.simulation import FreeSimulation
from warpcrete.mps.grid.state import NO_SLIP_VISCOSITY
from warpcrete.theory.pipe import Concrete

HALF = 0.2, 0.05
"""Half of the width, and the height, of the box of concrete that is released on a plate [m]."""


def spread(yield_stress, viscosity, duration, spacing, time_step):
    """Return how far the front of released concrete moves [m]; only Courant's number and `time_step` limit steps."""
    concrete = Concrete(
        density=2000.0, viscosity=viscosity, yield_stress=yield_stress, slip_viscosity=NO_SLIP_VISCOSITY, slip_yield=0.0
    )
    scene = FreeScene(
        name="dam", concrete=concrete, axial=False, width=0.45, height=0.08, spacing=spacing,
        outline=((0.0, 0.0), (HALF[0], 0.0), HALF, (0.0, HALF[1])), sides={"left": "mirror"}, duration=duration,
        sample_interval=duration, time_step=time_step, step_error=0.1,
    )  # fmt: skip
    run = FreeSimulation(scene, device="cpu", threads=1).run()
    return float(run.series["spread"][-1]) - HALF[0]


def test_viscous_flow_hardly_depends_on_the_time_step():
    # The viscous number 20 ms * 3000 Pa s / (2000 kg/m3 * (6.25 mm)^2) is 770. The measured difference is 2.4 %. If
    # the pressure lags behind, concrete flows 26 % farther with the longer steps.
    short, long = (spread(0.0, 3000.0, 1.0, 6.25e-3, dt) for dt in (2e-3, 2e-2))
    assert long == pytest.approx(short, rel=0.04)


def test_heap_that_slows_down_hardly_depends_on_the_time_step():
    # The measured difference is 4.0 %; it is 7.8 % if the pressure lags behind. Steps of 2 to 5 ms agree within 0.2 %.
    short, long = (spread(50.0, 10.0, 2.0, 5e-3, dt) for dt in (5e-3, 2e-2))
    assert long == pytest.approx(short, rel=0.05)


@pytest.mark.parametrize("time_step", [2.5e-3, 2e-2])
def test_concrete_below_its_yield_stress_stays_at_rest(time_step):
    assert abs(spread(2000.0, 30.0, 3.0, 6.25e-3, time_step)) < 2e-4
