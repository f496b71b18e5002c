"""Distance of points to a mesh, and its nearest triangle."""

import warp as wp


@wp.kernel(enable_backward=False)
def signed_distances(
    mesh: wp.uint64, points: wp.array(dtype=wp.vec3), reach: wp.float32, distance: wp.array(dtype=wp.float32)
):
    """Signed distance (negative inside, by winding number), or `reach` where nothing is that near."""
    i = wp.tid()
    query = wp.mesh_query_point_sign_winding_number(mesh, points[i], reach)
    distance[i] = reach
    if query.result:
        nearest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        distance[i] = query.sign * wp.length(points[i] - nearest)


@wp.kernel(enable_backward=False)
def distances(
    mesh: wp.uint64, points: wp.array(dtype=wp.vec3), reach: wp.float32, distance: wp.array(dtype=wp.float32)
):
    """Compute the distance of each point to the surface, or `reach` where nothing is that near."""
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points[i], reach)
    distance[i] = reach
    if query.result:
        distance[i] = wp.length(points[i] - wp.mesh_eval_position(mesh, query.face, query.u, query.v))


@wp.kernel(enable_backward=False)
def ray_distances(
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    reach: wp.float32,
    distance: wp.array(dtype=wp.float32),
):
    """Distance along each unit direction to the surface, or -1 where the ray meets none within `reach`."""
    i = wp.tid()
    query = wp.mesh_query_ray(mesh, origins[i], directions[i], reach)
    distance[i] = -1.0
    if query.result:
        distance[i] = query.t


@wp.kernel(enable_backward=False)
def nearest_faces(mesh: wp.uint64, points: wp.array(dtype=wp.vec3), reach: wp.float32, face: wp.array(dtype=wp.int32)):
    """Triangle nearest to each point, or -1 where none is within `reach`."""
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points[i], reach)
    face[i] = -1
    if query.result:
        face[i] = query.face
