"""Formation control laws from the literature, for comparison; each is given the true positions it needs.

Robots are single integrators here, at positions z (N,), complex, m, on the ground. A law is a function from
positions to wanted velocities, made of the shape (N,) and of a rate k, 1/s. Gains are normalised such that at
the shape the fastest mode decays at the rate k, as it does under one unit's goals
(`skyherd.control.topology.convergence_rate`): at one k all laws are equally far from instability in discrete
time.

One file a family: `laplacians.py` (complex and matrix-weighted Laplacians), `affine.py` (laws whose aim is an
affine image of the shape), `bearings.py` (with and without ranges), `distances.py` (rigid frameworks).
`graphs.py` has who is whose neighbour, which the papers leave open; `registry.py` the laws by name.
"""

from skyherd.sim.baseline_laws.graphs import Law
from skyherd.sim.baseline_laws.registry import LAWS, BaselineLaw, find_law

__all__ = ["LAWS", "BaselineLaw", "Law", "find_law"]
