"""Clump templates: rigid shapes made of overlapping spheres, whose overlaps count only once in mass and inertia."""

import functools
import heapq
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core.errors import SceneError, between, refuse
from ...core.inputs.fingerprints import EqualByContent

SHARE_POINTS = 64
"""Number of grid points along the longest side of a clump, with which its volume is divided among its spheres."""


@dataclass(frozen=True, eq=False)
class ClumpTemplate(EqualByContent):
    """Shape of an aggregate at unit size, that is, with the volume of a sphere of diameter 1.

    Sphere centres are relative to the centroid of the spheres' union, in its principal axes. A body multiplies all
    lengths by its size, the diameter of the sphere of equal volume.
    """

    name: str
    offsets: np.ndarray
    """Centres of the spheres relative to the centroid, divided by the body's size (the diameter of the sphere of equal
    volume), shape (k, 3)."""
    radii: np.ndarray
    """Radii of the spheres, divided by the body's size (the diameter of the sphere of equal volume), shape (k,)."""
    inertia: np.ndarray
    """Principal moments of inertia, divided by the mass and by the size squared, shape (3,).

    The size of a body is the diameter of the sphere of equal volume. Moments that differ by less than 1e-4 of their
    mean are made equal.
    """

    @property
    def extent(self) -> float:
        """Largest distance of the surface from the centroid, divided by the diameter of the sphere of equal volume."""
        return float(np.max(np.linalg.norm(self.offsets, axis=1) + self.radii))

    @property
    def widths(self) -> np.ndarray:
        """Sides of the bounding box in principal axes over the diameter of the sphere of equal volume, shape (3,)."""
        return np.max(self.offsets + self.radii[:, None], 0) - np.min(self.offsets - self.radii[:, None], 0)

    @property
    def shape_factor(self) -> float:
        """Ratio of the longest to the shortest side of the bounding box in principal axes."""
        return float(self.widths.max() / self.widths.min())

    @functools.cached_property
    def shares(self) -> np.ndarray:
        """Fraction of the clump's volume that belongs to each sphere, shape (k,); the sum is 1.

        A point in several spheres belongs to the sphere below whose surface it lies deepest.
        """
        if len(self.radii) == 1:
            return np.ones(1)
        lower, upper = (self.offsets - self.radii[:, None]).min(0), (self.offsets + self.radii[:, None]).max(0)
        step = (upper - lower).max() / SHARE_POINTS
        axes = [np.arange(low + step / 2, high, step) for low, high in zip(lower, upper, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        least, nearest = np.full(len(points), np.inf), np.zeros(len(points), int)
        for sphere, (centre, radius) in enumerate(zip(self.offsets, self.radii, strict=True)):
            gap = np.linalg.norm(points - centre, axis=1) - radius
            nearest[gap < least] = sphere
            least = np.minimum(least, gap)
        number = np.bincount(nearest[least < 0], minlength=len(self.radii))
        return number / number.sum()


def union_properties(
    centres: np.ndarray, radii: np.ndarray, resolution: int = 384
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the volume, centroid, and inertia tensor about the centroid, of a union of spheres.

    Shapes are (), (3,) and (3, 3); the density is 1. Lines along z, on a fine grid in x and y, are intersected exactly
    with the spheres, and overlaps count once. The error falls as the 1.5th power of the grid step. `resolution` is the
    number of grid steps across the union; at its default the volume of one sphere is accurate to 2e-5.
    """
    centres, radii = np.asarray(centres, float), np.asarray(radii, float)
    lower, upper = (centres - radii[:, None]).min(0), (centres + radii[:, None]).max(0)
    step = (upper[:2] - lower[:2]).max() / resolution
    counts = np.maximum(1, np.ceil((upper[:2] - lower[:2]) / step)).astype(int)
    steps = (upper[:2] - lower[:2]) / counts
    x = lower[0] + (np.arange(counts[0]) + 0.5) * steps[0]
    y = lower[1] + (np.arange(counts[1]) + 0.5) * steps[1]
    gx, gy = (a.ravel() for a in np.meshgrid(x, y, indexing="ij"))
    square = radii**2 - (gx[:, None] - centres[:, 0]) ** 2 - (gy[:, None] - centres[:, 1]) ** 2
    half = np.sqrt(np.maximum(square, 0.0))
    begin = np.where(square > 0, centres[:, 2] - half, np.inf)
    end = np.where(square > 0, centres[:, 2] + half, -np.inf)
    # Each line crosses the spheres in several chords. Sort the chords, and clip each chord where the previous chords
    # end, so that overlaps count once.
    order = np.argsort(begin, axis=1)
    begin, end = np.take_along_axis(begin, order, 1), np.take_along_axis(end, order, 1)
    reached = np.maximum.accumulate(end, axis=1)
    begin[:, 1:] = np.maximum(begin[:, 1:], reached[:, :-1])
    real = end > begin
    b, e = np.where(real, begin, 0.0), np.where(real, end, 0.0)
    z0, z1, z2 = (e - b).sum(1), (e**2 - b**2).sum(1) / 2, (e**3 - b**3).sum(1) / 3
    area = steps[0] * steps[1]
    volume = z0.sum() * area
    centroid = np.array([(gx * z0).sum(), (gy * z0).sum(), z1.sum()]) * area / volume
    second = np.empty((3, 3))
    # The integrals are sums over prisms along z with a rectangular cross-section. The mean of x^2 over a prism is the
    # square of its middle plus steps[0]^2/12, because the prism is steps[0] wide. The mean of y^2 follows in the same
    # way from steps[1].
    second[0, 0] = ((gx**2 + steps[0] ** 2 / 12) * z0).sum()
    second[1, 1] = ((gy**2 + steps[1] ** 2 / 12) * z0).sum()
    second[2, 2] = z2.sum()
    second[0, 1] = second[1, 0] = (gx * gy * z0).sum()
    second[0, 2] = second[2, 0] = (gx * z1).sum()
    second[1, 2] = second[2, 1] = (gy * z1).sum()
    second = second * area - volume * np.outer(centroid, centroid)
    return volume, centroid, np.trace(second) * np.eye(3) - second


def clump(name: str, centres: np.ndarray, radii: np.ndarray) -> ClumpTemplate:
    """Create the template of a clump (a rigid body of spheres) from spheres at any scale and position.

    `centres`, shape (k, 3), and `radii`, shape (k,), are centred, rotated to principal axes and scaled to unit size.
    Raises :class:`SceneError` for invalid input.
    """
    try:
        centres, radii = np.atleast_2d(np.asarray(centres, float)), np.atleast_1d(np.asarray(radii, float))
    except (TypeError, ValueError):
        refuse("centres", centres, "must be rows of three numbers, with one radius each")
    if len(radii) == 0:
        refuse("radii", [], "must contain at least one radius")
    if centres.shape != (len(radii), 3) or not np.all(np.isfinite(centres)):
        refuse("centres", f"shape {centres.shape}", f"must be finite, shape ({len(radii)}, 3)")
    if not np.all(np.isfinite(radii)) or np.any(radii <= 0):
        refuse("radii", radii.tolist(), "must be finite numbers above 0")
    if len(radii) == 1:
        return ClumpTemplate(name, np.zeros((1, 3)), np.array([0.5]), np.full(3, 0.1))
    volume, centroid, inertia = union_properties(centres, radii)
    size = (6 * volume / np.pi) ** (1 / 3)
    moments, axes = np.linalg.eigh(inertia)
    if np.linalg.det(axes) < 0:
        axes = axes * [1, 1, -1]
    if np.ptp(moments) < 1e-4 * moments.mean():
        # Set moments equal if they agree within the accuracy of the integration, because the rotation of a body with
        # three equal moments is cheaper to compute.
        moments = np.full(3, moments.mean())
    offsets = (centres - centroid) @ axes / size
    return ClumpTemplate(name, offsets, radii / size, moments / (volume * size**2))


@functools.cache
def sphere() -> ClumpTemplate:
    """Return the template of a single sphere."""
    return clump("sphere", np.zeros((1, 3)), np.array([1.0]))


@functools.cache
def elongated(shape_factor: float) -> ClumpTemplate:
    """Return a straight row of equal spheres whose ratio of length to width is `shape_factor`, from 1 to 20.

    Zhan (2019, Fig. 14) shows such rows for the factors 1.5, 2.5, 3.5 and 4.5. The rows of this function have centres
    that are at most one radius apart, so that their narrowest cross-section is wider than 0.86 of the full width.
    """
    between("shape_factor", shape_factor, 1.0, 20.0)
    if shape_factor == 1:
        return sphere()
    count = 1 + int(np.ceil(2 * (shape_factor - 1) - 1e-9))
    x = np.linspace(-(shape_factor - 1), shape_factor - 1, count)
    return clump(f"shape-factor-{shape_factor:g}", np.stack([x, 0 * x, 0 * x], 1), np.ones(count))


@functools.cache
def reference() -> tuple[ClumpTemplate, ...]:
    """Return four aggregate shapes modelled by hand after Zhan (2019, Fig. 2), which gives no coordinates.

    The shapes are a rounded pair, a flat triangle, a compact tetrahedron and a bent row, with shape factors of 1.4 to
    2.1.
    """
    pair = clump("pair", np.array([[-0.35, 0, 0], [0.45, 0, 0]]), np.array([1.0, 0.85]))
    angle = np.radians([90, 210, 330])
    flat = clump("flat", 0.62 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1), np.array([1.0, 0.9, 0.8]))
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.38
    compact = clump("compact", corners, np.array([1.0, 0.92, 0.85, 0.78]))
    bent = clump("bent", np.array([[-0.95, 0.12, 0], [0, -0.18, 0.1], [0.9, 0.2, 0]]), np.array([0.8, 1.0, 0.85]))
    return (pair, flat, compact, bent)


TEMPLATE_SETS = ("reference", "spheres", "shape-1.5", "shape-2.5", "shape-3.5", "shape-4.5")


def templates(name: str, spheres: int = 10) -> tuple[ClumpTemplate, ...]:
    """Return templates by name: `reference` (four clumps), `spheres`, or `shape-F` with a shape factor F of 1 to 20.

    A name with a file extension is the path of a closed mesh, which is covered by `spheres` spheres; several paths may
    be separated by commas. Raises :class:`SceneError` for an unknown name.
    """
    if name == "reference":
        return reference()
    if name == "spheres":
        return (sphere(),)
    if name.startswith("shape-"):
        try:
            return (elongated(float(name.removeprefix("shape-"))),)
        except ValueError as error:
            if isinstance(error, SceneError):
                raise
    paths = [part.strip() for part in name.split(",")]
    if all(Path(path).suffix for path in paths):
        return tuple(from_mesh(path, spheres, Path(path).stem) for path in paths)
    hint = "for elongated bodies, write 'shape-' and the ratio of length to width, 1 to 20, as in 'shape-1.5'"
    refuse("shapes", name, "must be one of " + ", ".join(TEMPLATE_SETS) + ", or the path of a closed mesh", hint)


def from_mesh(mesh, spheres: int, name: str = "mesh", resolution: int = 32) -> ClumpTemplate:
    """Create a template that approximates a closed triangle mesh by a given number of spheres.

    Candidates are spheres tangent to the surface from inside, centred at interior points of a grid with `resolution`
    cells along the longest side. A greedy search repeatedly adds the candidate that covers most of the volume not yet
    covered. Finally all radii grow by the same length until the union has the mesh's volume. Cavities count as filled,
    because a body touches others only with its outer surface.

    `mesh` is a ``trimesh.Trimesh`` or a path that trimesh can read; `spheres` is 1 to 500. Raises :class:`SceneError`
    for an open or unreadable mesh.
    """
    from ...geometry.meshes import load_closed, signed_distance
    from ...geometry.solids import without_cavities

    if isinstance(spheres, bool) or not isinstance(spheres, int | np.integer):
        refuse("spheres", spheres, "must be a whole number in [1, 500]")
    between("spheres", spheres, 1, 500)
    between("resolution", resolution, 4, 256)
    mesh = without_cavities(load_closed(mesh, "clump mesh"))
    lower, upper = mesh.bounds
    step = (upper - lower).max() / resolution
    axes = [np.arange(a + step / 2, b, step) for a, b in zip(lower, upper, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    depth = -signed_distance(mesh, points)
    inside = depth > 0
    if inside.sum() < 8:
        refuse("resolution", resolution, "is too coarse for this mesh", "increase 'resolution'")
    points, depth = points[inside], depth[inside]
    # Spheres centred near the surface are small, so the 4,000 deepest points are enough as candidates for centres.
    candidates = np.argsort(-depth)[:4000]
    # The points are sorted by x, so all points that a candidate sphere can cover are in one slice of the array.
    reach = depth[candidates] + 0.25 * step
    first = np.searchsorted(points[:, 0], points[candidates, 0] - reach - step)
    last = np.searchsorted(points[:, 0], points[candidates, 0] + reach + step)
    slices = [slice(*ends) for ends in zip(first.tolist(), last.tolist(), strict=True)]
    coverage = [
        np.linalg.norm(points[near] - points[c], axis=1) <= r
        for near, c, r in zip(slices, candidates, reach, strict=True)
    ]
    uncovered = np.ones(len(points), dtype=bool)
    chosen: list[int] = []
    # The number of uncovered points that a candidate sphere would cover can only fall when spheres are added, so a
    # number counted earlier is an upper bound. If the candidate with the highest bound still has this number, it is the
    # best one. Among candidates with equal numbers, take the deepest one.
    bounds = [(-int(np.count_nonzero(cover)), number) for number, cover in enumerate(coverage)]
    heapq.heapify(bounds)
    while len(chosen) < spheres:
        bound, best = bounds[0]
        count = int(np.count_nonzero(coverage[best] & uncovered[slices[best]]))
        if count < -bound:
            heapq.heapreplace(bounds, (-count, best))
            continue
        if count == 0:
            break
        chosen.append(int(candidates[best]))
        uncovered[slices[best]] &= ~coverage[best]
    if len(chosen) < spheres:
        refuse("spheres", spheres, f"must be at most {len(chosen)} for this mesh at resolution {resolution}")
    centres, radii = points[chosen], depth[chosen]
    # Find by bisection the length that must be added to all radii to give the union the volume of the mesh.
    low, high = 0.0, float(mesh.volume) ** (1 / 3)
    for _ in range(30):
        middle = 0.5 * (low + high)
        volume, *_ = union_properties(centres, radii + middle, resolution=128)
        low, high = (middle, high) if volume < mesh.volume else (low, middle)
    return clump(name, centres, radii + 0.5 * (low + high))
