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

from matplotlib.figure import Figure

from warpcrete.core.device.device import parallel
from warpcrete.core.inputs.fingerprints import fingerprint
from warpcrete.dem import packing, simulation
from warpcrete.dem.scene.bodies import BodyTable

COARSE = 40
"""Pixels per inch of a picture that is cut short."""


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
    """Replacement of `Figure.savefig` in Matplotlib: all is drawn, but at few pixels and without a computed layout."""

    def __init__(self, save):
        self.save, self.active = save, True

    def __call__(self, figure, *arguments, **settings):
        if self.active:
            figure.set_layout_engine("none")
            settings["dpi"] = COARSE
        return self.save(figure, *arguments, **settings)


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
