/* The stages of following, as long as all is as usual (vision/photometric/following.py). */
#include "follow.h"

#include <stdlib.h>
#include <string.h>

/* Working memory; (count,) each. */
typedef struct {
    Appearance *appearances;
    float *cells;       /* of the markers in view */
    double *sigmas_px;
    Weighted *weighted;
} Scratch;

static int32_t allocate_scratch(Scratch *scratch, const FollowRequest *given) {
    const size_t count = (size_t)given->count, cells = (size_t)(given->n + 2) * (size_t)(given->n + 2);
    scratch->appearances = malloc(count * sizeof *scratch->appearances);
    scratch->cells = malloc(count * cells * sizeof *scratch->cells);
    scratch->sigmas_px = malloc(count * sizeof *scratch->sigmas_px);
    scratch->weighted = malloc(count * sizeof *scratch->weighted);
    const int all = scratch->appearances && scratch->cells && scratch->sigmas_px && scratch->weighted;
    return all ? 0 : FIT_NO_MEMORY;
}

static void release_scratch(Scratch *scratch) {
    free(scratch->appearances);
    free(scratch->cells);
    free(scratch->sigmas_px);
    free(scratch->weighted);
}

static int32_t fit_in_view(const FollowRequest *given, Scratch *scratch, FollowResults *results) {
    const size_t sides = (size_t)given->n + 2, cells = sides * sides;
    for (int64_t k = 0; k < results->here; k++) {
        const int64_t row = results->rows[k];
        results->blurs[k] = given->tracks[row].sigma_px * blur_per_px(results->starts + k);
        scratch->appearances[k] = appearance_of(&given->constants->looks, results->blurs[k], given->tracks[row].around);
        memcpy(scratch->cells + (size_t)k * cells, given->cells + (size_t)row * cells, cells * sizeof *scratch->cells);
    }
    const FitRequest request = {
        .image = given->image,
        .start = results->starts,
        .appearances = scratch->appearances,
        .cells = scratch->cells,
        .constants = given->fit_constants,
        .height = given->height,
        .width = given->width,
        .count = results->here,
        .texture = given->constants->looks.texture / given->noise,
        .noise = given->noise,
        .n = given->n,
        .max_steps = given->max_steps,
    };
    return fit_markers(&request, results->plane, results->fits, results->cell_means);
}

/* Return whether a fit may be of a marker, and has found the blur that was assumed (refine.py). */
static int is_settled(const FollowRequest *given, const FollowResults *results, int64_t k) {
    const BlurConstants *limits = &given->constants->blur;
    const double found_px = within_blur_limits(limits, results->fits + k, given->n);
    return is_promising(limits, results->fits + k, results->cell_means + k * given->n * given->n, given->n) &&
           fabs(log(found_px / given->tracks[results->rows[k]].sigma_px)) <= limits->settled;
}

/* Return the noise of an image, grey levels (image_noise.py). */
static double image_noise(const FollowRequest *given) {
    enum { LEVELS = 1021 };
    const FollowConstants *constants = given->constants;
    int64_t counts[LEVELS], total = 0, seen = 0;
    const int32_t margin = constants->saturation_margin;
    count_second_differences(given->image, given->height, given->width, margin, 255 - margin, counts);
    for (int i = 0; i < LEVELS; i++) total += counts[i];
    if (total < constants->min_unsaturated_pixels) return constants->rounding_noise;
    double median = 0;
    for (int i = 0; i < LEVELS; i++) { /* the mean of both middle values */
        const int64_t before = seen;
        seen += counts[i];
        median += 0.5 * i * ((before <= (total - 1) / 2 && (total - 1) / 2 < seen) + (before <= total / 2 && total / 2 < seen));
    }
    return fmax(median / constants->median_difference, constants->rounding_noise);
}

/* Return whether a pixel shows something other than the marker (fitting/fit.py, `has_outlier_pixels`). */
static int may_be_occluded(const FollowConstants *constants, const Fit *fit, double noise) {
    return fit->peak > fmax(constants->outlier_share * fit->contrast, constants->outlier_sigmas * noise);
}

/* Return whether all fits are settled, verified, wholly visible and without a streak, or an error. */
static int32_t are_usual(const FollowRequest *given, Scratch *scratch, const FollowResults *results) {
    const FollowConstants *constants = given->constants;
    for (int64_t k = 0; k < results->here; k++)
        if (!is_settled(given, results, k)) return 0;
    const double noise = image_noise(given);
    if (!are_verified(&constants->verification, results->fits, results->cell_means, results->blurs, results->here, given->n,
                      noise, scratch->weighted))
        return 0;
    for (int64_t k = 0; k < results->here; k++)
        scratch->weighted[k] = (Weighted){results->fits[k].noise_std, results->fits[k].pixels};
    const double left = weighted_median(scratch->weighted, results->here);
    for (int64_t k = 0; k < results->here; k++)
        if (may_be_occluded(constants, results->fits + k, fmax(noise, left))) return 0;
    const int32_t streak = has_streak(given, results, scratch->cells, left);
    return streak < 0 ? streak : !streak;
}

static int is_request_sound(const FollowRequest *given) {
    const VerificationLimits *limits = &given->constants->verification;
    return given->count > 0 && given->height > 0 && given->width > 0 && given->n > 0 && given->n <= MAX_CELLS &&
           given->max_steps > 0 && given->fit_constants->max_box_markers > 0 && limits->table_size > 1 &&
           given->constants->streak_markers > 0 &&
           given->constants->streak_markers <= MAX_STREAK_MARKERS;
}

/* Follow the markers of `tracks` into an image.
 *
 * Returns FOLLOW_USUAL with all results; FOLLOW_FITTED with those of the fit, if something is unusual after it; or
 * FOLLOW_NOT_FITTED if no marker is in view or one is too large for a fit at full size; or an error. */
int32_t follow_markers(const FollowRequest *given, FollowResults *results) {
    if (!is_request_sound(given)) return FIT_INVALID_SIZE;
    find_in_view(given, results);
    int seen = results->here > 0;
    for (int64_t k = 0; k < results->here; k++) seen &= side_px(results->starts + k) <= given->constants->max_side_px;
    if (!seen) return FOLLOW_NOT_FITTED;
    Scratch scratch;
    int32_t result = allocate_scratch(&scratch, given);
    if (!result) result = fit_in_view(given, &scratch, results);
    int64_t next = 0;
    int is_missing = 0;
    for (int64_t k = 0; k < given->count; k++) {
        const int here = next < results->here && results->rows[next] == k;
        is_missing |= !here && results->should_be_seen[k];
        next += here;
    }
    if (!result) result = is_missing ? 0 : are_usual(given, &scratch, results);
    if (result >= 0) result = result ? FOLLOW_USUAL : FOLLOW_FITTED;
    if (result == FOLLOW_USUAL) learn(given, scratch.weighted, scratch.sigmas_px, results);
    release_scratch(&scratch);
    return result;
}
