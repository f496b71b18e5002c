"""Kernels that query a triangle mesh: distances of points, hits of rays, and nearest triangles."""

import warp as wp


@wp.kernel(enable_backward=False)
def signed_distances(
    mesh: wp.uint64, points: wp.array(dtype=wp.vec3), reach: wp.float32, distance: wp.array(dtype=wp.float32)
):
    """Compute each point's signed distance to the mesh [m], or `reach` where the surface is farther than that.

    Points inside the mesh, as judged by the winding number, have negative distances.
    """
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
    """Compute the distance of each point from the surface [m], or `reach` where the surface is farther than that."""
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
    """Compute the distance along each ray to the surface [m], or -1 where the ray hits nothing within `reach`.

    `directions` are the unit vectors of the rays.
    """
    i = wp.tid()
    query = wp.mesh_query_ray(mesh, origins[i], directions[i], reach)
    distance[i] = -1.0
    if query.result:
        distance[i] = query.t


@wp.kernel(enable_backward=False)
def nearest_faces(mesh: wp.uint64, points: wp.array(dtype=wp.vec3), reach: wp.float32, face: wp.array(dtype=wp.int32)):
    """Find the index of the triangle nearest to each point, or -1 where no triangle lies within `reach`."""
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points[i], reach)
    face[i] = -1
    if query.result:
        face[i] = query.face
