/* The fit of markers: Gauss-Newton steps in all unknowns of all markers of an image (fitting/fit.py). */
#include "steps.h"

#include <stdlib.h>
#include <string.h>

enum { POSE = 3 };

/* Largest level of the ground around a marker, its contrasts above or below white. Derived: black is one below. */
static const double MAX_GROUND_LEVEL = 1.0;

/* Allocate all arrays, and begin where the request does. Returns 0 or an error. */
int32_t allocate_steps(Steps *steps, const FitRequest *given) {
    const size_t count = (size_t)given->count;
    *steps = (Steps){.middle = {(double)(given->width - 1) / 2, (double)(given->height - 1) / 2}};
    steps->pixels = calloc(count, sizeof *steps->pixels);
    steps->start = malloc(2 * count * sizeof *steps->start);
    steps->appearances = malloc(count * sizeof *steps->appearances);
    steps->moved_px = malloc(count * sizeof *steps->moved_px);
    steps->is_active = malloc(2 * count);
    const int32_t free_result = allocate_solutions(&steps->free, given->count);
    const int32_t held_result = allocate_solutions(&steps->held, given->count);
    if (free_result || held_result || !steps->pixels || !steps->start || !steps->appearances || !steps->moved_px ||
        !steps->is_active)
        return FIT_NO_MEMORY;
    steps->here = steps->start + count;
    steps->right = steps->is_active + count;
    memset(steps->is_active, 1, 2 * count);
    memcpy(steps->appearances, given->appearances, count * sizeof *steps->appearances);
    memcpy(steps->here, given->start, count * sizeof *steps->here);
    return 0;
}

void release_steps(Steps *steps, int64_t count) {
    for (int64_t k = 0; steps->pixels && k < count; k++) release_pixels(steps->pixels + k);
    free(steps->pixels);
    free(steps->start);
    free(steps->appearances);
    free(steps->moved_px);
    free(steps->is_active);
    release_solutions(&steps->free);
    release_solutions(&steps->held);
}

void to_floats(const double *from, int64_t count, float *to) {
    for (int64_t i = 0; i < count; i++) to[i] = (float)from[i];
}

/* Largest residual of a pixel of a marker, and the mean one of the pixels beside it, grey levels. */
typedef struct { double peak, beside; } Left;

/* Compute the mean residual of solution k over each cell (n, n), and return the others. */
static Left cell_means_of(const FitRequest *given, const Steps *steps, const Solutions *solutions, int64_t k, double *means) {
    enum { CELLS = MAX_CELLS * MAX_CELLS };
    const int32_t cells = given->n * given->n;
    double used[CELLS] = {0}, read[CELLS] = {0};
    Left left = {0, 0};
    float values[UNKNOWNS];
    const MarkerBlocks blocks = blocks_of(steps->pixels + k);
    to_floats(solutions->values + k * UNKNOWNS, UNKNOWNS, values);
    for (int32_t i = 0; i < cells; i++) means[i] = 0;
    add_over_cells(&blocks, values, given->n, means, used, read, &left.peak, &left.beside);
    for (int32_t i = 0; i < cells; i++) means[i] /= used[i] > 1 ? used[i] : 1;
    return left;
}

/* Find out whether a marker's cells all have the right colour, by its free solution. */
static uint8_t cells_are_right(const FitRequest *given, const Steps *steps, int64_t k) {
    double means[MAX_CELLS * MAX_CELLS], worst = 0;
    cell_means_of(given, steps, &steps->free, k, means);
    for (int32_t i = 0; i < given->n * given->n; i++) worst = fabs(means[i]) > worst ? fabs(means[i]) : worst;
    return worst < given->constants->off_cell * contrast_of(&steps->free, k, given->constants);
}

/* Move a marker by the step of its held solution, cut to the largest one. */
void step_marker(const FitRequest *given, Steps *steps, int64_t k) {
    const FitConstants *constants = given->constants;
    const double *values = steps->held.values + k * UNKNOWNS, per = 1 / contrast_of(&steps->held, k, constants);
    const Complex shift = {values[RIGHT] * per, values[DOWN] * per}, grow = {values[GROW] * per, values[TURN] * per};
    const Complex anisotropy = {values[ANISOTROPY_X] * per, values[ANISOTROPY_Y] * per};
    const Complex keystone = {values[KEYSTONE_X] * per, values[KEYSTONE_Y] * per};
    const double size = sqrt(squared(shift) + (squared(grow) + squared(anisotropy)) / 4 + squared(keystone) / 16);
    const double share = constants->max_step / fmax(size, constants->min_step), cut = share < 1 ? share : 1.0;
    steps->here[k] = moved(steps->start + k, scaled(shift, cut), scaled(grow, cut), scaled(anisotropy, cut),
                           scaled(keystone, cut));
    steps->moved_px[k] = size * side_px(steps->start + k);
}

/* Give a marker the perspective of the plane at its place. */
void put_on_plane(const Plane *plane, Steps *steps, int64_t k) {
    steps->here[k].perspective = perspective_at(plane, minus(steps->here[k].center, steps->middle));
}

/* Learn the ground around a marker without a card from its held solution. Returns whether its texture is about as assumed:
 * another texture gives the pixels other weights. */
int learn_surroundings(const FitRequest *given, Steps *steps, int64_t k) {
    const double *values = steps->held.values + k * UNKNOWNS;
    const double level = values[GROUND] / contrast_of(&steps->held, k, given->constants);
    const MarkerBlocks blocks = blocks_of(steps->pixels + k);
    float solution[UNKNOWNS];
    to_floats(values, UNKNOWNS, solution);
    Surroundings *around = &steps->appearances[k].around;
    const double before = around->texture;
    around->level = limited(level, -MAX_GROUND_LEVEL, MAX_GROUND_LEVEL);
    around->texture = ground_texture(&blocks, solution, given->noise);
    return fabs(around->texture - before) <= given->noise;
}

/* Take step `number`; marker sides `sides_px` are those of the start. Returns how many markers are not settled. */
static int64_t take_step(const FitRequest *given, Steps *steps, const Plane *plane, int32_t number) {
    const double settled_px = given->constants->settled_px * cbrt(given->noise);
    int64_t active = 0;
    for (int64_t k = 0; k < given->count; k++) {
        const Homography *at = steps->start + k;
        const double contrast = contrast_of(&steps->held, k, given->constants), side = side_px(given->start + k);
        steps->appearances[k].black_ratio = (steps->held.values[k * UNKNOWNS + BLACK] + MIDDLE_GREY) / contrast;
        const int known = !is_bare(steps->appearances + k) || learn_surroundings(given, steps, k);
        step_marker(given, steps, k);
        if (plane->shared) put_on_plane(plane, steps, k);
        const double bent_px = magnitude(minus(steps->here[k].perspective, at->perspective)) * side * side / 2;
        const int unsettled = steps->moved_px[k] > settled_px || bent_px > given->constants->settled_perspective_px || !known;
        steps->is_active[k] = unsettled && (steps->right[k] || 2 * number < given->max_steps);
        active += steps->is_active[k];
    }
    steps->round_in_image = !is_level(plane) || given->has_streak;
    return active;
}

/* Read all active markers, hold what markers share, and step, until all have settled. Returns 0 or an error. */
static int32_t take_steps(const FitRequest *given, Steps *steps, Plane *plane) {
    steps->round_in_image = !is_level(plane) || given->has_streak;
    for (int64_t k = 0; plane->shared && !is_level(plane) && k < given->count; k++) put_on_plane(plane, steps, k);
    int64_t active = given->count;
    for (int32_t number = 1; number <= given->max_steps && active; number++) {
        for (int64_t k = 0; k < given->count; k++) {
            if (!steps->is_active[k]) continue;
            steps->start[k] = steps->here[k];
            Pixels *pixels = steps->pixels + k;
            const int32_t result = draw_marker(given, steps->start + k, steps->appearances + k, steps->round_in_image,
                                               pixels, k);
            if (result) return result;
            solve_marker(given, pixels, pixels->count, &steps->free, k);
            if (number > 1) steps->right[k] = cells_are_right(given, steps, k);
        }
        const int32_t result = hold_common_unknowns(given, steps->start, steps->right, number > 1, &steps->free, plane,
                                                    &steps->held);
        if (result) return result;
        active = take_step(given, steps, plane, number);
    }
    return 0;
}

/* Compute how (u, v, heading) change with each unknown, P (3, 15), and with each column's product, P C (3, 15).
 *
 * A step moves the centre by m d + k d̄ and turns forward by Re((m + k) / (m - k)) (θ - e_shear); steps are unknowns over
 * contrast. */
static void pose_influences(const FitRequest *given, const Steps *steps, int64_t k, double maps[POSE][UNKNOWNS],
                            double influences[POSE][UNKNOWNS]) {
    const Homography *at = steps->here + k;
    const Complex right = plus(at->similarity, at->anisotropy), back = minus(at->similarity, at->anisotropy);
    const Complex down = times_i(back);
    const double per = 1 / contrast_of(&steps->held, k, given->constants), turn = over(right, back).re * per;
    const double *c = steps->held.inverse_normals + k * UNKNOWNS * UNKNOWNS;
    memset(maps, 0, POSE * sizeof *maps);
    maps[0][RIGHT] = right.re * per;
    maps[1][RIGHT] = right.im * per;
    maps[0][DOWN] = down.re * per;
    maps[1][DOWN] = down.im * per;
    maps[2][TURN] = turn;
    maps[2][ANISOTROPY_Y] = -turn;
    for (int q = 0; q < POSE; q++)
        for (int j = 0; j < UNKNOWNS; j++) {
            influences[q][j] = 0;
            for (int i = 0; i < UNKNOWNS; i++) influences[q][j] += maps[q][i] * c[i * UNKNOWNS + j];
        }
}

/* Compute the ratios of a marker's variances to those of independent noise, and their number of boxes. */
static int32_t variance_ratios(const FitRequest *given, const Steps *steps, int64_t k,
                               double influences[POSE][UNKNOWNS], const double variances[POSE], Fit *fit) {
    const int64_t picked = 0;
    double small[POSE] = {0}, large[POSE] = {0}, ratios[POSE];
    float values[UNKNOWNS], by[POSE * UNKNOWNS];
    int64_t boxes = 0;
    to_floats(steps->held.values + k * UNKNOWNS, UNKNOWNS, values);
    to_floats(&influences[0][0], POSE * UNKNOWNS, by);
    const MarkerBlocks blocks = blocks_of(steps->pixels + k);
    const int32_t result = add_over_boxes(&blocks, &picked, 1, values, by, POSE, given->constants->box_px, small, large,
                                          &boxes);
    for (int q = 0; q < POSE; q++)
        ratios[q] = (2 * large[q] - small[q]) / (given->constants->kept_share * variances[q]);
    fit->ratios[0] = (ratios[0] + ratios[1]) / 2;
    fit->ratios[1] = ratios[2];
    fit->boxes = (double)boxes;
    return result;
}

/* Write the result of marker k. Its residuals are summed over boxes if it is picked. Returns 0 or an error. */
static int32_t write_fit(const FitRequest *given, const Steps *steps, const Plane *plane, int64_t k, int is_picked,
                         Fit *fit, double *cell_means) {
    const FitConstants *constants = given->constants;
    const double contrast = contrast_of(&steps->held, k, constants), *values = steps->held.values + k * UNKNOWNS;
    const double noise = noise_variance(&steps->held, k), log_blur = values[BLUR] / contrast;
    const double believed = limited(log_blur, -constants->max_log_blur, constants->max_log_blur);
    double maps[POSE][UNKNOWNS], influences[POSE][UNKNOWNS], variances[POSE];
    *fit = (Fit){
        .homography = steps->here[k],
        .black = values[BLACK] + MIDDLE_GREY,
        .contrast = values[CONTRAST],
        .noise_std = sqrt(noise),
        .log_blur = log_blur,
        .sigma_px = given->appearances[k].sigma * exp(believed) / blur_per_px(steps->here + k),
        .pixels = steps->held.pixels[k],
        .moved_px = steps->moved_px[k],
        .ratios = {1, 1},
        .around = steps->appearances[k].around,
    };
    const Left left = cell_means_of(given, steps, &steps->held, k, cell_means);
    fit->peak = left.peak;
    fit->beside = left.beside;
    pose_influences(given, steps, k, maps, influences);
    for (int a = 0; a < POSE; a++)
        for (int b = 0; b < POSE; b++) {
            double sum = 0;
            for (int i = 0; i < UNKNOWNS; i++) sum += influences[a][i] * maps[b][i];
            fit->covariance[a * POSE + b] = sum * noise;
        }
    for (int q = 0; q < POSE; q++) variances[q] = fit->covariance[q * POSE + q];
    if (plane->shared) { /* a shear that is held at the plane's value varies as the plane does */
        const double per_shear = maps[2][ANISOTROPY_Y] * contrast;
        const Complex point = minus(steps->here[k].center, steps->middle);
        fit->covariance[8] += per_shear * per_shear * anisotropy_variance_at(plane, point);
    }
    return is_picked ? variance_ratios(given, steps, k, influences, variances, fit) : 0;
}

/* Write the results of all markers. Returns 0 or an error. */
int32_t write_fits(const FitRequest *given, const Steps *steps, const Plane *plane, Fit *fits, double *cell_means) {
    int64_t right = 0, seen = 0;
    for (int64_t k = 0; k < given->count; k++) right += steps->right[k];
    const int64_t most = given->constants->max_box_markers, every = right > most ? (right + most - 1) / most : 1;
    for (int64_t k = 0; k < given->count; k++) {
        const int is_picked = steps->right[k] && seen++ % every == 0;
        const int32_t result = write_fit(given, steps, plane, k, is_picked, fits + k, cell_means + k * given->n * given->n);
        if (result) return result;
    }
    return 0;
}

int is_request_valid(const FitRequest *given) {
    return given->n > 0 && given->n <= MAX_CELLS && given->count > 0 && given->height > 0 && given->width > 0 &&
           given->max_steps > 0 && given->constants->max_box_markers > 0;
}

/* Fit markers that lie near `start`, and find the plane that they lie on.
 *
 * plane is the known one, and then the one found; fits (count,) and cell_means (count, n, n), the mean residual over each
 * cell, are results. Returns 0 or an error. */
int32_t fit_markers(const FitRequest *given, Plane *plane, Fit *fits, double *cell_means) {
    if (!is_request_valid(given)) return FIT_INVALID_SIZE;
    Steps steps;
    int32_t result = allocate_steps(&steps, given);
    if (!result) result = take_steps(given, &steps, plane);
    if (!result) result = write_fits(given, &steps, plane, fits, cell_means);
    release_steps(&steps, given->count);
    return result;
}
