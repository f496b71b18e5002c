"""Short flows into run folders, for tests of locks, failures and kills."""

import json

from warpcrete import Simulation, scenes
from warpcrete.record.run_folder import TableRecorder

FLOW = dict(duration=0.02, spacing=0.01, length=0.1)


def flow(folder=None, *more, every=0.0, going_on=False):
    """A short flow into a folder, with a checkpoint at every sample, and other recorders."""
    table = [] if folder is None else [TableRecorder(folder, going_on=going_on)]
    path = None if folder is None else folder / "checkpoint.npz"
    return Simulation(scenes.channel(**FLOW), device="cpu", threads=1, recorders=[*table, *more], checkpoint_path=path,
                      checkpoint_every=every)  # fmt: skip


def same(folder, whole) -> bool:
    """Return whether a folder holds the same files as that of an undisturbed run, with the same bits."""
    results = [json.loads((each / "result.json").read_text(encoding="utf-8")) for each in (folder, whole)]
    names = [sorted(path.name for path in each.iterdir()) for each in (folder, whole)]
    series = [(each / "series.csv").read_bytes() for each in (folder, whole)]
    return (
        names[0] == names[1] and series[0] == series[1] and results[0]["state_hash"] == results[1]["state_hash"]
        and results[0]["finished"] is True
    )  # fmt: skip


class Killed(BaseException):
    """Stands for a kill: nothing handles it."""
