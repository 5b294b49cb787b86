/* Whether fits show their markers and leave little but noise (vision/photometric/verify.py). */
#include "follow.h"

/* Residuals that one cell of the wrong colour would leave: their mean over the cell, and the root mean square of all
 * pixels; and the side of a cell, px. */
typedef struct { double mean, pixels, cell_px; } WrongCell;

static double interpolated(const VerificationLimits *limits, const double *table, double log_sigma) {
    const double range = limits->last_log_sigma - limits->first_log_sigma, last = limits->table_size - 1;
    const double place = (log_sigma - limits->first_log_sigma) / range * last;
    if (!(place > 0)) return table[0];
    if (place >= last) return table[limits->table_size - 1];
    const int32_t index = (int32_t)place;
    return table[index] + (place - index) * (table[index + 1] - table[index]);
}

static WrongCell wrong_cell(const VerificationLimits *limits, const Fit *fit, double blur_cells, int32_t n) {
    const double log_sigma = log(blur_cells) + limited(fit->log_blur, -1.0, 1.0);
    const double own = interpolated(limits, limits->own_cell, log_sigma);
    const double square = interpolated(limits, limits->square, log_sigma);
    const double contrast = fmax(fit->contrast, limits->min_divisor_contrast);
    const double cell_px = side_px(&fit->homography) / n;
    return (WrongCell){contrast * own * own, contrast * square * cell_px / sqrt(fmax(fit->pixels, 1.0)), cell_px};
}

/* Return whether a fit has cells, contrast, sharpness, a shape and pixels such as markers have. */
static int is_plausible(const VerificationLimits *limits, const Fit *fit, double cell_px, double blur_cells) {
    const Homography *at = &fit->homography;
    return cell_px >= limits->min_cell_px && fit->contrast >= limits->min_contrast && fit->black + fit->contrast <= limits->max_white &&
           blur_cells <= limits->max_blur_cells && fit->pixels / fabs(area_px2(at)) >= limits->min_area_share &&
           magnitude(at->anisotropy) / magnitude(at->similarity) <= limits->max_anisotropy &&
           magnitude(keystone_of(at, at->perspective)) <= limits->max_keystone;
}

/* Return whether all cells have the right colour, and residuals do not exceed the noise or what the model lacks. */
static int leaves_noise(const VerificationLimits *limits, const Fit *fit, const WrongCell *wrong, const double *means,
                        double blur_cells, int32_t cells, double noise) {
    double worst = 0, squares = 0;
    for (int32_t i = 0; i < cells; i++) {
        worst = fmax(worst, fabs(means[i]));
        squares += means[i] * means[i];
    }
    worst /= wrong->mean;
    const double per_cell = 1 / (wrong->mean * wrong->cell_px), cell_noise = fit->noise_std * per_cell;
    const double usual = fmin(limits->wrong_cell_share + limits->wrong_cell_sigmas * cell_noise, limits->wrong_cell_limit);
    const double weak = hypot(limits->weak_cell_share, limits->wrong_cell_sigmas * noise * per_cell);
    double model = fmin(limits->model_share * fmin(1.0, limits->sharp_blur_cells / blur_cells) * fit->contrast,
                        sqrt(limits->wrong_bits) * wrong->pixels);
    if (!limits->is_strong && noise > limits->max_processed_noise * fit->contrast) model = 0;
    const double allowed = limits->noise_factor * noise;
    return worst <= (limits->is_strong ? limits->strong_cell_limit : fmin(usual, weak)) &&
           fit->moved_px <= limits->max_last_step_px && cell_noise <= limits->max_cell_noise &&
           fit->noise_std <= fmax(allowed, model) &&
           sqrt(squares / cells) <= fmax(allowed / wrong->cell_px, limits->cell_model_share * fit->contrast);
}

/* Return the print contrast, (white - black) / white. */
static double print_contrast(const Fit *fit) { return fit->contrast / fmax(fit->black + fit->contrast, 1.0); }

/* Return whether all of `count` fits show their markers.
 *
 * cell_means (count, n, n) and blurs (count,), in sides, are of the fits; noise is that of the image. */
int are_verified(const VerificationLimits *limits, const Fit *fits, const double *cell_means, const double *blurs,
                 int64_t count, int32_t n, double noise, Weighted *scratch) {
    const int32_t cells = n * n;
    for (int64_t k = 0; k < count; k++) {
        const double blur_cells = blurs[k] * n;
        const WrongCell wrong = wrong_cell(limits, fits + k, blur_cells, n);
        if (!is_plausible(limits, fits + k, wrong.cell_px, blur_cells)) return 0;
        if (!leaves_noise(limits, fits + k, &wrong, cell_means + k * cells, blur_cells, cells, noise)) return 0;
        scratch[k] = (Weighted){print_contrast(fits + k), fits[k].pixels};
    }
    const double least = limits->min_print_share * weighted_median(scratch, count);
    for (int64_t k = 0; k < count; k++)
        if (!(print_contrast(fits + k) >= least)) return 0;
    return 1;
}
