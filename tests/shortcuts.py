"""Work that tests share or cut short, because no check depends on it: packings of aggregates and pictures of runs.

Packing takes most of the time of a short pumping run, and pictures a large part of the time in which its folder is
written. A test with the fixture `monkeypatch`, which may change how aggregates are packed, packs anew unless it
has the fixture `shared_packings` too. A test with the fixture `whole_pictures` draws as users do.
"""

import hashlib
import os
import pickle
from dataclasses import fields
from pathlib import Path

import numpy as np
from matplotlib.collections import Collection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.spines import Spine

from warpcrete.core.device.device import parallel
from warpcrete.core.inputs.fingerprints import fingerprint
from warpcrete.dem import packing, simulation
from warpcrete.dem.scene.bodies import BodyTable

COARSE = 40
"""Pixels per inch of a picture that is cut short."""

CONTENTS = ("text", "xydata", "array", "offsets", "facecolor", "color", "linestyle", "linewidth", "marker", "xlim",
            "ylim", "xscale", "yscale", "position", "aspect", "xy")  # fmt: skip
"""Properties of Matplotlib's artists that decide what a picture of a run shows."""


class SharedPackings:
    """Replacement of the function `pack` that :meth:`Simulation.prepare` calls: equal input gives the bodies of before.

    Packing gives equal bits for equal input, as `test_packing_is_seeded` and
    `test_shared_packings_have_the_bits_of_new_ones` check. All workers of one test run share the `folder` of packings.
    Whoever calls `warpcrete.dem.packing` directly packs anew, and so do batches and other processes.
    """

    def __init__(self, folder: Path | None):
        self.folder, self.active, self.reused = folder, True, 0

    def __call__(self, fill, *, contact, seed, device, precision, progress, threads):
        settings = dict(contact=contact, seed=seed, device=device, precision=precision, threads=threads)
        if not self.active:
            return packing.pack(fill, progress=progress, **settings)
        # Packing uses nothing else of the contact law.
        law = fingerprint(contact.frictionless()), contact.stress_scale
        key = (fingerprint(fill), law, seed, str(device), parallel(device), precision, threads)
        path = self.folder / hashlib.sha256(repr(key).encode()).hexdigest()
        if path.exists():
            arrays, report = pickle.loads(path.read_bytes())
            self.reused += 1
            return BodyTable(**arrays, templates=fill.templates), report
        table, report = packing.pack(fill, progress=progress, **settings)
        arrays = {each.name: getattr(table, each.name) for each in fields(table) if each.name != "templates"}
        partial = path.with_suffix(f".{os.getpid()}")
        partial.write_bytes(pickle.dumps((arrays, report)))
        os.replace(partial, path)
        return table, report


class CoarsePictures:
    """Replacement of `Figure.savefig` in Matplotlib: all is drawn, but at few pixels and without a computed layout.

    Tests repeat short runs. A figure with the data and texts of an earlier figure is not drawn again: its file gets the
    contents of the earlier file.
    """

    def __init__(self, save):
        self.save, self.active, self.drawn = save, True, {}

    def __call__(self, figure, *arguments, **settings):
        if not self.active:
            return self.save(figure, *arguments, **settings)
        figure.set_layout_engine("none")
        settings["dpi"] = COARSE
        if len(arguments) != 1 or not isinstance(arguments[0], str | Path):
            return self.save(figure, *arguments, **settings)
        path, key = Path(arguments[0]), (contents_of(figure), repr(settings))
        if key not in self.drawn:
            self.save(figure, path, **settings)
            self.drawn[key] = path.read_bytes()
        path.write_bytes(self.drawn[key])
        return None


def contents_of(figure: Figure) -> bytes:
    """Return a digest of the artists of a figure: their types, texts, sizes, colours, limits and plotted numbers."""
    digest = hashlib.sha256(repr(figure.get_size_inches()).encode())
    for artist in figure.findobj(lambda artist: not isinstance(artist, Spine)):
        digest.update(f"{type(artist).__name__} {artist.get_visible()} {artist.get_zorder()}".encode())
        for name in CONTENTS:
            if (get := getattr(artist, f"get_{name}", None)) is not None:
                value = get()
                numbers = isinstance(value, np.ndarray) and value.dtype != object
                digest.update(np.ascontiguousarray(value).tobytes() if numbers else repr(value).encode())
        if isinstance(artist, Collection):
            paths = artist.get_paths()
        else:
            paths = [artist.get_path()] if isinstance(artist, Patch) else []
        for path in paths:
            digest.update(path.vertices.tobytes())
    return digest.digest()


class Shortcuts:
    """Both shortcuts, in this process."""

    def __init__(self):
        self.packings, self.pictures = SharedPackings(None), CoarsePictures(Figure.savefig)

    def begin(self, folder: Path) -> None:
        """Share packings in `folder`, and draw coarse pictures, from here on."""
        folder.mkdir(exist_ok=True)
        self.packings.folder, simulation.pack = folder, self.packings
        Figure.savefig = lambda figure, *arguments, **settings: self.pictures(figure, *arguments, **settings)

    def choose(self, fixtures: list[str]) -> None:
        """Take those shortcuts that suit a test with these fixtures."""
        self.packings.active = "monkeypatch" not in fixtures or "shared_packings" in fixtures
        self.pictures.active = "whole_pictures" not in fixtures


SHORTCUTS = Shortcuts()
