/* The ground: a periodic texture, sampled bilinearly at the place of each pixel.
 *
 * A period has n samples, n a power of two. Places are in samples modulo n, in fixed point with 16 binary decimals. The
 * texture has n rows of `stride` pairs: each sample and its lower neighbour. Column n repeats the first one, so that
 * the four samples around a place are four adjacent bytes. Weights have 8 binary decimals.
 */
#include "render.h"

#include <math.h>

enum { GROUP = 512, CHUNK = 64, PART = 32, FIXED_BITS = 16, MAX_SAMPLES = 1 << 14 };

/* Difference of a homography's last row from (0, 0, 1) below which it is affine. Derived: over images of 1e4 px and
 * textures of 1e4 samples a place moves by 1e-4 of a sample. */
static const double AFFINE = 1e-12;

/* Relative change of W along PART pixels below which their places are interpolated by a parabola. Derived: the error is
 * below 0.05 of its square times the distance of the places, 0.003 of a sample. */
static const double MAX_CHANGE = 0.04;

/* Places of pixels of a row, at most GROUP. Chosen: a processor waits for single bytes that are read again as vectors;
 * groups of 512 take two thirds of the time of groups of 64. */
typedef struct { uint32_t x[GROUP], y[GROUP]; } FixedPlaces;

/* Return a place modulo the period in fixed point, with 1 / samples, which is exact. Not finite places become 0. */
static inline uint32_t fixed(double place, double samples, double share) {
    const double periods = place * share, within = periods - floor(periods);
    return (uint32_t)(int32_t)((within >= 0 ? within : 0) * (samples * (1 << FIXED_BITS)) + 0.5);
}

/* Compute the places of `count` pixels of row v from column u on, without lens and perspective. */
static void locate_affine(const double m[9], int32_t u, int32_t v, int32_t count, double samples,
                          FixedPlaces *restrict places) {
    const double share = 1 / samples;
    const uint32_t step_x = fixed(m[0], samples, share), step_y = fixed(m[3], samples, share);
    for (int32_t from = 0; from < count; from += CHUNK) {
        const uint32_t x = fixed(m[0] * (u + from) + m[1] * v + m[2], samples, share);
        const uint32_t y = fixed(m[3] * (u + from) + m[4] * v + m[5], samples, share);
        for (uint32_t i = 0; i < CHUNK; i++) {
            places->x[from + i] = x + i * step_x;
            places->y[from + i] = y + i * step_y;
        }
    }
}

/* Write the places 0..PART-1 on a parabola through three of them: 0, PART / 2 and PART. */
static void interpolate(double first, double middle, double last, double samples, uint32_t *restrict places) {
    const float linear = (float)((4 * middle - 3 * first - last) / PART);
    const float square = (float)((2 * first - 4 * middle + 2 * last) / (PART * PART));
    const uint32_t from = fixed(first, samples, 1 / samples);
    for (int i = 0; i < PART; i++) {
        const float at = (float)i;
        places[i] = from + (uint32_t)(int32_t)((linear + square * at) * at * (1 << FIXED_BITS));
    }
}

/* Compute the places of PART pixels without lens, or return 0 where they change too fast to be interpolated. */
static int locate_tilted(const double m[9], int32_t u, int32_t v, double samples, uint32_t *restrict x,
                         uint32_t *restrict y) {
    double at_x[3], at_y[3];
    const double w = m[6] * u + m[7] * v + m[8];
    if (!(fabs(m[6]) * PART < MAX_CHANGE * w)) return 0;
    for (int node = 0; node < 3; node++) {
        const double column = u + node * (PART / 2), scale = 1 / (m[6] * column + m[7] * v + m[8]);
        at_x[node] = (m[0] * column + m[1] * v + m[2]) * scale;
        at_y[node] = (m[3] * column + m[4] * v + m[5]) * scale;
    }
    if (!(fabs(at_x[2] - at_x[0]) < MAX_SAMPLES && fabs(at_y[2] - at_y[0]) < MAX_SAMPLES)) return 0;
    interpolate(at_x[0], at_x[1], at_x[2], samples, x);
    interpolate(at_y[0], at_y[1], at_y[2], samples, y);
    return 1;
}

/* Compute the places of PART pixels of row v from column u on, through the lens if there is one. */
static void locate_bent(const Canvas *canvas, const double m[9], int32_t u, int32_t v, double samples,
                        uint32_t *restrict x, uint32_t *restrict y) {
    const ptrdiff_t pixels = (ptrdiff_t)canvas->width * canvas->height, at = (ptrdiff_t)v * canvas->width + u;
    const double share = 1 / samples;
    float du[PART] = {0}, dv[PART] = {0};
    for (int i = 0; canvas->lens && i < PART && u + i < canvas->width; i++) {
        du[i] = canvas->lens[at + i];
        dv[i] = canvas->lens[pixels + at + i];
    }
    for (int i = 0; i < PART; i++) {
        const double column = u + i + du[i], row = v + dv[i];
        const double scale = 1 / (m[6] * column + m[7] * row + m[8]);
        x[i] = fixed((m[0] * column + m[1] * row + m[2]) * scale, samples, share);
        y[i] = fixed((m[3] * column + m[4] * row + m[5]) * scale, samples, share);
    }
}

/* Compute the places of `count` pixels of row v from column u on. */
static void locate_ground(const Canvas *canvas, const double m[9], int32_t u, int32_t v, int32_t count, double samples,
                          FixedPlaces *restrict places) {
    for (int from = 0; from < count; from += PART) {
        uint32_t *x = places->x + from, *y = places->y + from;
        if (canvas->lens || !locate_tilted(m, u + from, v, samples, x, y))
            locate_bent(canvas, m, u + from, v, samples, x, y);
    }
}

/* Return four bytes as a number, the first one lowest: one load on little-endian processors. */
static inline uint32_t quad(const uint8_t *at) {
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

/* Interpolate the texture at `count` places. Both columns of a quad are interpolated in the halves of one number. */
static void sample(const uint8_t *restrict texture, int32_t stride, uint32_t mask, const FixedPlaces *restrict places,
                   int32_t count, uint8_t *restrict levels) {
    uint32_t at[GROUP];
    for (int i = 0; i < count; i++)
        at[i] = 2 * ((places->y[i] >> FIXED_BITS & mask) * (uint32_t)stride + (places->x[i] >> FIXED_BITS & mask));
    for (int i = 0; i < count; i++) {
        at[i] = quad(texture + at[i]);
        __asm__ volatile("" ::: "memory"); /* scalar loads: gathered into vectors they take a third longer */
    }
    for (int i = 0; i < count; i++) {
        const uint32_t upper = at[i] & 0xff00ff, lower = at[i] >> 8 & 0xff00ff;
        const uint32_t columns = (upper << 8) + (lower - upper) * (places->y[i] >> 8 & 255);
        const uint32_t left = columns & 0xffff, right = columns >> 16;
        levels[i] = (uint8_t)(((left << 8) + (right - left) * (places->x[i] >> 8 & 255) + (1 << 15)) >> 16);
    }
}

static int is_affine(const double m[9]) {
    return fabs(m[6]) < AFFINE * fabs(m[8]) && fabs(m[7]) < AFFINE * fabs(m[8]);
}

/* Draw the ground into an image of 8 bits.
 *
 * `matrices` (instants, 3, 3) map undistorted pixels to samples. `texture` has `samples` rows of `stride` pairs.
 */
int32_t draw_ground(const Canvas *canvas, const double *matrices, int32_t instants, const uint8_t *texture,
                    int32_t samples, int32_t stride) {
    if (!is_valid_canvas(canvas) || !canvas->image) return INVALID_CANVAS;
    if (!matrices || (instants != 1 && instants != 3)) return INVALID_SHAPES;
    if (!texture || samples < 2 || samples > MAX_SAMPLES || (samples & (samples - 1)) || stride <= samples ||
        stride > 2 * MAX_SAMPLES)
        return INVALID_TEXTURE;
    FixedPlaces places;
    double m[9];
    for (int32_t v = 0; v < canvas->height; v++) {
        matrix_of_row(matrices, 1, instants, 0, canvas->row_times[v], m);
        const int affine = !canvas->lens && is_affine(m);
        for (int i = 0; affine && i < 6; i++) m[i] /= m[8];
        uint8_t *row = canvas->image + (ptrdiff_t)v * canvas->width;
        for (int32_t u = 0; u < canvas->width; u += GROUP) {
            const int32_t count = canvas->width - u < GROUP ? canvas->width - u : GROUP;
            if (affine) locate_affine(m, u, v, count, samples, &places);
            else locate_ground(canvas, m, u, v, count, samples, &places);
            sample(texture, stride, (uint32_t)samples - 1, &places, count, row + u);
        }
    }
    return 0;
}
