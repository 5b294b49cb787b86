/* What an image adds to the estimates of a camera, and its detections (vision/photometric/state.py, refine.py). */
#include "follow.h"

#include <stdlib.h>

static int by_value(const void *one, const void *other) {
    const double a = ((const Weighted *)one)->value, b = ((const Weighted *)other)->value;
    return (a > b) - (a < b);
}

/* Return the value at which the weights, summed in order of value, reach one half. Sorts the values. */
double weighted_median(Weighted *values, int64_t count) {
    double total = 0, sum = 0;
    qsort(values, (size_t)count, sizeof *values, by_value);
    for (int64_t k = 0; k < count; k++) total += values[k].weight;
    for (int64_t k = 0; k < count; k++) {
        sum += values[k].weight;
        if (sum >= total / 2) return values[k].value;
    }
    return values[count - 1].value;
}

/* Return an earlier estimate moved towards a value, or the value if there is none. */
static double moved_towards(const FollowConstants *constants, double value, double before) {
    return isnan(before) ? value : before + constants->learning_rate * (value - before);
}

/* Which quantity of fits is meant. */
typedef enum { SIGMA, NOISE, CONTRAST_LEVEL, PRINT } Quantity;

static double quantity_of(const FollowRequest *given, const Fit *fit, Quantity quantity) {
    if (quantity == SIGMA) return within_blur_limits(&given->constants->blur, fit, given->n);
    if (quantity == NOISE) return fit->noise_std;
    if (quantity == CONTRAST_LEVEL) return fit->contrast;
    return fit->contrast / fmax(fit->black + fit->contrast, 1.0);
}

static double usual(const FollowRequest *given, const FollowResults *results, Quantity quantity, Weighted *scratch) {
    for (int64_t k = 0; k < results->here; k++)
        scratch[k] = (Weighted){quantity_of(given, results->fits + k, quantity), results->fits[k].pixels};
    return weighted_median(scratch, results->here);
}

/* Pool the ratios of the markers' variances to those of independent noise with those of the images before. */
static void pool_ratios(const FollowConstants *constants, FollowResults *results) {
    const double kept = 1 - constants->forgotten;
    double sums[2] = {0}, boxes = 0;
    for (int64_t k = 0; k < results->here; k++) {
        const Fit *fit = results->fits + k;
        for (int part = 0; part < 2; part++) sums[part] += fit->boxes * fit->ratios[part];
        boxes += fit->boxes;
    }
    Estimates *own = &results->estimates;
    for (int part = 0; part < 2; part++) own->ratio_sums[part] = kept * own->ratio_sums[part] + sums[part];
    own->ratio_boxes = kept * own->ratio_boxes + boxes;
}

/* Return the factor of standard deviations of positions (0) or headings (1); 1 if it is not significant. */
static double std_factor(const FollowConstants *constants, const Estimates *own, int part) {
    if (!(own->ratio_boxes > 0)) return 1;
    const double pooled = limited(own->ratio_sums[part] / own->ratio_boxes, constants->min_ratio, constants->max_ratio);
    return fabs(pooled - 1) > constants->significant_ratio_error / sqrt(own->ratio_boxes) ? sqrt(pooled) : 1.0;
}

static void write_detections(const FollowConstants *constants, FollowResults *results) {
    static const Complex corners[4] = {{-0.5, -0.5}, {0.5, -0.5}, {0.5, 0.5}, {-0.5, 0.5}};
    const double place = std_factor(constants, &results->estimates, 0), turn = std_factor(constants, &results->estimates, 1);
    const double scales[3] = {place, place, turn};
    for (int64_t k = 0; k < results->here; k++) {
        const Homography *at = &results->fits[k].homography;
        const Complex down = minus(at->similarity, at->anisotropy);
        Detection *made = results->detections + k;
        made->center = at->center;
        made->heading_rad = atan2(-down.re, down.im); /* of -i (m - k) */
        made->side_px = side_px(at);
        for (int corner = 0; corner < 4; corner++) made->corners[corner] = image_of(at, corners[corner]);
        for (int i = 0; i < 9; i++)
            made->covariance[i] = scales[i / 3] * results->fits[k].covariance[i] * scales[i % 3];
    }
}

/* Write the estimates after an image whose markers in view are all verified, its tracks and detections.
 *
 * scratch and sigmas_px (here,) are working memory. */
void learn(const FollowRequest *given, Weighted *scratch, double *sigmas_px, FollowResults *results) {
    const FollowConstants *constants = given->constants;
    const double usual_px = usual(given, results, SIGMA, scratch);
    Estimates *own = &results->estimates;
    *own = given->estimates;
    own->sigma_px = moved_towards(constants, usual_px, own->sigma_px);
    own->noise = moved_towards(constants, usual(given, results, NOISE, scratch), own->noise);
    own->contrast = moved_towards(constants, usual(given, results, CONTRAST_LEVEL, scratch), own->contrast);
    own->print_contrast = moved_towards(constants, usual(given, results, PRINT, scratch), own->print_contrast);
    pool_ratios(constants, results);
    for (int64_t k = 0; k < results->here; k++) {
        const double found_px = within_blur_limits(&constants->blur, results->fits + k, given->n);
        const int near = found_px == usual_px || fabs(log(found_px / usual_px)) < constants->max_log_blur_difference;
        sigmas_px[k] = near ? own->sigma_px : found_px;
    }
    update_tracks(given, sigmas_px, results);
    write_detections(constants, results);
}
