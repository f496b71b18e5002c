"""Try the meshes of a folder as walls, bores, clumps and containers; every one works or is refused in one line.

By hand: PYTHONPATH=tests python tests/attack/attack_meshes.py FOLDER [CAD_FOLDER]

With a second folder, pipes as a CAD user draws them are written there first and tried, too. Meshes that others made
come, for example, from the folder models of trimesh's repository. Nothing is simulated: scenes are made, which is where
meshes are read, followed and checked.
"""

import signal
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from attack_inputs import TooLong
from tubes import bent, tube

from warpcrete import scenes
from warpcrete.core.errors import PlausibilityWarning, WarpcreteError
from warpcrete.dem.scene.clumps import from_mesh
from warpcrete.dem.scene.containers import MeshContainer
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.lines import line_of

LONGEST = 20.0
"""Time that a mesh may take in one way [s]."""


def as_bore(path: Path) -> Any:
    """Take a mesh in mm as a part of a line of its own diameter, 100 mm where that is not known."""
    bore = {"file": path.name, "scale": 0.001}
    return line_of({"diameter": 0.1, "parts": [{"straight": 1}, {"bore": bore}, {"straight": 1}]}, "it", path.parent)


WAYS: dict[str, Callable[[Path], Any]] = {
    "part": lambda path: scenes.part(wall=str(path), wall_scale=0.001, diameter=0.1),
    "pipe": lambda path: scenes.pipe(wall=str(path), wall_scale=0.001, diameter=0.1, unit="horizontal", length=0.2),
    "bore": as_bore,
    "clump": lambda path: from_mesh(path, 8),
    "container": MeshContainer,
}


def tried(way: str, path: Path) -> tuple[str, str, float]:
    """Return `works`, `refused` or `WRONG`, with what was said and the time it took [s]."""

    def stop(*_: object) -> None:
        raise TooLong

    signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, LONGEST)
    start = time.monotonic()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", PlausibilityWarning)
            warnings.simplefilter("ignore", DeprecationWarning)
            WAYS[way](path)
        found = "works", ""
    except WarpcreteError as error:
        text = str(error)
        found = ("refused" if text.isprintable() and len(text) < 1500 else "WRONG"), text
    except TooLong:
        found = "WRONG", f"more than {LONGEST:g} s"
    except BaseException as error:
        found = "WRONG", f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    return *found, time.monotonic() - start


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return bodies side by side in one file, as a CAD program exports an assembly."""
    return trimesh.util.concatenate(meshes)


def cad_pipes(folder: Path) -> dict[str, tuple[str, ...]]:
    """Write pipes as a CAD user draws them, in mm; return the ways in which each must work (other ways may)."""
    folder.mkdir(parents=True, exist_ok=True)
    elbow = Axis((0, 0, 0), (1, 0, 0), (Line(0.1), Arc(0.25, np.pi / 2, (0, 1, 0)), Line(0.1)))
    half = np.sqrt(0.5)
    arcs = (Arc(0.25, np.pi / 4, (0, 1, 0)), Arc(0.25, np.pi / 4, (half, -half, 0)))
    s_bend = Axis((0, 0, 0), (1, 0, 0), arcs)

    def swept(name: str, axis: Axis, **more: Any) -> trimesh.Trimesh:
        mesh = trimesh.load_mesh(bent(folder / name, axis, **more))
        mesh.apply_scale(1000)
        mesh.export(folder / name)
        return mesh

    def ring(outer: float, inner: float, at: float, height: float = 16, sections: int = 64) -> trimesh.Trimesh:
        mesh = trimesh.creation.annulus(inner, outer, height=height, sections=sections)
        mesh.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], [1, 0, 0]))
        mesh.apply_translation([at, 0, 0])
        return mesh

    body = swept("elbow.stl", elbow, wall=0.004)
    joined(body, ring(100, 54.5, 8)).export(folder / "elbow_flange.stl")
    swept("s_bend.stl", s_bend, wall=0.004)
    open_elbow = swept("elbow_open.stl", elbow)
    open_elbow.invert()
    open_elbow.export(folder / "elbow_inverted.stl")
    joined(trimesh.load_mesh(folder / "elbow_open.stl"), swept("outer.stl", elbow, radius=0.055)).export(
        folder / "two_shells.stl"
    )
    (folder / "outer.stl").unlink()
    straight = Axis((0, 0, 0), (1, 0, 0), (Line(1.0),))
    swept("square.stl", straight, wall=0.006, square=True)
    swept("off_centre_skin.stl", straight, wall=0.02, aside=0.01)
    joined(ring(80, 55, 200, 400, 6), ring(55, 50, 200, 400)).export(folder / "hexagon.stl")
    ring(80, 50, 200, 400, 6).export(folder / "hexagonal_bore.stl")
    tube(folder / "reducer.stl", [0.05, 0.05, 0.04, 0.04], length=0.4)
    eccentric = trimesh.load_mesh(folder / "reducer.stl")
    vertices = eccentric.vertices.copy()
    vertices[:, 2] -= np.interp(vertices[:, 0], [133, 267], [0, 10])
    trimesh.Trimesh(vertices, eccentric.faces).export(folder / "eccentric_reducer.stl")
    moved = ring(54, 50, 200, 400)
    moved.apply_translation([1000, 300, 50])
    moved.export(folder / "off_origin.stl")
    angle = np.linspace(0, np.pi, 60)
    slope = 60 / np.hypot(300, 60)
    flat = np.sqrt(1 - slope**2)
    middle = np.stack([300 * np.sin(angle), 300 * (1 - np.cos(angle)), 60 * angle], 1)
    inward = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], 1)
    along = np.stack([flat * np.cos(angle), flat * np.sin(angle), slope + 0 * angle], 1)
    side, turn = np.cross(along, inward), np.arange(48) * np.pi / 24
    rings = 50 * (np.cos(turn)[:, None] * inward[:, None] + np.sin(turn)[:, None] * side[:, None]) + middle[:, None]
    first = (48 * np.arange(59)[:, None] + np.arange(48)).ravel()
    after = first - first % 48 + (first + 1) % 48
    faces = [np.stack([first, after, first + 48], 1), np.stack([after, after + 48, first + 48], 1)]
    trimesh.Trimesh(rings.reshape(-1, 3), np.concatenate(faces)).export(folder / "half_helix.stl")
    run = ring(54, 50, 200, 400)
    run = trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(run.vertices, run.faces, 20))
    branch = trimesh.creation.annulus(25, 29, height=200)
    branch.apply_translation([200, 0, 150])
    keep = ~((np.abs(run.triangles_center[:, 0] - 200) < 40) & (run.triangles_center[:, 2] > 30))
    run.update_faces(keep)
    joined(run, branch).export(folder / "tee.stl")
    both, all_ways = ("part", "bore"), ("part", "pipe", "bore")
    return {
        "elbow": both, "elbow_flange": both, "s_bend": ("part",), "elbow_open": both, "elbow_inverted": both,
        "two_shells": both, "square": all_ways, "off_centre_skin": all_ways,
    }  # fmt: skip


def main(folder: Path, cad: Path | None) -> int:
    """Try all meshes; print one line each and counts; return 1 if one is answered wrongly."""
    must = cad_pipes(cad) if cad is not None else {}
    files = [path for each in (folder, cad) if each is not None for path in sorted(each.rglob("*")) if path.is_file()]
    counts = {way: dict.fromkeys(("works", "refused", "WRONG"), 0) for way in WAYS}
    for path in files:
        for way in WAYS:
            answer, said, spent = tried(way, path)
            if answer != "works" and cad in path.parents and way in must.get(path.stem, ()):
                answer, said = "WRONG", f"must work: {said}"
            if answer == "works" and path.stem == "tee" and way in ("part", "bore"):
                answer, said = "WRONG", "has an opening to the side"
            counts[way][answer] += 1
            if answer == "WRONG" or "-v" in sys.argv or cad in path.parents:
                print(f"{answer:8s} {way:10s} {path.name:32s} {spent:5.1f} s  {said[:260]}", flush=True)
    print(f"\n{len(files)} files\n{'way':12s}{'works':>8s}{'refused':>9s}{'wrong':>7s}")
    for way, count in counts.items():
        print(f"{way:12s}{count['works']:8d}{count['refused']:9d}{count['WRONG']:7d}")
    return int(any(count["WRONG"] for count in counts.values()))


if __name__ == "__main__":
    folders = [Path(word) for word in sys.argv[1:] if word != "-v"]
    raise SystemExit(main(folders[0], folders[1] if len(folders) > 1 else None))
