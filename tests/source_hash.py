"""Check whether the suite has run on a GPU with the present code. `python tests/source_hash.py` prints the verdict."""

import hashlib
import json
from pathlib import Path

ROOT = Path(__file__).parent.parent
FOLDERS = ("kernels", "scenes", "warpcrete")
RECORD = Path(__file__).parent / "gpu.json"
"""Written by a run of the whole suite on a GPU: device, date, outcome, and the hash of the code."""


def source_hash() -> str:
    """SHA-256 over the Python files of the program, their paths and contents."""
    digest = hashlib.sha256()
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            place = path.relative_to(ROOT)
            if place.parts[:2] not in (("warpcrete", "kernels"), ("warpcrete", "scenes")):  # links to the others
                digest.update(place.as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def verdict() -> str:
    """Return one line that states whether the record in `tests/gpu.json` belongs to the present code."""
    if not RECORD.is_file():
        return "GPU: no record in tests/gpu.json; the suite has not run on a GPU"
    record = json.loads(RECORD.read_text(encoding="utf-8"))
    found = f"{record['device']}, {record['date']}: {record['passed']} passed, {record['skipped']} skipped"
    if record.get("failed"):
        found += f", FAILED {', '.join(record['failed'])}"
    if record.get("not_run"):
        found += f", {record['not_run']} not run (time was over, or a worker lost)"
    if record.get("without"):
        found += f", without {record['without']}"
    if record["hash"] == source_hash():
        return f"GPU: tests/gpu.json is of this code ({found})"
    return f"GPU: tests/gpu.json is NOT of this code but of {record['hash'][:12]} ({found}); run the suite on a GPU"


if __name__ == "__main__":
    print(verdict())
