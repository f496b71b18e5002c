"""Cross-sections of a bore that is given as a mesh: a search that follows the bore from its start to its end."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core.errors import refuse
from .mesh_axis import directions
from .meshes import FARTHEST_WALL, SurfaceQueries, fan

AROUND = 36
"""Number of directions around the axis in which the distance to a bore's wall is measured at each cross-section."""
ADVANCE = 0.25
"""Distance between neighbouring cross-sections of a bore, divided by the bore's radius."""
MIN_END_STEP = 1 / 256
"""Accuracy with which the search finds the last closed cross-section of a bore, divided by the bore's radius.

The search halves its step as it approaches the end, and stops when the step is at most a quarter of the accuracy.
"""
MIN_ADVANCE = ADVANCE / 16
"""Smallest distance between neighbouring cross-sections in the search along a bore, divided by the bore's radius. A
bore that cannot be followed by this distance has ended."""
MAX_ROTATIONS, ROTATION_FRACTION = 6, 0.4
"""Constants of the search for the direction of a new cross-section, which must be perpendicular to the bore.

The search turns the cross-section several times. MAX_ROTATIONS is the number of turns, and ROTATION_FRACTION is the
fraction of the remaining angle that each turn covers.
"""
MAX_TURN_PER_STEP = 0.6
"""Largest accepted angle between the directions of neighbouring cross-sections of a bore [rad]."""
END_CHECK_DISTANCES = (0.1, 0.3)
"""Two distances beyond an end of a bore, divided by the bore's radius. At both places, at least half of the rays
perpendicular to the axis must meet no wall, so that the bore really ends."""
MAX_SECTIONS = 4000
"""Largest accepted number of cross-sections of a bore."""
TURNING_ROUNDS = 3
"""Number of times that all cross-sections are turned perpendicular to the curve through their centres."""
NEAREST = 1e-3
"""Distance from the start of a bore at which its first cross-section is measured, divided by the longest edge of the
box around the mesh."""
ASIDE = 0.02
"""Largest accepted distance, perpendicular to the bore, between the bore's stated start and the centre of its first
cross-section, divided by the bore's radius."""
RADIUS_TOLERANCE = 0.02
"""Largest accepted change of a cross-section's radius, as a fraction of the radius, when the cross-section is shifted
or turned. A larger change means that its rays meet something other than the bore's wall, for example a lid."""
OPENING_RATIO = 3.0
"""Largest accepted ratio of the radius of a cross-section to the radius of the previous cross-section. At a larger
ratio, the bore counts as open to the side."""


@dataclass(frozen=True)
class Sections:
    """Cross-sections of a bore, in order from its start to its end."""

    ahead: np.ndarray
    """Unit vector along the bore at its start, shape (3,)."""
    points: np.ndarray
    """Centres of the bore's cross-sections [m], shape (n, 3)."""
    radii: np.ndarray
    """Radii of circles that have the same areas as the cross-sections [m], shape (n,)."""


def follow(
    vertices: np.ndarray, faces: np.ndarray, start: np.ndarray, ways: Sequence[np.ndarray], field: str, name: str
) -> Sections:
    """Follow a bore from a point on its axis to its end, section by section.

    Each cross-section is perpendicular to the local direction of the bore. Rays from the centre of the cross-section
    measure it, so outer skins, rims and lids have no influence. The bore ends where a cross-section is open, because
    at least one ray meets no wall; a cross-section behind a lid is open too.

    Args:
        vertices: Corners of the mesh [m], shape (v, 3).
        faces: Corner indices of each triangle, shape (f, 3).
        start: Point on the axis where the bore begins [m], shape (3,).
        ways: Unit directions in which the axis may start, shape (3,) each; the first that leads into the bore is used.
        field: Name of the field that error messages show.
        name: Value of that field in error messages.

    Raises:
        SceneError: No cross-section is closed at the start, the bore opens to the side, or the bore has no end.
    """
    queries = SurfaceQueries(vertices, faces)
    ahead, radius = _first_direction(queries, start, ways, float(np.ptp(vertices, axis=0).max()), field, name)
    points, radii = _follow_bore(queries, start, ahead, radius, field, name)
    _square(queries, points, radii, ahead)
    # The last cross-section found in the search may be tilted by as much as the bore turns within one step. Now that
    # its direction is corrected, a closed cross-section may exist nearer to the end.
    points, radii = _extended_to_end(queries, points, radii, directions(points, ahead))
    _square(queries, points, radii, ahead)
    last = directions(points, ahead)[-1]
    problem = f"can be followed for {_length(list(points)):.4g} m only"
    _check_open(queries, points[-1], last, radii[-1], field, name, problem,
                "check the mesh there for a hole, a sharp edge, a branch, a plate or a chamber")  # fmt: skip
    return Sections(ahead, points, radii)


def _square(queries: SurfaceQueries, points: np.ndarray, radii: np.ndarray, ahead: np.ndarray) -> None:
    """Turn the cross-sections of a bore until they are perpendicular to the curve through their centres.

    The function changes the centres `points` and the `radii` in place. The curve starts in the direction `ahead`.
    """
    for _ in range(TURNING_ROUNDS):
        tangents = directions(points, ahead)
        for k in range(1, len(points)):
            section = _section(queries, points[k], tangents[k], radii[k])
            if section is not None and abs(section[1] / radii[k] - 1) <= RADIUS_TOLERANCE:
                points[k], radii[k] = section


def _extended_to_end(
    queries: SurfaceQueries, points: np.ndarray, radii: np.ndarray, tangents: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Move the last cross-section to the bore's end, or add one there; return the centres and radii [m] of all.

    The end is the farthest position where the cross-section is closed and has the same radius as the last one.
    `tangents` are the directions of the bore at its cross-sections.
    """
    bend = (tangents[-1] - tangents[-2]) / np.linalg.norm(points[-1] - points[-2])
    step, far, last_section = 0.5 * ADVANCE * radii[-1], 0.0, None
    while step > MIN_END_STEP / 4 * radii[-1]:
        way = tangents[-1] + (far + step) * bend
        way = way / np.linalg.norm(way)
        further = _section(queries, points[-1] + 0.5 * (far + step) * (tangents[-1] + way), way, radii[-1])
        # Near a lid, some rays of a slightly tilted cross-section end on the lid instead of the wall, and the measured
        # radius changes. A cross-section with a changed radius is therefore rejected.
        if further is None or abs(further[1] / radii[-1] - 1) > RADIUS_TOLERANCE:
            step *= 0.5
        else:
            last_section, far = further, far + step
    if last_section is None:
        return points, radii
    if far < 0.5 * ADVANCE * radii[-1]:
        points[-1], radii[-1] = last_section
        return points, radii
    return np.concatenate([points, last_section[0][None]]), np.append(radii, last_section[1])


def _first_direction(
    queries: SurfaceQueries, start: np.ndarray, ways: Sequence[np.ndarray], extent: float, field: str, name: str
) -> tuple[np.ndarray, float]:
    """Return the first of the directions `ways` in which a bore leads away from `start`, and the bore's radius [m].

    `extent` is the longest edge of the box around the mesh [m]. Error messages show `field` and its value `name`.
    """
    beside = None
    for way in ways:
        first = _section(queries, start + NEAREST * extent * way, way, extent)
        if first is None or _section(queries, start + ADVANCE * first[1] * way, way, first[1]) is None:
            continue
        middle = first[0] - start
        beside = float(np.linalg.norm(middle - (middle @ way) * way))
        if beside <= ASIDE * first[1]:
            _check_open(queries, start, -way, first[1], field, name, "extends behind its origin, where it should begin",
                        "move the mesh so that the middle of one end lies at its origin")  # fmt: skip
            return way, first[1]
    if beside is not None:
        refuse(field, name, f"does not begin at its origin: the middle of its first cross-section lies {beside:.4g} m "
                            "beside the origin",
               "move the mesh so that the middle of one end lies at its origin")  # fmt: skip
    leads = " or ".join("+-"[int(way.sum() < 0)] + "xyz"[int(np.argmax(np.abs(way)))] for way in ways)
    wanted = "one of these directions" if len(ways) > 1 else "this direction"
    refuse(field, name, f"has no closed cross-section at its origin in the direction {leads}",
           f"move the mesh so that it begins at its origin and leads in {wanted}, close its holes, or check its "
           "unit")  # fmt: skip


def _follow_bore(
    queries: SurfaceQueries, start: np.ndarray, ahead: np.ndarray, radius: float, field: str, name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and radii [m] of cross-sections from `start` on, as far as the bore can be followed.

    At `start`, the bore has the direction `ahead` and the `radius` [m]. Error messages show `field` and its value
    `name`.
    """
    points, radii = [start], [radius]
    tangent, step = ahead, ADVANCE
    while len(points) <= MAX_SECTIONS:
        section = _next_section(queries, points, tangent, step * radii[-1], radii[-1])
        if section is None:
            step *= 0.5
            if step < MIN_ADVANCE:
                break
            continue
        middle, wide, tangent = section
        if wide > OPENING_RATIO * radii[-1]:
            problem = f"opens to the side {_length(points):.3g} m from its start"
            refuse(field, name, problem, "close the opening in the side, because a bore has one inlet and one outlet")
        points.append(middle)
        radii.append(wide)
        step = min(2 * step, ADVANCE)
    else:
        problem = f"is too long: its length exceeds its radius by a factor of more than {MAX_SECTIONS // 4}"
        refuse(field, name, problem, "split the mesh into several files")
    # Drop the last cross-section, because its rays may end on a lid. Also drop every cross-section whose centre is
    # close to the previous centre, because the direction between two close centres is inaccurate.
    kept = [0]
    for k in range(1, len(points) - 1):
        if np.linalg.norm(points[k] - points[kept[-1]]) > 0.5 * ADVANCE * radii[k]:
            kept.append(k)
    if len(kept) < 3:
        problem = "is too short for its axis to be found"
        refuse(field, name, problem, "check the unit of the mesh, and that it begins at its origin")
    return np.array(points)[kept], np.array(radii)[kept]


def _next_section(
    queries: SurfaceQueries, points: list[np.ndarray], tangent: np.ndarray, step: float, radius: float
) -> tuple[np.ndarray, float, np.ndarray] | None:
    """Return the centre [m], radius [m] and direction of the next cross-section of a bore, or None if there is none.

    The cross-section lies about one `step` [m] beyond the last of `points`. The function turns it several times and
    measures its centre again each time, so that it becomes perpendicular to the parabola through its own centre and two
    earlier centres. In a conical bore, the centre of a tilted cross-section is displaced from the axis by up to the
    radius times the slope of the wall. The turns therefore converge only if each of them covers a fraction of the
    remaining angle.
    """
    way, section = tangent, None
    place = points[-1] + step * tangent
    for _ in range(MAX_ROTATIONS):
        section = _section(queries, place, way, radius)
        if section is None or not 0.5 * step < (section[0] - points[-1]) @ tangent < 1.5 * step:
            return None
        way = way + ROTATION_FRACTION * (_slope(points, section[0], 0.9 * ADVANCE * radius, tangent) - way)
        way = way / np.linalg.norm(way)
        place = section[0]
    if section is None or way @ tangent < np.cos(MAX_TURN_PER_STEP):
        return None
    return section[0], section[1], way


def _slope(points: list[np.ndarray], last: np.ndarray, apart: float, tangent: np.ndarray) -> np.ndarray:
    """Return the unit direction at point `last`, from the parabola through it and two earlier points.

    The points of the parabola are at least `apart` [m] from each other. With only one earlier point, the result is the
    direction from that point to `last`. Without earlier points, the result is `tangent`.
    """
    chosen = [last]
    for point in reversed(points):
        if np.linalg.norm(point - chosen[-1]) >= apart:
            chosen.append(point)
            if len(chosen) == 3:
                break
    if len(chosen) == 1:
        return tangent
    ahead = chosen[0] - chosen[1]
    length = float(np.linalg.norm(ahead))
    slope = ahead / length
    if len(chosen) == 3:
        before = chosen[1] - chosen[2]
        behind = float(np.linalg.norm(before))
        # The slope of a parabola at its end is the slope of the last chord plus a share of the change of slope from the
        # previous chord. The share is the length of the last chord divided by the length of both chords.
        slope = slope + (slope - before / behind) * length / (length + behind)
    return slope / np.linalg.norm(slope)


def _length(points: list[np.ndarray]) -> float:
    return float(np.linalg.norm(np.diff(np.array(points), axis=0), axis=1).sum()) if len(points) > 1 else 0.0


def _check_open(
    queries: SurfaceQueries, end: np.ndarray, outward: np.ndarray, radius: float, field: str, name: str, *words: str
) -> None:
    """Refuse a bore that continues beyond one of its ends; `words` are the problem and the hint of the message.

    The bore ends at the point `end` if, beyond it in the direction `outward`, at most half of the rays perpendicular to
    the axis meet a wall.
    """
    normal, side = _across(outward)
    places = end + radius * np.array(END_CHECK_DISTANCES)[:, None] * outward
    missed = queries.around(places, normal[[0, 0]], side[[0, 0]], AROUND, FARTHEST_WALL * radius) < 0
    if np.any(missed.mean(axis=1) < 0.5):
        refuse(field, name, *words)


def _across(tangent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors that are perpendicular to `tangent` and to each other, shape (1, 3) each."""
    normal = np.cross(tangent, np.eye(3)[np.argmin(np.abs(tangent))])
    normal = normal / np.linalg.norm(normal)
    return normal[None], np.cross(tangent, normal)[None]


def _section(
    queries: SurfaceQueries, point: np.ndarray, tangent: np.ndarray, radius: float
) -> tuple[np.ndarray, float] | None:
    """Return centre and radius [m] of the cross-section perpendicular to `tangent` at a point.

    `radius` is the expected radius [m]. The result is None if the cross-section is open, because at least one ray from
    the point meets no wall.
    """
    normal, side = _across(tangent)
    ways = fan(normal, side, AROUND)[0]
    area = np.zeros(AROUND)
    for _ in range(4):
        reach = queries.around(point[None], normal, side, AROUND, FARTHEST_WALL * radius)[0]
        if np.any(reach < 0):
            return None
        # Divide the cross-section into triangles between the point and two neighbouring places on the wall.
        corners = point + reach[:, None] * ways
        following = np.roll(corners, -1, axis=0)
        area = 0.5 * np.linalg.norm(np.cross(corners - point, following - point), axis=1)
        if not area.sum() > 0:
            # An area of zero means that every ray meets a surface at the point itself, so there is no cross-section.
            return None
        middle = (area[:, None] * (corners + following + point) / 3).sum(axis=0) / area.sum()
        moved = np.linalg.norm(middle - point)
        point = middle
        if moved < 1e-3 * radius:
            break
    return point, float(np.sqrt(area.sum() * (2 * np.pi / AROUND) / np.sin(2 * np.pi / AROUND) / np.pi))
