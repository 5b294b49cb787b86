/* Whether a few markers of an image show a streak of motion (vision/photometric/refine.py, fitting/streak_evidence.py). */
#include "follow.h"

#include <string.h>

/* The markers that are asked. */
typedef struct {
    Homography places[MAX_STREAK_MARKERS];
    Appearance appearances[MAX_STREAK_MARKERS];
    float cells[MAX_STREAK_MARKERS * (MAX_CELLS + 2) * (MAX_CELLS + 2)];
    int64_t count;
} Few;

static void add_marker(const FollowRequest *given, const Fit *fit, const float *cells, Few *few) {
    const size_t sides = (size_t)given->n + 2, size = sides * sides;
    Appearance *look = few->appearances + few->count;
    *look = appearance_of(&given->constants->looks, fit->sigma_px * blur_per_px(&fit->homography), fit->around);
    look->black_ratio = fit->black / fmax(fit->contrast, 1.0);
    few->places[few->count] = fit->homography;
    memcpy(few->cells + (size_t)few->count * size, cells, size * sizeof *cells);
    few->count++;
}

/* Choose every so many of the markers at full size, as long as they have no more pixels together than are asked. */
static void choose_few(const FollowRequest *given, const FollowResults *results, const float *cells, Few *few) {
    const FollowConstants *constants = given->constants;
    const int64_t size = (int64_t)(given->n + 2) * (given->n + 2), most = constants->streak_markers;
    int64_t telling = 0, number = 0;
    double pixels = 0;
    for (int64_t k = 0; k < results->here; k++)
        telling += side_px(&results->fits[k].homography) <= constants->max_side_px;
    const int64_t every = telling > most ? (telling + most - 1) / most : 1;
    for (int64_t k = 0; k < results->here; k++) {
        if (!(side_px(&results->fits[k].homography) <= constants->max_side_px) || number++ % every) continue;
        pixels += results->fits[k].pixels;
        if (few->count && !(pixels <= constants->streak_pixels)) return;
        add_marker(given, results->fits + k, cells + k * size, few);
    }
}

/* A symmetric matrix (2, 2): its elements xx, xy, yx and yy. */
typedef struct { double xx, xy, yx, yy; } Square;

static Square ridged(const double *information, double ridge) {
    return (Square){information[0] + ridge, information[1], information[2], information[3] + ridge};
}

static Complex solved(Square a, Complex b) {
    const double determinant = a.xx * a.yy - a.xy * a.yx;
    return (Complex){(a.yy * b.re - a.xy * b.im) / determinant, (a.xx * b.im - a.yx * b.re) / determinant};
}

static double product(Complex a, Complex b) { return a.re * b.re + a.im * b.im; }

/* Return whether the evidence of `count` markers is significant: the fall of the chi-squared with the change of the streak,
 * over what the markers then leave of theirs, a degree of freedom. */
static int is_significant(const FollowConstants *constants, const double *informations, const double *scores, int64_t count) {
    double sum[4] = {0}, squares = 0;
    Complex total = {0, 0};
    for (int64_t k = 0; k < count; k++) {
        for (int i = 0; i < 4; i++) sum[i] += informations[4 * k + i];
        total = plus(total, (Complex){scores[2 * k], scores[2 * k + 1]});
    }
    const Complex change = solved(ridged(sum, constants->streak_ridge), total);
    for (int64_t k = 0; k < count; k++) {
        const double *own = informations + 4 * k;
        const Complex explained = {own[0] * change.re + own[1] * change.im, own[2] * change.re + own[3] * change.im};
        const Complex left = minus((Complex){scores[2 * k], scores[2 * k + 1]}, explained);
        squares += product(left, solved(ridged(own, constants->streak_ridge), left));
    }
    const double freedom = 2 * ((double)count - 1), per = freedom > 0 ? fmax(1.0, squares / freedom) : 1;
    return !(product(total, change) / per < constants->significant) && !(magnitude(change) < constants->min_streak_px2);
}

/* Return whether verified markers show a streak of motion, or an error. `noise` is that of their pixels. */
int32_t has_streak(const FollowRequest *given, const FollowResults *results, const float *cells, double noise) {
    Few few = {.count = 0};
    double informations[4 * MAX_STREAK_MARKERS], scores[2 * MAX_STREAK_MARKERS];
    choose_few(given, results, cells, &few);
    if (!few.count) return 0;
    const FitRequest request = {
        .image = given->image,
        .start = few.places,
        .appearances = few.appearances,
        .cells = few.cells,
        .constants = given->fit_constants,
        .height = given->height,
        .width = given->width,
        .count = few.count,
        .texture = given->constants->looks.texture / noise,
        .noise = noise,
        .n = given->n,
        .max_steps = given->max_steps,
        .has_streak = 1,
    };
    const int32_t result = streak_evidence(&request, informations, scores);
    return result ? result : is_significant(given->constants, informations, scores, few.count);
}
