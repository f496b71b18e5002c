"""Processes that end with this one."""

from __future__ import annotations

import os
import sys

TIED = """
import ctypes, os, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG, which stays with the program that follows
if os.getppid() == int(sys.argv[1]):
    os.execv(sys.argv[2], sys.argv[2:])
"""
"""Becomes another program, which the system kills when the process that started it ends."""


def tied(command: list[str]) -> list[str]:
    """Return a command that runs another and is killed with this process, whatever ends it (on Linux)."""
    if sys.platform != "linux":
        return command
    return [sys.executable, "-IS", "-c", TIED, str(os.getpid()), *command]
