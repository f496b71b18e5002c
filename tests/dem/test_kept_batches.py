"""Constants and arrays of a batch of two unlike scenes, at its beginning and after some steps, kept (see `kept`).

The scenes differ in every number: numbers of bodies, laws, pieces of pipes, triangles and shapes. An
offset of one scene that is wrong by one is another number here.
"""

from contextlib import nullcontext

import kept
import numpy as np
import pytest
from test_checkpoint import mixed_scene

from warpcrete.core.device.device import divide_work_like_gpu, find_device
from warpcrete.core.device.footprint import arrays_of
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.stepper import steppers_of
from warpcrete.dem.scene.bodies import placed_bodies
from warpcrete.dem.scene.clumps import reference
from warpcrete.dem.scene.scene import Bodies, Contact, Scene, TimeStep
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.walls import Driven, MeshWall, PipeWall, PlaneWall, Prescribed


def piped(number: int) -> Scene:
    """Return a scene with clumps, two materials, a driven plate, a bent pipe and a mesh; `number` changes them all."""
    rng = np.random.default_rng(number)
    pieces = Line(0.1 + 0.02 * number), Arc(0.2, 0.5 + 0.1 * number, (1, 0, 0)), Line(0.1)
    axis = Axis((0, 0, 0), (0, 0, 1), pieces[: 2 + number])
    vertices, faces = Axis((0.3, 0, 0), (0, 0, 1), (Line(0.1),)).tube(0.04 + 0.01 * number, 5 + number)
    count = 6 + 3 * number
    grid = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], np.arange(9), indexing="ij"), -1).reshape(-1, 3)[: 2 * count]
    places = 0.0125 * grid + rng.normal(0, 2e-4, (2 * count, 3)) + [0, 0, 0.02]
    laws = {
        ("aggregate", "wall"): Contact(effective_modulus=2e5 * (1 + number), friction=0.1 * (1 + number)),
        ("stone", "stone"): Contact(effective_modulus=4e5, friction=0.5 - 0.1 * number),
    }
    return Scene(
        name=f"piped {number}", duration=1.0, contacts=laws, contact=Contact(friction=0.2, normal_damping_ratio=0.3),
        gravity=(0.1 * number, 0.0, -9.81), time_step=TimeStep(fixed=(2 + number) * 1e-5),
        bodies=(
            Bodies(positions=places[:count], sizes=rng.uniform(0.009, 0.012, count), template=reference()[number],
                   spins=rng.normal(0, 5, (count, 3))),
            Bodies(positions=places[count:], sizes=0.01, material="stone", density=2600.0 + number),
        ),
        walls=(
            PlaneWall(name="side", point=(-0.05 - 0.01 * number, 0, 0), normal=(1, 0, 0)),
            PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1), motion=Prescribed(velocity=(0, 0, 0.1))),
            PlaneWall(name="plate", point=(0, 0, 0.2), normal=(0, 0, -1),
                      motion=Driven(direction=(0, 0, -1), force=2.0 + number, mass=0.1)),
            PipeWall(name="pipe", axis=axis, radius=0.05 + 0.002 * number),
            MeshWall(name="mesh", vertices=vertices, faces=faces, motion=Prescribed(spin=(0, 0, 1.0 + number))),
        ),
    )  # fmt: skip


CONSTANTS = (
    "across", "bodies", "bond_parameters", "corners", "drive_axis", "drive_force", "face_wall", "faces", "flags",
    "links", "pair_parameters", "pairs", "ring", "ring_start", "scenes", "segments", "slot_scene", "slots", "spheres",
    "wall_parameters", "walls",
)  # fmt: skip


def arrays(batch):
    """Return all arrays of a batch that its scenes determine, with one entry for each field of a struct."""
    found = {}
    for path, array in arrays_of("", {name: getattr(batch, name) for name in CONSTANTS}):
        values = array.numpy()
        for field in values.dtype.names or ("",):
            name = f"{path}.{field}".strip(".")
            if name != "walls.table.mesh" and array.size:  # which are addresses
                found[name] = (values[field] if field else values).astype(float)
    return dict(sorted(found.items()))


@pytest.mark.parametrize("way", [nullcontext, divide_work_like_gpu], ids=["half", "full"])
def test_a_batch_of_unlike_scenes_is_kept(way):
    with way():
        models = [build_model(piped(k), find_device("cpu"), "float64") for k in (0, 1)]
        steppers = steppers_of(models, [State(model, placed_bodies(model.scene)) for model in models])
        for stepper in steppers:
            stepper.choose_dt()
        batch = steppers[0].batch
        rows = {name: batch.rows[name].astype(float) for name in batch.rows.dtype.names}
        kept.compare("batch-full" if batch.parallel else "batch-half", {"rows": rows} | arrays(batch))
        if not batch.parallel:
            for stepper in steppers:
                stepper.take(40)
            found = arrays(batch)
            kept.compare("batch-moved", {k: v for k, v in found.items() if k[:6] in ("bodies", "walls.")}, 1e-5)


def test_a_batch_of_bonded_scenes_is_kept():
    models = [build_model(mixed_scene(k), find_device("cpu"), "float64") for k in (0, 1)]
    steppers = steppers_of(models, [State(model, placed_bodies(model.scene)) for model in models])
    kept.compare("batch-bonded", arrays(steppers[0].batch))
