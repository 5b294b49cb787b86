"""Laws whose only equilibria are the shape in any place, rotation and size: linear, by Laplacians.

Both have complex numbers for weights. A real 2 x 2 weight `a I + b J` of the papers on matrix-weighted
Laplacians, J a quarter turn, is the complex number `a + b i`.
"""

import numpy as np

from skyherd.geometry import ComplexArray, IntArray
from skyherd.sim.baseline_laws.graphs import Law, neighbors, triangles


def complex_laplacian_law(shape: ComplexArray, gain_ps: float) -> Law:
    """The law `dz/dt = -k L z / λ_max(L)`, with a complex Laplacian L: L 1 = 0 and L shape = 0.

    From Lin, Wang, Han and Fu (Lin 2014). Each robot needs the positions of its neighbours relative to its
    own, in its own frame, in a unit of length that all have in common. Place, rotation and size of the shape
    are free; each robot's point in it is fixed.

    Args:
        shape: (N,) points that the robots are to form.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points lie in a line.
    """
    matrix = complex_laplacian(shape)
    matrix *= gain_ps / np.linalg.eigvalsh(matrix)[-1]
    return lambda positions: -(matrix @ positions)


def complex_laplacian(shape: ComplexArray) -> ComplexArray:
    """The Laplacian L (N, N) of a shape (N,): Hermitian, positive semidefinite, of rank N - 2.

    The paper leaves the weights open. Here L is the sum over the triangles of the shape of `w wᴴ`, where
    `wᴴ z` is zero for the triangles similar to it. This makes L stable without the diagonal matrix that other
    weights need.

    Raises:
        InputError: the points lie in a line.
    """
    corners = triangles(shape)
    ahead, behind = np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)
    weights = shape[behind] - shape[ahead]
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    rows = np.zeros((len(corners), shape.size), dtype=np.complex128)
    np.put_along_axis(rows, corners, weights, axis=1)
    return np.asarray(rows.conj().T @ rows)


def matrix_weighted_law(shape: ComplexArray, gain_ps: float) -> Law:
    """The law `dz_i/dt = -k Σ_j A_ij (z_i - z_j)` on a graph without cycles; two leaders stand still.

    From Fan, Xu, Fu, Sun, Zhang and Zhang (Fan 2025). A follower has two robots before it, and weights with
    `A_ij (s_i - s_j) + A_ik (s_i - s_k) = 0` at the shape s. The paper leaves their common factor open; here
    `A_ij + A_ik = I`, so that the matrix is triangular with k on its diagonal: every mode has the rate k.
    Each follower needs the positions of those two relative to its own, in its own frame. Place, rotation and
    size of the shape are those that the leaders have at the start.

    Args:
        shape: (N,) points that the robots are to form.
        gain_ps: rate k, 1/s.

    Raises:
        InputError: the points lie in a line.
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
    """Links (2 (N - 2), 2) from each follower to its two robots before it, a follower's rows together.

    A side of a Delaunay triangle is the leaders'; the third corner of a triangle follows once the other two
    are placed. Of all sides that which leaves the last robot the fewest followers behind its leaders is
    taken: the paper leaves the choice open, and errors add up along the way.

    Raises:
        InputError: the points lie in a line.
    """
    corners = triangles(shape).tolist()
    found = [_links_from(leaders, corners) for leaders in neighbors(shape).tolist()]
    return np.array(min(found, key=lambda item: item[0])[1], dtype=np.int64)


def _links_from(leaders: list[int], corners: list[list[int]]) -> tuple[int, list[tuple[int, int]]]:
    """How many followers the last robot has before it, itself counted, and all links, from two leaders."""
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
