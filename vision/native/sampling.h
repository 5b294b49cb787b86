/* Grey levels between pixels. */
#ifndef SKYHERD_SAMPLING_H
#define SKYHERD_SAMPLING_H

#include <stddef.h>
#include <stdint.h>

typedef struct { double u, v; } Place;

/* Return a coordinate within 0 to `last`; what is no number counts as 0. */
static inline double within(double value, double last) { return value > 0 ? value < last ? value : last : 0.0; }

/* Places that are read at a time. */
enum { PLACES_AT_ONCE = 64 };

/* Write the grey levels at places by bilinear interpolation; places outside read the nearest pixel of the border.
 *
 * Only the loop that loads pixels is not vectorized. A place on the last column or row lies all the way to the next pixel of
 * the one before. */
static inline void read_grey(const uint8_t *image, int32_t width, int32_t height, const double *restrict u,
                             const double *restrict v, int32_t count, float *restrict grey) {
    int32_t at[PLACES_AT_ONCE], pixels[4][PLACES_AT_ONCE];
    float right[PLACES_AT_ONCE], down[PLACES_AT_ONCE];
    const int32_t last_column = width > 1 ? width - 2 : 0, last_row = height > 1 ? height - 2 : 0;
    for (int32_t i = 0; i < count; i++) {
        const double x = within(u[i], width - 1), y = within(v[i], height - 1);
        const int32_t column = (int32_t)x < last_column ? (int32_t)x : last_column;
        const int32_t row = (int32_t)y < last_row ? (int32_t)y : last_row;
        right[i] = (float)(x - column);
        down[i] = (float)(y - row);
        at[i] = row * width + column;
    }
    const ptrdiff_t next = width > 1, below = height > 1 ? width : 0;
    for (int32_t i = 0; i < count; i++) {
        const uint8_t *pixel = image + at[i];
        pixels[0][i] = pixel[0], pixels[1][i] = pixel[next];
        pixels[2][i] = pixel[below], pixels[3][i] = pixel[below + next];
    }
    for (int32_t i = 0; i < count; i++) {
        const float top = (float)pixels[0][i] + right[i] * (float)(pixels[1][i] - pixels[0][i]);
        const float bottom = (float)pixels[2][i] + right[i] * (float)(pixels[3][i] - pixels[2][i]);
        grey[i] = top + down[i] * (bottom - top);
    }
}

#endif
