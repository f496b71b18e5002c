"""Child processes that the system kills when this process ends."""

import os
import sys

KILL_WITH_PARENT = """
import ctypes, os, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG, which stays with the program that follows
if os.getppid() == int(sys.argv[1]):
    os.execv(sys.argv[2], sys.argv[2:])
"""
"""Source of a Python program that replaces itself by the command in its arguments. It first asks Linux to kill this
process when the parent process ends."""


def killed_with_parent(command: list[str]) -> list[str]:
    """Return a command line that runs `command`, and whose process the system kills when this process ends.

    Only Linux can kill the process in this way. On other systems, return `command` unchanged.
    """
    if sys.platform != "linux":
        return command
    return [sys.executable, "-IS", "-c", KILL_WITH_PARENT, str(os.getpid()), *command]
