"""Checkpoint and resume: the bits of an uncut run; damaged or foreign files are refused; a kill corrupts nothing."""

import functools
import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from pumping import SMALL, command, small_options

from warpcrete import Simulation, scenes
from warpcrete.core.errors import RunFolderError
from warpcrete.core.inputs.fingerprints import fingerprint
from warpcrete.core.run.checkpoint import _digest, discard, remove
from warpcrete.core.run.files import partial_of
from warpcrete.core.run.recorder import Recorder
from warpcrete.dem.engine.state_data import state_hash
from warpcrete.dem.laws import Contact
from warpcrete.dem.scene import clumps
from warpcrete.dem.scene.scene import Bodies, Bonds, Hydration, Scene, TimeStep
from warpcrete.geometry.axis import Axis, Line
from warpcrete.geometry.walls import Driven, MeshWall, PlaneWall, Prescribed
from warpcrete.record.rerun import RerunRecorder
from warpcrete.record.run_folder import TableRecorder
from warpcrete.record.usd import UsdRecorder

KILLS = 3


def mixed_scene(seed=0, energy_balance=False) -> Scene:
    """A heap of clumps in a spinning mesh drum under a driven plate: every part of a state is in use."""
    random = np.random.default_rng(seed)
    vertices, faces = Axis((0, 0, 0), (0, 0, 1), (Line(0.2),)).tube(0.055, 24)
    template = clumps.reference()[1]
    grid = np.stack(np.meshgrid(*[np.arange(4) - 1.5] * 3, indexing="ij"), -1).reshape(-1, 3)
    bonds = Bonds(tensile_strength=300.0, cohesion=150.0, healing=True)
    return Scene(
        name="mixed",
        duration=0.12,
        sample_interval=0.004,
        bodies=(
            Bodies(
                positions=0.017 * grid + random.normal(scale=5e-4, size=grid.shape) + [0, 0, 0.045],
                sizes=random.uniform(0.009, 0.014, len(grid)),
                template=template,
                spins=random.normal(scale=20.0, size=grid.shape),
            ),
        ),
        walls=(
            PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1)),
            PlaneWall(
                name="plate", point=(0, 0, 0.1), normal=(0, 0, -1),
                motion=Driven(direction=(0, 0, -1), force=5, mass=0.1),
            ),
            MeshWall(
                name="drum", vertices=vertices, faces=faces, motion=Prescribed(spin=(0, 0, 2.0), ramp_time=0.05)
            ),
        ),
        contact=Contact(friction=0.3, shear_damping_ratio=0.1),
        bonds=bonds,
        hydration=Hydration(fraction=0.3, bonds=Bonds(effective_modulus=1e5)),
        time_step=TimeStep(interval=7),
        energy_balance=energy_balance,
        seed=seed,
    )  # fmt: skip


class Cut(Recorder):
    """Writes a checkpoint after a row, and optionally stops there."""

    def __init__(self, path, row, stop):
        self.path, self.row, self.stop = path, row, stop

    def sample(self, simulation, row):
        if len(simulation.rows) == self.row + 1:
            simulation.stop_requested = self.stop


@functools.cache
def uncut_run(device, precision):
    """Return a simulation of the mixed scene with its energy balance after its run, and the run; change neither."""
    simulation = Simulation(mixed_scene(energy_balance=True), device=device, precision=precision)
    return simulation, simulation.run()


def test_what_a_checkpoint_holds_does_not_change_with_the_run(device):
    simulation = Simulation(mixed_scene(), device=device, precision="float32")
    simulation.begin()
    kept = simulation.state_dict()["state"]
    arrays = {(group, name): a for group, held in kept.items() if isinstance(held, dict) for name, a in held.items()}
    arrays = {key: a for key, a in arrays.items() if isinstance(a, np.ndarray)} | {("flags", ""): kept["flags"]}
    before = {key: a.copy() for key, a in arrays.items()}
    simulation.run()
    assert ("bodies", "position") in arrays
    assert all(np.array_equal(a, before[key]) for key, a in arrays.items())


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("row", [0, 1, 13, 29])
def test_a_resumed_run_holds_the_bits_of_an_uncut_one(device, precision, row, tmp_path):
    path = tmp_path / "checkpoint.npz"
    scene = mixed_scene(energy_balance=True)
    uncut, whole = uncut_run(device, precision)
    first = Simulation(
        scene, device=device, precision=precision, checkpoint_path=path, recorders=[Cut(path, row, stop=True)]
    )
    assert not first.run().finished
    second = Simulation(scene, device=device, precision=precision, recorders=[Recorder()])
    second.resume(path)
    rest = second.run()
    assert state_hash(second.state) == state_hash(uncut.state)
    assert whole.result["state_hash"] == rest.result["state_hash"] == state_hash(uncut.state)
    assert list(whole.series) == list(rest.series)
    for name in whole.series:
        assert np.array_equal(whole.series[name], rest.series[name], equal_nan=True), name
    assert whole.series["bonds"].max() > 20 and whole.series["broken_tension"][-1] > 0
    # More than the hash sees: the order in memory, the lists, all of it.
    for (struct, name, array), (_, _, other) in zip(uncut.state.arrays(), second.state.arrays()):
        if struct != "pairs":  # their rows beyond the list hold anything
            assert np.array_equal(array.numpy(), other.numpy()), f"{struct}.{name}"


def test_a_cut_may_fall_between_any_two_steps(device, tmp_path):
    scene = mixed_scene()
    one = Simulation(scene, device=device)
    one.prepare()
    one.stepper.take(101)
    one.save(tmp_path / "a.npz")
    one.stepper.take(257)
    other = Simulation(scene, device=device)
    other.resume(tmp_path / "a.npz")
    other.stepper.take(257)
    assert state_hash(one.state) == state_hash(other.state)


def test_two_runs_hold_the_same_bits_and_other_seeds_do_not(device):
    runs = [Simulation(mixed_scene(seed), device=device).run() for seed in (0, 0, 1)]
    hashes = [run.result["state_hash"] for run in runs]
    assert hashes[0] == hashes[1] != hashes[2]
    assert len(hashes[0]) == 64


def test_fingerprints_tell_large_numbers_types_and_functions_apart():
    assert fingerprint(2**60) != fingerprint(2**60 + 1) and fingerprint(10**400) != fingerprint(10**400 + 1)
    assert fingerprint(1) == fingerprint(1.0) == fingerprint(np.int64(1))
    assert fingerprint(int) != fingerprint(float) and fingerprint(len) != fingerprint(abs)
    assert fingerprint(mixed_scene) != fingerprint(fingerprint)


def test_fingerprints_tell_arrays_and_lists_of_the_same_numbers_apart():
    numbers = np.arange(6.0)
    values = [
        numbers, numbers.reshape(2, 3), numbers.reshape(3, 2), numbers.view(np.int64), numbers.astype(np.float32),
        numbers.tolist(), [numbers.tolist()], [[0.0], [1.0]], [[0.0, 1.0]], "1", 1, None, "None", {"a": 1, "b": 2},
        {"b": 2, "a": 1}, {"a": 2, "b": 1},
    ]  # fmt: skip
    found = [fingerprint(value) for value in values]
    assert len(set(found)) == len(values)
    # The layout of an array in memory does not count.
    assert fingerprint(np.asfortranarray(numbers.reshape(2, 3))) == found[1]


def test_fingerprints_tell_scenes_apart():
    one = mixed_scene()
    assert fingerprint(one) == fingerprint(mixed_scene())
    assert fingerprint(one) != fingerprint(mixed_scene(1))
    assert fingerprint(scenes.pipe()) == fingerprint(scenes.pipe())
    for change in (dict(friction=0.06), dict(shapes="reference"), dict(unit="horizontal"), dict(elbow_radius=0.6)):
        base = dict(unit="bend-to-horizontal") if "elbow_radius" in change else {}
        assert fingerprint(scenes.pipe(**base)) != fingerprint(scenes.pipe(**(base | change))), change


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "checkpoint.npz"
    simulation = Simulation(mixed_scene(), device="cpu")
    simulation.prepare()
    simulation.save(path)
    return path


def test_a_truncated_checkpoint_is_refused_wherever_it_ends(saved):
    whole = saved.read_bytes()
    for share in (0.0, 0.01, 0.3, 0.7, 0.99, 1 - 1 / len(whole)):
        saved.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(RunFolderError, match="damaged or not a checkpoint"):
            Simulation(mixed_scene(), device="cpu").resume(saved)
    with pytest.raises(RunFolderError, match=r"other\.npz': does not exist"):
        Simulation(mixed_scene(), device="cpu").resume(saved.with_name("other.npz"))


def test_a_checkpoint_is_removed_with_the_file_of_a_write_that_was_interrupted(tmp_path):
    path = tmp_path / "checkpoint.npz"
    for file in (path, partial_of(path)):
        file.write_bytes(b"state")
    discard(path)
    assert list(tmp_path.iterdir()) == [path]
    partial_of(path).write_bytes(b"half a state")
    remove(path)
    assert not list(tmp_path.iterdir())
    remove(path)  # A run that ends before its first checkpoint has neither file.


def as_bytes(content):
    return np.frombuffer(content, dtype=np.uint8)


def test_a_foreign_or_altered_checkpoint_is_refused_with_the_reason(saved):
    with pytest.raises(RunFolderError, match="belongs to another scene"):
        Simulation(mixed_scene(1), device="cpu").resume(saved)
    with pytest.raises(RunFolderError, match="precision 'float32', not 'float64'"):
        Simulation(mixed_scene(), device="cpu", precision="float64").resume(saved)
    with np.load(saved) as file:
        arrays = dict(file)
    whole = dict(arrays)
    arrays["state/bodies/position"] = arrays["state/bodies/position"] + 1e-3
    np.savez(saved, **arrays)
    with pytest.raises(RunFolderError, match="do not match its checksum"):
        Simulation(mixed_scene(), device="cpu").resume(saved)
    for key, value, says in (
        ("warpcrete checkpoint", 1, "has checkpoint format 1"), ("versions", {"warp": "0.1"}, "written by warp 0.1"),
        ("versions", None, "lacks data of the run"), ("contents", None, "lacks data"), ("contents", {}, "lacks data"),
        ("precision", ..., "lacks data"), ("device", ..., "lacks data"), ("scene", ..., "lacks data"),
        ("processor", ..., "lacks data"),
    ):  # fmt: skip
        text = json.loads(whole["text"].tobytes()) | {key: value}
        changed = whole | {"text": as_bytes(json.dumps({k: v for k, v in text.items() if v is not ...}).encode())}
        del changed["digest"]
        np.savez(saved, **changed, digest=as_bytes(_digest(changed)))
        with pytest.raises(RunFolderError, match=says):
            Simulation(mixed_scene(), device="cpu").resume(saved)
    np.savez(saved, somebody="else")
    with pytest.raises(RunFolderError, match="is not a checkpoint of warpcrete"):
        Simulation(mixed_scene(), device="cpu").resume(saved)
    saved.write_text("no archive", encoding="utf-8")
    with pytest.raises(RunFolderError, match="damaged or not a checkpoint"):
        Simulation(mixed_scene(), device="cpu").resume(saved)


def recorded_frames(path) -> dict:
    """All that a recording holds, by entity, time and component; without Rerun's own row numbers and clocks."""
    from rerun.chunk import RrdReader

    found: dict = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        names = [n for n in batch.schema.names if n not in ("log_time", "log_tick") and "RowId" not in n]
        for row in range(batch.num_rows):
            values = {n: batch.column(n)[row] for n in names}
            key = (str(chunk.entity_path), str(values.get("step")))
            if not key[0].startswith("/__"):
                kept = {n: str(v.as_py()) for n, v in values.items() if n not in ("time", "step") and v.is_valid}
                found.setdefault(key, {}).update(kept)
    return found


def test_series_recording_and_usd_of_a_resumed_run_are_those_of_an_uncut_one(tmp_path):
    from pxr import Usd

    scene = scenes.pipe(**(SMALL | dict(travel=0.04)))

    def recorders(folder):
        return [TableRecorder(folder), RerunRecorder(folder / "run.rrd"), UsdRecorder(folder / "scene.usdc")]

    Simulation(scene, device="cpu", recorders=recorders(tmp_path / "whole")).run()
    folder = tmp_path / "cut"
    checkpoint = folder / "checkpoint.npz"
    cut = [*recorders(folder), Cut(checkpoint, 11, stop=True)]
    first = Simulation(scene, device="cpu", recorders=cut, checkpoint_path=checkpoint, checkpoint_every=0.0)
    assert not first.run().finished
    # A killed process may leave such rows behind after its last checkpoint.
    with (folder / "series.csv").open("a", encoding="utf-8") as file:
        file.write("1,2,3\n4,5")
    (folder / "run-0050.rrd").write_bytes(b"half a p")
    for number in range(3):
        second = Simulation(
            scene, device="cpu", recorders=[*recorders(folder), Cut(checkpoint, 14 + number, stop=number < 2)],
            checkpoint_path=checkpoint,
        )  # fmt: skip
        second.resume(checkpoint)
        assert second.run().finished == (number == 2)
    assert not checkpoint.exists()
    assert [p.name for p in folder.glob("*run*")] == ["run.rrd"]
    assert (folder / "series.csv").read_bytes() == (tmp_path / "whole" / "series.csv").read_bytes()
    texts = []
    for name in ("whole", "cut"):
        stage = Usd.Stage.Open(str(tmp_path / name / "scene.usdc"))
        texts.append(stage.GetRootLayer().ExportToString())
    assert texts[0] == texts[1]
    frames = [recorded_frames(tmp_path / name / "run.rrd") for name in ("whole", "cut")]
    assert frames[0].keys() == frames[1].keys()
    assert len(frames[0]) > 40
    assert frames[0] == frames[1]
    assert any("position" in name for values in frames[0].values() for name in values)


def kill_at(folder, delay: float, *arguments, after_checkpoint: bool = True) -> None:
    """Start the command and kill the process, `delay` seconds after its start or after its next checkpoint."""
    code = "from warpcrete.cli import main; main()"
    path = folder / "checkpoint.npz"
    old = path.stat().st_mtime_ns if path.is_file() else 0
    process = subprocess.Popen([sys.executable, "-c", code, *map(str, arguments)], stderr=subprocess.DEVNULL)
    end = time.monotonic() + 120
    while after_checkpoint and process.poll() is None and time.monotonic() < end:
        if path.is_file() and path.stat().st_mtime_ns != old:
            break
        time.sleep(0.002)
    time.sleep(delay)
    process.send_signal(signal.SIGKILL)
    process.wait()


def killed_again_and_again(tmp_path, kills: int, travel: float) -> int:
    options = small_options(travel=travel, seed=5)
    whole = tmp_path / "whole"
    done = command("run", "pipe", *options, "--out", whole, "--device", "cpu", "--quiet", "--checkpoint-every", 0)
    assert done.returncode == 0, done.stderr
    random = np.random.default_rng(kills)
    folder = tmp_path / "killed"
    every = 0.05
    first = ("run", "pipe", *options, "--out", folder, "--device", "cpu", "--quiet", "--checkpoint-every", every)
    kill_at(folder, random.uniform(0, 0.3), *first)
    reached, rows = [], 0
    for kill in range(kills):
        # Whatever the moment: every file of the folder is whole, or a part that is thrown away.
        json.loads((folder / "scene.json").read_text(encoding="utf-8"))
        assert (folder / "checkpoint.npz").is_file()
        with np.load(folder / "checkpoint.npz") as file:
            settling = b'"settled"' in file["text"].tobytes()
            clock = 0.0 if settling else float(file["state/scenes/clock"][0, 0])
        reached.append(clock)
        series = folder / "series.csv"
        lines = series.read_text(encoding="utf-8").split("\n") if series.is_file() else [""]
        assert all(line.count(",") == lines[0].count(",") for line in lines[:-1])
        assert len(lines) - 1 >= rows  # what stood at a checkpoint stays
        rows = round(clock / 0.01)
        if kill < kills - 1:
            early = kill % 3 == 2
            delay = random.uniform(0.3, 2.5) if early else random.uniform(0.0, 0.15)
            kill_at(folder, delay, "run", "--resume", folder, "--quiet", after_checkpoint=not early)
            if not (folder / "checkpoint.npz").exists():
                break  # it was faster
    assert reached == sorted(reached)
    if (folder / "checkpoint.npz").exists():
        done = command("run", "--resume", folder, "--quiet")
        assert done.returncode == 0, done.stderr
    results = [json.loads((f / "result.json").read_text(encoding="utf-8")) for f in (whole, folder)]
    assert results[1]["finished"] and results[0]["state_hash"] == results[1]["state_hash"]
    assert (folder / "series.csv").read_bytes() == (whole / "series.csv").read_bytes()
    # A kill between state and recordings costs frames up to that state, nothing else.
    frames, known = (recorded_frames(each / "run.rrd") for each in (folder, whole))
    assert len(frames) > 0.5 * len(known) and all(known[key] == values for key, values in frames.items())
    names = {"scene.json", "series.csv", "result.json", "pressure.png", "run.rrd", "scene.usdc"}
    assert {path.name for path in folder.iterdir()} == names
    return len(reached)


@pytest.mark.thorough
def test_killed_runs_resume_to_the_same_bits(tmp_path):
    assert killed_again_and_again(tmp_path, KILLS, 0.06) > 1


@pytest.mark.slow
def test_twenty_kills_corrupt_nothing(tmp_path):
    assert killed_again_and_again(tmp_path, 20, 0.5) == 20


@pytest.mark.thorough
def test_resume_refuses_what_it_cannot_go_on_with(tmp_path):
    done = command("run", "--resume", tmp_path / "none")
    assert done.returncode == 2 and "does not exist" in done.stderr
    folder = tmp_path / "run"
    options = small_options(travel=0.02)
    done = command("run", "pipe", *options, "--out", folder, "--device", "cpu", "--quiet", "--no-usd", "--no-rerun")
    assert done.returncode == 0, done.stderr
    done = command("run", "--resume", folder)
    assert done.returncode == 2 and "the run is already finished" in done.stderr
    done = command("run", "tube", "--resume", folder)
    assert done.returncode == 2 and "is a run of the scene 'pipe'; continue it with" in done.stderr
    (folder / "result.json").unlink()  # as of one that was killed before its first checkpoint
    done = command("run", "--resume", folder, "--quiet")
    assert done.returncode == 0 and json.loads((folder / "result.json").read_text(encoding="utf-8"))["finished"], (
        done.stderr
    )
    (folder / "checkpoint.npz").write_bytes(b"PK\x03\x04")
    done = command("run", "--resume", folder)
    assert done.returncode == 2 and "damaged" in done.stderr and "Traceback" not in done.stderr
    done = command("run", "pipe", "--resume", folder, "--velocity", 0.5)
    assert done.returncode == 2 and "leave out velocity" in done.stderr


def test_the_watch_goes_on_with_what_it_had_seen(tmp_path):
    """Energy that appears after a resumption is judged by the least there was before it."""
    scene = mixed_scene()
    first = Simulation(scene, device="cpu")
    first.prepare()
    for _ in range(3):
        first.stepper.take(200)
        first.watch_row(first.measure())
    first.save(tmp_path / "a.npz")
    second = Simulation(scene, device="cpu")
    second.resume(tmp_path / "a.npz")
    assert second.watch.state_dict() == first.watch.state_dict()
    assert np.isfinite(second.watch.least) and second.watch.scale > 0
