"""How full cells of a grid are: what they hold, levels of surfaces, films, walls that meet sides of the room aslant."""

import math

import numpy as np
import pytest
from test_free_flows import vessel
from test_grid_flows import stages_through

from warpcrete.mps.free.layout import free_layout
from warpcrete.mps.free.simulation import FreeSimulation
from warpcrete.mps.grid.filling import fill_cells
from warpcrete.mps.grid.geometry import OPEN_SIDE, WALL, Room, geometry_of
from warpcrete.verification.vessels import tilted_vessel


@pytest.mark.parametrize("axial", [False, True])
def test_a_cell_holds_what_its_particles_weigh(axial):
    """Beside walls on the grid's lines and within the concrete, the crowd of the particles that are placed is one; what
    lies between a cell's middle and a wall counts in full."""
    room = Room((8, 6), (0.1, 0.1), (0.0, 0.0), (("mirror" if axial else WALL, WALL), (WALL, OPEN_SIDE)))
    g = geometry_of(room, [], axial)
    places, mass = fill_cells(room, 3, lambda x: np.ones(len(x), bool))
    radius = places[:, 0] if axial else np.ones(len(places))
    for i, k in ((0, 0), (3, 0), (4, 3), (7, 2)):
        middle = np.array([(i + 0.5) * 0.1, (k + 0.5) * 0.1])
        away = np.abs(places - middle) / 0.1
        walls = np.array([[places[:, 0] < middle[0], places[:, 0] > middle[0]][i == 7], places[:, 1] < middle[1]]).T
        away[walls & [i in (0, 7), k == 0] & (away < 0.5)] = 0
        near = np.maximum(1 - away, 0).prod(1)
        whole = np.sum(near * mass * radius) * (0.1 / 3) ** 2
        assert whole == pytest.approx(g.weighted_volume[k + 1, i + 1], rel=0.012 if axial else 1e-9)


def test_particles_weigh_what_there_is_of_cells_that_an_edge_passes():
    room = Room((20, 20), (0.1, 0.1), (-1.0, -1.0), ((OPEN_SIDE, OPEN_SIDE),) * 2)
    places, mass = fill_cells(room, 3, lambda x: np.linalg.norm(x - [0.013, 0.027], axis=1) < 0.77)
    assert mass.sum() * (0.1 / 3) ** 2 == pytest.approx(math.pi * 0.77**2, rel=3e-3)
    assert np.all(mass[np.linalg.norm(places, axis=1) < 0.5] == 1)


def filled(device, change):
    """Fullness of the cells of a box, shape (rows, columns), once its particles' places and masses were changed."""
    simulation = FreeSimulation(vessel(spacing=0.01), device=device, precision="float64")
    simulation.prepare()
    particles = simulation.state.particles
    place, mass = change(particles.position.numpy().copy(), particles.mass.numpy().copy())
    particles.position.assign(place)
    particles.mass.assign(mass)
    stages_through(simulation.flow, "fill")
    return simulation.state.cells("fill")


@pytest.mark.parametrize("up", [0.0, 0.15, 0.45, 0.6, 0.9])
def test_a_cell_is_as_full_as_a_flat_surface_stands_in_it(device, up):
    """Concrete to row five and a part of the next, particles a third of a cell apart; measured: 0.021 cells, beside
    a wall 0.041."""

    def raised(place, mass):
        return place + [0.0, 0.01 * up], mass

    fill = filled(device, raised)
    assert np.all(fill[1:9] == 1) and np.all(fill[11:] == 0)
    level = fill[9:12].sum(0)
    assert level[1:-1] == pytest.approx(np.full(len(level) - 2, 1 + up), abs=0.025)
    assert level[[0, -1]] == pytest.approx(np.full(2, 1 + up), abs=0.045)


@pytest.mark.parametrize("deep", [0.1, 0.3, 0.45])
def test_a_film_on_a_plate_fills_what_there_is_of_it(device, deep):
    """Thinner than half a cell, where a surface in the open would leave nothing."""

    def squeezed(place, mass):
        lowest = place[:, 1] < 0.01
        return place * [1.0, deep], np.where(lowest, deep * mass, 0.0)

    fill = filled(device, squeezed)
    assert fill[0] == pytest.approx(np.full(fill.shape[1], deep), abs=1e-9) and np.all(fill[1:] == 0)


def test_slanted_walls_that_meet_sides_of_the_room_leave_all_between_them():
    """A wedge between two walls, in a plane and, between sides of the room, in space: the same section, to 0.3 %."""
    z = np.linspace(0.013, 0.2, 1001)
    width = (z - 0.013) / 0.487 * 0.34
    section = float(np.sum(0.5 * (width[1:] + width[:-1]) * np.diff(z)))
    for depth in (0.0, 0.05):
        layout = free_layout(tilted_vessel(depth=depth))
        room = layout.geometry.room[(slice(1, 21), *[slice(1, -1)] * (layout.axes - 1))]
        whole = float(room.sum() * np.prod(layout.room.width))
        assert whole == pytest.approx(section * (depth or 1.0), rel=3e-3)


def test_every_particle_of_a_crowded_cell_counts(device):
    """Light particles from near an axis gather further out, 67 of them in a cell of a thin heap: the lists have each
    particle once, with its cell, in the order of their numbers, however many a cell holds."""
    simulation = FreeSimulation(vessel(spacing=0.01), device=device)
    simulation.prepare()
    particles, mesh = simulation.state.particles, simulation.state.mesh
    place, mass = particles.position.numpy(), particles.mass.numpy()
    rng = np.random.default_rng(1)
    crowd = rng.permutation(len(place))[:300]
    place[crowd] = [0.203, 0.054] + rng.uniform(-2e-3, 2e-3, (300, 2))
    mass[crowd] /= 50
    mass[[7, 11]] = 0
    particles.position.assign(place)
    particles.mass.assign(mass)
    stages_through(simulation.flow, "fill")
    begin, count, listed = mesh.begin.numpy(), mesh.count.numpy(), mesh.sorted_particles.numpy()
    parts = [listed[begin[c] : begin[c] + count[c]] for c in np.flatnonzero(count)]
    assert max(map(len, parts)) >= 299
    assert sorted(np.concatenate(parts)) == [p for p in range(len(place)) if p not in (7, 11)]
    for part in parts:
        assert list(part) == sorted(part)
        assert len(np.unique(np.floor(place[part] / 0.01), axis=0)) == 1
