/* Grey levels between pixels. */
#ifndef SKYHERD_SAMPLING_H
#define SKYHERD_SAMPLING_H

#include <stddef.h>
#include <stdint.h>

typedef struct { double u, v; } Place;

/* Return a coordinate within 0 to `last`; what is no number counts as 0. */
static inline double within(double value, double last) { return value > 0 ? value < last ? value : last : 0.0; }

/* Return the grey level at a place by bilinear interpolation; places outside read the nearest pixel of the border. */
static inline float grey_at(const uint8_t *image, int32_t width, int32_t height, Place at) {
    const double u = within(at.u, width - 1), v = within(at.v, height - 1);
    const int32_t column = (int32_t)u, row = (int32_t)v;
    const float right = (float)(u - column), down = (float)(v - row);
    const uint8_t *above = image + (ptrdiff_t)row * width + column, *below = above + (row + 1 < height ? width : 0);
    const int32_t next = column + 1 < width;
    const float top = (float)above[0] + right * (float)(above[next] - above[0]);
    const float bottom = (float)below[0] + right * (float)(below[next] - below[0]);
    return top + down * (bottom - top);
}

#endif
