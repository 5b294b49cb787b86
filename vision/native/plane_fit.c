/* Least-squares fit of a plane to anisotropies, and the choice of the simplest one (fitting/plane.py).
 *
 * A plane of anisotropy α and perspective λ makes a marker at the image point p anisotropic by
 *
 *     ε(p) = (α (1 - p λ̄ / 2) - p λ / 2) / (1 - p̄ λ / 2 - p̄ λ̄ α / 2) ≈ α - p λ / 2.
 */
#include "homography.h"
#include "ranking.h"

typedef struct {
    const Complex *points, *anisotropies;
    const double *variances;
    int64_t count;
    const PlaneLimits *limits;
} Observed;

/* Normal matrix of the columns 1 and -p / 2. */
typedef struct { double aa, hh; Complex ah; } Normal;

typedef struct { Complex a, h; } Numbers;

/* Return the sum of the squared residuals from a plane, over their variances. */
static double chi_squared(const Observed *observed, Numbers plane) {
    double total = 0;
    for (int64_t i = 0; i < observed->count; i++) {
        const Complex expected = anisotropy_at(plane.a, plane.h, observed->points[i]);
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
    const double raised = observed->limits->ridge * (normal.aa + normal.hh);
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
static Numbers iterate(const Observed *observed, const Normal *normal, int tilted, Complex covariance[4]) {
    const double determinant = normal->aa * normal->hh - squared(normal->ah);
    covariance[0] = complex_of(tilted ? normal->hh / determinant : 1 / normal->aa);
    covariance[1] = tilted ? scaled(normal->ah, -1 / determinant) : complex_of(0);
    covariance[2] = conjugate(covariance[1]);
    covariance[3] = complex_of(tilted ? normal->aa / determinant : 0);
    double farthest_px = 0;
    for (int64_t i = 0; i < observed->count; i++) farthest_px = fmax(farthest_px, magnitude(observed->points[i]));
    Numbers plane = {{0, 0}, {0, 0}};
    for (int32_t round = 0; round < observed->limits->max_rounds; round++) {
        const Numbers right = right_side(observed, plane);
        const Numbers next = {plus(times(covariance[0], right.a), times(covariance[1], right.h)),
                              plus(times(covariance[2], right.a), times(covariance[3], right.h))};
        const double change = magnitude(minus(next.a, plane.a)) + magnitude(minus(next.h, plane.h)) * farthest_px;
        plane = next;
        if (magnitude(plane.a) > 1 || magnitude(plane.h) * farthest_px > 1) {
            for (int i = 0; i < 4; i++) covariance[i] = complex_of(0);
            return (Numbers){{0, 0}, {0, 0}};
        }
        if (change < observed->limits->converged) break;
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

/* Return the simplest plane that explains all anisotropies; that of no tilt where no variance is finite. */
static Plane plane_to_all(const Observed *observed) {
    const PlaneLimits *limits = observed->limits;
    const double freedom = 2 * (double)observed->count;
    Plane best = {.shared = 1};
    int is_finite = 0;
    for (int64_t i = 0; i < observed->count; i++) is_finite |= observed->variances[i] < INFINITY;
    if (!is_finite) return best;
    double least = chi_squared(observed, (Numbers){{0, 0}, {0, 0}}), per_freedom = least / freedom;
    const Normal normal = normal_of(observed);
    const int may_fall = !(possible_fall(observed, &normal) <= limits->significant);
    for (int unknowns = 2; may_fall && unknowns <= 4 && freedom > unknowns; unknowns += 2) {
        Complex own[4];
        const Numbers found = iterate(observed, &normal, unknowns == 4, own);
        const double chi = chi_squared(observed, found), scatter = fmax(chi / (freedom - unknowns), 1.0);
        if (!(least - chi > limits->significant * scatter)) continue;
        best.anisotropy = found.a;
        best.perspective = found.h;
        least = chi;
        per_freedom = scatter;
        for (int i = 0; i < 4; i++) best.covariance[i] = own[i];
    }
    best.shared = per_freedom <= limits->excess;
    return best;
}

/* Rank the kept observations by their distance from a plane, over their deviations. */
static void rank_kept(const Observed *observed, const Plane *plane, Ranked *kept, int64_t count) {
    for (int64_t i = 0; i < count; i++) {
        const int64_t row = kept[i].row;
        const Complex expected = anisotropy_at(plane->anisotropy, plane->perspective, observed->points[row]);
        kept[i].value = squared(minus(observed->anisotropies[row], expected)) / observed->variances[row];
    }
    rank(kept, count);
}

/* Find the simplest plane of anisotropies (count,) at points (count,), px from the image's centre.
 *
 * It explains all of them, or most of them if `most`: while no plane explains the kept ones, the tenth that lies farthest
 * off is left out. The result is that of all where none explains enough. Returns 0 or an error. */
int32_t fit_plane(const PlaneLimits *limits, const Complex *points, const Complex *anisotropies, const double *variances,
                  int64_t count, int32_t most, Plane *plane) {
    const Observed all = {points, anisotropies, variances, count, limits};
    *plane = plane_to_all(&all);
    if (plane->shared || !most) return 0;
    Ranked *kept = malloc((size_t)count * sizeof *kept);
    Complex *numbers = malloc(2 * (size_t)count * sizeof *numbers);
    double *own = malloc((size_t)count * sizeof *own);
    const int has_memory = kept && numbers && own;
    int64_t left = 0;
    for (int64_t i = 0; has_memory && i < count; i++)
        if (variances[i] < INFINITY) kept[left++].row = i;
    const double share = ceil(limits->min_share * (double)left);
    const int64_t least = share > limits->min_markers ? (int64_t)share : limits->min_markers;
    Plane found = *plane;
    while (!found.shared && left > least) {
        rank_kept(&all, &found, kept, left);
        const int64_t fewer = left - (left + 9) / 10;
        left = fewer > least ? fewer : least;
        for (int64_t i = 0; i < left; i++) {
            numbers[i] = points[kept[i].row];
            numbers[count + i] = anisotropies[kept[i].row];
            own[i] = variances[kept[i].row];
        }
        found = plane_to_all(&(Observed){numbers, numbers + count, own, left, limits});
    }
    if (found.shared) *plane = found;
    free(kept);
    free(numbers);
    free(own);
    return has_memory ? 0 : FIT_NO_MEMORY;
}
