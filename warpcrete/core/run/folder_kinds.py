"""Kinds of folders that the commands write, for messages about a missing folder or a folder of another kind."""

from pathlib import Path

KINDS = {
    "scene.json": ("run", "warpcrete run --resume"),
    "study.json": ("study", "warpcrete study --resume"),
    "trade.json": ("trade-off study", "warpcrete trade --resume"),
    "calibration.json": ("calibration", "warpcrete calibrate --resume"),
    "reproduction.json": ("reproduction", "warpcrete reproduce --resume"),
    "line.json": ("line", ""),
}
"""Name of the record in each kind of folder, with the name of the kind and the command that continues its runs."""


def wrong_folder(folder: Path, record: str, resumed: bool = True) -> str:
    """Return why `folder` is not a folder of the kind whose record has the name `record`, and what to do instead.

    `resumed` is True if the user wants to continue the runs in the folder.
    """
    kind = KINDS[record][0]
    if not folder.exists():
        return "does not exist; check the path"
    if not folder.is_dir():
        return f"is a file; give the folder of a {kind}"
    for other, (name, command) in KINDS.items():
        if other != record and (folder / other).is_file():
            how = f"; continue it with '{command} {folder}'" if command and resumed else ""
            return f"is the folder of a {name}, not of a {kind}{how}"
    return f"is not the folder of a {kind} (it contains no {record}); give the folder of a {kind}"


def missing_recording(folder: Path) -> str:
    """Return why `folder`, or a file of this name, is not a recording that Rerun's viewer shows, and what to do."""
    if not folder.exists():
        return "does not exist; check the path"
    if not folder.is_dir():
        return "is not a recording (.rrd); give the folder of a run"
    kind = next((name for record, (name, _) in KINDS.items() if (folder / record).is_file()), "")
    recordings = sorted(path.parent for path in folder.rglob("run.rrd"))
    if recordings:
        called = f"is the folder of a {kind}" if kind else "contains several runs"
        return f"{called}; view one of its {len(recordings)} recorded runs, as in 'warpcrete view {recordings[0]}'"
    if kind == "study":
        return "is the folder of a study without recordings; repeat the study with --rerun, which records each case"
    return "contains no recording (run.rrd); record a new run with 'warpcrete run SCENE --out FOLDER'"
