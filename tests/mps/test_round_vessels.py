"""Heights, bases and reach of concrete in made-up cells, in a plane, in space and around an axis; durations."""

import dataclasses
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from warpcrete.core.errors import InstabilityError
from warpcrete.core.units import quantity
from warpcrete.mps.common import forecast as common_forecast
from warpcrete.mps.common.forecast import coarser_run
from warpcrete.mps.free import forecast
from warpcrete.mps.free.forecast import course_of
from warpcrete.mps.free.probes import bases, reach, surface


def flow_of(fill, *, room=1.0, round=False, axial=False, left=0.0):
    """Flow whose cells are 0.1 m wide and 0.05 m high, with these fractions of concrete, shape (z, (y,) x)."""
    fill = np.array(fill, float)
    cells = {"fill": fill, "room": np.broadcast_to(room, fill.shape)}
    layout = SimpleNamespace(
        left=left, spacing=0.1, step=0.05, cells=fill.shape[::-1], axes=fill.ndim, axial=axial,
        room=SimpleNamespace(width=(0.1, 0.1, 0.05)[: fill.ndim - 1] + (0.05,)),
    )  # fmt: skip
    return SimpleNamespace(
        state=SimpleNamespace(layout=layout, cells=lambda name: cells[name]),
        scene=SimpleNamespace(round=round, walls=()),
    )


def test_a_surface_in_a_plane():
    flow = flow_of([[0, 1, 0.5], [0, 0.5, 0]], room=[[1, 0.4, 1], [1, 1, 1]], left=-0.2)
    across, height = surface(flow)
    assert across == pytest.approx([-0.15, -0.05, 0.05])
    assert height == pytest.approx([0, (0.4 + 0.5) * 0.05, 0.5 * 0.05])
    # A wall fills 0.6 of the second cell from below; the third column begins at the bottom.
    assert bases(flow) == pytest.approx([0, 0.6 * 0.05, 0])
    assert reach(flow) == pytest.approx(0.15)
    lifted = flow_of([[0, 0, 0], [1, 0, 1]], room=[[1, 1, 1], [1, 1, 0.5]])
    assert bases(lifted) == pytest.approx([0.05, 0, 0.05 + 0.025])


def test_an_axisymmetric_reach_has_the_volume_of_a_disc():
    assert reach(flow_of([[1, 1, 0.5]], axial=True)) == pytest.approx(np.sqrt(2 * (0.05 + 0.15 + 0.125) * 0.1))
    assert reach(flow_of([[1, 1, 1], [1, 0, 0]], axial=True)) == pytest.approx(0.3)


def test_a_surface_in_space_is_a_mean_over_the_depth():
    flow = flow_of([[[1, 0.5], [0, 0.5]], [[1, 0], [0.5, 0]]], room=np.full((2, 2, 2), 1.0))
    assert surface(flow)[1] == pytest.approx([0.05 * 2.5 / 2, 0.05 * 0.5])
    assert bases(flow) == pytest.approx([0, 0]) and reach(flow) == pytest.approx(0.2 * 0.75)


def test_a_surface_around_an_axis_is_a_mean_over_rings():
    """A quarter of 3 by 3 columns: the rings are one cell, the three beside it, and the four beyond these."""
    fill = np.zeros((2, 3, 3))
    fill[0] = [[1.0, 0.8, 0.3], [0.6, 0.4, 0.2], [0.3, 0.0, 0.9]]
    flow = flow_of(fill, round=True)
    across, height = surface(flow)
    distance = np.hypot(*np.meshgrid([0.05, 0.15, 0.25], [0.05, 0.15, 0.25]))
    rings = [fill[0][(distance >= r) & (distance < r + 0.1)].mean() * 0.05 for r in (0.0, 0.1, 0.2)]
    assert across == pytest.approx([0.05, 0.15, 0.25]) and height == pytest.approx(rings)
    assert reach(flow) == pytest.approx(np.sqrt(4 / np.pi * fill[0].sum() * 0.01))
    assert bases(flow_of(np.stack([0 * fill[0], fill[0]]), round=True)) == pytest.approx([0.05] * 3)


def test_the_expected_course_of_a_flow(monkeypatch):
    """A coarser copy gives steps and duration, for a funnel a closed form; without a copy, steps are the longest."""
    asked = []
    copy = SimpleNamespace(
        result={"funnel_time": 1.0},
        series={
            "time": np.array([0.0, 1.0, 3.0]),
            "steps": np.array([0, 200, 500]),
            "fastest": np.array([0, 3.0, 2.0]),
        },
    )

    def course(run=copy, **given):
        settings = dict(
            extent=np.array([[0.0, 0.0], [0.6, 0.3]]), spacing=0.01, time_step=8e-3, step_error=1e-3, test=None,
            duration=8.0, dimensions={"opening": 0.15},
        )  # fmt: skip
        simulation = SimpleNamespace(scene=SimpleNamespace(**settings | given))
        simulation.scene.fluid = simulation.scene
        monkeypatch.setattr(
            forecast, "coarser_run", lambda *each, **changes: asked.append((each[1], changes)) or (run, 3.0, ["uneven"])
        )
        monkeypatch.setattr(forecast, "_slowdown", lambda *each: 1.5)
        return course_of(simulation)

    # In the first second the concrete crosses 300 cells, in the other two seconds 400 cells.
    found = course()
    assert (found.duration, found.time_step, found.remarks, found.slowdown) == (3.0, 3.0 / 700, ["uneven"], 1.5)
    assert course(step_error=0.0).time_step == 3.0 / 500 and course(spacing=0.02).time_step == 3.0 / 500
    assert asked[0] == ("the concrete is not at rest", {"spacing": pytest.approx(0.3 / 12)})
    course(dimensions={"opening": 0.06})
    assert asked[-1][1]["spacing"] == pytest.approx(0.06 / 4)
    # Cells that represent bars would make the copy as fine as the scene.
    course(dimensions={"opening": 0.15, "bar_diameter": 0.018})
    assert asked[-1][1]["spacing"] == pytest.approx(0.3 / 12)
    course(spacing=0.05)
    assert asked[-1][1]["spacing"] == 0.05
    stopped = course(run=None)
    assert (stopped.duration, stopped.time_step, stopped.slowdown) == (3.0, 8e-3, 1.0)

    out = SimpleNamespace(outflow=SimpleNamespace(time="funnel_time"))
    for estimate, duration in ((2.0, 1.2 * 2.0), (7.9, 8.0)):
        monkeypatch.setattr(forecast, "expected", lambda scene, estimate=estimate: {"funnel_time": estimate})
        found = course(test=out)
        assert (found.duration, found.time_step, found.remarks) == (pytest.approx(duration), 3.0 / 700, [])
    clogged = SimpleNamespace(result={}, series=copy.series)
    assert course(clogged, test=out).remarks == ["uneven"]
    monkeypatch.setattr(forecast, "expected", lambda scene: {})
    assert "may hold the concrete" in course(test=out).remarks[0] and course(test=out).duration == 8.0


@dataclasses.dataclass(frozen=True)
class Coarse:
    """Scene of a made-up flow."""

    spacing: float = 0.01
    fails: bool = False


class Flow:
    """Made-up simulation of a scene; notes what copies are asked for and whether they are released."""

    log: ClassVar[list] = []
    duration = 7.0
    now: ClassVar[list] = [0.0]
    pause: ClassVar[float] = 10.0
    """Wall time between two reports of progress [s]; a copy reports until 100 s."""

    def __init__(self, scene, *, device, precision, threads, progress):
        self.scene, self.device, self.precision, self.threads = scene, device, precision, threads
        self.log.append((scene.spacing, device, precision, threads))
        self.steady, self.tell, self.stop_requested = scene.spacing < 0.05, progress, False

    def run(self):
        if self.scene.fails:
            raise InstabilityError("t = 1 s: burst")
        while not self.stop_requested and self.now[0] < 100:
            self.tell("running", 0.1, {})
            self.now[0] += self.pause
        return SimpleNamespace(result={"simulated_time": quantity(2.5, "s")}, finished=not self.stop_requested)

    def release(self):
        self.log.append("released")


def test_a_coarser_copy_stops_after_half_a_minute(monkeypatch):
    monkeypatch.setattr(common_forecast, "time", SimpleNamespace(monotonic=lambda: Flow.now[0]))
    Flow.now[0] = 0.0
    run, reached, (remark,) = coarser_run(Flow(Coarse(), device="cpu", precision="float64", threads=3,
                                               progress=None), "it is not at rest", spacing=0.04)  # fmt: skip
    assert run is not None and reached == 7.0 and Flow.now[0] == 50.0
    assert "reached 2.5 s in 30 s of wall time, but it is not at rest then" in remark and "assumes 7 s" in remark


def test_a_coarser_copy_runs_with_the_settings_of_the_flow_and_is_released(monkeypatch):
    monkeypatch.setattr(Flow, "pause", 1000.0)
    flow = Flow(Coarse(), device="cpu", precision="float64", threads=3, progress=None)
    Flow.log.clear()
    Flow.now[0] = 0.0
    run, reached, remarks = coarser_run(flow, "not at rest", spacing=0.04)
    assert run is not None and (reached, remarks) == (2.5, [])
    assert Flow.log == [(0.04, "cpu", "float64", 3), "released"]
    Flow.now[0] = 0.0
    assert coarser_run(flow, "not at rest", spacing=0.06)[1:] == (2.5, ["not at rest within 2.5 s"])
    run, reached, (remark,) = coarser_run(flow, "not at rest", fails=True)
    assert run is None and reached == 7.0 and "a coarser copy of this flow stopped: t = 1 s: burst" in remark
    assert Flow.log[-1] == "released"
