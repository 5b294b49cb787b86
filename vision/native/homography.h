/* Geometry of markers and planes (vision/photometric/fitting/local_homography.py, plane.py). */
#ifndef SKYHERD_HOMOGRAPHY_H
#define SKYHERD_HOMOGRAPHY_H

#include "fit.h"

/* Return the area of a marker's affine image, |m|² - |k|², px². */
static inline double area_px2(const Homography *at) { return squared(at->similarity) - squared(at->anisotropy); }

static inline double side_px(const Homography *at) { return sqrt(fabs(area_px2(at))); }

/* Return blur of a standard deviation of 1 px in the image, in sides: the root of its mean variance. */
static inline double blur_per_px(const Homography *at) {
    return sqrt(squared(at->similarity) + squared(at->anisotropy)) / fabs(area_px2(at));
}

/* Return the keystone q of a perspective h: h m̄ + h̄ k. */
static inline Complex keystone_of(const Homography *at, Complex perspective) {
    return plus(times(perspective, conjugate(at->similarity)), times(conjugate(perspective), at->anisotropy));
}

/* Return by how much blur that is round in the image differs along a marker's directions: e / (1 + |e|²), e = k / m. */
static inline Complex blur_anisotropy(const Homography *at) {
    const Complex relative = over(at->anisotropy, at->similarity);
    return scaled(relative, 1 / (1 + squared(relative)));
}

/* Return the homography after a step in marker coordinates: shift, growth and turn, anisotropy and keystone. */
static inline Homography moved(const Homography *at, Complex shift, Complex grow, Complex anisotropy, Complex keystone) {
    const Complex m = at->similarity, k = at->anisotropy, one = complex_of(1);
    const Complex bent = minus(times(keystone, m), times(conjugate(keystone), k));
    return (Homography){
        plus(at->center, plus(times(m, shift), times(k, conjugate(shift)))),
        plus(times(m, plus(one, grow)), times(k, conjugate(anisotropy))),
        plus(times(k, plus(one, conjugate(grow))), times(m, anisotropy)),
        plus(at->perspective, scaled(bent, 1 / area_px2(at))),
    };
}

/* Corners of a marker, right + i down, from front left on. */
static const Complex SQUARE_CORNERS[4] = {{-0.5, -0.5}, {0.5, -0.5}, {0.5, 0.5}, {-0.5, 0.5}};

/* Return the image of a point of a marker's plane: p_0 + d / (1 + Re(h̄ d)), d = m z + k z̄. */
static inline Complex image_of(const Homography *at, Complex z) {
    const Complex away = plus(times(at->similarity, z), times(at->anisotropy, conjugate(z)));
    return plus(at->center, scaled(away, 1 / (1 + times(conjugate(at->perspective), away).re)));
}

/* Return by how much a marker's corners moved at most, px. */
static inline double corner_shift_px(const Homography *before, const Homography *after) {
    double largest = 0;
    for (int corner = 0; corner < 4; corner++) {
        const Complex one = image_of(before, SQUARE_CORNERS[corner]), other = image_of(after, SQUARE_CORNERS[corner]);
        largest = fmax(largest, magnitude(minus(other, one)));
    }
    return largest;
}

/* Return the anisotropy ε that a plane gives to a marker at p, px from the image's centre. */
static inline Complex anisotropy_at(Complex a, Complex h, Complex p) {
    const Complex half_p = scaled(p, 0.5), conjugate_h = conjugate(h), one = complex_of(1);
    const Complex top = minus(times(a, minus(one, times(half_p, conjugate_h))), times(half_p, h));
    return over(top, minus(one, times(conjugate(half_p), plus(h, times(conjugate_h, a)))));
}

/* Return the perspective of a plane at p, px from the image's centre, 1/px: λ / (1 - λ·p). */
static inline Complex perspective_at(const Plane *plane, Complex p) {
    return scaled(plane->perspective, 1 / (1 - times(conjugate(plane->perspective), p).re));
}

/* Return the variance of each component of a plane's anisotropy at p, px from the image's centre. */
static inline double anisotropy_variance_at(const Plane *plane, Complex p) {
    const Complex *c = plane->covariance, half_p = scaled(p, -0.5);
    const Complex first = plus(c[0], times(half_p, c[2])), second = plus(c[1], times(half_p, c[3]));
    return plus(first, times(second, conjugate(half_p))).re;
}

static inline int is_level(const Plane *plane) {
    return plane->shared && squared(plane->anisotropy) == 0 && squared(plane->perspective) == 0;
}

#endif
