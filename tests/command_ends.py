"""Ends of commands: their exit code together with the checks that failed."""

import re


def failed_checks(output):
    """Return the names of the checks that the output of `warpcrete run` or `warpcrete study` calls failed."""
    if found := re.search(r"^FAILED: checks of .*((?:\n  .*)+)", output, re.MULTILINE):
        return set(re.findall(r"^  ([^,]*), in ", found[1], re.MULTILINE))
    found = re.search(r"^FAILED: .*?$", output, re.MULTILINE)
    return {name for names in re.findall(r"\(([^()]*)\)", found[0] if found else "") for name in names.split(", ")}


def assert_ended(done, *checks):
    """Assert that a command went to its end and that exactly the named `checks` failed.

    The exit code is 0 without a failed check, and 3 with one. `done` is a finished process whose output is text.
    """
    said = done.stdout + done.stderr
    assert done.returncode == (3 if checks else 0), said
    assert failed_checks(said) == set(checks), said
