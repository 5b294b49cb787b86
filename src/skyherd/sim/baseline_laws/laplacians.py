"""Linear laws with Laplacians, whose only equilibria are the shape in any place, rotation and size.

Weights are complex numbers. A real 2 x 2 weight `a I + b J` of the papers on matrix-weighted Laplacians, with
the quarter turn J, is the complex number `a + b i`.
"""

import numpy as np

from skyherd.geometry import ComplexArray, IntArray
from skyherd.sim.baseline_laws.graphs import Law, both_ways, neighbors, triangles


def complex_laplacian_law(shape: ComplexArray, gain_ps: float) -> Law:
    """Return the law `dz/dt = -k L z / λ_max(L)`, with a complex Laplacian L: L 1 = 0 and L shape = 0.

    From Lin, Wang, Han and Fu (Lin 2014). Each robot needs the relative positions of its neighbours in its
    own frame, in a common unit of length. Place, rotation and size of the shape are free; the roles are
    fixed.

    Args:
        shape: (N,) points of the desired shape.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points are collinear.
    """
    matrix = complex_laplacian(shape)
    matrix *= gain_ps / np.linalg.eigvalsh(matrix)[-1]
    return lambda positions: -(matrix @ positions)


def complex_maneuver_law(shape: ComplexArray, velocities: ComplexArray) -> Law:
    """Return the law `dz/dt = M z` that moves a shape, added to that of its complex Laplacian.

    From García de Marina (Marina 2021). The weights satisfy `M 1 = 0` and `M shape = velocities`. A robot
    needs its neighbours' relative positions, as before. Velocities of a translation, rotation and growth keep
    the shape. The paper leaves the weights open. Here each robot has those of the smallest norm on its
    neighbours.

    Args:
        shape: (N,) points of the desired shape.
        velocities: (N,) their desired velocities in the frame of the shape, units of the shape per second.

    Raises:
        InputError: the points are collinear.
    """
    robots, others = both_ways(neighbors(shape)).T
    arms = shape[others] - shape[robots]
    norms = np.bincount(robots, np.abs(arms) ** 2)
    matrix = np.zeros((shape.size, shape.size), dtype=np.complex128)
    matrix[robots, others] = arms.conj() * (velocities / norms)[robots]
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return lambda positions: matrix @ positions


def complex_laplacian(shape: ComplexArray) -> ComplexArray:
    """Return the Laplacian L (N, N) of a shape (N,): Hermitian, positive semidefinite, of rank N - 2.

    The paper leaves the weights open. Here L is the sum of `w wᴴ` over the triangles of the shape, where
    `wᴴ z` is zero for triangles similar to it. L is therefore stable without the diagonal matrix that other
    weights need.

    Raises:
        InputError: the points are collinear.
    """
    corners = triangles(shape)
    ahead, behind = np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)
    weights = shape[behind] - shape[ahead]
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    rows = np.zeros((len(corners), shape.size), dtype=np.complex128)
    np.put_along_axis(rows, corners, weights, axis=1)
    return np.asarray(rows.conj().T @ rows)


def matrix_weighted_law(shape: ComplexArray, gain_ps: float) -> Law:
    """Return the law `dz_i/dt = -k Σ_j A_ij (z_i - z_j)` on an acyclic graph with two static leaders.

    From Fan, Xu, Fu, Sun, Zhang and Zhang (Fan 2025). A follower has two predecessors, and weights with
    `A_ij (s_i - s_j) + A_ik (s_i - s_k) = 0` at the shape s. The paper leaves their common factor open. Here
    `A_ij + A_ik = I`. The matrix is then triangular with k on its diagonal, and every mode has the rate k.
    Each follower needs the relative positions of its predecessors in its own frame. The leaders' start
    determines place, rotation and size of the shape.

    Args:
        shape: (N,) points of the desired shape.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points are collinear.
    """
    links = follower_links(shape).reshape(-1, 2, 2)
    follower, one, other = links[:, 0, 0], links[:, 0, 1], links[:, 1, 1]
    share = (shape[follower] - shape[one]) / (shape[other] - shape[one])
    matrix = np.zeros((shape.size, shape.size), dtype=np.complex128)
    matrix[follower, follower] = gain_ps
    matrix[follower, one] = -gain_ps * (1 - share)
    matrix[follower, other] = -gain_ps * share
    return lambda positions: -(matrix @ positions)


def follower_links(shape: ComplexArray) -> IntArray:
    """Return links (2 (N - 2), 2) from each follower to its two predecessors, both rows together.

    The leaders form a side of a Delaunay triangle. The third corner of a triangle follows once the other two
    are placed. The chosen side minimizes the maximum number of followers in a chain, because errors
    accumulate along it. The paper leaves this choice open.

    Raises:
        InputError: the points are collinear.
    """
    corners = triangles(shape).tolist()
    found = [_links_from(leaders, corners) for leaders in neighbors(shape).tolist()]
    return np.array(min(found, key=lambda item: item[0])[1], dtype=np.int64)


def _links_from(leaders: list[int], corners: list[list[int]]) -> tuple[int, list[tuple[int, int]]]:
    """Return the length of the longest chain of followers, and all links, for two leaders."""
    depth, links = dict.fromkeys(leaders, 0), list[tuple[int, int]]()
    while True:
        ready = [
            (max(depth[robot] for robot in before), robots[0], before)
            for triangle in corners
            if len(robots := [robot for robot in triangle if robot not in depth]) == 1
            for before in [[robot for robot in triangle if robot in depth]]
        ]
        if not ready:
            return max(depth.values()), links
        deepest, follower, before = min(ready)
        depth[follower] = deepest + 1
        links += [(follower, robot) for robot in before]
