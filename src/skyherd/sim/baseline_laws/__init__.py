"""Formation control laws from the literature, for comparison; they receive true positions.

Robots are single integrators with complex positions z (N,), m, on the ground. A law is a function from
positions to velocities. Its parameters are the shape (N,) and a rate k, 1/s. Gains are normalised: at the
shape, the fastest mode decays at the rate k, as with one unit's goals
(`skyherd.control.topology.convergence_rate`). For equal k, all laws therefore have the same distance from
instability in discrete time.

Each family has one file: `laplacians.py` (complex and matrix-weighted Laplacians), `affine.py` (affine
formations), `bearings.py` (with and without ranges), `distances.py` (rigid frameworks),
`angles_and_ratios.py` (angles, or ratios of distances), `mean_shift.py` (robots without roles). `graphs.py`
contains the choice of neighbours, which the papers leave open, and `registry.py` the laws by name.
"""

from skyherd.sim.baseline_laws.graphs import Law
from skyherd.sim.baseline_laws.registry import LAWS, BaselineLaw, find_law

__all__ = ["LAWS", "BaselineLaw", "Law", "find_law"]
