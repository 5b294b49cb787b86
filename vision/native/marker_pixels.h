/* One marker's pixels, which a fit reads again from step to step. */
#ifndef SKYHERD_MARKER_PIXELS_H
#define SKYHERD_MARKER_PIXELS_H

#include "homography.h"

/* Pixels of a marker as they were last read; arrays have room for more. */
typedef struct {
    uint8_t *memory; /* of all arrays */
    float *places, *columns, *bends;
    int32_t *pixels;
    int64_t bounds[2], count, room; /* room in blocks */
} Pixels;

static inline double limited(double value, double low, double high) {
    return value < low ? low : value > high ? high : value;
}

/* Return whether a marker has no card. */
static inline int is_bare(const Appearance *look) { return !isnan(look->around.level); }

int32_t draw_marker(const FitRequest *given, const Homography *at, const Appearance *look, int round_in_image, Pixels *own,
                    int64_t k);
void solve_marker(const FitRequest *given, const Pixels *own, int64_t used, Solutions *solutions, int64_t k);
MarkerBlocks blocks_of(const Pixels *own);
void release_pixels(Pixels *own);
void streak_moments(const Homography *at, Complex streak, double table[3]);

#endif
