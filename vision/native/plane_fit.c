/* Least-squares fit of a plane to anisotropies, and the choice of the simplest one (fitting/plane.py).
 *
 * A plane of anisotropy α and perspective λ makes a marker at the image point p anisotropic by
 *
 *     ε(p) = (α (1 - p λ̄ / 2) - p λ / 2) / (1 - p̄ λ / 2 - p̄ λ̄ α / 2) ≈ α - p λ / 2.
 */
#include "fit.h"

#include <math.h>

static Complex complex_of(double re) { return (Complex){re, 0}; }
static Complex plus(Complex a, Complex b) { return (Complex){a.re + b.re, a.im + b.im}; }
static Complex minus(Complex a, Complex b) { return (Complex){a.re - b.re, a.im - b.im}; }
static Complex conjugate(Complex a) { return (Complex){a.re, -a.im}; }
static Complex scaled(Complex a, double by) { return (Complex){a.re * by, a.im * by}; }
static double squared(Complex a) { return a.re * a.re + a.im * a.im; }
static double magnitude(Complex a) { return sqrt(squared(a)); }

static Complex times(Complex a, Complex b) {
    return (Complex){a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re};
}

static Complex over(Complex a, Complex b) { return scaled(times(a, conjugate(b)), 1 / squared(b)); }

/* Observations, and limits: of the fall of the chi-squared and of its excess, of the last change, and the ridge. */
typedef struct {
    const Complex *points, *anisotropies;
    const double *variances;
    int64_t count;
    double significant, excess, converged, ridge;
    int32_t max_rounds;
} Observed;

/* Normal matrix of the columns 1 and -p / 2. */
typedef struct { double aa, hh; Complex ah; } Normal;

typedef struct { Complex a, h; } Numbers;

/* Return the anisotropy that a plane gives to a marker at p. */
static Complex anisotropy_at(Numbers plane, Complex p) {
    const Complex half_p = scaled(p, 0.5), conjugate_h = conjugate(plane.h), one = complex_of(1);
    const Complex top = minus(times(plane.a, minus(one, times(half_p, conjugate_h))), times(half_p, plane.h));
    const Complex turned = plus(plane.h, times(conjugate_h, plane.a));
    return over(top, minus(one, times(conjugate(half_p), turned)));
}

/* Return the sum of the squared residuals from a plane, over their variances. */
static double chi_squared(const Observed *observed, Numbers plane) {
    double total = 0;
    for (int64_t i = 0; i < observed->count; i++) {
        const Complex expected = anisotropy_at(plane, observed->points[i]);
        total += squared(minus(observed->anisotropies[i], expected)) / observed->variances[i];
    }
    return total;
}

static Normal normal_of(const Observed *observed) {
    Normal normal = {0, 0, {0, 0}};
    for (int64_t i = 0; i < observed->count; i++) {
        const Complex p = observed->points[i];
        const double weight = 1 / observed->variances[i];
        normal.aa += weight;
        normal.ah = minus(normal.ah, scaled(p, weight / 2));
        normal.hh += weight * squared(p) / 4;
    }
    const double raised = observed->ridge * (normal.aa + normal.hh);
    normal.aa += raised;
    normal.hh += raised;
    return normal;
}

/* Return the right side of the normal equations: of the anisotropies, plus what ε has of second order in a plane. */
static Numbers right_side(const Observed *observed, Numbers plane) {
    Numbers right = {{0, 0}, {0, 0}};
    for (int64_t i = 0; i < observed->count; i++) {
        const Complex p = observed->points[i], e = observed->anisotropies[i], conjugate_h = conjugate(plane.h);
        const Complex bend = times(times(plane.a, p), conjugate_h);
        const Complex turn = times(times(e, conjugate(p)), plus(plane.h, times(conjugate_h, plane.a)));
        const Complex weighted = scaled(plus(e, scaled(minus(bend, turn), 0.5)), 1 / observed->variances[i]);
        right.a = plus(right.a, weighted);
        right.h = minus(right.h, scaled(times(weighted, conjugate(p)), 0.5));
    }
    return right;
}

/* Return the plane, with λ free if `tilted`, and its covariance (2, 2). Both are zero where the iteration diverges. */
static Numbers solve(const Observed *observed, const Normal *normal, int tilted, Complex covariance[4]) {
    const double determinant = normal->aa * normal->hh - squared(normal->ah);
    covariance[0] = complex_of(tilted ? normal->hh / determinant : 1 / normal->aa);
    covariance[1] = tilted ? scaled(normal->ah, -1 / determinant) : complex_of(0);
    covariance[2] = conjugate(covariance[1]);
    covariance[3] = complex_of(tilted ? normal->aa / determinant : 0);
    double farthest_px = 0;
    for (int64_t i = 0; i < observed->count; i++) farthest_px = fmax(farthest_px, magnitude(observed->points[i]));
    Numbers plane = {{0, 0}, {0, 0}};
    for (int32_t round = 0; round < observed->max_rounds; round++) {
        const Numbers right = right_side(observed, plane);
        const Numbers next = {plus(times(covariance[0], right.a), times(covariance[1], right.h)),
                              plus(times(covariance[2], right.a), times(covariance[3], right.h))};
        const double change = magnitude(minus(next.a, plane.a)) + magnitude(minus(next.h, plane.h)) * farthest_px;
        plane = next;
        if (magnitude(plane.a) > 1 || magnitude(plane.h) * farthest_px > 1) {
            for (int i = 0; i < 4; i++) covariance[i] = complex_of(0);
            return (Numbers){{0, 0}, {0, 0}};
        }
        if (change < observed->converged) break;
    }
    return plane;
}

/* Return by how much the chi-squared falls, to first order, if both unknowns are free. */
static double possible_fall(const Observed *observed, const Normal *normal) {
    const Numbers right = right_side(observed, (Numbers){{0, 0}, {0, 0}});
    const double cross = 2 * times(times(conjugate(right.a), normal->ah), right.h).re;
    const double fall = squared(right.a) * normal->hh + squared(right.h) * normal->aa - cross;
    return fall / (normal->aa * normal->hh - squared(normal->ah));
}

/* Find the simplest plane of anisotropies (count,) at points (count,), px from the image's centre.
 *
 * limits: SIGNIFICANT, EXCESS, CONVERGED and PERSPECTIVE_RIDGE of plane.py. plane (2,) is α and λ, covariance (2, 2) theirs.
 * Returns whether the plane explains the anisotropies. */
int32_t fit_plane(const Complex *points, const Complex *anisotropies, const double *variances, int64_t count,
                  const double limits[4], int32_t max_rounds, Complex plane[2], Complex covariance[4]) {
    const Observed observed = {points,    anisotropies, variances, count,     limits[0],
                               limits[1], limits[2],    limits[3], max_rounds};
    const double freedom = 2 * (double)count;
    Numbers best = {{0, 0}, {0, 0}};
    for (int i = 0; i < 4; i++) covariance[i] = complex_of(0);
    double least = chi_squared(&observed, best), per_freedom = least / freedom;
    const Normal normal = normal_of(&observed);
    const int may_fall = !(possible_fall(&observed, &normal) <= observed.significant);
    for (int unknowns = 2; may_fall && unknowns <= 4 && freedom > unknowns; unknowns += 2) {
        Complex own[4];
        const Numbers found = solve(&observed, &normal, unknowns == 4, own);
        const double chi = chi_squared(&observed, found), scatter = fmax(chi / (freedom - unknowns), 1.0);
        if (!(least - chi > observed.significant * scatter)) continue;
        best = found;
        least = chi;
        per_freedom = scatter;
        for (int i = 0; i < 4; i++) covariance[i] = own[i];
    }
    plane[0] = best.a;
    plane[1] = best.h;
    return per_freedom <= observed.excess;
}
