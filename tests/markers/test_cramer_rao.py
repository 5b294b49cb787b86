"""Cramér–Rao bound against published values, a brute-force Fisher matrix, and simulated estimation."""

import numpy as np
import pytest
from scipy.special import ndtr

from skyherd.errors import InputError
from skyherd.geometry import UNIFORM_VARIANCE
from skyherd.markers.blur_model import cell_edges, normal_cdf, total_sigma_px
from skyherd.markers.cramer_rao import pose_covariances, sides_px
from skyherd.markers.dictionary import card_side, marker_cells

DICTIONARY, ALL = "4X4_50", np.arange(50)

# Side (px) and noise -> RMS bound of u and v (px) and of heading (deg): black 30, white 230, blur 0.8 px.
TABLE = {
    (12, 2): (0.0034, 0.054), (16, 2): (0.0026, 0.029), (24, 2): (0.0020, 0.0142),
    (32, 2): (0.0017, 0.0087), (80, 2): (0.0010, 0.0020),
    (12, 10): (0.0167, 0.267), (16, 10): (0.0126, 0.143), (24, 10): (0.0097, 0.070),
    (32, 10): (0.0082, 0.043), (80, 10): (0.0050, 0.010),
}  # fmt: skip


def similarity(side_px, heading_rad=0.0, center_px=(0.0, 0.0)):
    """Return the map from marker coordinates (forward, left) to pixels: left is against the image's sense."""
    c, s = side_px * np.cos(heading_rad), side_px * np.sin(heading_rad)
    return np.array([[c, s, center_px[0]], [s, -c, center_px[1]], [0.0, 0.0, 1.0]])


def tilted(markers, tilt_rad=0.26, focal_px=400.0, middle_px=100.0):
    """Return the view of a camera rotated about its u axis, `K R K⁻¹`, cropped to keep the centre."""
    c, s = np.cos(tilt_rad), np.sin(tilt_rad)
    intrinsic = np.array([[focal_px, 0.0, middle_px], [0.0, focal_px, middle_px], [0.0, 0.0, 1.0]])
    turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    seen = intrinsic @ turn @ np.linalg.inv(intrinsic)
    at = seen @ [middle_px, middle_px, 1.0]
    cut = np.array([[1.0, 0.0, middle_px - at[0] / at[2]], [0.0, 1.0, middle_px - at[1] / at[2]], [0, 0, 1]])
    return cut @ seen @ np.asarray(markers)


def rms(covariances):
    position = np.sqrt(np.trace(covariances[:, :2, :2], axis1=1, axis2=2).mean() / 2)
    return position, np.degrees(np.sqrt(covariances[:, 2, 2].mean()))


@pytest.mark.smoke
@pytest.mark.parametrize(("side_px", "noise"), TABLE)
def test_bound_matches_published_values(side_px, noise):
    """To 4 % and the table's last digit; the unstated card edge is worth 5 % at 16 px."""
    markers = np.repeat(similarity(side_px)[None], 50, axis=0)
    position, heading = rms(
        pose_covariances(DICTIONARY, ALL, markers, psf_px=0.8, noise=np.hypot(noise, ROUNDING**0.5))
    )
    want_position, want_heading = TABLE[side_px, noise]
    last_digit = 0.0005 if want_heading > 0.02 else 0.00005
    assert abs(position - want_position) < 0.04 * want_position + 0.00005
    assert abs(heading - want_heading) < 0.04 * want_heading + last_digit


def test_bound_scales_with_noise_contrast_and_rotation():
    """cov ∝ n², cov ∝ contrast⁻²; rotating the image rotates the covariance."""
    markers = np.repeat(similarity(20.0)[None], 50, axis=0)
    plain = pose_covariances(DICTIONARY, ALL, markers, psf_px=0.8, noise=2.0)
    noisy = pose_covariances(DICTIONARY, ALL, markers, psf_px=0.8, noise=6.0)
    faint = pose_covariances(
        DICTIONARY, ALL, markers, psf_px=0.8, noise=2.0, black=79.0, white=179.0, ground=128.0
    )
    bold = pose_covariances(
        DICTIONARY, ALL, markers, psf_px=0.8, noise=2.0, black=30.0, white=230.0, ground=128.0
    )
    np.testing.assert_allclose(noisy, 9 * plain, rtol=1e-9)
    np.testing.assert_allclose(faint, 4 * bold, rtol=1e-9)
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    turned = pose_covariances(DICTIONARY, ALL, turn @ markers, psf_px=0.8, noise=2.0)
    np.testing.assert_allclose(turned, turn @ plain @ turn.T, rtol=1e-6, atol=1e-9 * plain.max())


# The published figures are of 8-bit images: rounding adds its variance to the noise.
ROUNDING = 1.0 / 12.0


def scanned_card(dictionary, marker_id, image_marker, pixels, sigma_px, black, white, ground):
    """Return grey levels (P,) at pixels (P, 2): exact along u on scan lines, summed along v.

    On a scan line the card is piecewise constant between the cells' edges, for any homography. The integral
    of a Gaussian over a constant piece is a difference of normal distribution functions.
    """
    cells = np.where(marker_cells(dictionary, marker_id), white, black)
    levels = np.pad(np.pad(cells, 1, constant_values=white), 1, constant_values=ground)
    edges = cell_edges(cells.shape[0], 1.0)
    marker_image = np.linalg.inv(image_marker)
    step = 0.1
    rows = np.arange(pixels[:, 1].min() - 5 * sigma_px, pixels[:, 1].max() + 5 * sigma_px, step)
    # Forward or left = e  <=>  (row of the inverse - e last row) . (u, v, 1) = 0, solved for u.
    lines = np.concatenate([marker_image[axis] - edges[:, None] * marker_image[2] for axis in (0, 1)])
    crossings = np.sort(-(lines[:, 1:2] * rows + lines[:, 2:]) / lines[:, :1], axis=0).T
    ends = np.pad(crossings, ((0, 0), (1, 1)), constant_values=((0, 0), (-1e6, 1e6)))
    middles = np.clip((ends[:, 1:] + ends[:, :-1]) / 2, -1e4, 1e4)
    points = np.stack([middles, np.broadcast_to(rows[:, None], middles.shape), np.ones_like(middles)])
    forward, left, depth = np.einsum("ij,j...->i...", marker_image, points)
    row, column = (np.searchsorted(edges, -value / depth) for value in (forward, left))
    value = levels[row, column]
    columns, column_of = np.unique(pixels[:, 0], return_inverse=True)
    lines_v, line_of = np.unique(pixels[:, 1], return_inverse=True)
    below = ndtr((ends[:, None, :] - columns[None, :, None]) / sigma_px)
    along = np.einsum("rcp,rp->rc", np.diff(below, axis=2), value)
    away = rows[None, :] - lines_v[:, None]
    weight = np.exp(-((away / sigma_px) ** 2) / 2) * (np.abs(away) < 5 * sigma_px)
    return (weight @ along / weight.sum(axis=1, keepdims=True))[line_of, column_of]


def pose(image_marker):
    center = image_marker[:2, 2] / image_marker[2, 2]
    forward = image_marker[:2, 0] - center * image_marker[2, 0]
    return np.array([*center, np.arctan2(forward[1], forward[0])])


def brute_force_covariances(ids, markers, psf_px, noise, slanted):
    """Invert the joint Fisher matrix of all unknowns, by central differences of scanned images.

    Unknowns of a marker: shift, turn, log scale on its plane, gain, offset, log blur, ground level; then
    entries of one homography of the image: two affine, two projective.
    """
    sigma = total_sigma_px(psf_px)
    half = card_side(DICTIONARY) / 2
    total = 8 * len(ids) + 4 * slanted
    fisher, derivatives = np.zeros((total, total)), np.zeros((len(ids), 3, total))

    def changed(marker, k, by):
        """Return homography, sigma, gain, offset and ground with unknown k changed."""
        near, far = np.eye(3), np.eye(3)
        if k == 0:
            near[0, 2] = by
        elif k == 1:
            near[1, 2] = by
        elif k == 2:
            near[:2, :2] = [[np.cos(by), -np.sin(by)], [np.sin(by), np.cos(by)]]
        elif k == 3:
            near[:2, :2] *= np.exp(by)
        elif k == 8:
            far[:2, :2] += np.diag([by, -by])
        elif k == 9:
            far[0, 1] = far[1, 0] = by
        elif k >= 10:
            far[2, k - 10] = by / 100
        light = (np.exp(by) if k == 4 else 1.0, 50 * by if k == 5 else 0.0, 50 * by if k == 7 else 0.0)
        return far @ marker @ near, sigma * (np.exp(by) if k == 6 else 1.0), *light

    for index, (marker_id, marker) in enumerate(zip(ids, markers, strict=True)):
        box = np.stack(np.meshgrid(np.arange(200.0), np.arange(200.0)), axis=-1).reshape(-1, 2)
        back = np.column_stack([box, np.ones(len(box))]) @ np.linalg.inv(marker).T
        pixels = box[(np.abs(back[:, :2] / back[:, 2:]) <= half).all(axis=1)]

        def image(k, by, marker=marker, marker_id=marker_id, pixels=pixels):
            homography, blur, gain, offset, ground = changed(marker, k, by)
            grey = scanned_card(DICTIONARY, marker_id, homography, pixels, blur, 30.0, 230.0, 128.0 + ground)
            # Gain and offset apply to the card only; the ground has its own level.
            card = scanned_card(DICTIONARY, marker_id, homography, pixels, blur, 1.0, 1.0, 0.0)
            return grey + card * ((gain - 1) * 100 + offset) + (gain - 1) * (grey - 100 * card)

        own = list(range(8)) + ([8, 9, 10, 11] if slanted else [])
        where = np.array([8 * index + k if k < 8 else 8 * len(ids) + k - 8 for k in own])
        step = 3e-4
        columns = np.stack([(image(k, step) - image(k, -step)) / (2 * step) for k in own])
        fisher[np.ix_(where, where)] += columns @ columns.T / noise**2
        for k, at in zip(own, where, strict=True):
            poses = [pose(changed(marker, k, by)[0]) for by in (1e-5, -1e-5)]
            derivatives[index, :, at] = (poses[0] - poses[1]) / 2e-5
    scale = 1 / np.sqrt(np.diag(fisher))
    inverse = np.linalg.inv(fisher * np.outer(scale, scale)) * np.outer(scale, scale)
    return derivatives @ inverse @ derivatives.transpose(0, 2, 1)


LAYOUT = [
    (20.0, 0.3, (60.4, 61.2)),
    (20.0, 2.0, (140.7, 55.9)),
    (20.0, -1.2, (103.2, 140.5)),
]


@pytest.mark.parametrize("slanted", [False, True])
def test_bound_matches_brute_force_fisher_matrix(slanted):
    """Standard deviations to 3 %, the variation by pixels on the card's edge; on average to 1 %.

    Under tilt all three markers share the plane's four unknowns.
    """
    markers = np.array([similarity(*marker) for marker in LAYOUT])
    markers = tilted(markers) if slanted else markers
    ids = np.array([3, 11, 24])
    want = brute_force_covariances(ids, markers, 0.8, 5.0, slanted)
    have = pose_covariances(DICTIONARY, ids, markers, psf_px=0.8, noise=5.0)
    ratio = np.sqrt(np.einsum("nii->ni", have) / np.einsum("nii->ni", want))
    np.testing.assert_allclose(ratio, 1.0, atol=0.03)
    assert abs(ratio.mean() - 1) < 0.01
    unlike = np.abs(have - want) / np.sqrt(np.einsum("nii,njj->nij", want, want))
    assert unlike.max() < 0.1


def test_maximum_likelihood_reaches_bound():
    """Gauss–Newton on simulated noise; the scatter of 300 draws has an error of 4 %."""
    rng = np.random.default_rng(3)
    marker, noise, marker_id = similarity(16.0, 0.4, (30.3, 30.8)), 5.0, 7
    sigma = total_sigma_px(0.8)
    box = np.stack(np.meshgrid(np.arange(18.0, 44), np.arange(18.0, 44)), axis=-1).reshape(-1, 2)
    back = np.column_stack([box, np.ones(len(box))]) @ np.linalg.inv(marker).T
    pixels = box[(np.abs(back[:, :2]) <= card_side(DICTIONARY) / 2).all(axis=1)]

    def image(about):
        homography = similarity(16.0 * np.exp(about[3]), 0.4 + about[2], (30.3 + about[0], 30.8 + about[1]))
        return scanned_card(DICTIONARY, marker_id, homography, pixels, sigma, 30.0, 230.0, 128.0)

    steps = 1e-3 * np.eye(4)
    columns = np.stack([(image(step) - image(-step)) / 2e-3 for step in steps])
    draws = np.linalg.lstsq(columns.T, noise * rng.standard_normal((pixels.shape[0], 300)), rcond=None)[0]
    bound = pose_covariances(DICTIONARY, [marker_id], marker[None], psf_px=0.8, noise=noise)[0]
    ratio = draws[:3].std(axis=1) / np.sqrt(np.diag(bound))
    assert ((ratio > 0.85) & (ratio < 1.15)).all(), ratio


def test_unknown_plane_costs_less_with_more_markers():
    """Sixteen markers at 15 deg: under 6 % on average; a single one costs more, a known plane nothing."""
    ids = np.arange(16)
    markers = tilted(
        [similarity(24.0, 0.4 * k, (40.0 * (k % 4) + 40, 40.0 * (k // 4) + 40)) for k in range(16)]
    )
    about = dict(psf_px=0.8, noise=5.0)
    known = rms(pose_covariances(DICTIONARY, ids, markers, shared_plane=False, **about))
    shared = rms(pose_covariances(DICTIONARY, ids, markers, **about))
    alone = rms(
        np.concatenate(
            [pose_covariances(DICTIONARY, ids[k : k + 1], markers[k : k + 1], **about) for k in ids]
        )
    )
    assert known[0] < shared[0] < 1.06 * known[0]
    assert alone[0] > 1.2 * known[0]


def test_vertical_view_has_no_plane_unknowns():
    markers = np.array([similarity(*marker) for marker in LAYOUT])
    about = dict(psf_px=0.8, noise=5.0)
    np.testing.assert_array_equal(
        pose_covariances(DICTIONARY, [1, 2, 3], markers, **about),
        pose_covariances(DICTIONARY, [1, 2, 3], markers, shared_plane=False, **about),
    )
    np.testing.assert_allclose(sides_px(markers), 20.0)


def test_bad_input_is_rejected_and_empty_accepted():
    assert pose_covariances(DICTIONARY, [], np.zeros((0, 3, 3)), psf_px=0.8, noise=1.0).shape == (0, 3, 3)
    with pytest.raises(InputError, match="noise 0"):
        pose_covariances(DICTIONARY, [1], similarity(20.0)[None], psf_px=0.8, noise=0.0)
    with pytest.raises(InputError, match="shape"):
        pose_covariances(DICTIONARY, [1, 2], similarity(20.0)[None], psf_px=0.8, noise=1.0)


def test_pixel_aperture_is_part_of_blur():
    """The same total blur from a sharper lens gives no less: it includes UNIFORM_VARIANCE."""
    assert total_sigma_px(0.8) ** 2 == pytest.approx(0.64 + UNIFORM_VARIANCE)


def test_normal_cdf_equals_that_of_scipy_also_in_the_tails() -> None:
    """Rounding of the argument changes Φ by `x² eps`, 3e-13 at -37."""
    x = np.linspace(-37, 37, 2001).reshape(3, -1)
    np.testing.assert_allclose(normal_cdf(x), ndtr(x), rtol=1e-12, atol=0)
