"""Command `warpcrete warm`: compile the kernels of scenes before their first run."""

import hashlib
import json
import time
from contextlib import suppress
from itertools import takewhile
from pathlib import Path
from typing import Any

import click
import warp as wp

from .. import kernels
from .. import scenes as scene_package
from ..core.device.device import default_threads, find_device
from ..core.device.kernel_files import kernel_files
from ..core.errors import RunFolderError
from ..core.records import SceneArguments
from ..core.run.files import atomic_file
from ..core.run.provenance import provenance
from ..core.run.scene_module import SceneModule
from ..methods import method_of
from ..studies.tradeoffs.explain import explain
from .options import check_scene
from .study import parameter_values, parsed


def run(words: list[str], modules: dict[str, Any], device: str | None) -> None:
    """Compile the kernels of the scenes that `words` names, or of all scenes if it names none.

    The names may be followed by parameters of the scenes. A scene without such parameters is skipped if all its kernels
    are in the cache. Raises :class:`warpcrete.SceneError` for an unknown scene, parameter or device before anything is
    compiled.
    """
    names, parameters = _scenes_and_parameters(words, modules)
    selected_device = find_device(device)
    code = _code_hash()
    scenes = {name: modules[name].scene(**parameters) for name in names}
    for name, scene in scenes.items():
        # Use no record if there are parameters: the record's name does not depend on parameters or on the code of a
        # user's contact law, so the record of another run would be found.
        record = None if parameters else _record(name, Path(modules[name].__file__), selected_device, code)
        if record is not None and _is_complete(record):
            click.echo(f"{name:12s} ready: an earlier call compiled its kernels, and all of them are in the cache")
            continue
        started = time.perf_counter()
        click.echo(f"{name:12s} begins; each kernel that is not in the cache is compiled")
        # The forecast `explain` simulates the first steps of a small copy of the scene, takes measurements and draws a
        # frame. This compiles all kernels of a run.
        with kernel_files() as files:
            explain(scene, device=str(selected_device), cache=False)
        if record is not None:
            # Ignore a record that cannot be written, because the kernels are ready without it.
            with suppress(OSError, RunFolderError):
                _write_record(record, files)
        click.echo(f"{name:12s} {method_of(scene).name:10s} {time.perf_counter() - started:5.1f} s")
    click.echo(
        f"kernels for {selected_device} are ready; later runs of these scenes with their features start without "
        "compiling"
    )


def _scenes_and_parameters(words: list[str], modules: dict[str, SceneModule]) -> tuple[list[str], SceneArguments]:
    """Return the names of scenes at the beginning of `words` (all scenes if there are none), and their parameters."""
    names = list(takewhile(lambda word: not word.startswith("-"), words))
    for name in names:
        check_scene(name, modules)
    if len(names) == len(words):
        return names or list(modules), {}
    if not names:
        raise click.UsageError(
            f"{words[0]}: needs the name of a scene before it; write 'warpcrete warm SCENE {words[0]}'"
        )
    _, options = parsed(words[len(names) :])
    for option, values in options.items():
        if len(values) > 1:
            raise click.UsageError(
                f"--{option} = {', '.join(values)}: must be a single value; write the names of "
                "scenes before the parameters"
            )
    values = {name: parameter_values(modules[name], options) for name in names}[names[-1]]
    return names, {name: several[0] for name, several in values.items()}


def _record(name: str, scene_file: Path, device: wp.Device, code: str) -> Path:
    """Return the path of the file that lists the compiled kernels of a scene.

    The name of this file contains a hash of everything on which the kernels depend: the program's code, the text of
    `scene_file`, the versions of warpcrete and Warp, the device and its processor.
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
    """Write the paths of a scene's compiled kernels into the file `record`, one per line, relative to Warp's cache."""
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
