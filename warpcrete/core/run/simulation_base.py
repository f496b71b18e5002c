"""Interface of a simulation: the members that each simulation method defines, and the selection of the method."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NoReturn, TypeVar

import numpy as np

from ..device.simulation_protocol import SimulationOnDevice
from ..drawing.display import Display
from ..errors import refuse, refuse_unknown_settings
from ..inputs.scene_functions import SceneFunction
from ..records import SavedState
from .coroutines import Coroutine, Until
from .ending import Ending
from .frames import Frames
from .run import Run

S = TypeVar("S", bound="SimulationBase")


def refuse_scene(scene: object, known: Sequence[type], hint: str = "") -> NoReturn:
    """Raise :class:`SceneError` about an object that is not a scene of one of the types `known`."""
    problem, kind = f"must be a {' or a '.join(each.__name__ for each in known)}", type(scene).__name__
    example = "create one with a function of warpcrete.scenes, such as warpcrete.scenes.pipe()"
    if isinstance(scene, SceneFunction):
        example = f"call this function, as in warpcrete.scenes.{scene.__name__}()"
    elif isinstance(scene, str) and scene.isidentifier():
        example = f"call a function of warpcrete.scenes, as in warpcrete.scenes.{scene}()"
    refuse("scene", kind, problem, hint or example)


class SimulationBase(SimulationOnDevice):
    """Members of a simulation that depend on the simulation method, which the type of the scene selects.

    The class `Simulation` of the module `run_loop` uses them. The subclass for a simulation method must define the
    abstract members and the class attribute `scene_type`. The other members have defaults.
    """

    scene_type: ClassVar[type]
    """Type of the scenes that a subclass simulates."""
    kinds: ClassVar[list[type[SimulationBase]]] = []
    """Subclasses with a `scene_type`: one for each simulation method."""
    scene: Any
    """Scene of the run; its type depends on the simulation method."""
    precision: str
    frames: Frames
    """Schedule of the simulated times at which pictures of the state (frames) are recorded."""
    resumes = False
    """True if the run goes on from a checkpoint, in an existing folder."""
    ending: Ending | None = None
    """Reason why the run ended; None as long as the run has not ended."""
    at_end = False
    """True if the last step has been taken, so that only recordings may still be incomplete."""

    def __init_subclass__(cls, **settings: object) -> None:
        super().__init_subclass__(**settings)
        if "scene_type" in cls.__dict__:
            names = vars(SimulationBase)
            missing = [name for name in names if getattr(getattr(cls, name), "__isabstractmethod__", False)]
            if missing:
                raise TypeError(f"{cls.__name__} does not define {', '.join(missing)}")
            SimulationBase.kinds.append(cls)

    def __new__(cls: type[S], scene: object, **settings: object) -> S:
        refuse_unknown_settings(cls.__init__, settings)
        kind: Any = cls
        kinds = SimulationBase.kinds
        if not hasattr(cls, "scene_type"):
            # Search the simulation classes in the reverse order of their definition. A scene type may be a subclass of
            # the scene type of an earlier class, which would then match the scene, too.
            kinds = [kind for kind in kinds if issubclass(kind, cls)]
            kind = next((kind for kind in reversed(kinds) if isinstance(scene, kind.scene_type)), cls)
        wanted = getattr(kind, "scene_type", None)
        if wanted is None or not isinstance(scene, wanted):
            known = [wanted] if wanted else [kind.scene_type for kind in kinds]
            refuse_scene(scene, known, "use warpcrete.Simulation, which accepts every scene" if wanted else "")
        return super().__new__(kind)

    @abstractmethod
    def set_up(self) -> None:
        """Create the data of the simulation method from the scene; refuse a scene that cannot be simulated."""

    @property
    @abstractmethod
    def prepared(self) -> bool:
        """True if the simulation has a state, which either `prepare` or a checkpoint has provided."""

    @abstractmethod
    def prepare(self) -> None:
        """Compute everything up to the state at t = 0, such as packing and settling."""

    @property
    @abstractmethod
    def rows(self) -> list[dict[str, float]]:
        """Rows of the time series so far; each row is a dictionary from column names to values."""

    @abstractmethod
    def unit(self, column: str) -> str:
        """Return the unit of a column of the run's time series."""

    @abstractmethod
    def measure(self) -> dict[str, float]:
        """Measure the quantities of the present state; append them to `rows` as a new row, and return this row."""

    @abstractmethod
    def watch_row(self, row: dict[str, float]) -> None:
        """Raise :class:`InstabilityError` if a row of the time series shows that the state has no physical meaning."""

    @abstractmethod
    def display(self, colouring: str | None = None) -> Display:
        """Return the view of the simulation that recorders draw, with bodies coloured by the quantity `colouring`."""

    @abstractmethod
    def result(self, finished: bool) -> Run:
        """Return the time series and the result quantities of the run up to now.

        `finished` is true if the run has reached its end.
        """

    @abstractmethod
    def state_dict(self) -> SavedState:
        """Return the state of the simulation for a checkpoint; :meth:`save` adds the data about the run."""

    @abstractmethod
    def load_state_dict(self, state: SavedState) -> None:
        """Restore the state from a `state_dict`; called instead of `prepare`."""

    @abstractmethod
    def release(self) -> None:
        """Free the memory on the device; the results of the run remain available."""

    # The following members have defaults.

    @property
    def duration(self) -> float:
        """Maximum simulated time of the whole run [s]."""
        return self.scene.duration

    @property
    def expected_duration(self) -> float:
        """Simulated time that the run will probably take [s]."""
        return self.duration

    @property
    def frame_step(self) -> float:
        """Size of the time steps [s], if it does not depend on where the run stops; otherwise infinity.

        With constant steps, the run can stop between two rows of the time series to record a picture of the state.
        """
        return np.inf

    @property
    def may_end_early(self) -> bool:
        """True if the run may end before its maximum duration, so that the remaining time is only an upper limit."""
        return False

    def ended_early(self) -> bool:
        """Return whether the run has reached its end before its maximum duration."""
        return False

    def why_ended(self) -> tuple[str, str]:
        """Return the reason why a complete run has ended: a key of :data:`.ending.REASONS`, and a sentence."""
        return "duration", f"the run has reached its duration of {self.duration:.4g} s"

    def reaching(self, time: float) -> Coroutine:
        """Advance the run to the simulated time `time` [s]; this generator requests the steps from its caller.

        Each :class:`Until` request states the time up to which the caller must step the run next. Subclasses override
        the method if something must happen before `time`, for example a rest of the concrete.
        """
        yield Until(time)
