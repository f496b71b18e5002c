"""Surfaces of concrete in recordings, read back with the libraries that made them, and colours of their shear rate."""

import h5py
import numpy as np
import pytest
from test_recordings import columns

from warpcrete import Simulation, scenes
from warpcrete.core.drawing.paint import ENDS, colour_map, packed, palette_colours
from warpcrete.core.drawing.style import NAMES, RUN, SECOND, explained
from warpcrete.core.run.recorder import Recorder
from warpcrete.record.blueprint import plot_title
from warpcrete.record.legend import meaning
from warpcrete.record.paraview import ParaViewRecorder
from warpcrete.record.rerun import RerunRecorder
from warpcrete.record.usd import UsdRecorder
from warpcrete.record.usd_looks import linear

CONE = dict(concrete="own", density=2300.0, viscosity=30.0, yield_stress=500.0, spacing=0.0125, duration=0.2)
SHORT_PART = dict(concrete="no1", unit="bend-to-vertical", straight=0.2, spacing=0.0125, duration=0.03)


class Surfaces(Recorder):
    """Surface, its cut and its colours at every frame."""

    def __init__(self):
        self.found, self.times = [], []

    def frame(self, simulation):
        display = simulation.display("shear")
        self.times.append(simulation.stepper.time)
        whole, cut = display.surface(), display.surface(cut=True)
        self.found.append((whole, cut, display.surface_colours(whole)))
        self.display = display


def recorded(folder, scene):
    kept = Surfaces()
    recorders = [
        kept,
        RerunRecorder(folder / "run.rrd", colouring="shear"),
        UsdRecorder(folder / "scene.usdc", colouring="shear"),
        ParaViewRecorder(folder, colouring="shear"),
    ]
    run = Simulation(scene, device="cpu", threads=1, recorders=recorders).run()
    return folder, kept, run


@pytest.fixture(scope="module", params=["float32", "float64"])
def cone(request, tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("cone"), scenes.slump(**CONE, precision=request.param, lift_time=0.2))


@pytest.fixture(scope="module")
def bend(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("bend"), scenes.part(**SHORT_PART))


def test_recording_changes_nothing_of_a_run(cone):
    _, kept, run = cone
    again = Simulation(run.scene, device="cpu", threads=1).run()
    assert again.result["state_hash"] == run.result["state_hash"] and len(kept.times) == 11


def test_rerun_has_the_surface_of_every_frame(cone):
    folder, kept, _ = cone
    for path, which in (("/scene/concrete", 0), ("/scene/cut/concrete", 1)):
        held = columns(folder / "run.rrd", path)
        assert held["time"] == pytest.approx(kept.times, abs=1e-8)
        for number, positions in enumerate(held["Mesh3D:vertex_positions"]):
            surface = kept.found[number][which]
            assert np.array(positions) == pytest.approx(surface.vertices, abs=1e-6)
            faces, normals = (held[f"Mesh3D:{name}"][number] for name in ("triangle_indices", "vertex_normals"))
            assert np.array_equal(faces, surface.faces)
            assert np.array(normals) == pytest.approx(surface.normals, abs=1e-5)
            if which == 0:
                assert np.array_equal(np.ravel(held["Mesh3D:vertex_colors"][number]), packed(kept.found[number][2]))


def test_a_shape_that_stays_is_recorded_once(bend):
    """The concrete fills the part at all times; only its colours change."""
    folder, kept, _ = bend
    held = columns(folder / "run.rrd", "/scene/concrete")
    there = [positions is not None for positions in held["Mesh3D:vertex_positions"]]
    assert len(there) == len(kept.times) == 3 and there == [True] + [False] * (len(there) - 1)
    assert all(colours is not None for colours in held["Mesh3D:vertex_colors"])


def test_concrete_of_a_part_fills_its_bore_and_its_wall_lies_outside(bend):
    _, kept, run = bend
    whole, cut, _ = kept.found[-1]
    length = run.scene.axis.length
    assert whole.volume == pytest.approx(np.pi * 0.05**2 * length, rel=0.02)  # measured 1.6 %: the inlet is oblique
    assert cut.volume == pytest.approx(0.5 * whole.volume, rel=0.001)
    nearest, _ = run.scene.axis.projected(whole.vertices)
    assert np.linalg.norm(whole.vertices - nearest, axis=1).max() < 0.05 * 1.01  # measured 0.9 %, across cells
    (wall,) = kept.display.walls()
    nearest, _ = run.scene.axis.projected(wall.vertices)
    assert np.linalg.norm(wall.vertices - nearest, axis=1) == pytest.approx(0.05 * 1.03, rel=1e-3)
    # Concrete slips on the wall and is sheared there most, and hardly on the axis.
    middle = np.abs(s_of(run, cut) - 0.5 * length) < 0.1
    inner = radius_of(run, cut) < 0.01
    outer = radius_of(run, cut) > 0.04
    shear = cut.fields["shear_rate"]
    assert shear[middle & outer].mean() > 2 * shear[middle & inner].mean() > 0


def s_of(run, surface):
    return run.scene.axis.projected(surface.vertices)[1]


def radius_of(run, surface):
    return np.linalg.norm(surface.vertices - run.scene.axis.projected(surface.vertices)[0], axis=1)


def test_usd_has_the_surface_of_every_frame(cone):
    from pxr import Usd, UsdGeom

    folder, kept, _ = cone
    stage = Usd.Stage.Open(str(folder / "scene.usdc"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Run/Concrete"))
    codes = mesh.GetPointsAttr().GetTimeSamples()
    assert np.array(codes) / stage.GetTimeCodesPerSecond() == pytest.approx(kept.times, abs=1e-9)
    for code, (whole, _, colours) in zip(codes, kept.found, strict=True):
        assert np.array(mesh.GetPointsAttr().Get(code)) == pytest.approx(whole.vertices, abs=1e-6)
        assert np.array_equal(np.array(mesh.GetFaceVertexIndicesAttr().Get(code)), whole.faces.ravel())
        found = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("displayColor").ComputeFlattened(code)
        assert np.array(found) == pytest.approx(linear(colours), abs=1e-6)
    assert "slump, concrete own (500 Pa, 30 Pa s)" in stage.GetRootLayer().documentation


def test_paraview_has_the_surface_of_every_frame(cone):
    folder, kept, _ = cone
    with h5py.File(folder / "surface.vtkhdf") as file:
        root = file["VTKHDF"]
        starts = root["Steps/PointOffsets"][:]
        assert root["Steps/Values"][:] == pytest.approx(kept.times)
        for start, (whole, _, colours) in zip(starts, kept.found, strict=True):
            part = slice(start, start + len(whole.vertices))
            assert root["Points"][part] == pytest.approx(whole.vertices, abs=1e-6)
            for name in ("shear_rate", "speed", "pressure"):
                assert root["PointData"][name][part] == pytest.approx(whole.fields[name], rel=1e-5, abs=1e-6)
            assert np.array_equal(root["PointData/colour"][part], colours)
    with h5py.File(folder / "bodies.vtkhdf") as file:
        assert {"shear_rate", "speed", "pressure", "radius"} <= set(file["VTKHDF/PointData"])


def test_vtk_reads_the_surface_with_its_normals(cone):
    vtk = pytest.importorskip("vtk", reason="needs VTK's reader (pip install vtk; in the extra 'test')")

    folder, kept, _ = cone
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(folder / "surface.vtkhdf"))
    reader.UpdateInformation()
    reader.UpdateTimeStep(kept.times[-1])
    drawn = reader.GetOutput()
    whole = kept.found[-1][0]
    assert drawn.GetNumberOfPoints() == len(whole.vertices) and drawn.GetNumberOfPolys() == len(whole.faces)
    mass = vtk.vtkMassProperties()
    mass.SetInputData(drawn)
    mass.Update()
    assert mass.GetVolume() == pytest.approx(whole.volume, rel=1e-3)
    assert drawn.GetPointData().GetArray("Normals").GetNumberOfComponents() == 3


def test_colours_of_concrete_run_from_grey_to_dark_red(cone):
    """They become darker all the way, so that prints without colours can be read."""
    _, kept, _ = cone
    light = colour_map("concrete")(np.linspace(0, 1, 64))[:, :3] @ [0.2126, 0.7152, 0.0722]
    assert np.all(np.diff(light) < 0)
    grey = palette_colours(np.zeros(1), 1.0, name="concrete")[0].astype(int)
    assert np.ptp(grey) < 15 and kept.display.palette == "concrete"
    assert "(grey)" in meaning(kept.display) and "(dark red)" in meaning(kept.display)
    assert set(ENDS) == {"viridis", "concrete"}


def test_titles_of_plots_name_the_colours_of_their_curves(cone):
    _, kept, _ = cone
    shape, speed = kept.display.plots()
    assert plot_title(shape) == f"Shape [mm]: spread {NAMES[RUN]}, highest point {NAMES[SECOND]}"
    assert plot_title(speed) == "Fastest [mm/s]" and explained("Speed", [("a", RUN)]) == "Speed"
