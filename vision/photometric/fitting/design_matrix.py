"""The linear model of a marker's pixels around a pose: its design matrix, drawn at the image's own pixels.

The columns are computed in `vision/native/columns.h`, `round_blur.c` and `elliptic_blur.c`. This page has the
formulas and the constants.

With T what a blurred marker looks like (`vision/native/columns.h`) at marker coordinates
z = z(p) = x + iy, the grey level of pixel p is

    I(p) ≈ a + b T + b (T_z · δz + T_log σ δ log σ) + g (1 - A) + (l_x x + l_y y) (r + T) + c T (1 - T),

with these unknowns, 15 in all, of which eight make up a homography:

- black level a and contrast b (white minus black), whose ratio is r = a / b;
- a step of the pose, δz = d + (s + iθ) z + e z̄ - z Re(q̄ z): shift d, scale s, rotation θ, anisotropy e,
  keystone q;
- a change δ log σ of the blur's logarithm;
- ground level g, less that of white, beyond the card, which covers the share A of a pixel. Around a marker
  without a card the ground begins at the border, and slopes are those of T + (g / b) (1 - A)
  (`surroundings`);
- light l that changes over the marker;
- a bend c of the tone curve, by which a camera's gamma shifts edges towards black.

The marker and its derivatives are computed *at the image's own pixels* (`vision/native/fit.h`). The image
is never resampled, so that its noise stays white.

Blur that is round in the image is not round in the coordinates of a marker that is anisotropic. An anisotropy
z ↦ z + e z̄ leaves there a blur of variances σ² (1 ∓ 2 e_x) and covariance -2 σ² e_y, to first order, and so
changes T by `- e_x σ² (T_xx - T_yy) - 2 e_y σ² T_xy`. Towards the horizon the marker shrinks by `w^(-3/2)`
with `w = 1 + Re(h̄ m z)`, so that the blur grows in its coordinates, and the anisotropy changes by `- h m̄ z
/ 2`. Blur that differs more along its directions, at a steep tilt or by a streak, is drawn as what it is
(`vision/native/elliptic_blur.c`):
blur of the image's covariance S is `A⁻¹ S A⁻ᵀ` in the coordinates of a marker that the image shows by the
affine map A. With complex numbers, A z = m z + k z̄, and S of mean variance σ² and a part without trace,
Q = (S_uu - S_vv) / 2 + i S_uv, the blur of z has

    E z² = (2 m̄² Q + 2 k² Q̄ - 4 m̄ k σ²) / D²,   E |z|² = (2 (|m|² + |k|²) σ² - 4 Re(m̄ k̄ Q)) / D²,

with D = |m|² - |k|². An image taken while the camera moves straight by L px in the direction φ has
`Q = L² / 24 e^{2iφ}`. A change dS of the blur in marker coordinates changes T by
`(dS_xx T_xx + dS_yy T_yy) / 2 + dS_xy T_xy`.

Ground seen through the blur near the card's edge has a texture, which the model does not describe. Pixels are
therefore weighted by `1 / sqrt(1 + (t (1 - A))²)`, with t the texture's standard deviation over the noise:
texture is noise too, and without the weights the covariance would promise too much.
"""

BLACK, CONTRAST, RIGHT, DOWN, TURN, GROW, BLUR, GROUND = range(8)
"""Indices of the unknowns with one component, in the order of the model's columns."""

ANISOTROPY, LIGHT, KEYSTONE = [8, 9], [10, 11], [12, 13]
"""Indices of the unknowns with two components each."""

TONE = [14]
"""Index of the bend of the tone curve, in a list as those of two components are."""

POSE = [RIGHT, DOWN, TURN, GROW, *ANISOTROPY, *KEYSTONE]
"""Indices of the unknowns that make up a step of the pose."""

MAX_GROWTH = 0.5
"""Largest share by which a horizon may move a marker's border outwards. Chosen: at a half, the marker is seen
from nearer than its own side; what lies further out is not read."""

SIGMA_LIMITS = 1e-4, 1e4
"""Blurs are drawn as of these limits where they lie beyond, in marker sides. Chosen far outside of what a
marker can be read under: a thousandth of a cell, and ten thousand markers."""

STEEP_ANISOTROPY = 0.1
"""Anisotropy from which on a marker's blur is drawn as an ellipse and not as what an anisotropy changes of
round blur to first order. Derived: the second order is half of the square of twice the anisotropy, 2 % of the
blur's part of the image here; it is that of a tilt of 35 degrees."""

MIN_VARIANCE_PX2 = 0.25**2
"""Variance that is left of a blur across a streak, at least. Chosen: a little less than that of a square
pixel, 1/12."""
