"""Fixtures: the same test bodies run on the CPU and, where there is one, on a GPU."""

import datetime
import gc
import json
import os
import sys

# Matrices here are small: threads of linear algebra would wait for one another longer than they compute. NumPy reads
# this when it is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from shortcuts import SHORTCUTS
from source_hash import RECORD, source_hash

from warpcrete.core.device.device import divide_work_like_gpu, find_device, quiet_init
from warpcrete.dem.engine.bonding import bond_kinds, bond_rows
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.stepper import Stepper
from warpcrete.dem.scene.bodies import placed_bodies

os.environ.setdefault("MPLBACKEND", "Agg")

# Without compiled Python files, every process that a test starts would compile the whole package again (0.5 s), and
# every worker all tests (6 s).
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Side by side, each worker of the tests keeps to cores of its own, and with it the threads and processes it begins, and
# to one of the GPUs that CUDA_VISIBLE_DEVICES names.
WORKER = os.environ.get("PYTEST_XDIST_WORKER", "")
if WORKER:
    workers = int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
    place = int(WORKER.removeprefix("gw")) % workers  # one that follows a lost worker has a number beyond them
    if gpus := os.environ.get("CUDA_VISIBLE_DEVICES"):
        os.environ["CUDA_VISIBLE_DEVICES"] = gpus.split(",")[place % len(gpus.split(","))]
    if hasattr(os, "sched_setaffinity") and workers <= len(os.sched_getaffinity(0)):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[place::workers])

PRECISIONS = ("float32", "float64")


def devices() -> list[str]:
    import warp as wp

    quiet_init()
    return ["cpu"] + (["cuda:0"] if wp.is_cuda_available() else [])


@pytest.fixture(params=devices())
def device(request) -> str:
    return request.param


@pytest.fixture
def like_a_gpu():
    """Work is shared out as on a GPU, whatever the device."""
    with divide_work_like_gpu():
        yield


@pytest.fixture
def start(device):
    """Function scene -> stepper, on the device under test, without packing or settling."""

    def make(scene, precision="float64", **settings):
        model = build_model(scene, find_device(device), precision)
        stepper = Stepper(model, State(model, placed_bodies(scene)), scene.time_step, **settings)
        stepper.choose_dt()
        return stepper

    return make


def bonds_of(state) -> tuple[np.ndarray, np.ndarray]:
    """Return the bond kind and the bond load of every entry of the pair list.

    The kind is 0 without a bond and negative for a broken bond. The load is 0 where there is no bond.
    """
    bond, load = state.pairs.bond.numpy(), state.pairs.load.numpy()
    return bond_kinds(bond), np.where(bond[:, None] > 0, load[bond_rows(np.maximum(bond, 0))], 0).astype(load.dtype)


def pair_history(state) -> dict:
    """Contact history by permanent sphere numbers (low, high): shear (with friction), bond kind, force, moment."""
    start, other = state.pairs.start.numpy(), state.pairs.other.numpy()
    ids = state.spheres.id.numpy()
    features = state.model.features
    arrays = [state.pairs.history.numpy()] if features.history else []
    if features.bonds:
        arrays += bonds_of(state)
    result = {}
    for i in range(state.sphere_count):
        for k in range(start[i], start[i + 1]):
            if other[k] < 0 and not features.half_list:
                continue  # a full list's second entry of a pair holds neither history nor load
            j = other[k] if other[k] >= 0 else -1 - other[k]
            key = (min(ids[i], ids[j]), max(ids[i], ids[j]))
            assert (other[k] >= 0) == (ids[i] < ids[j])
            value = tuple(a[k].tobytes() for a in arrays)
            if key in result:
                assert result[key] == value, "both copies of a full list hold the same bits"
            result[key] = value
    return result


def by_id(state, name: str) -> np.ndarray:
    """A body array in the order of permanent numbers."""
    return getattr(state.bodies, name).numpy()[np.argsort(state.bodies.id.numpy())]


def verification(module, thorough=()):
    """Test of every case of a verification module, on every device, in both precisions; some only thoroughly."""
    precisions = [pytest.param(p, marks=[pytest.mark.thorough] if p in thorough else []) for p in PRECISIONS]
    cases = [pytest.param(c, id=c.name, marks=[pytest.mark.slow] if c.slow else []) for c in module.CASES]

    @pytest.mark.parametrize("precision", precisions)
    @pytest.mark.parametrize("case", cases)
    def test_case(device, precision, case):
        rows = case.run(device, precision)
        wrong = [
            f"{r.quantity}: {r.ours:.6g}, not {r.expected:.6g}: {r.error:.2e} > {r.tolerance:.1e}"
            for r in rows
            if not r.passed
        ]
        assert rows and not wrong, "\n".join(wrong)

    return test_case


@pytest.fixture(scope="session")
def undisturbed_folder(tmp_path_factory):
    """The run folder of a short flow that nothing disturbed."""
    from run_folders import flow  # It imports much of the package, which most workers do not need.

    folder = tmp_path_factory.mktemp("folders") / "whole"
    flow(folder).run()
    return folder


@pytest.fixture(scope="session")
def whole_pictures():
    """Pictures are drawn as users see them."""


@pytest.fixture(scope="session")
def shared_packings():
    """Simulations share packings even if the test has the fixture `monkeypatch`."""


@pytest.fixture(scope="session", autouse=True)
def shared_folder(tmp_path_factory):
    """Give the workers of a run one folder for what their tests share."""
    folder = tmp_path_factory.getbasetemp()
    SHORTCUTS.begin((folder.parent if WORKER else folder) / "packings")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    SHORTCUTS.choose(item.fixturenames)


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    """Give each worker of `-n` a contiguous part of the tests, and let idle workers take over the rest of another's.

    Tests of one file share kernels and fixtures. If they alternate between workers, as is usual, both workers compile
    the same kernels at the same time, and both make the runs that a file's tests share.
    """
    if getattr(config.option, "dist", "no") == "load":
        config.option.dist = "worksteal"


def pytest_addoption(parser):
    parser.addoption(
        "--gpu", action="store_true", help="leave out what is on a CPU here as anywhere: cases of device cpu"
    )


def pytest_collection_modifyitems(config, items):
    for item in items:
        if item.get_closest_marker("linux") and sys.platform != "linux":
            item.add_marker(pytest.mark.skip(reason="needs Linux: /proc, /dev/full or threads bound to cores"))
        if item.get_closest_marker("posix") and sys.platform == "win32":
            item.add_marker(pytest.mark.skip(reason="needs POSIX signals or limits, which Windows lacks"))
    if config.getoption("--gpu"):
        spared = [item for item in items if hasattr(item, "callspec") and item.callspec.params.get("device") == "cpu"]
        config.hook.pytest_deselected(items=spared)
        items[:] = [item for item in items if item not in set(spared)]


def pytest_collection_finish():
    """Spare the garbage collector what has been imported by now, which stays until the end."""
    gc.collect()
    gc.freeze()


def pytest_terminal_summary(terminalreporter, config):
    """A run of the whole suite on a GPU leaves a record of what it came to."""
    chosen = config.option.keyword or config.option.markexpr != "not slow"
    chosen = chosen or config.option.collectonly or config.args != config.getini("testpaths")
    if chosen or hasattr(config, "workerinput") or len(devices()) < 2:
        return
    import warp as wp

    counts = {name: len(terminalreporter.stats.get(name, [])) for name in ("passed", "skipped")}
    failed = [report.nodeid for name in ("failed", "error") for report in terminalreporter.stats.get(name, [])]
    left = max(0, terminalreporter._session.testscollected - sum(counts.values()) - len(set(failed)))
    record = {
        "device": wp.get_device("cuda:0").name,
        "date": datetime.date.today().isoformat(),
        "passed": counts["passed"],
        "skipped": counts["skipped"],
        "failed": failed,
        "not_run": left,
        "without": "cases of device cpu" if config.getoption("--gpu") else "",
        "warp": wp.__version__,
        "hash": source_hash(),
    }
    RECORD.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
