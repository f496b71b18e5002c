"""Recordings and scenes are read back with the libraries that made them, and compared with the recorded state."""

import sys
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from warpcrete import Simulation, WarpcreteError, scenes
from warpcrete.core.device.recorder_thread import RecorderThread
from warpcrete.core.run.recorder import Recorder
from warpcrete.dem.scene import clumps
from warpcrete.dem.scene.scene import Bodies, Scene
from warpcrete.geometry.rotation import rotate
from warpcrete.geometry.walls import PlaneWall, Prescribed
from warpcrete.record.paraview import ParaViewRecorder, Poly
from warpcrete.record.rerun import RerunRecorder
from warpcrete.record.usd import UsdRecorder

INTERVAL = 5e-3


class Kept(Recorder):
    """Bodies, spheres and walls at every frame, and every row."""

    def __init__(self):
        self.tables, self.centres, self.poses, self.rows, self.times = [], [], [], [], []

    def frame(self, simulation):
        display = simulation.display("speed")
        self.times.append(simulation.stepper.time)
        self.tables.append(simulation.state.table())
        self.centres.append(display.centres().copy())
        names = [wall.name for wall in display.walls()]
        self.poses.append([a.copy() for a in map(np.asarray, display.wall_pose(names.index("paddle")))])

    def sample(self, simulation, row):
        self.rows.append(row)


def recording(patch, in_thread):
    """Recorders work beside the run, or in it."""
    patch.setattr(RecorderThread, "for_simulation", classmethod(lambda cls, simulation: cls(in_thread)))


@pytest.fixture(scope="module", params=["beside the run", "in the run"])
def recorded(request, tmp_path_factory):
    """Spinning clumps of two shapes that fly apart, beside a paddle that turns: every quaternion differs."""
    folder = tmp_path_factory.mktemp("recorded")
    shapes = clumps.reference()[:2]
    random = np.random.default_rng(3)
    place = np.array([[0.05 * k, 0.04 * (k % 2), 0.1] for k in range(6)])
    turned = random.normal(size=(6, 4))
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    scene = Scene(
        name="recorded",
        duration=0.03,
        sample_interval=INTERVAL,
        gravity=(0.0, 0.0, 0.0),
        bodies=tuple(
            Bodies(
                positions=place[k::2], sizes=[0.01, 0.012, 0.014], template=shapes[k], orientations=turned[k::2],
                spins=random.normal(scale=20, size=(3, 3)), velocities=random.normal(scale=0.3, size=(3, 3)),
            )
            for k in range(2)
        ),
        walls=(
            PlaneWall(
                name="paddle", point=(0.0, 0.0, -0.5), normal=(0.0, 0.0, 1.0), drawn_radius=0.1,
                motion=Prescribed(velocity=(0.1, 0.0, 0.2), spin=(3.0, 0.0, 5.0), ramp_time=0.0),
            ),
        ),
    )  # fmt: skip
    kept = Kept()
    recorders = [kept, RerunRecorder(folder / "run.rrd"), UsdRecorder(folder / "scene.usdc"), ParaViewRecorder(folder)]
    with pytest.MonkeyPatch.context() as patch:
        recording(patch, request.param == "beside the run")
        run = Simulation(scene, device="cpu", recorders=recorders, frame_interval=INTERVAL).run()
    assert run.finished and len(kept.times) == 7
    return folder, kept


def test_usd_has_every_body_as_the_state_has_it(recorded):
    from pxr import Usd, UsdGeom

    folder, kept = recorded
    stage = Usd.Stage.Open(str(folder / "scene.usdc"))
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/Run/Aggregates"))
    codes = instancer.GetPositionsAttr().GetTimeSamples()
    assert np.array(codes) / stage.GetTimeCodesPerSecond() == pytest.approx(kept.times, abs=1e-9)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (codes[0], codes[-1])
    assert (stage.GetFramesPerSecond(), stage.GetTimeCodesPerSecond()) == (round(1 / INTERVAL), 1000)
    assert np.array(instancer.GetScalesAttr().Get()) == pytest.approx(np.repeat(kept.tables[0].size[:, None], 3, 1))
    assert list(instancer.GetProtoIndicesAttr().Get()) == kept.tables[0].template.tolist()
    for code, table, previous in zip(codes, kept.tables, [None, *kept.tables]):
        assert np.array(instancer.GetPositionsAttr().Get(code)) == pytest.approx(table.position, abs=1e-7)
        assert np.array(instancer.GetVelocitiesAttr().Get(code)) == pytest.approx(table.velocity, rel=1e-6)
        found = np.array([[*q.GetImaginary(), q.GetReal()] for q in instancer.GetOrientationsAttr().Get(code)])
        aligned = np.abs(np.sum(found * table.orientation, axis=1))
        assert aligned == pytest.approx(1, abs=2e-3)  # half precision
        if previous is not None:
            assert np.all(np.abs(np.sum(table.orientation * previous.orientation, axis=1)) < 0.9999)


def test_usd_puts_every_sphere_where_it_is(recorded):
    """Through USD's own arithmetic of instances: position, orientation, size and prototype together."""
    from pxr import Usd, UsdGeom

    folder, kept = recorded
    stage = Usd.Stage.Open(str(folder / "scene.usdc"))
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/Run/Aggregates"))
    prototypes = [stage.GetPrimAtPath(path) for path in instancer.GetPrototypesRel().GetTargets()]
    for number in (0, 3, 6):
        code = Usd.TimeCode(instancer.GetPositionsAttr().GetTimeSamples()[number])
        matrices = instancer.ComputeInstanceTransformsAtTime(code, code)
        places = []
        for matrix, kind in zip(matrices, instancer.GetProtoIndicesAttr().Get()):
            for ball in prototypes[kind].GetChildren():
                local = UsdGeom.Xformable(ball).GetLocalTransformation()
                places.append((local * matrix).ExtractTranslation())
        assert np.array(places) == pytest.approx(kept.centres[number], abs=2e-5)


def test_usd_reads_the_same_by_a_program_that_has_nothing_of_pixar_s(recorded):
    """LightUSD, with readers of its own: bodies, their sizes and colours, turns, walls."""
    lightusd = pytest.importorskip("lightusd", reason="needs a second reader of USD, which the extra [test] installs")
    from pxr import Usd, UsdGeom

    folder, kept = recorded
    stage = lightusd.load(str(folder / "scene.usdc"))
    bodies = stage.prim_at("/Run/Aggregates")
    assert np.asarray(bodies["scales"])[:, 0] == pytest.approx(kept.tables[0].size)
    assert np.array_equal(np.asarray(bodies["protoIndices"]), kept.tables[0].template)
    pixar = Usd.Stage.Open(str(folder / "scene.usdc"))
    primvar = UsdGeom.PrimvarsAPI(pixar.GetPrimAtPath("/Run/Aggregates")).GetPrimvar("displayColor")
    table, colour = (bodies.attribute(f"primvars:displayColor{end}") for end in ("", ":indices"))
    for time, expected in zip(kept.times, kept.tables, strict=True):
        code = 1000 * time
        assert np.asarray(bodies.attribute("positions").get(time=code)) == pytest.approx(expected.position, abs=1e-7)
        turned = np.roll(
            np.asarray(bodies.attribute("orientations").get(time=code)).astype(float), -1, axis=1
        )  # w first
        assert np.abs(np.sum(turned * expected.orientation, axis=1)) == pytest.approx(1, abs=2e-3)
        found = np.asarray(table.get())[np.asarray(colour.get(time=code))]
        assert found == pytest.approx(np.array(primvar.ComputeFlattened(code)), abs=1e-6) and np.ptp(found) > 0.01
    assert np.asarray(stage.prim_at("/Run/Walls/paddle")["points"]).shape[1] == 3


def test_usd_moves_walls_as_they_move(recorded):
    from pxr import Usd, UsdGeom

    folder, kept = recorded
    stage = Usd.Stage.Open(str(folder / "scene.usdc"))
    paddle = UsdGeom.Xformable(stage.GetPrimAtPath("/Run/Walls/paddle"))
    for when, (position, turn) in zip(kept.times, kept.poses, strict=True):
        matrix = paddle.GetLocalTransformation(when * stage.GetTimeCodesPerSecond())
        assert np.array(matrix.ExtractTranslation()) == pytest.approx(position, abs=1e-6)
        for axis in np.eye(3):
            ours = rotate(turn[None], axis[None])[0]
            assert np.array(matrix.TransformDir(tuple(map(float, axis)))) == pytest.approx(
                ours, abs=5e-6
            )  # single precision
    assert np.linalg.norm(kept.poses[-1][0] - kept.poses[0][0]) > 1e-3


def columns(path, entity: str) -> dict[str, list]:
    """Columns of an entity of a recording, by name: one value a row, in the order of time; durations in seconds. What a
    row does not have, since it is as before, is None."""
    from rerun.chunk import RrdReader

    rows: list[dict] = []
    for chunk in RrdReader(str(path)).stream().to_chunks():
        if str(chunk.entity_path) == entity and not chunk.is_static:
            batch, held = chunk.to_record_batch(), {}
            for name in batch.schema.names:
                if name not in ("log_time", "log_tick") and "RowId" not in name:
                    column = batch.column(name)
                    values = column.cast("int64").to_numpy() * 1e-9 if name == "time" else column.to_pylist()
                    held[name] = values
            rows += [dict(zip(held, row)) for row in zip(*held.values())]
    rows.sort(key=lambda row: row["time"])
    return {name: [row.get(name) for row in rows] for name in sorted({name for row in rows for name in row})}


def everything(path):
    """All arrays of a VTKHDF file, by their paths."""
    found = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


def test_paraview_has_every_sphere_and_wall_as_the_state_has_it(recorded):
    """Read by VTK's own reader, at every time."""
    vtk = pytest.importorskip("vtk", reason="needs VTK's reader (pip install vtk; in the extra 'test')")
    from vtk.util.numpy_support import vtk_to_numpy

    folder, kept = recorded
    found = {}
    for name in ("bodies", "walls"):
        reader = vtk.vtkHDFReader()
        reader.SetFileName(str(folder / f"{name}.vtkhdf"))
        reader.UpdateInformation()
        times = reader.GetOutputInformation(0).Get(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS())
        assert times == pytest.approx(kept.times, abs=1e-12)
        for number, time_ in enumerate(times):
            reader.UpdateTimeStep(time_)
            drawn = reader.GetOutput()
            data = drawn.GetPointData()
            fields = {
                data.GetArrayName(k): vtk_to_numpy(data.GetArray(k)).copy() for k in range(data.GetNumberOfArrays())
            }
            cells = [drawn.GetNumberOfVerts(), drawn.GetNumberOfPolys(), drawn.GetNumberOfLines()]
            found[name, number] = vtk_to_numpy(drawn.GetPoints().GetData()).copy(), fields, cells
    for number, (table, centres) in enumerate(zip(kept.tables, kept.centres, strict=True)):
        points, fields, cells = found["bodies", number]
        assert points == pytest.approx(centres, abs=1e-7) and cells == [len(centres), 0, 0]
        assert fields["velocity"] == pytest.approx(table.velocity[fields["body"]][:, :3], rel=1e-6)
        assert np.bincount(fields["body"]).sum() == len(centres) and set(fields["body"]) == set(range(6))
        assert fields["radius"].min() > 0 and fields["colour"].shape == (len(centres), 3)
        points, fields, cells = found["walls", number]
        position, orientation = kept.poses[number]
        # A slab of 0.1 m about the paddle's middle, half of it to either side, wherever it has turned to.
        own = rotate(np.broadcast_to(orientation, (len(points), 4)), points.astype(float) - position, inverse=True)
        if number == 0:
            first = own
        assert cells[1] > 8 and np.all(fields["wall"] == 0) and own == pytest.approx(first, abs=1e-6)
        assert np.linalg.norm(own[:, :2], axis=1).max() == pytest.approx(0.1, rel=1e-2)


def test_faces_of_several_walls_have_corners_of_their_own_wall(tmp_path):
    """One file holds all walls, one after the other: a triangle, which stays, and a square, which moves and turns."""
    flat, square = (
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]),
        np.array([[0.0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]]),
    )
    walls = [SimpleNamespace(vertices=flat, faces=np.array([[0, 1, 2]])),
             SimpleNamespace(vertices=square, faces=np.array([[0, 1, 2], [0, 2, 3]]))]  # fmt: skip
    poses = [(np.zeros(3), np.array([0.0, 0, 0, 1])), (np.array([5.0, 0, 1]), np.array([0.0, 0, 1, 1]) / np.sqrt(2))]
    recorder = ParaViewRecorder(tmp_path)
    recorder._walls, recorder._display = walls, SimpleNamespace(wall_pose=poses.__getitem__)
    recorder._files["walls"] = Poly(tmp_path / "walls.vtkhdf", "Polygons")
    recorder._draw_walls(0.0)
    recorder._files["walls"].write()
    found = everything(tmp_path / "walls.vtkhdf")
    turned = [[5, 0, 1], [5, 2, 1], [3, 2, 1], [3, 0, 1]]  # A quarter turn about z takes x to y.
    assert found["VTKHDF/Points"] == pytest.approx(np.concatenate([flat, turned]), abs=1e-6)
    assert found["VTKHDF/Polygons/Connectivity"].tolist() == [0, 1, 2, 3, 4, 5, 3, 5, 6]
    assert found["VTKHDF/PointData/wall"].tolist() == [0, 0, 0, 1, 1, 1, 1]


def test_steps_of_a_file_for_paraview_are_the_same_however_they_came_in(tmp_path):
    """Four steps, each with more lines than the one before: at once, in two goes, and cut from five."""
    random = np.random.default_rng(0)
    steps = []
    for k in range(5):
        points, cells = random.normal(size=(2 * k, 3)), np.arange(2 * k).reshape(-1, 2)
        steps.append(
            (0.1 * k, points, cells, {"bonded": np.arange(2 * k, dtype="u1"), "v": random.normal(size=(2 * k, 3))})
        )

    def written(name, *goes, keep=None):
        file = Poly(tmp_path / name, "Lines")
        for go in goes:
            for step in go:
                file.add(*step)
            file.write()
        if keep is not None:
            file.shorten(keep)
        return everything(tmp_path / name)

    once = written("once", steps[:4])
    for other in (
        written("twice", steps[:1], steps[1:4]),
        written("cut", steps, keep=4),
        written("same", steps[:4], keep=4),
    ):
        assert set(other) == set(once)
        for name, array in once.items():
            assert np.array_equal(array, other[name]), name
    assert once["VTKHDF/Steps/CellOffsets"].tolist() == [[0, 0, 0, 0], [0, 0, 0, 0], [0, 1, 0, 0], [0, 3, 0, 0]]
    assert once["VTKHDF/Lines/NumberOfCells"].tolist() == [0, 1, 2, 3]
    assert once["VTKHDF/Lines/Offsets"].tolist() == [0, 0, 2, 0, 2, 4, 0, 2, 4, 6]
    with h5py.File(tmp_path / "cut") as file:
        assert file["VTKHDF/Steps"].attrs["NSteps"] == 4 and file["VTKHDF"].attrs["Type"] == b"PolyData"
    (tmp_path / "damaged").write_bytes((tmp_path / "cut").read_bytes()[:300])
    assert [Poly(tmp_path / name, "Lines").count() for name in ("cut", "none", "damaged")] == [4, 0, 0]
    Poly(tmp_path / "cut", "Lines").shorten(0)
    assert not (tmp_path / "cut").exists()


def test_paraview_says_what_it_needs(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(
        WarpcreteError,
        match=r"^paraview: needs the package h5py, which is not installed; run pip install 'warpcrete\[paraview\]'$",
    ):
        ParaViewRecorder(tmp_path)


@pytest.mark.parametrize("number", [1, 2, 9])
def test_heights_of_bars_are_as_rerun_would_have_them(number):
    """Converted once for so many, then swapped in Arrow's array."""
    from rerun.components import TensorDataBatch

    recorder, rng = RerunRecorder(None), np.random.default_rng(number)
    recorder._tensors = {}
    for _ in range(3):
        values = rng.normal(size=number)
        expected = TensorDataBatch(values).as_arrow_array()
        found = recorder._bars(values)
        assert found.type == expected.type and found.equals(expected)
    assert not found.equals(TensorDataBatch(values + 1).as_arrow_array())


def test_rerun_has_every_frame_and_every_row_with_its_time(recorded):
    folder, kept = recorded
    spheres = columns(folder / "run.rrd", "/scene/aggregates")
    (positions,) = [value for name, value in spheres.items() if "positions" in name]
    assert len(positions) > 1
    for found, centres in zip(positions, kept.centres, strict=True):
        assert np.array(found) == pytest.approx(centres, abs=1e-6)
    assert spheres["time"] == pytest.approx(kept.times, abs=1e-8)
    energy = columns(folder / "run.rrd", "/energy/kinetic_energy")
    (scalars,) = [value for key, value in energy.items() if "scalars" in key.lower()]
    assert np.ravel(scalars) == pytest.approx([row["kinetic_energy"] for row in kept.rows])


@pytest.mark.parametrize("method", ["elements", "flow"])
def test_rerun_shows_pressures_in_kilopascals(tmp_path, method):
    kept = []

    class Rows(Recorder):
        def sample(self, simulation, row):
            kept.append(row)

    if method == "elements":
        scene = scenes.pipe(
            diameter=0.08, length=0.1, ramp=0.0, travel=0.01, settle=0.0, size_min=8e-3, size_max=16e-3, plug="plate"
        )
        shown = {"/pressure/piston": ("pressure", 1e-3)}
    else:
        scene = scenes.channel(spacing=20e-3, duration=0.02)
        shown = {"/pressure/piston": ("pressure", 1e-3), "/slip/layer": ("slip_velocity", 100.0)}
    path = tmp_path / "run.rrd"
    Simulation(scene, device="cpu", recorders=[RerunRecorder(path), Rows()]).run()
    for entity, (name, factor) in shown.items():
        found = columns(path, entity)
        (scalars,) = [value for key, value in found.items() if "scalars" in key.lower()]
        assert np.ravel(scalars) == pytest.approx([factor * row[name] for row in kept], nan_ok=True), entity
        assert np.nanmax([abs(row[name]) for row in kept]) > 0
