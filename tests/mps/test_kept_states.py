"""Constants and arrays with which flows begin on the device, kept (see `kept`), and states that come back."""

import kept
import numpy as np
import pytest

from warpcrete import scenes
from warpcrete.core.device.device import find_device
from warpcrete.mps.free.layout import free_layout
from warpcrete.mps.grid.state import PARTICLE_ARRAYS as GRID_ARRAYS
from warpcrete.mps.grid.state import GridState, grid_numbers
from warpcrete.mps.part.layout import part_layout
from warpcrete.mps.pipe_grid import pipe_layout
from warpcrete.mps.state import GRAIN_ARRAYS, PARTICLE_ARRAYS, FluidState, flow_numbers

OWN = dict(
    concrete="own",
    density=2300.0,
    viscosity=30.0,
    yield_stress=50.0,
    slip_viscosity=900.0,
    slip_yield=20.0,
    flow_index=1.2,
    slip_flow_index=1.1,
)
GRIDS = {
    "channel": lambda: (scenes.channel(**OWN, spacing=0.02, ends="periodic"), pipe_layout),
    "tube": lambda: (scenes.tube(**OWN, spacing=0.02, ends="periodic"), pipe_layout),
    "tube rested": lambda: (scenes.tube(spacing=0.02, ends="periodic", rest=60.0, thixotropy=0.1), pipe_layout),
    "slump": lambda: (scenes.slump(**OWN, spacing=0.02), free_layout),
    "lcpc": lambda: (scenes.lcpc(**OWN, spacing=0.02), free_layout),
    "part": lambda: (
        scenes.part(concrete="no1", unit="bend-to-vertical", straight=0.2, spacing=0.0125, gravity=9.0),
        part_layout,
    ),
}
COLUMNS = {
    "channel": lambda: scenes.channel(**OWN, spacing=0.02, ends="piston"),
    "tube": lambda: scenes.tube(**OWN, spacing=0.02, ends="piston"),
    "grains": lambda: scenes.channel(spacing=5e-3, aggregates=True, aggregate_fraction=0.15),
}


def numbers(struct):
    return {name: np.array(getattr(struct, name), float) for name in struct._cls.vars}


def arrays(struct):
    found = {name: getattr(struct, name) for name in struct._cls.vars}
    return {name: array.numpy().astype(float) for name, array in found.items() if array is not None and array.size}


def changed(stored, rng):
    """Return arrays of the same shapes with other values; no two arrays are equal."""
    return {
        name: (rng.uniform(1, 2, array.shape) * 100).astype(array.dtype) if array.dtype.fields is None else array
        for name, array in stored.items()
    }


def comes_back(make, own):
    """A state that loads a checkpoint has all arrays of the stored state, each under its own name."""
    first, second = make(), make()
    stored = first.state_dict()
    assert own <= set(stored)
    other = changed(stored, np.random.default_rng(1))
    second.load_state_dict(other)
    again = second.state_dict()
    # The arrays of a checkpoint must not change when the state changes.
    second.load_state_dict(stored)
    assert set(again) == set(other)
    for name, array in other.items():
        assert np.array_equal(again[name], array), name
    second.load_state_dict(other)
    return second, other


@pytest.mark.parametrize("name", GRIDS)
def test_a_grid_begins_as_it_is_kept_and_comes_back(name):
    scene, layout_of = GRIDS[name]()
    state = GridState(scene, layout_of(scene), find_device("cpu"), "float64")
    cells = {
        each: state.cells(each)
        for each in ("fill", "solid", "quarter_fraction", "weighted_volume", "room")
        if getattr(state.mesh if each in state.structs.Fields.vars else state.geometry, each).size == state.slots
    }
    kept.compare(
        f"grid-{name.replace(' ', '-')}",
        {
            "numbers": numbers(grid_numbers(state)),
            "walls": arrays(state.walls),
            "particles": arrays(state.particles),
            "mesh": arrays(state.mesh),
            "geometry": arrays(state.geometry),
            "opened": arrays(state.opened),
            "cells": cells,
            "spacing": state.particle_spacing,
        },
    )
    layout = state.layout
    back, stored = comes_back(lambda: GridState(scene, layout, find_device("cpu"), "float64"), {*GRID_ARRAYS, "flags"})
    for each in GRID_ARRAYS:
        assert np.array_equal(getattr(back.particles, each).numpy(), stored[each])
    for each in back.mesh_arrays:
        assert np.array_equal(getattr(back.mesh, each).numpy(), stored[f"mesh_{each}"])


@pytest.mark.parametrize("name", COLUMNS)
def test_a_column_begins_as_it_is_kept_and_comes_back(name):
    scene = COLUMNS[name]()
    state = FluidState(scene, find_device("cpu"), "float64")
    own = {*PARTICLE_ARRAYS, "flags", *(f"grain_{each}" for each in GRAIN_ARRAYS if name == "grains")}
    kept.compare(
        f"column-{name}",
        {
            "numbers": numbers(flow_numbers(state, skin=0.4, correction=0.1)),
            "particles": arrays(state.particles),
            "grains": {} if state.grain_arrays is None else arrays(state.grain_arrays),
            "mass": state.mass,
            "spacing": state.particle_spacing,
        },
    )
    assert own >= {"position", "rounding", "velocity", "pressure", "flags"}
    back, stored = comes_back(lambda: FluidState(scene, find_device("cpu"), "float64"), own)
    for each in PARTICLE_ARRAYS:
        assert np.array_equal(getattr(back.particles, each).numpy(), stored[each])
