/* Fits of markers of all sizes under blurs that are not known (vision/photometric/refine.py).
 *
 * A round fits some markers, each in an image that is shrunk until the marker is no larger than `max_side_px`. Those that may
 * be markers, and whose blur is not the one that was assumed, are fitted again in the next round about the blur found.
 */
#include "marker_pixels.h"
#include "search.h"

#include <stdlib.h>
#include <string.h>

enum { MAX_OCTAVES = 16, NOT_DUE = -1 };

/* Variance of a square pixel, px². */
static const double PIXEL_VARIANCE = 1.0 / 12;

/* Return how a marker looks under a blur, in sides (fitting/appearance.py). */
Appearance appearance_of(const AppearanceConstants *constants, double sigma, Surroundings around) {
    const double quiet = constants->quiet, outside = constants->outside_sigmas * sigma, ratio = constants->black_ratio;
    const double beyond = limited(quiet - constants->inside_sigmas * sigma, 0.0, outside);
    const int reaches_ground = quiet - beyond < constants->ground_sigmas * sigma;
    if (!isnan(around.level)) return (Appearance){sigma, 0.5 + outside, INFINITY, ratio, around};
    return (Appearance){sigma, 0.5 + beyond, reaches_ground ? 0.5 + quiet : INFINITY, ratio, around};
}

/* Return the blur that a fit found within the limits that markers are fitted under, px. */
double within_blur_limits(const BlurConstants *limits, const Fit *fit, int32_t n) {
    const double most = fmax(limits->max_sigma_cells * side_px(&fit->homography) / n, limits->min_sigma_px);
    return limited(fit->sigma_px, limits->min_sigma_px, most);
}

/* Return whether a fit may yet be of a marker: with contrast, and no cell quite wrong. */
int is_promising(const BlurConstants *limits, const Fit *fit, const double *cell_means, int32_t n) {
    double worst = 0;
    for (int32_t i = 0; i < n * n; i++) worst = fmax(worst, fabs(cell_means[i]));
    return fit->contrast >= limits->min_contrast && worst < limits->max_wrong_share * fit->contrast;
}

/* An image shrunk by means over shrink x shrink pixels; `memory` is its own, if it has any. */
typedef struct { const uint8_t *pixels; uint8_t *memory; int64_t height, width; double shrink; } Level;

/* What a call needs. Arrays are (count,) and have those markers of a round that are fitted in one image. */
typedef struct {
    Level levels[MAX_OCTAVES];
    int64_t *rows;
    Homography *start;
    Appearance *appearances;
    float *cells;
    Fit *fits;
    double *cell_means;
    int32_t *octaves;               /* in which a marker is fitted in this round; NOT_DUE if in none */
    int64_t count;
} Work;

static int32_t allocate_work(Work *work, const FitRequest *markers) {
    const size_t count = (size_t)markers->count, n = (size_t)markers->n;
    *work = (Work){
        .levels = {{markers->image, NULL, markers->height, markers->width, 1}},
        .rows = malloc(count * sizeof *work->rows),
        .start = malloc(count * sizeof *work->start),
        .appearances = malloc(count * sizeof *work->appearances),
        .cells = malloc(count * (n + 2) * (n + 2) * sizeof *work->cells),
        .fits = malloc(count * sizeof *work->fits),
        .cell_means = malloc(count * n * n * sizeof *work->cell_means),
        .octaves = malloc(count * sizeof *work->octaves),
    };
    const int has_memory = work->rows && work->start && work->appearances && work->cells && work->fits && work->cell_means &&
                           work->octaves;
    return has_memory ? 0 : FIT_NO_MEMORY;
}

static void release_work(Work *work) {
    for (int octave = 0; octave < MAX_OCTAVES; octave++) free(work->levels[octave].memory);
    free(work->rows);
    free(work->start);
    free(work->appearances);
    free(work->cells);
    free(work->fits);
    free(work->cell_means);
    free(work->octaves);
}

/* Shrink the image for an octave, unless that is done. Returns 0 or an error. */
static int32_t shrink_image(Work *work, int octave) {
    const Level full = work->levels[0];
    Level *own = work->levels + octave;
    if (own->pixels) return 0;
    const int32_t shrink = 1 << octave;
    *own = (Level){NULL, NULL, full.height / shrink, full.width / shrink, shrink};
    uint16_t *sums = malloc((size_t)full.width * sizeof *sums);
    own->memory = malloc((size_t)(own->height * own->width) + 1);
    own->pixels = own->memory;
    const int32_t result = !sums || !own->memory ? FIT_NO_MEMORY
                                                 : block_means(full.pixels, (int32_t)full.width, (int32_t)full.height, shrink,
                                                               sums, own->memory);
    free(sums);
    return result;
}

/* Return how often the image is halved for a marker; a pixel at least is left of it. */
static int octave_of(const BlurRequest *given, const Homography *at) {
    const int64_t height = given->markers->height, width = given->markers->width, shorter = height < width ? height : width;
    int octave = 0;
    for (double side = side_px(at); side > given->max_side_px && octave < MAX_OCTAVES - 1 && shorter >> (octave + 1); side /= 2)
        octave++;
    return octave;
}

/* Return a blur of lens and pixel together in an image that is shrunk; a factor below 1 enlarges. */
static double shrunk_blur(double sigma_px, double shrink) {
    const double lens = fmax(sigma_px * sigma_px - PIXEL_VARIANCE, 0.0);
    return shrink == 1 ? sigma_px : sqrt(lens / (shrink * shrink) + PIXEL_VARIANCE);
}

/* Return a homography into the shrunk image; pixel centres have whole coordinates. A factor below 1 enlarges. */
static Homography shrunk_homography(const Homography *at, double shrink) {
    const Complex middle = {(shrink - 1) / 2, (shrink - 1) / 2};
    return (Homography){scaled(minus(at->center, middle), 1 / shrink), scaled(at->similarity, 1 / shrink),
                        scaled(at->anisotropy, 1 / shrink), scaled(at->perspective, shrink)};
}

static Plane shrunk_plane(const Plane *plane, double shrink) {
    Plane made = *plane;
    made.perspective = scaled(plane->perspective, shrink);
    for (int i = 0; i < 4; i++) {
        const double units = (i / 2 ? shrink : 1) * (i % 2 ? shrink : 1);
        made.covariance[i] = scaled(plane->covariance[i], units);
    }
    return made;
}

/* Return a result of the shrunk image in pixels of the full-size one. */
static Fit full_size(const Fit *fit, double shrink) {
    Fit made = *fit;
    if (shrink == 1) return made;
    made.homography = shrunk_homography(&fit->homography, 1 / shrink);
    made.sigma_px = shrunk_blur(fit->sigma_px, 1 / shrink);
    made.pixels *= shrink * shrink;
    made.moved_px *= shrink;
    for (int i = 0; i < 9; i++) made.covariance[i] *= (i / 3 < 2 ? shrink : 1) * (i % 3 < 2 ? shrink : 1);
    return made;
}

/* Collect the markers that are due and fitted in the image of an octave. */
static void collect(const BlurRequest *given, int octave, const double *sigmas_px, const Fit *fits, double *blurs, Work *work) {
    const FitRequest *markers = given->markers;
    const size_t cells = ((size_t)markers->n + 2) * ((size_t)markers->n + 2);
    const double shrink = work->levels[octave].shrink;
    work->count = 0;
    for (int64_t k = 0; k < markers->count; k++) {
        if (work->octaves[k] != octave) continue;
        const Homography at = shrink == 1 ? fits[k].homography : shrunk_homography(&fits[k].homography, shrink);
        blurs[k] = shrunk_blur(sigmas_px[k], shrink) * blur_per_px(&at);
        work->rows[work->count] = k;
        work->start[work->count] = at;
        work->appearances[work->count] = appearance_of(given->looks, blurs[k], fits[k].around);
        memcpy(work->cells + (size_t)work->count * cells, markers->cells + (size_t)k * cells, cells * sizeof *work->cells);
        work->count++;
    }
}

/* Fit the collected markers in the image of an octave from a plane on, and put the results in place, before which the markers
 * begin there. plane becomes the one found. Returns 0 or an error. */
static int32_t fit_collected(const BlurRequest *given, int octave, int32_t max_steps, Plane *plane, Work *work, Fit *fits,
                             double *cell_means) {
    const FitRequest *markers = given->markers;
    const Level *level = work->levels + octave;
    const double shrink = level->shrink, pixels = shrink * shrink;
    const double noise = shrink == 1 ? markers->noise : sqrt(markers->noise * markers->noise / pixels + PIXEL_VARIANCE);
    const size_t cells = (size_t)markers->n * (size_t)markers->n;
    FitRequest own = *markers;
    own.image = level->pixels, own.height = level->height, own.width = level->width;
    own.start = work->start, own.appearances = work->appearances, own.cells = work->cells, own.count = work->count;
    own.noise = noise, own.texture = given->looks->texture / noise;
    own.streak_px2 = scaled(markers->streak_px2, 1 / pixels);
    own.max_steps = max_steps;
    if (shrink != 1) *plane = shrunk_plane(plane, shrink);
    const int32_t result = fit_markers(&own, plane, work->fits, work->cell_means);
    if (shrink != 1) *plane = shrunk_plane(plane, 1 / shrink);
    for (int64_t i = 0; i < work->count && !result; i++) {
        fits[work->rows[i]] = full_size(work->fits + i, shrink);
        memcpy(cell_means + (size_t)work->rows[i] * cells, work->cell_means + (size_t)i * cells, cells * sizeof *cell_means);
    }
    return result;
}

/* Fit the markers that are due, each in the image that suits it. plane becomes that of the smallest ones. */
static int32_t fit_due(const BlurRequest *given, int32_t max_steps, Plane *plane, const double *sigmas_px, Work *work, Fit *fits,
                       double *cell_means, double *blurs) {
    const Plane known = *plane;
    int used[MAX_OCTAVES] = {0}, is_first = 1;
    for (int64_t k = 0; k < given->markers->count; k++)
        if (work->octaves[k] != NOT_DUE) used[work->octaves[k]] = 1;
    for (int octave = 0; octave < MAX_OCTAVES; octave++) {
        if (!used[octave]) continue;
        Plane own = known;
        int32_t result = shrink_image(work, octave);
        if (result) return result;
        collect(given, octave, sigmas_px, fits, blurs, work);
        result = fit_collected(given, octave, max_steps, &own, work, fits, cell_means);
        if (result) return result;
        if (is_first) *plane = own;
        is_first = 0;
    }
    return 0;
}

/* Choose the markers for another round: those that may be such, and whose blur is not the one that was assumed. The blur
 * found is assumed next. Returns how many there are. */
static int64_t choose_unsettled(const BlurRequest *given, const Fit *fits, const double *cell_means, double *sigmas_px,
                                Work *work) {
    const FitRequest *markers = given->markers;
    int64_t count = 0;
    for (int64_t k = 0; k < markers->count; k++) {
        const double found_px = within_blur_limits(given->limits, fits + k, markers->n);
        const int is_due = is_promising(given->limits, fits + k, cell_means + k * markers->n * markers->n, markers->n) &&
                           fabs(log(found_px / sigmas_px[k])) > given->limits->settled;
        work->octaves[k] = is_due ? octave_of(given, &fits[k].homography) : NOT_DUE;
        if (is_due) sigmas_px[k] = found_px;
        count += is_due;
    }
    return count;
}

/* Fit all markers. Returns 0 or an error. */
static int32_t fit_first(const BlurRequest *given, Plane *plane, const double *sigmas_px, Work *work, Fit *fits,
                         double *cell_means, double *blurs) {
    const FitRequest *markers = given->markers;
    for (int64_t k = 0; k < markers->count; k++) {
        fits[k].homography = markers->start[k];
        fits[k].around = given->around[k];
        work->octaves[k] = octave_of(given, markers->start + k);
    }
    return fit_due(given, markers->max_steps, plane, sigmas_px, work, fits, cell_means, blurs);
}

/* Fit markers that lie near `start` until they have found the blurs that were assumed.
 *
 * plane is the known one, and then that which the first fit of the smallest markers found. sigmas_px (count,) are the blurs
 * that the first fit assumes, and then the last one. fits (count,), cell_means (count, n, n), the mean residual over each
 * cell, and blurs (count,), those of the last fit in sides, are results; they are given if the first fit is known. Returns 0 or
 * an error. */
int32_t fit_any_blur(const BlurRequest *given, Plane *plane, double *sigmas_px, Fit *fits, double *cell_means, double *blurs) {
    const BlurConstants *limits = given->limits;
    if (!is_request_valid(given->markers) || !(given->max_side_px > 0) || limits->steps_per_round <= 0) return FIT_INVALID_SIZE;
    Work work;
    int32_t result = allocate_work(&work, given->markers);
    if (!result && !given->is_fitted) result = fit_first(given, plane, sigmas_px, &work, fits, cell_means, blurs);
    for (int32_t round = 0; round < given->rounds && !result; round++) {
        Plane settled = *plane;
        if (!choose_unsettled(given, fits, cell_means, sigmas_px, &work)) break;
        result = fit_due(given, limits->steps_per_round, &settled, sigmas_px, &work, fits, cell_means, blurs);
    }
    release_work(&work);
    return result;
}
