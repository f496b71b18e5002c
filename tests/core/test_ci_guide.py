"""The test and the workflow that the guide to continuous integration shows."""

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest

from warpcrete.core.run.provenance import CPU_INFO, processor_features

PAGE = Path(__file__).parents[2] / "notebooks" / "how-to" / "test-in-ci.md"


def block(language, sign):
    """Return the only block of code on the page that contains `sign`."""
    text = PAGE.read_text(encoding="utf-8")
    (found,) = [each for each in re.findall(rf"```{language}\n(.*?)```", text, re.S) if sign in each]
    return found


@pytest.mark.thorough
def test_the_guides_test_stores_compares_and_renews_a_reference(tmp_path, monkeypatch):
    """It fails without a reference, and compares bits on the same processor and values on another one."""
    (tmp_path / "test_concrete.py").write_text(block("python", "REFERENCE"), encoding="utf-8")

    def outcome():
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"],
            cwd=tmp_path, capture_output=True, encoding="utf-8", timeout=600,
        )  # fmt: skip
        return done.stdout.splitlines()[-1], done.stdout

    last, said = outcome()
    assert last.startswith("3 failed, 3 passed") and "no reference for slump; copy runs" in said
    reference = tmp_path / "reference.json"
    shutil.copyfile(tmp_path / "runs" / "reference.json", reference)
    assert outcome()[0].startswith("6 passed")
    known = json.loads(reference.read_text(encoding="utf-8"))
    tube = known["tube"]
    slightly = tube | {"value": tube["value"] * 1.00005, "state_hash": "another"}
    # The page's comparison is called directly with the last result, because this needs no further run.
    monkeypatch.chdir(tmp_path)
    spec = importlib.util.spec_from_file_location("test_concrete", tmp_path / "test_concrete.py")
    page = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(page)
    case = "tube", json.loads((tmp_path / "runs" / "tube" / "result.json").read_text(encoding="utf-8"))
    page.test_result_is_as_before(case)
    # Other bits of the state or the result fail on this processor; on another one the result may differ within the
    # tolerance and no further.
    for changed, passes in (
        (tube, True),
        (tube | {"state_hash": "another"}, False),
        (tube | {"value": slightly["value"]}, False),
        (slightly | {"made_on": {}}, True),
        (slightly | {"made_on": {}, "value": tube["value"] * 1.0002}, False),
    ):
        reference.write_text(json.dumps(known | {"tube": changed}), encoding="utf-8")
        with nullcontext() if passes else pytest.raises(AssertionError):
            page.test_result_is_as_before(case)


@pytest.mark.linux
def test_the_guides_workflow_finds_the_features_of_the_processor():
    """Its command prints something for the line of this processor, and for that of an ARM processor."""
    command = re.search(r"features=\$\((.*)\)\"", block("yaml", "features="))[1]
    empty = subprocess.run(["sha256sum"], input=b"", capture_output=True).stdout[:16].decode()
    assert str(CPU_INFO) in command
    made = subprocess.run(["bash", "-c", command], capture_output=True, encoding="utf-8").stdout.strip()
    assert len(made) == 16 and (made != empty) == bool(processor_features())
    arm = command.replace(str(CPU_INFO), "<(printf 'processor\\t: 0\\nFeatures\\t: fp asimd\\n')")
    made = subprocess.run(["bash", "-c", arm], capture_output=True, encoding="utf-8").stdout.strip()
    assert len(made) == 16 and made != empty
