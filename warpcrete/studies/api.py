"""Python interface of parameter studies: run a study of a scene function."""

import sys
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import SceneError, flag, refuse, suggested
from ..core.inputs.parameters import declared_fields
from ..core.inputs.scene_functions import SceneFunction
from ..core.run.files import output_folder
from ..core.run.progress import Progress, progress_bar, stderr_is_terminal
from .study import run_study
from .study_result import Study

SETTINGS = ("repeat", "one_at_a_time", "device", "precision", "processes", "frames", "checkpoint_every", "scheduler",
            "workers", "progress", "rerun", "usd")  # fmt: skip


LISTS = (list, tuple, range, np.ndarray)
"""Types of lists. A list as the value of a fixed parameter is a mistake of the user, who wanted to vary this
parameter."""


def study(
    scene: SceneFunction, *, vary: Mapping[str, Sequence[object]] | None = None, out: Path | str | None = None,
    quiet: bool | None = None, **given: object,
) -> Study:  # fmt: skip
    """Run a scene function, such as ``warpcrete.scenes.pipe``, with all combinations of the values in `vary`.

    `vary` maps the names of scene parameters to lists of values. All settings of
    :func:`warpcrete.studies.study.run_study` are accepted, for example `repeat`, `one_at_a_time`, `device`,
    `processes`, `frames`, `scheduler` and `workers`. If `rerun` or `usd` is true, each case is also recorded for the
    Rerun viewer or as a USD file. All other keywords are fixed parameters of the scene. `out` is the new folder
    (default: runs/study-NNN). `quiet` hides the progress bar; by default, the bar is shown only in a terminal. If a
    callback `progress` is given, it is called instead of showing the bar. Raises :class:`SceneError` if `scene` is not
    a scene function or `vary` is not a mapping to lists, and everything that :func:`warpcrete.studies.study.run_study`
    raises.
    """
    name, module = module_of(scene)
    lists = {key: np.asarray(values).tolist() for key, values in given.items() if isinstance(values, LISTS)}
    if lists:
        values = dict(vary) | lists if isinstance(vary, Mapping) else lists
        problem = "is a list; a study varies only the parameters in 'vary'"
        refuse(next(iter(lists)), next(iter(lists.values())), problem, f"write vary={values}")
    for key, values in given.items() if vary is None else ():
        if isinstance(values, Mapping) and suggested(key, ["vary"]):
            refuse(key, values, "is not a parameter", suggested(key, ["vary"]))
    if vary is None:
        raise SceneError(
            'vary: is missing; name the parameters and their values, for example vary={"velocity": [0.3, 0.5]}'
        )
    if not isinstance(vary, Mapping):
        refuse("vary", vary, "must map each parameter to a list of values", 'for example vary={"velocity": [0.3, 0.5]}')
    for key, values in vary.items():
        if not isinstance(key, str):
            refuse("vary", key, "is not the name of a parameter", 'for example vary={"velocity": [0.3, 0.5]}')
        if isinstance(values, str) or not isinstance(values, Iterable):
            refuse(key, values, "must be a list of values", f'for example vary={{"{key}": [{values!r}, ...]}}')
    if quiet is not None:
        flag("quiet", quiet)
    settings = {key: given.pop(key) for key in SETTINGS if key in given}
    check_settings(scene, given, (*SETTINGS, "vary", "out", "quiet"))
    folder = output_folder(out, "study")
    if "progress" in settings:
        return run_study(name, module, vary, base=given, out=folder, **settings)
    with study_progress(not stderr_is_terminal() if quiet is None else quiet) as tell:
        return run_study(name, module, vary, base=given, out=folder, progress=tell, **settings)


def check_settings(scene: SceneFunction, given: Iterable[str], settings: Sequence[str]) -> None:
    """Refuse a name in `given` that is not a parameter of the scene, but resembles (misspells) a name in `settings`."""
    known = declared_fields(scene.parameters)
    for name in given:
        meant = suggested(name, (*settings, *known)) if name not in known else ""
        if any(repr(setting) in meant for setting in settings):
            refuse("parameter", name, f"is neither a setting nor a parameter of scene {scene.name}", meant)


@contextmanager
def study_progress(quiet: bool) -> Generator[Progress | None]:
    """Yield a callback that shows the progress of a study as a bar, or None if `quiet`; close the bar at the end.

    The first call of the callback also prints a line, which says that the first cases compile kernels.
    """
    called = False
    with progress_bar(quiet) as bar:

        def announced(phase: str, fraction: float, figures: dict[str, float]) -> None:
            nonlocal called
            if not called:
                called = True
                print(
                    "running; the first cases compile kernels that are missing in the cache",
                    file=sys.stderr,
                    flush=True,
                )
            assert bar is not None
            bar(phase, fraction, figures)

        yield None if bar is None else announced


def module_of(scene: SceneFunction) -> tuple[str, Any]:
    """Return the command-line name and the module of a scene function; raise :class:`SceneError` for other objects."""
    module = getattr(scene, "module", None)
    if module is None or getattr(module, "scene", None) is not scene:
        problem = "must be a scene function"
        refuse("scene", scene, problem, "use a scene function of warpcrete.scenes, such as warpcrete.scenes.pipe")
    return scene.name, module
