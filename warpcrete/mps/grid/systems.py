"""Linear systems of a flow on a grid, and the levels of their multigrid preconditioner."""

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from ...core.device.arrays import Scalar
from ...core.device.device import parallel
from ...kernels.common.reductions import BLOCK
from ...kernels.mps.conjugate_gradient import OUTCOME
from ...kernels.mps.grid.levels import system_structs
from ...kernels.mps.grid.multigrid import PROLONG, RESTRICT, SMOOTH
from ..common.allocation import allocate

CHUNKS = 32
"""Number of chunks into which a CPU divides the rows of a linear system.

Each chunk yields one partial sum, so sums have the same bits for any number of threads. CHUNKS is also the maximum
number of threads.
"""
HISTORY = 256  # Maximum number of iterations for which a solve stores the norm of the residual.
SMALLEST = {"cpu": 2000, "gpu": 150_000}
"""Minimum number of cells, including those around the grid, for a multigrid preconditioner with several levels. Smaller
grids have a single level, so that the preconditioner is the diagonal of the matrix.

On smaller grids, coarser levels take more time than they save.
"""
COARSEST = 32
"""Number of cells of a multigrid level at or below which no coarser level follows."""
COARSEST_STEPS = 6
"""Number of smoothing steps by which the equations of the coarsest multigrid level are solved approximately."""
VISITS = {"cpu": 2, "gpu": 1}
"""Number of visits of the next coarser level in a multigrid cycle: 1 is a V-cycle, 2 a W-cycle.

A second visit reduces the number of iterations. On a GPU, however, the barriers of a second visit take more time than
the visit saves.
"""
STEPS = {"cpu": 1, "gpu": 2}
"""Number of smoothing steps before the visits of the next coarser multigrid level; the same number follows the visits.
On the finest level, the number is always 1."""


@dataclass(frozen=True)
class System:
    """Linear system with a row for each face or for each cell of the grid."""

    rows: int
    """Number of rows on the finest multigrid level, whose cells are the cells of the grid itself."""
    first: tuple[int, ...]
    """Index of the first row of each multigrid level, followed by the total number of rows."""
    matrix: Any
    """Coefficients of the linear systems of all multigrid levels, a struct `Matrix`."""
    arrays: Any
    """Working arrays of the conjugate-gradient solve, such as residuals and search directions, in a struct `Solve`."""


def system_of(scalar: Scalar, device: wp.Device, shape: tuple[int, ...], copies: int, near: int) -> System:
    """Return a linear system for a grid, with the levels of its preconditioner.

    `shape` is the number of cells along each axis, last axis first, including the cells around the grid. There are
    `copies` rows for each cell: one per axis for velocities, or a single one for pressures. A row has at most `near`
    off-diagonal entries.
    """
    kind = "gpu" if parallel(device) else "cpu"
    shapes = level_shapes(shape) if math.prod(shape) >= SMALLEST[kind] else [shape]
    first = np.cumsum([0, *(copies * math.prod(each) for each in shapes)])
    parent, child = kinship(shapes, copies, first)
    rows, levels, structs = int(first[-1]), len(shapes), system_structs(scalar)
    matrix = structs.Matrix()
    matrix.near_capacity, matrix.rows, matrix.levels, matrix.children = near, rows, levels, 2 ** len(shape)
    many = {"near": rows * near, "coefficient": rows * near, "before": rows if parallel(device) else 0}
    sizes = {name: many.get(name, rows) for name in structs.Matrix.vars if name not in NUMBERS}
    data = {"free": np.ones(rows), "parent": parent, "child": child, "first": first, "begin": levels + 1}
    data["cycle"] = np.array(cycle(levels, VISITS[kind], STEPS[kind]), np.int32).ravel()
    allocate(structs.Matrix, device, matrix, **sizes | data)
    return System(int(first[1]), tuple(map(int, first)), matrix, solve_arrays(scalar, device, int(first[1]), rows))


NUMBERS = ("near_capacity", "rows", "levels", "children")
"""Members of the struct `Matrix` that are single numbers, not arrays."""


def solve_arrays(scalar: Scalar, device: wp.Device, finest: int, rows: int) -> Any:
    """Return the working arrays of a solve with `finest` rows on the finest multigrid level and `rows` rows in all."""
    wide = parallel(device)
    sizes = {
        "direction": finest * (2 if wide else 1), "product": finest, "stop_norm": 1, "outcome": OUTCOME,
        "partial": 4 * (-(-finest // BLOCK) if wide else CHUNKS), "history": HISTORY,
    }  # fmt: skip
    struct = system_structs(scalar).Solve
    return allocate(struct, device, **dict.fromkeys(struct.vars, rows) | sizes)


def level_shapes(shape: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Return the number of cells along each axis for all multigrid levels.

    The number halves from each level to the next coarser one.
    """
    shapes = [tuple(shape)]
    while math.prod(shapes[-1]) > COARSEST and max(shapes[-1]) > 2:
        shapes.append(tuple((n + 1) // 2 for n in shapes[-1]))
    return shapes


def kinship(shapes: list[tuple[int, ...]], copies: int, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return for each row its parent on the next coarser multigrid level, and for each coarser row its children.

    `shapes` and `first` hold the number of cells and the first row of each level, and `copies` is the number of rows
    for each cell. The children are rows of the next finer level. Rows of the coarsest level have the parent -1. The
    second array has 2^axes entries for each coarser row, one after the other; entries without a child are -1.
    """
    axes = len(shapes[0])
    parent = np.full(first[-1], -1)
    child = np.full((first[-1] - first[1], 2**axes), -1)
    for level, (fine, coarse) in enumerate(itertools.pairwise(shapes)):
        at = np.indices(fine).reshape(axes, -1)
        beside = np.ravel_multi_index(tuple(at // 2), coarse)
        which = np.ravel_multi_index(tuple(at % 2), (2,) * axes)
        for copy in range(copies):
            own = first[level] + copy * math.prod(fine) + np.arange(math.prod(fine))
            above = first[level + 1] + copy * math.prod(coarse) + beside
            parent[own] = above
            child[above - first[1], which] = own
    return parent, child.ravel()


def cycle(levels: int, visits: int, steps: int) -> list[tuple[int, int, int, int]]:
    """Return the operations of a multigrid cycle, as `kernels/mps/grid/multigrid.py` describes them.

    Each level visits the next coarser level `visits` times. `steps` smoothing steps precede these visits, and as many
    steps follow them; the finest level makes one step instead. The first smoothing step of a level is part of the
    operation before it. A level has two arrays for its solution, `even` and `odd`, which smoothing reads and writes in
    alternation. The solution of the finest level is in `odd` before the cycle, and in `even` after it.
    """
    operations: list[tuple[int, int, int, int]] = []

    def smooth(level: int, side: int, count: int) -> int:
        for _ in range(count):
            operations.append((int(SMOOTH), level, side, 0))
            side = 1 - side
        return side

    def visit(level: int, side: int, first: bool) -> int:
        """Add the operations of a visit of a multigrid level to the cycle; return the array with the new solution.

        `side` is the array with the solution before the visit. Both arrays are stated as 0 for `even` or 1 for `odd`.
        The `first` visit of a level in a cycle needs one smoothing step less.
        """
        if level == levels - 1:
            return smooth(level, side, COARSEST_STEPS - first)
        count = steps if level else 1
        side = smooth(level, side, count - first)
        operations.append((int(RESTRICT), level, side, 0))
        coarse = visit(level + 1, 0, True)
        if level + 1 < levels - 1:
            for _ in range(visits - 1):
                coarse = visit(level + 1, coarse, False)
        operations.append((int(PROLONG), level, side, coarse))
        return smooth(level, side, count)

    if levels > 1:
        visit(0, 1, True)
    return operations
