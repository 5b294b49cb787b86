/* The fit of markers to those of their pixels that agree on a pose; something covers the others (fitting/occlusion.py). */
#include "steps.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { CELLS = MAX_CELLS * MAX_CELLS, MAX_FALLS = 50, MAX_MARGIN_PX = 200 };

/* What a round needs besides the steps. Arrays have room for the largest marker, and grow with it. */
typedef struct {
    Steps steps;
    double *limits, *supports;      /* (count,) grey levels; (count, n, n) visible shares of cells without margins */
    float *left;                    /* (room,) residuals of a marker's pixels */
    uint8_t *used;                  /* (room,) */
    int32_t *near;                  /* (near_room,) changes along lines of the number of outliers within reach */
    int64_t room, near_room;
} Visible;

static int32_t allocate_visible(Visible *visible, const VisibleRequest *given) {
    const size_t count = (size_t)given->markers->count, cells = (size_t)given->markers->n * (size_t)given->markers->n;
    *visible = (Visible){0};
    visible->limits = malloc(count * sizeof *visible->limits);
    visible->supports = calloc(count * cells, sizeof *visible->supports);
    const int32_t result = allocate_steps(&visible->steps, given->markers);
    return result || !visible->limits || !visible->supports ? FIT_NO_MEMORY : 0;
}

static void release_visible(Visible *visible, int64_t count) {
    release_steps(&visible->steps, count);
    free(visible->limits);
    free(visible->supports);
    free(visible->left);
    free(visible->used);
    free(visible->near);
}

static int32_t make_room(Visible *visible, int64_t pixels) {
    if (pixels <= visible->room) return 0;
    free(visible->left);
    free(visible->used);
    visible->room = 0;
    visible->left = malloc((size_t)pixels * sizeof *visible->left);
    visible->used = malloc((size_t)pixels);
    if (!visible->left || !visible->used) return FIT_NO_MEMORY;
    visible->room = pixels;
    return 0;
}

/* Return what the model of the blur leaves along edges at most, as a share of the contrast. */
static double edge_misfit(const VisibleConstants *constants, double sigma_px) {
    const double pixel = 1.0 / 12 / (sigma_px * sigma_px);
    return constants->pixel_share * pixel * pixel;
}

/* Return the last limit of the residuals of marker k, grey levels. */
static double last_limit(const VisibleRequest *given, int64_t k, double noise) {
    const VisibleConstants *constants = given->constants;
    return constants->inlier_sigmas * noise + edge_misfit(constants, given->sigmas_px[k]) * given->contrasts[k];
}

/* Return the rounds until the limit has fallen to its last value, and the final ones. */
static int32_t count_rounds(const VisibleRequest *given) {
    double largest = 0;
    if (given->settled) return given->constants->final_rounds;
    for (int64_t k = 0; k < given->markers->count; k++) largest = fmax(largest, given->contrasts[k]);
    const double last = given->constants->inlier_sigmas * given->markers->noise;
    const double falls = log(last / (largest / 2)) / log(given->constants->limit_factor);
    return (int32_t)(falls > 0 ? ceil(fmin(falls, MAX_FALLS)) : 0.0) + given->constants->final_rounds;
}

/* Line and column of pixel `at` of a marker. */
typedef struct { int32_t v, u; } Pixel;

static inline Pixel pixel_of(const MarkerBlocks *blocks, int64_t at) {
    const int32_t *pixel = blocks->pixels + at / BLOCK_PX * (2 * BLOCK_PX) + at % BLOCK_PX;
    return (Pixel){pixel[0], pixel[BLOCK_PX]};
}

/* Box of the pixels of a marker, with a margin around it that is never read. */
typedef struct { int32_t top, left; int64_t height, width; } Box;

static Box box_of(const MarkerBlocks *blocks, int32_t reach) {
    int32_t top = INT32_MAX, left = INT32_MAX, bottom = 0, right = 0;
    for (int64_t at = 0; at < blocks->counts[0]; at++) {
        const Pixel pixel = pixel_of(blocks, at);
        top = pixel.v < top ? pixel.v : top, bottom = pixel.v > bottom ? pixel.v : bottom;
        left = pixel.u < left ? pixel.u : left, right = pixel.u > right ? pixel.u : right;
    }
    return (Box){top - reach, left - reach, (int64_t)bottom - top + 2 * reach + 1, (int64_t)right - left + 2 * reach + 2};
}

/* Leave out the pixels within a margin of those that are not used: discs are added up as changes along lines. */
static int32_t leave_out_margins(const MarkerBlocks *blocks, double margin_px, Visible *visible) {
    if (!(margin_px > 0 && margin_px < MAX_MARGIN_PX) || !blocks->counts[0]) return 0;
    const int32_t reach = (int32_t)margin_px;
    const Box box = box_of(blocks, reach);
    const int64_t size = box.height * box.width;
    if (size > visible->near_room) {
        free(visible->near);
        visible->near = malloc((size_t)size * sizeof *visible->near);
        visible->near_room = visible->near ? size : 0;
        if (!visible->near) return FIT_NO_MEMORY;
    }
    memset(visible->near, 0, (size_t)size * sizeof *visible->near);
    for (int64_t at = 0; at < blocks->counts[0]; at++) {
        if (visible->used[at]) continue;
        const Pixel pixel = pixel_of(blocks, at);
        const int64_t v = pixel.v - box.top, u = pixel.u - box.left;
        for (int32_t down = -reach; down <= reach; down++) {
            const int64_t half = (int64_t)sqrt(margin_px * margin_px - (double)down * down);
            int32_t *line = visible->near + (v + down) * box.width + u;
            line[-half] += 1;
            line[half + 1] -= 1;
        }
    }
    for (int64_t v = 0; v < box.height; v++)
        for (int64_t u = 1; u < box.width; u++) visible->near[v * box.width + u] += visible->near[v * box.width + u - 1];
    for (int64_t at = 0; at < blocks->counts[0]; at++) {
        const Pixel pixel = pixel_of(blocks, at);
        const int64_t v = pixel.v - box.top, u = pixel.u - box.left;
        visible->used[at] &= visible->near[v * box.width + u] == 0;
    }
    return 0;
}

/* Choose the pixels of marker k whose residuals from its solution, without its step, are below the limit. */
static int32_t choose_pixels(const VisibleRequest *given, const MarkerBlocks *blocks, int64_t k, int with_margins,
                             Visible *visible) {
    const VisibleConstants *constants = given->constants;
    const double *solution = visible->steps.held.values + k * UNKNOWNS;
    const double limit = visible->limits[k], far = constants->cover_share * solution[CONTRAST];
    float values[UNKNOWNS];
    int64_t covering = 0;
    to_floats(solution, UNKNOWNS, values);
    for (int i = RIGHT; i <= GROW; i++) values[i] = 0;
    for (int i = ANISOTROPY_X; i <= ANISOTROPY_Y; i++) values[i] = 0;
    for (int i = KEYSTONE_X; i <= KEYSTONE_Y; i++) values[i] = 0;
    residuals(blocks, values, visible->left);
    for (int64_t at = 0; at < blocks->counts[0]; at++) {
        const double left = fabs((double)visible->left[at]);
        visible->used[at] = left < limit;
        covering += left > far;
    }
    if (!with_margins || covering < constants->min_cover_px) return 0;
    return leave_out_margins(blocks, constants->margin_sigmas * given->sigmas_px[k], visible);
}

/* Set the columns of the pixels that are not used to zero. Returns how many are used. */
static int64_t restrict_to_used(const MarkerBlocks *blocks, const uint8_t *used) {
    int64_t count = 0;
    for (int64_t at = 0; at < blocks->counts[0]; at++) {
        float *columns = blocks->columns + at / BLOCK_PX * (COLUMNS * BLOCK_PX) + at % BLOCK_PX;
        for (int c = 0; !used[at] && c < COLUMNS; c++) columns[c * BLOCK_PX] = 0;
        count += columns[BLACK * BLOCK_PX] > 0;
    }
    return count;
}

/* Compute the share of the pixels of each cell (n, n) that is used; 0 for a cell off the image. */
static void visible_shares(const MarkerBlocks *blocks, int32_t n, double *shares) {
    const float none[UNKNOWNS] = {0};
    double sums[CELLS] = {0}, used[CELLS] = {0}, read[CELLS] = {0}, peak = 0, beside = 0;
    add_over_cells(blocks, none, n, sums, used, read, &peak, &beside);
    for (int32_t i = 0; i < n * n; i++) shares[i] = used[i] / (read[i] > 1 ? read[i] : 1);
}

/* Read the visible pixels of all markers in round `number` of `rounds`, solve, and step. Returns 0 or an error. */
static int32_t take_round(const VisibleRequest *given, int32_t number, int32_t rounds, Plane *plane, Visible *visible) {
    const FitRequest *markers = given->markers;
    Steps *steps = &visible->steps;
    const int64_t cells = (int64_t)markers->n * markers->n;
    const int32_t last_without_margins = rounds - given->constants->final_rounds;
    int32_t result = 0;
    for (int64_t k = 0; k < markers->count && !result; k++) {
        Pixels *pixels = steps->pixels + k;
        steps->start[k] = steps->here[k];
        result = draw_marker(markers, steps->start + k, steps->appearances + k, steps->round_in_image, pixels, k);
        const MarkerBlocks blocks = blocks_of(pixels);
        if (!result) result = make_room(visible, blocks.blocks * BLOCK_PX);
        if (!result) result = choose_pixels(given, &blocks, k, number > last_without_margins, visible);
        if (result) return result;
        solve_marker(markers, pixels, restrict_to_used(&blocks, visible->used), &steps->free, k);
        if (number == last_without_margins) visible_shares(&blocks, markers->n, visible->supports + k * cells);
    }
    if (!result)
        result = hold_visible_unknowns(markers, steps->start, &steps->free, given->settled, plane, &steps->held);
    for (int64_t k = 0; k < markers->count && !result; k++) {
        step_marker(markers, steps, k);
        if (plane->shared) put_on_plane(plane, steps, k);
    }
    return result;
}

/* Let the limits fall towards their last values. */
static void lower_limits(const VisibleRequest *given, Visible *visible) {
    for (int64_t k = 0; k < given->markers->count; k++) {
        const double noise = fmin(given->markers->noise, sqrt(noise_variance(&visible->steps.held, k)));
        const double lower = given->constants->limit_factor * visible->limits[k];
        visible->limits[k] = fmax(lower, last_limit(given, k, noise));
    }
}

/* Let cells with a bit that are hidden leave the whole contrast, and hidden cells of the border nothing. */
static void mark_hidden_bits(const VisibleRequest *given, const Visible *visible, int64_t k, double *means) {
    const VisibleConstants *constants = given->constants;
    const int32_t n = given->markers->n, border = (int32_t)given->border;
    const double contrast = contrast_of(&visible->steps.held, k, given->markers->constants);
    const MarkerBlocks blocks = blocks_of(visible->steps.pixels + k);
    double clear[CELLS];
    visible_shares(&blocks, n, clear);
    for (int32_t i = 0; i < n * n; i++) {
        const double seen = visible->supports[k * n * n + i];
        const double share = fmin(seen, clear[i] * constants->min_visible_share / constants->min_clear_share);
        const int32_t row = i / n, column = i % n;
        const int has_bit = row >= border && row < n - border && column >= border && column < n - border;
        if (share < constants->min_visible_share) means[i] = has_bit ? contrast : 0.0;
    }
}

static int is_valid(const VisibleRequest *given) {
    const VisibleConstants *constants = given->constants;
    return is_request_valid(given->markers) && given->border >= 0 && constants->final_rounds > 0 &&
           constants->final_rounds < 20 && constants->limit_factor > 0 && constants->limit_factor < 1;
}

/* Fit markers to their visible pixels.
 *
 * The markers are held at the plane, if it is shared; if they are settled, it is found. fits (count,) and cell_means
 * (count, n, n), the mean residual over each cell, are results. Returns 0 or an error. */
int32_t fit_visible(const VisibleRequest *given, Plane *plane, Fit *fits, double *cell_means) {
    if (!is_valid(given)) return FIT_INVALID_SIZE;
    const FitRequest *markers = given->markers;
    const int64_t count = markers->count, cells = (int64_t)markers->n * markers->n;
    const int32_t rounds = count_rounds(given);
    Visible visible;
    Steps *steps = &visible.steps;
    int32_t result = allocate_visible(&visible, given);
    for (int64_t k = 0; k < count && !result; k++) {
        double *values = steps->held.values + k * UNKNOWNS;
        memset(values, 0, UNKNOWNS * sizeof *values);
        values[BLACK] = given->blacks[k] - MIDDLE_GREY;
        values[CONTRAST] = given->contrasts[k];
        const Appearance *look = markers->appearances + k;
        if (is_bare(look)) values[GROUND] = look->around.level * given->contrasts[k];
        visible.limits[k] = given->settled ? last_limit(given, k, markers->noise) : given->contrasts[k] / 2;
        steps->right[k] = 0;
        if (plane->shared) put_on_plane(plane, steps, k);
    }
    steps->round_in_image = !is_level(plane) || markers->has_streak;
    for (int32_t number = 0; number < rounds && !result; number++) {
        result = take_round(given, number, rounds, plane, &visible);
        if (!result) lower_limits(given, &visible);
    }
    if (!result) result = write_fits(markers, steps, plane, fits, cell_means);
    for (int64_t k = 0; k < count && !result; k++) mark_hidden_bits(given, &visible, k, cell_means + k * cells);
    release_visible(&visible, count);
    return result;
}
