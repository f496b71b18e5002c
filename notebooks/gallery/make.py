"""Pictures of the gallery: every entry runs its command or its lines of Python, and draws what they leave.

python notebooks/gallery/make.py                  makes all pictures and the page, in seven minutes on two cores
python notebooks/gallery/make.py slump line       makes two of them
python notebooks/gallery/make.py --again          runs all commands anew, as after a change of the program
python notebooks/gallery/make.py --list           lists their names

Runs are kept in a folder for temporary files, so that entries with the same command share one run. Scenes are drawn by
VTK from the USD scene or the VTKHDF files of a run, without a display, by EGL. The screenshot of the viewer needs
Vulkan. Both work in software if there is no GPU. On Debian, install the packages libegl1 and mesa-vulkan-drivers.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rendering import chains, lumps, scene_picture, surface_file

HERE = Path(__file__).resolve().parent
WORK = Path(tempfile.gettempdir()) / "warpcrete-gallery"
MADE = ".made"
"""File that marks the folder of a complete run."""
WIDTH, HIGHEST, MOST_BYTES = 1200, 1440, 120_000
"""Largest width [px], which is sharp on screens with two pixels for each point, largest height [px], and largest size
of the file of a picture."""


@dataclass(frozen=True)
class Entry:
    """Picture of the gallery."""

    name: str
    title: str
    says: str
    """Caption: what the picture shows."""
    code: str
    """Command, or lines of Python that leave a Matplotlib figure in the name `figure`."""
    draw: Callable[[Path], Any]
    """Function that takes the folder of the run and returns the picture as a figure, or as the path of an image."""


def image(name: str) -> Callable[[Path], Path]:
    """Return a function that takes a picture which the command itself has drawn."""
    return lambda folder: folder / name


def usd(**look: Any) -> Callable[[Path], Any]:
    """Return a function that draws the USD scene of a run."""
    return lambda folder: scene_picture([("", folder / "scene.usdc")], **look)


def units(folder: Path) -> Any:
    """Draw the scenes of a study side by side, each with the value that its case varies."""
    cases = sorted(path.parent for path in folder.glob("*/scene.usdc"))
    names = [re.sub(r"^\d+-unit=", "unit ", case.name) for case in cases]
    figure = scene_picture([(name, case / "scene.usdc") for name, case in zip(names, cases, strict=True)])
    figure.suptitle("pumping units, diameter 100 mm, concrete zhan, 8.48 m3/h", fontsize="medium")
    return figure


def viewer(folder: Path) -> Path:
    """Take a screenshot of the end of a recording in the Rerun viewer, which needs no display for that."""
    from PIL import Image
    from rerun.experimental import ViewerClient

    import warpcrete

    shot, port = folder / "viewer.png", "9877"
    program = shutil.which("rerun") or str(Path(sys.executable).parent / "rerun")
    words = [
        program,
        folder / "run.rrd",
        "--headless",
        "--window-size",
        "1400x900",
        "--renderer",
        "vulkan",
        "--port",
        port,
    ]
    # The command is a script that starts the viewer, so both get a session, which ends as a whole.
    shown = subprocess.Popen(
        [*map(str, words)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        client = _once_there(lambda: ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy"))
        end = float(warpcrete.load(folder).series["time"][-1])
        _once_there(lambda: client.set_time("time", duration=end, play_state="paused"))
        time.sleep(SETTLING)
        client.save_screenshot(str(shot))
    finally:
        os.killpg(shown.pid, signal.SIGTERM)
        shown.wait(timeout=30)
    with Image.open(shot) as picture:
        below = picture.crop((0, MENU, *picture.size))
    below.save(shot)
    return shot


MENU = 37
"""Height of the viewer's menu, which is not drawn [px]."""
STARTING, SETTLING = 60.0, 5.0
"""Longest time in which the viewer starts, and time in which it draws a new state [s]."""


def _once_there(action: Callable[[], Any]) -> Any:
    """Return the result of an action of the viewer, which fails until the viewer has started."""
    started = time.monotonic()
    while True:
        try:
            return action()
        except Exception as error:  # The viewer's interface raises several kinds, none of them documented.
            if time.monotonic() - started > STARTING:
                raise SystemExit(f"viewer: Rerun did not start within {STARTING:g} s: {error}") from error
            time.sleep(1)


REDUCER = """\
import numpy as np, warpcrete; from warpcrete.core.drawing.style import new_figure
scene = warpcrete.scenes.part(unit="horizontal", outlet_diameter=0.07, spacing=0.01)
simulation = warpcrete.Simulation(scene, device="cpu"); simulation.run(); display = simulation.display("speed")
half = display.surface(cut=True); x, y, z = half.vertices.T; cap = half.faces[np.all(y[half.faces] < 1e-6, axis=1)]
figure = new_figure(scene.caption, 1.7); axes = figure.add_subplot(aspect="equal", xlabel="x [m]", ylabel="z [m]")
figure.colorbar(axes.tripcolor(x, z, cap, half.fields["speed"]), label="speed [m/s]", location="bottom", aspect=45)"""
MIGRATION = """\
import warpcrete; from warpcrete.core.drawing import style
scene = warpcrete.scenes.channel(aggregates=True, spacing=0.005, duration=2.0, sample_interval=0.05)
run = warpcrete.Simulation(scene, device="cpu").run(); axes = style.new_figure(scene.caption).add_subplot()
for part, colour in zip(("front", "rear", "inner", "outer"), map(style.rgb, style.SERIES)):
    share = 100 * run.series[f"aggregate_{part}"]; axes.plot(run.series["time"], share - share[0], c=colour, label=part)
axes.set(xlabel="time [s]", ylabel="change of share [% points]"); style.legend_above(axes); figure = axes.figure"""
RESTART = """\
from warpcrete.core.drawing import style; from warpcrete.theory.pipe import CONCRETES, Line, restart
figure, rests = style.new_figure("100 m of pipe, concrete no2, 20 m3/h"), range(0, 1801, 60)
axes = figure.add_subplot(xlabel="rest [s]", ylabel="restart pressure [bar]", xlim=(0, 2100))
for rate, colour in zip((0.1, 0.5, 1.7), map(style.rgb, style.SERIES)):
    peaks = [restart(CONCRETES["no2"], Line(length=100, rise=0), t, rate, 20 / 3600).pressure / 1e5 for t in rests]
    axes.plot(rests, peaks, color=colour); axes.annotate(f" {rate} Pa/s", (rests[-1], peaks[-1]))"""
CONCRETE = "--concrete own --density 2300 --viscosity 30 --yield-stress"
PIPE = "--diameter 0.1 --length 0.35 --elbow-radius 0.25"
PIPE_A = "--diameter 0.1 --length 0.35"
ENTRIES = (
    Entry("units", "Pumping units",
          "This picture shows aggregates in the four pipes of Zhan et al. (2019): a vertical pipe, a horizontal"
          " pipe and two bends. The colour of an aggregate is the largest contact force on it.",
          f"warpcrete study pipe --unit A B C D {PIPE} --travel 0.02 --settle 0.3 --usd --out OUT", units),
    Entry("chains", "Force chains in a bend",
          "This picture shows the contact forces between the aggregates in a bend, drawn as lines. The dark disc "
          "is the piston, and the forces are largest near the piston. The short lines at the top lie in the plug "
          "of balls at the front of the concrete.",
          f"warpcrete run pipe --unit D {PIPE} --travel 0.15 --network --paraview --out OUT", chains),
    Entry("viewer", "The same bend in the viewer",
          "This picture shows the recording of the bend in the viewer Rerun: the aggregates, a cut through the "
          "bend, the force chains, and curves of results. All of them share one time axis.",
          f"warpcrete run pipe --unit D {PIPE} --travel 0.15 --network --paraview --out OUT", viewer),
    Entry("blocked", "A blocked reducer",
          "This picture shows stones of 14 to 18 mm in a pipe that narrows from 80 to 36 mm. The dark stones "
          "below the narrow part lag behind the piston and jam, so the run stops.",
          "warpcrete run part-dem --unit vertical --diameter 0.08 --outlet-diameter 0.036 --taper 0.08 \\\n"
          "    --straight 0.12 --size-min 0.014 --size-max 0.018 --plug none --stop-when-blocked \\\n"
          "    --colour speed --out OUT",
          usd(direction=(0.3, -1.0, 0.25), cut=True)),
    Entry("worn", "A worn bend",
          "This picture shows how deep the wall of a bend is worn. The colour is the depth that sliding stones "
          "have removed from the wall.",
          f"warpcrete run pipe --unit D {PIPE} --travel 0.3 --wear --out OUT",
          usd(direction=(-0.55, -1.0, 0.1), only_walls=True)),
    Entry("slump", "Slump test",
          "This picture shows a cone of concrete in a slump test while its mould is lifted. The colour is the "
          "shear rate.",
          f"warpcrete run slump {CONCRETE} 500 --spacing 0.01 --duration 1 --out OUT",
          usd(time=0.5, direction=(0.25, -1.0, 0.35), opacity=0.18)),
    Entry("heap", "Shape after the slump test",
          "The upper diagram shows the shape of concrete at rest after a slump test, and the shape of a heap by a "
          "closed form (a formula of theory). The lower diagram shows the spread and the highest point of the "
          "concrete over time.",
          f"warpcrete run slump {CONCRETE} 200 --spacing 0.01 --out OUT", image("flow.png")),
    Entry("jring", "J-ring test",
          "This picture shows grains that spread through the ring of bars of a J-ring test. The colour of a "
          "grain is its speed.",
          "warpcrete run jring-dem --size-min 0.016 --size-max 0.022 --duration 1 --lift-time 0.5 --colour speed "
          "--out OUT", usd(time=0.4, direction=(0.2, -1.0, 0.55), opacity=0.2)),
    Entry("lbox", "L-box test",
          "This picture shows concrete in an L-box test. While the gate opens, the concrete flows past two "
          "bars into the long, low part of the box.",
          "warpcrete run lbox --concrete own --density 2300 --viscosity 20 --yield-stress 30 --bars 2 \\\n"
          "    --bar-diameter 0.02 --spacing 0.0125 --duration 0.5 --out OUT",
          usd(direction=(0.45, -1.0, 0.35), opacity=0.2)),
    Entry("funnel", "V-funnel test",
          "This picture shows concrete that flows out of a V-funnel. The concrete is sheared most at the outlet.",
          "warpcrete run funnel --concrete own --density 2300 --viscosity 20 --yield-stress 20 --spacing 0.015 \\\n"
          "    --duration 1 --out OUT", usd(direction=(0.3, -1.0, 0.15))),
    Entry("line", "Pressure along a line",
          "This picture shows the pressure along the line of the Shanghai Tower by theory, with its likely "
          "range. It also shows the part of the pressure that the weight of the concrete causes, and the "
          "pressure that was recorded at the pump.",
          "warpcrete line shanghai-tower --theory --out OUT", image("line.png")),
    Entry("trade", "Error against time",
          "This picture shows the error and the computing time of a simulated flow in a channel with different "
          "settings. Each point is one choice of settings. The line joins the points for which no other point "
          "has both a smaller error and a shorter time. A hollow marker means that the run failed a check.",
          "warpcrete trade channel --budget 40s --out OUT", image("trade.png")),
    Entry("posterior", "What measurements determine",
          "The wall stress of a concrete was measured at two flows. This picture shows which slip layers agree "
          "with these stresses. The two histograms show how likely each viscosity (top) and each yield stress "
          "(right) of the slip layer is. The map shows how likely a pair of viscosity and yield stress is: only "
          "a narrow band of pairs is likely.",
          "warpcrete calibrate notebooks/targets/two_flows.yaml --trials 14 --out OUT",
          image("calibration.png")),
    Entry("migration", "Migration of stones",
          "This picture shows how the share of aggregate in the concrete of a channel changes, in percentage "
          "points since the start. The curves are for the front half, the rear half, the region near the axis "
          "and the region near the wall. A curve jumps whenever a grain crosses the border of such a region.",
          MIGRATION, lambda folder: None),
    Entry("mortar", "Stones in mortar",
          "This picture shows grains and mortar that flow through a channel. The grains are rigid, so only the "
          "mortar is sheared, mainly beside the wall.",
          "warpcrete run channel --aggregates --spacing 0.005 --duration 0.05 --out OUT",
          image("flow.png")),
    Entry("validation", "Predicted against measured",
          "This picture compares predicted values with measured ones. The vertical bars are the likely ranges of "
          "the predictions. Filled points are measurements that are never used for a fit.",
          "warpcrete validate --quick --out OUT", image("validation.png")),
    Entry("strokes", "Two strokes with a stop",
          "This picture shows the pressure on the piston of a pump that makes two strokes with a stop between "
          "them.",
          "warpcrete run pipe --unit horizontal --concrete no2 --diameter 0.1 --length 0.25 --ramp 0.02 \\\n"
          "    --strokes 2 --stroke 0.1 --pause 0.3 --out OUT", image("pressure.png")),
    Entry("clumps", "Clumps in a bend",
          "This picture shows aggregates in a bend. Each aggregate is a clump, a rigid body of several spheres. "
          "The picture is drawn from the scene of the run in the 3D format USD, which Blender can open as well.",
          "warpcrete run pipe --unit C --shapes reference --diameter 0.1 --length 0.25 --elbow-radius 0.25 \\\n"
          "    --size-min 0.012 --size-max 0.024 --travel 0.02 --settle 0.2 --colour size --out OUT",
          usd(direction=(0.35, -1.0, 0.3), cut=True)),
    Entry("lumps", "Hydrated lumps",
          "This picture shows lumps of aggregates in a pipe after a piston has pushed the concrete. The "
          "aggregates of a lump are joined by hydrated bonds, which are much stiffer than other bonds. The eight "
          "largest lumps have colours of their own. All other aggregates are drawn smaller and paler.",
          f"warpcrete run pipe --unit A {PIPE_A} --travel 0.05 --hydration 0.1 --network --paraview --out OUT", lumps),
    Entry("reducer", "Inside a reducer",
          "This picture shows the speed of the concrete in a reducer that is cut open. The concrete moves as a "
          "plug, which becomes faster because the reducer becomes narrower.",
          REDUCER, lambda folder: None),
    Entry("paraview", "A file for ParaView",
          "This picture shows concrete in a bend. The colour is the pressure without the part that the weight "
          "causes. The picture was drawn by VTK from two files of the run, `surface.vtkhdf` and `walls.vtkhdf`.",
          "warpcrete run part --unit bend-to-vertical --spacing 0.0125 --paraview --out OUT", surface_file),
    Entry("profile", "Plug and slip",
          "This picture shows the velocity of concrete over the radius of a tube. The concrete moves as a plug "
          "and slips on the wall, as theory predicts.",
          "warpcrete run tube --concrete no2 --ends periodic --out OUT",
          image("flow.png")),
    Entry("study", "A parameter study",
          "This picture shows slump and spread over the yield stress (top) and over the viscosity (bottom) of "
          "the concrete. In the upper diagram, each colour is a viscosity. In the lower diagram, each colour is "
          "a yield stress. Circles are slumps, and squares are spreads.",
          "warpcrete study slump --concrete own --density 2300 --yield-stress 100 300 500 --viscosity 20 60 \\\n"
          "    --spacing 0.0125 --out OUT", image("study.png")),
    Entry("restart", "Pressure after a rest",
          "This picture shows the pressure that is needed to move the concrete in 100 m of pipe again after a "
          "rest, by theory. The three curves are for three rates at which the yield stress of the concrete grows "
          "at rest.",
          RESTART, lambda folder: None),
)  # fmt: skip


def folder_of(code: str) -> Path:
    """Return the folder of the run that a command or lines of Python make."""
    return WORK / hashlib.sha256(code.encode()).hexdigest()[:12]


def arguments(code: str) -> list[str]:
    """Return the words of a command, with the folder of its run."""
    return [str(folder_of(code)) if word == "OUT" else word for word in shlex.split(code.replace("\\\n", ""))]


def make(entry: Entry) -> None:
    """Run the code of an entry, if it was not run before, and write its picture."""
    folder = folder_of(entry.code)
    if entry.code.startswith("warpcrete "):
        if not (folder / MADE).exists():
            shutil.rmtree(folder, ignore_errors=True)  # of a run that was interrupted
            words = [sys.executable, "-m", "warpcrete", *arguments(entry.code)[1:]]
            words += [] if words[3] in ("line", "validate") else ["--quiet", "--device", "cpu"]
            done = subprocess.run(words, cwd=HERE.parents[1], capture_output=True, text=True)
            if done.returncode not in (0, 3):  # A check of a run as short as these may fail.
                shutil.rmtree(folder, ignore_errors=True)
                said = f"{done.stdout[-800:]}{done.stderr[-1500:]}"
                raise SystemExit(f"{entry.name}: exit code {done.returncode}\n{said}")
            (folder / MADE).touch()
        picture = entry.draw(folder)
    else:
        names: dict[str, Any] = {}
        exec(entry.code, names)
        picture = names["figure"]
    save(picture, HERE / f"{entry.name}.png")


def save(picture: Any, path: Path) -> None:
    """Write a picture with as many colours as its size allows."""
    from PIL import Image

    if isinstance(picture, Path):
        found = Image.open(picture).convert("RGB")
    else:
        out = io.BytesIO()
        picture.savefig(out, dpi=100 * 2, format="png")
        found = Image.open(out).convert("RGB")
    found.thumbnail((WIDTH, HIGHEST), Image.Resampling.LANCZOS)
    for colours in (256, 128, 64, 32, 16):
        flat = found.quantize(colours, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        flat.save(path, optimize=True)
        if path.stat().st_size <= MOST_BYTES:
            return


def page() -> str:
    """Return the page of the gallery."""
    lines = ["# Gallery", "", "What does warpcrete show, and which command shows it?", ""]
    lines += [
        "Each picture of this gallery is made by the command or the lines of Python below it. The runs are short and "
        "coarse, so that all of them together take only seven minutes on two CPU cores, and four if all kernels have "
        "been compiled before. The command `python notebooks/gallery/make.py` makes the whole gallery.",
        "",
    ]
    for entry in ENTRIES:
        language = "" if entry.code.startswith("warpcrete ") else "python"
        code = entry.code.replace(" --out OUT", f" --out {entry.name}")
        lines += [f"## {entry.title}", "", f"![{entry.title}]({entry.name}.png)", "", entry.says, "",
                  f"```{language}", code, "```", ""]  # fmt: skip
    lines += ["## Not covered", "", "The gallery does not explain recordings. The page [Look at a "
              "run](../how-to/view.md) says how to open them, and the page [Recordings](../reference/recordings.md) "
              "lists what they contain.", ""]  # fmt: skip
    return "\n".join(lines)


def main() -> None:
    """Make the pictures that are named, or all of them, and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="pictures to make (default: all)")
    parser.add_argument("--again", action="store_true", help="run the commands anew, even if their runs are kept")
    parser.add_argument("--list", action="store_true", help="list the names of all pictures")
    given = parser.parse_args()
    known = {entry.name: entry for entry in ENTRIES}
    if given.list:
        print("\n".join(known))
        return
    for name in given.names:
        if name not in known:
            parser.error(f"{name!r} is not a picture; use one of {', '.join(known)}")
    os.environ.setdefault("PYTHONPATH", str(HERE.parents[1]))
    for name in given.names or known:
        if given.again:
            shutil.rmtree(folder_of(known[name].code), ignore_errors=True)
    failures = []
    for name in given.names or known:
        started = time.perf_counter()
        try:
            make(known[name])
        except SystemExit as failure:  # The other pictures are made all the same.
            failures.append(str(failure))
            continue
        size = (HERE / f"{name}.png").stat().st_size
        print(f"{name:12} {time.perf_counter() - started:6.1f} s {size / 1e3:6.1f} kB", flush=True)
    (HERE / "index.md").write_text(page(), encoding="utf-8")
    if failures:
        raise SystemExit("\n".join(failures))


if __name__ == "__main__":
    main()
