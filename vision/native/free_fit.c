/* The fit of markers with all eight numbers of each homography free (vision/photometric/remeasure.py).
 *
 * No plane holds an anisotropy, and no keystone is expected. All markers take all steps.
 */
#include "steps.h"

enum { POSE = 8 };

/* Unknowns of the pose, in the order of design_matrix.py. */
static const int32_t POSE_UNKNOWNS[POSE] = {
    RIGHT, DOWN, TURN, GROW, ANISOTROPY_X, ANISOTROPY_Y, KEYSTONE_X, KEYSTONE_Y,
};

/* Read the pixels of all markers, and solve for their unknowns. Returns 0 or an error. */
static int32_t solve_markers(const FitRequest *given, Steps *steps) {
    for (int64_t k = 0; k < given->count; k++) {
        Pixels *pixels = steps->pixels + k;
        steps->start[k] = steps->here[k];
        const int32_t result = draw_marker(given, steps->start + k, steps->appearances + k, 1, pixels, k);
        if (result) return result;
        solve_marker(given, pixels, pixels->count, &steps->free, k);
    }
    return hold_light_and_tone(given, steps->start, &steps->free, &steps->held);
}

/* Step until no corner moves by `settled_px`, or as often as the request allows. Returns 0 or an error. */
static int32_t take_steps(const FitRequest *given, double settled_px, Steps *steps) {
    double moved_px = INFINITY;
    for (int32_t number = 0; number < given->max_steps && moved_px >= settled_px; number++) {
        const int32_t result = solve_markers(given, steps);
        if (result) return result;
        moved_px = 0;
        for (int64_t k = 0; k < given->count; k++) {
            if (is_bare(steps->appearances + k)) learn_surroundings(given, steps, k);
            step_marker(given, steps, k);
            moved_px = fmax(moved_px, corner_shift_px(steps->start + k, steps->here + k));
        }
    }
    return 0;
}

/* Write the covariance (8, 8) of the pose's unknowns of marker k, marker units, if noise is independent. */
static void write_covariance(const FitRequest *given, const Solutions *solutions, int64_t k, double *covariance) {
    const double *c = solutions->inverse_normals + k * UNKNOWNS * UNKNOWNS;
    const double contrast = contrast_of(solutions, k, given->constants);
    const double scale = noise_variance(solutions, k) / (contrast * contrast);
    for (int i = 0; i < POSE; i++)
        for (int j = 0; j < POSE; j++)
            covariance[i * POSE + j] = scale * c[POSE_UNKNOWNS[i] * UNKNOWNS + POSE_UNKNOWNS[j]];
}

/* Fit markers that lie near `start`, each by itself, until no corner moves by `settled_px`.
 *
 * fits (count,), cell_means (count, n, n), the mean residual over each cell, and covariances (count, 8, 8) of the pose's
 * unknowns are results. Residuals are summed over boxes as if all markers were right. Returns 0 or an error. */
int32_t fit_freely(const FitRequest *given, double settled_px, Fit *fits, double *cell_means, double *covariances) {
    if (!is_request_valid(given) || !(settled_px > 0)) return FIT_INVALID_SIZE;
    const Plane none = {.shared = 0};
    Steps steps;
    int32_t result = allocate_steps(&steps, given);
    if (!result) result = take_steps(given, settled_px, &steps);
    if (!result) result = write_fits(given, &steps, &none, fits, cell_means);
    for (int64_t k = 0; k < given->count && !result; k++)
        write_covariance(given, &steps.held, k, covariances + k * POSE * POSE);
    release_steps(&steps, given->count);
    return result;
}
