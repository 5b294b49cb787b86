/* Unknowns that all markers of an image share: even light, the tone curve, the plane.
 *
 * Each is a hypothesis that is tested on all markers together, which is more precise than on one. The formulas and their
 * reasons are those of vision/photometric/fitting/common_unknowns.py.
 */
#include "homography.h"
#include "ranking.h"

/* Memory of the tests: solutions with unknowns held on trial, and (count,) or (count, 2) numbers. */
typedef struct {
    const FitRequest *given;
    const FitConstants *constants;
    const Homography *start;
    Solutions trial;
    uint8_t *inliers;
    Complex *points, *anisotropies, *perspectives;
    double *targets, *variances, *numbers, *weights;
    Ranked *order;
    Complex middle;
} Tests;

static int32_t allocate_tests(Tests *tests, const FitRequest *given, const Homography *start) {
    const size_t count = (size_t)given->count;
    const Complex middle = {(double)(given->width - 1) / 2, (double)(given->height - 1) / 2};
    *tests = (Tests){.given = given, .constants = given->constants, .start = start, .middle = middle};
    tests->inliers = malloc(count);
    tests->points = malloc(3 * count * sizeof *tests->points);
    tests->targets = malloc(5 * count * sizeof *tests->targets);
    tests->order = malloc(count * sizeof *tests->order);
    const int32_t result = allocate_solutions(&tests->trial, given->count);
    if (result || !tests->inliers || !tests->points || !tests->targets || !tests->order) return FIT_NO_MEMORY;
    tests->anisotropies = tests->points + count;
    tests->perspectives = tests->points + 2 * count;
    tests->variances = tests->targets + 2 * count;
    tests->numbers = tests->targets + 3 * count;
    tests->weights = tests->targets + 4 * count;
    for (size_t k = 0; k < count; k++) tests->points[k] = minus(start[k].center, middle);
    return 0;
}

static void release_tests(Tests *tests) {
    free(tests->inliers);
    free(tests->points);
    free(tests->targets);
    free(tests->order);
    release_solutions(&tests->trial);
}

/* Return the number (of `numbers`) at which the weights, summed in ascending order of the numbers, reach one half. */
static double weighted_median(Tests *tests) {
    const int64_t count = tests->given->count;
    double total = 0, sum = 0;
    for (int64_t k = 0; k < count; k++) {
        tests->order[k] = (Ranked){tests->numbers[k], k};
        total += tests->weights[k];
    }
    rank(tests->order, count);
    for (int64_t i = 0; i < count; i++) {
        sum += tests->weights[tests->order[i].row];
        if (sum >= total / 2) return tests->order[i].value;
    }
    return tests->order[count - 1].value;
}

/* Mark the fits that decide on what all markers share: prints with all cells right; all fits if none is. */
static void find_inliers(Tests *tests, const Solutions *solutions, const uint8_t *right) {
    const int64_t count = solutions->count;
    int any = 0;
    for (int64_t k = 0; k < count; k++) {
        const double contrast = contrast_of(solutions, k, tests->constants);
        const double white = solutions->values[k * UNKNOWNS + BLACK] + MIDDLE_GREY + contrast;
        tests->numbers[k] = contrast / fmax(white, 1.0);
        tests->weights[k] = right[k] * solutions->pixels[k] * contrast * contrast / noise_variance(solutions, k);
        any |= right[k];
    }
    const double least = any ? tests->constants->min_print_share * weighted_median(tests) : 0.0;
    for (int64_t k = 0; k < count; k++) tests->inliers[k] = !any || (right[k] && tests->numbers[k] > least);
}

/* Return whether the inliers' pixels speak against holding so many unknowns: their mean chi-squared is too large. */
static int tells_more(const Tests *tests, const Solutions *solutions, const Solutions *held, int unknowns) {
    double total = 0, count = 0;
    for (int64_t k = 0; k < solutions->count; k++) {
        if (!tests->inliers[k]) continue;
        total += (held->squares[k] - solutions->squares[k]) / noise_variance(solutions, k) / unknowns;
        count += 1;
    }
    return total / count > 1 + tests->constants->free_sigmas * sqrt(2.0 / unknowns / count);
}

/* Hold the change of light at zero, unless the inliers' pixels contradict it. */
static void hold_even_light(Tests *tests, Solutions *solutions) {
    for (int64_t i = 0; i < 2 * solutions->count; i++) tests->targets[i] = 0;
    copy_solutions(solutions, &tests->trial);
    hold_at(&tests->trial, LIGHT_X, LIGHT_Y, tests->targets);
    if (!tells_more(tests, solutions, &tests->trial, 2)) copy_solutions(&tests->trial, solutions);
}

/* Hold the bend of the tone curve at zero, or at one share of each contrast: the inliers' median. */
static void hold_common_tone(Tests *tests, Solutions *solutions) {
    const int64_t count = solutions->count;
    int64_t inliers = 0;
    for (int64_t k = 0; k < count; k++) {
        tests->targets[k] = 0;
        inliers += tests->inliers[k];
    }
    copy_solutions(solutions, &tests->trial);
    hold_at(&tests->trial, TONE, TONE, tests->targets);
    double share = 0;
    if (inliers >= tests->constants->min_markers_for_tone && tells_more(tests, solutions, &tests->trial, 1)) {
        for (int64_t k = 0; k < count; k++) {
            const double contrast = contrast_of(solutions, k, tests->constants);
            const double spread = solutions->inverse_normals[(k * UNKNOWNS + TONE) * UNKNOWNS + TONE];
            tests->numbers[k] = solutions->values[k * UNKNOWNS + TONE] / contrast;
            tests->weights[k] = tests->inliers[k] * contrast * contrast / (spread * noise_variance(solutions, k));
        }
        share = weighted_median(tests);
    }
    if (!(0 < share && share < tests->constants->max_tone)) {
        copy_solutions(&tests->trial, solutions);
        return;
    }
    for (int64_t k = 0; k < count; k++) tests->targets[k] = share * contrast_of(solutions, k, tests->constants);
    hold_at(solutions, TONE, TONE, tests->targets);
}

/* Set the targets of the keystones to those of the perspectives. */
static void aim_at_perspectives(Tests *tests, const Solutions *solutions) {
    for (int64_t k = 0; k < solutions->count; k++) {
        const Complex change = minus(tests->perspectives[k], tests->start[k].perspective);
        const Complex step = scaled(keystone_of(tests->start + k, change), contrast_of(solutions, k, tests->constants));
        tests->targets[2 * k] = step.re;
        tests->targets[2 * k + 1] = step.im;
    }
}

static void hold_keystones(Tests *tests, Solutions *solutions) {
    aim_at_perspectives(tests, solutions);
    hold_at(solutions, KEYSTONE_X, KEYSTONE_Y, tests->targets);
}

/* Draw keystones towards those of the perspectives; `stds` (count,) are expected about them, 0 to hold. */
static void draw_keystones(Tests *tests, Solutions *solutions, const double *stds) {
    copy_solutions(solutions, &tests->trial);
    hold_keystones(tests, &tests->trial);
    aim_at_perspectives(tests, solutions);
    for (int64_t k = 0; k < solutions->count; k++) {
        const double spread = stds[k] * contrast_of(solutions, k, tests->constants);
        tests->variances[k] = spread * spread / noise_variance(&tests->trial, k);
    }
    hold_unknowns(solutions->values, solutions->inverse_normals, solutions->squares, solutions->count, KEYSTONE_X,
                  KEYSTONE_Y, tests->targets, tests->variances);
}

static void draw_alone(Tests *tests, Solutions *solutions) {
    for (int64_t k = 0; k < solutions->count; k++) {
        tests->perspectives[k] = complex_of(0);
        tests->numbers[k] = tests->constants->keystone_std;
    }
    draw_keystones(tests, solutions, tests->numbers);
}

/* Compute the anisotropies in image axes that solutions give, and their variances; infinite for those not counted. */
static void observe_anisotropies(Tests *tests, const Solutions *solutions) {
    for (int64_t k = 0; k < solutions->count; k++) {
        const Homography *at = tests->start + k;
        const double contrast = contrast_of(solutions, k, tests->constants);
        const double *values = solutions->values + k * UNKNOWNS, *c = solutions->inverse_normals + k * UNKNOWNS * UNKNOWNS;
        const Complex found = {values[ANISOTROPY_X] / contrast, values[ANISOTROPY_Y] / contrast};
        tests->anisotropies[k] = over(plus(at->anisotropy, times(at->similarity, found)), conjugate(at->similarity));
        const double spread = (c[ANISOTROPY_X * UNKNOWNS + ANISOTROPY_X] + c[ANISOTROPY_Y * UNKNOWNS + ANISOTROPY_Y]) / 2;
        const int counts = spread > 0 && solutions->pixels[k] > tests->constants->min_pixels_for_plane && tests->inliers[k];
        tests->variances[k] = counts ? spread * noise_variance(solutions, k) / (contrast * contrast) : INFINITY;
    }
}

/* Hold anisotropies at those of a plane. */
static void hold_anisotropies(Tests *tests, const Plane *plane, Solutions *solutions) {
    for (int64_t k = 0; k < solutions->count; k++) {
        const Homography *at = tests->start + k;
        const Complex there = anisotropy_at(plane->anisotropy, plane->perspective, tests->points[k]);
        const Complex step = over(minus(times(there, conjugate(at->similarity)), at->anisotropy), at->similarity);
        const double contrast = contrast_of(solutions, k, tests->constants);
        tests->targets[2 * k] = step.re * contrast;
        tests->targets[2 * k + 1] = step.im * contrast;
    }
    hold_at(solutions, ANISOTROPY_X, ANISOTROPY_Y, tests->targets);
}

/* Draw keystones to those of a plane for the markers near it, if most inliers are, and about zero for the others. */
static void draw_near_plane(Tests *tests, const Plane *plane, Solutions *solutions) {
    const FitConstants *constants = tests->constants;
    double near_inliers = 0, inliers = 0;
    for (int64_t k = 0; k < solutions->count; k++) {
        const Complex there = anisotropy_at(plane->anisotropy, plane->perspective, tests->points[k]);
        const int is_near = magnitude(minus(tests->anisotropies[k], there)) < constants->near_plane;
        tests->numbers[k] = is_near ? 0.0 : constants->keystone_std;
        near_inliers += is_near && tests->inliers[k];
        inliers += tests->inliers[k];
    }
    const int enough = near_inliers >= constants->plane.min_markers &&
                       near_inliers >= constants->plane.min_share * inliers;
    for (int64_t k = 0; k < solutions->count; k++) {
        const int is_near = enough && tests->numbers[k] == 0.0;
        tests->perspectives[k] = is_near ? perspective_at(plane, tests->points[k]) : complex_of(0);
        tests->numbers[k] = is_near ? 0.0 : constants->keystone_std;
    }
    draw_keystones(tests, solutions, tests->numbers);
}

/* Find the plane that the inliers lie on, from their anisotropies under the keystones of the one before. */
static int32_t find_plane(Tests *tests, int settling, Plane *plane, const Solutions *solutions) {
    for (int64_t k = 0; k < solutions->count; k++)
        tests->perspectives[k] = plane->shared ? perspective_at(plane, tests->points[k]) : complex_of(0);
    copy_solutions(solutions, &tests->trial);
    hold_keystones(tests, &tests->trial);
    observe_anisotropies(tests, &tests->trial);
    return fit_plane(&tests->constants->plane, tests->points, tests->anisotropies, tests->variances, solutions->count,
                     settling, plane);
}

/* Hold anisotropies and keystones at those of a plane. */
static void hold_at_plane(Tests *tests, const Plane *plane, Solutions *solutions) {
    for (int64_t k = 0; k < solutions->count; k++) tests->perspectives[k] = perspective_at(plane, tests->points[k]);
    hold_keystones(tests, solutions);
    hold_anisotropies(tests, plane, solutions);
}

/* Hold anisotropies and keystones at those of the plane that the inliers lie on, or draw keystones where none explains
 * them. `plane` is that of the step before, and then the one found. */
static int32_t hold_on_plane(Tests *tests, int settling, Plane *plane, Solutions *solutions) {
    const int32_t result = find_plane(tests, settling, plane, solutions);
    if (result) return result;
    if (plane->shared) hold_at_plane(tests, plane, solutions);
    else draw_near_plane(tests, plane, solutions);
    return 0;
}

/* Copy `free` to `held`, with the unknowns held that the markers share, and find their plane.
 *
 * start (count,) are the homographies that the solutions are linear about, and right (count,) says whether all cells of a
 * marker are right. A plane of most of the markers counts if the fit is settling. Returns 0 or an error. */
int32_t hold_common_unknowns(const FitRequest *given, const Homography *start, const uint8_t *right, int settling,
                             const Solutions *free, Plane *plane, Solutions *held) {
    Tests tests;
    int32_t result = allocate_tests(&tests, given, start);
    if (!result) {
        copy_solutions(free, held);
        find_inliers(&tests, held, right);
        hold_even_light(&tests, held);
        hold_common_tone(&tests, held);
        if (given->alone) {
            draw_alone(&tests, held);
            *plane = (Plane){.shared = 0};
        } else {
            result = hold_on_plane(&tests, settling, plane, held);
        }
    }
    release_tests(&tests);
    return result;
}

/* Do so for markers that are covered in part, all of which decide. Light may change.
 *
 * If their plane is to be found, it is that of most of them. A known plane that is not shared leaves anisotropies free, and
 * keystones are expected about zero. */
int32_t hold_visible_unknowns(const FitRequest *given, const Homography *start, const Solutions *free, int find,
                              Plane *plane, Solutions *held) {
    Tests tests;
    int32_t result = allocate_tests(&tests, given, start);
    if (!result) {
        copy_solutions(free, held);
        for (int64_t k = 0; k < given->count; k++) tests.inliers[k] = 1;
        hold_common_tone(&tests, held);
        if (find) result = hold_on_plane(&tests, 1, plane, held);
        else if (plane->shared) hold_at_plane(&tests, plane, held);
        else draw_alone(&tests, held);
    }
    release_tests(&tests);
    return result;
}

/* Do so for markers that share no plane: all decide on light and the tone curve, and all unknowns of a pose stay free. */
int32_t hold_light_and_tone(const FitRequest *given, const Homography *start, const Solutions *free, Solutions *held) {
    Tests tests;
    const int32_t result = allocate_tests(&tests, given, start);
    if (!result) {
        copy_solutions(free, held);
        for (int64_t k = 0; k < given->count; k++) tests.inliers[k] = 1;
        hold_even_light(&tests, held);
        hold_common_tone(&tests, held);
    }
    release_tests(&tests);
    return result;
}
