/* One marker's pixels and the model's columns at them, from its homography and appearance. */
#include "marker_pixels.h"

#include <stdlib.h>

/* Return the record of a marker, from which its pixels are listed and drawn. */
static Marker marker_of(const Homography *at, const Appearance *look, int round_in_image, const FitConstants *constants) {
    const Complex m = at->similarity, k = at->anisotropy, relative = over(k, m);
    const Complex right = plus(m, k), down = minus(m, k), one = complex_of(1);
    const double area = area_px2(at), spread = sqrt(1 + squared(relative));
    const double growth = magnitude(keystone_of(at, at->perspective)) * sqrt(2.0) * look->limit;
    const double strip = look->limit / (1 - (growth < constants->max_growth ? growth : constants->max_growth));
    Marker marker = {
        .center = at->center,
        .x_axis = scaled(down, 1 / area),
        .y_axis = scaled(times_i(right), 1 / area),
        .perspective = at->perspective,
        .limit = look->limit,
        .strip = strip,
        .height_px = strip * (fabs(right.im) + fabs(down.re)),
        .sigma = limited(look->sigma, constants->min_sigma, constants->max_sigma),
        .black_ratio = look->black_ratio,
        .half_card = look->half_card,
        .x_stretch = magnitude(minus(one, relative)) / spread,
        .y_stretch = magnitude(plus(one, relative)) / spread,
        .ground_level = is_bare(look) ? look->around.level : 0,
        .is_bare = is_bare(look),
    };
    if (round_in_image) {
        marker.keystone = times(at->perspective, conjugate(m));
        marker.anisotropy = blur_anisotropy(at);
    }
    return marker;
}

static int is_elliptic(const FitRequest *given, const Homography *at, int round_in_image) {
    if (given->has_streak) return 1;
    return round_in_image &&
           magnitude(at->anisotropy) > given->constants->steep_anisotropy * magnitude(at->similarity);
}

/* Compute the variances along x and y and the covariance, in sides squared, that a streak Q, px², adds to a blur
 * (fitting/design_matrix.py). */
void streak_moments(const Homography *at, Complex streak, double table[3]) {
    const Complex m = conjugate(at->similarity), k = at->anisotropy;
    const Complex along = plus(times(times(m, m), streak), times(times(k, k), conjugate(streak)));
    const double area = area_px2(at), absolute = -2 * times(times(m, conjugate(k)), streak).re;
    table[0] = (absolute + along.re) / (area * area);
    table[1] = (absolute - along.re) / (area * area);
    table[2] = along.im / (area * area);
}

/* Compute a blur's table (6,) for `fill_elliptic`: of round blur, and of the streak as far as that has room for it. */
static void blur_table(const FitRequest *given, const Homography *at, double sigma, double table[6]) {
    const double sigma_px = sigma / blur_per_px(at), length = magnitude(given->streak_px2);
    const double room = fmax(sigma_px * sigma_px - given->constants->min_variance_px2, 0.0) / fmax(length, 1e-12);
    const Complex square = scaled(blur_anisotropy(at), -2 * sigma * sigma);
    const double round[3] = {sigma * sigma + square.re, sigma * sigma - square.re, square.im};
    double streak[3];
    streak_moments(at, scaled(given->streak_px2, room < 1 ? room : 1.0), streak);
    for (int i = 0; i < 3; i++) {
        table[i] = round[i] + streak[i];
        table[3 + i] = 2 * round[i];
    }
}

/* A block of a column then lies in one line of the cache, and is read at once. */
enum { CACHE_LINE_BYTES = 64 };

/* Give a marker's arrays room for so many blocks of pixels. */
static int32_t make_room(Pixels *own, int64_t room) {
    if (room <= own->room) return 0;
    free(own->memory);
    own->room = 0;
    const size_t pixels = (size_t)room * BLOCK_PX;
    own->memory = malloc(pixels * ((COLUMNS + 2 + 3) * sizeof *own->columns + 2 * sizeof *own->pixels) + CACHE_LINE_BYTES);
    if (!own->memory) return FIT_NO_MEMORY;
    own->room = room;
    own->columns = (float *)(void *)(own->memory + (CACHE_LINE_BYTES - (uintptr_t)own->memory % CACHE_LINE_BYTES));
    own->places = own->columns + pixels * COLUMNS;
    own->bends = own->places + pixels * 2;
    own->pixels = (int32_t *)(own->bends + pixels * 3);
    return 0;
}

MarkerBlocks blocks_of(const Pixels *own) {
    return (MarkerBlocks){own->bounds, &own->count, own->places, own->pixels, own->columns, 1, own->bounds[1]};
}

void release_pixels(Pixels *own) { free(own->memory); }

/* Ask for the image's pixels of a marker. They lie on many lines, which processors do not foresee. */
static void prefetch(const uint8_t *image, int64_t width, const Pixels *own) {
    enum { STEP = BLOCK_PX / 2 };
    for (int64_t at = 0; at < own->count; at += STEP) {
        const int32_t *pixels = own->pixels + at / BLOCK_PX * (2 * BLOCK_PX) + at % BLOCK_PX;
        __builtin_prefetch(image + pixels[0] * width + pixels[BLOCK_PX]);
    }
}

/* Read the pixels of marker k about a homography, and compute the model's columns at them. Returns 0 or an error. */
int32_t draw_marker(const FitRequest *given, const Homography *at, const Appearance *look, int round_in_image, Pixels *own,
                    int64_t k) {
    const int elliptic = is_elliptic(given, at, round_in_image);
    const int64_t sides = given->n + 2;
    Marker marker = marker_of(at, look, round_in_image, given->constants);
    const int32_t result = make_room(own, count_blocks(&marker, 1, given->height, given->width));
    if (result) return result;
    list_pixels(&marker, 1, given->height, given->width, own->bounds, &own->count, own->places, own->pixels, own->room);
    prefetch(given->image, given->width, own);
    const float texture = (float)(is_bare(look) ? look->around.texture / given->noise : given->texture);
    const Scene scene = {given->image, &marker, given->cells + k * sides * sides, given->height, given->width, given->n,
                         texture * texture};
    const MarkerBlocks blocks = blocks_of(own);
    if (!elliptic) return fill_round(&scene, &blocks);
    double table[6];
    blur_table(given, at, marker.sigma, table);
    marker.keystone = keystone_of(at, at->perspective);
    return fill_elliptic(&scene, &blocks, table, own->bends);
}

/* Solve for all unknowns of marker k from the columns of its pixels, of which so many are used. */
void solve_marker(const FitRequest *given, const Pixels *own, int64_t used, Solutions *solutions, int64_t k) {
    const MarkerBlocks blocks = blocks_of(own);
    float gram[COLUMNS * COLUMNS];
    gram_matrices(&blocks, gram);
    solve(gram, given->constants, solutions, k);
    solutions->pixels[k] = (double)used;
}
