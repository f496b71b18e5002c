"""Command `warpcrete warm`: compile the kernels of scenes before their first run."""

import hashlib
import json
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import warp as wp

from .. import kernels
from .. import scenes as scene_package
from ..core.device.device import default_threads, find_device
from ..core.device.kernel_files import kernel_files
from ..core.errors import RunFolderError
from ..core.run.files import atomic_file
from ..core.run.provenance import provenance
from ..methods import method_of
from ..studies.tradeoffs.explain import explain
from .options import check_scene


def run(names: tuple[str, ...], modules: dict[str, Any], device: str | None) -> None:
    """Compile the kernels that the default runs of the named scenes need, or those of all scenes if no name is given.

    A scene whose kernels are known to be in the cache takes no time. Raises :class:`warpcrete.SceneError` for an
    unknown scene or device before anything is compiled.
    """
    for name in names:
        check_scene(name, modules)
    found = find_device(device)
    code = _code_hash()
    for name in names or modules:
        record = _record(name, Path(modules[name].__file__), found, code)
        if _is_complete(record):
            click.echo(f"{name:12s} ready: an earlier call compiled its kernels, and all of them are in the cache")
            continue
        scene = modules[name].scene()
        started = time.perf_counter()
        click.echo(f"{name:12s} begins; each kernel that is not in the cache is compiled")
        # A forecast takes the first steps of a small copy of the scene, measures it and draws a frame, so it compiles
        # all kernels of a run.
        with kernel_files() as files:
            explain(scene, device=str(found), cache=False)
        with suppress(OSError, RunFolderError):  # Ignore the error: the kernels are ready without a record.
            _write_record(record, files)
        click.echo(f"{name:12s} {method_of(scene).name:10s} {time.perf_counter() - started:5.1f} s")
    click.echo(f"kernels for {found} are ready; later runs of these scenes with their features start without compiling")


def _record(name: str, scene_file: Path, device: wp.Device, code: str) -> Path:
    """Return the path of the file that lists the compiled kernels of a scene.

    Its name depends on everything on which the kernels depend: the code, the versions, the device and its processor.
    """
    origin = provenance(device, "float32", 0, default_threads())
    key = json.dumps([name, scene_file.read_text(encoding="utf-8"), code, origin, str(device.arch)], sort_keys=True)
    return _cache() / f"warpcrete-{name}-{hashlib.sha256(key.encode()).hexdigest()[:16]}.txt"


def _cache() -> Path:
    return Path(wp.config.kernel_cache_dir)


def _code_hash() -> str:
    """Return a hash of all Python files of the program, from which the kernels are made."""
    digest = hashlib.sha256()
    roots = [Path(__file__).parents[1], *(Path(str(each.__file__)).parent for each in (kernels, scene_package))]
    for path in sorted({path.resolve() for root in roots for path in root.rglob("*.py")}):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _write_record(record: Path, files: set[Path]) -> None:
    """Write the paths of a scene's compiled kernels, relative to Warp's cache, one in a line."""
    with atomic_file(record) as partial:
        partial.write_text("\n".join(sorted(_in_cache(file) for file in files)), encoding="utf-8")


def _in_cache(file: Path) -> str:
    """Return the path of a compiled kernel relative to Warp's cache, or unchanged if it lies elsewhere."""
    return file.relative_to(_cache()).as_posix() if file.is_relative_to(_cache()) else str(file)


def _is_complete(record: Path) -> bool:
    """Return whether a record of an earlier `warm` exists, and all kernels that it lists are still in the cache."""
    if not record.is_file():
        return False
    listed = record.read_text(encoding="utf-8").splitlines()
    return bool(listed) and all((_cache() / name).is_file() for name in listed)
