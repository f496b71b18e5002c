"""Functions that worker processes run in tests. Every worker imports this file, so this file imports little."""

import os
import time

from warpcrete.core.errors import ConvergenceError, WarpcreteError


def add(one, other, asked):
    print("something that a library prints")
    return one + other, asked()


def leave(code, asked):
    os._exit(code)


def kill(number, asked):
    os.kill(os.getpid(), number)


def unreadable(asked):
    raise WarpcreteError(lambda: "no pickle holds a function")


def diverge(asked):
    raise ConvergenceError(0.1, "pressure", 7, [1.0, 0.5], 0.5, 7)


def wait_for_stop(asked):
    while not asked():
        time.sleep(0.01)
    return "stopped"


def sleep(asked):
    time.sleep(60)
