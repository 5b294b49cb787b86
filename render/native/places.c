/* Places of pixels in a shape, by the inverse of its homography, and the sharpness of edges there.
 *
 * With (X, Y, W) = M (u, v, 1), a pixel lies at x = X / W, y = Y / W. The gradient of x is (m_0 - x m_2) / W for the
 * rows m_i of M, times the derivatives of the lens. Its length times σ is the blur of lines of constant x.
 */
#include "render.h"

#include <math.h>
#include <string.h>

/* Change of W from pixel to pixel, relative to W, below which a row counts as affine. Derived: over 1000 pixels the
 * place is then off by 1e-4 of the distance. */
static const double AFFINE = 1e-7;

/* Least squared length of a gradient. Chosen: avoids 0 / 0 where an edge has no direction. */
static const double MIN_SQUARE = 1e-300;

enum { LENS_FIELDS = 6 };

/* Write the homography of a shape at the time of a row: the parabola through those of three instants at -1, 0, 1. */
void matrix_of_row(const double *matrices, int32_t count, int32_t instants, int32_t shape, double row_time,
                   double matrix[9]) {
    const double *first = matrices + 9 * (ptrdiff_t)shape;
    if (instants == 1) {
        memcpy(matrix, first, 9 * sizeof *matrix);
        return;
    }
    const double *middle = first + 9 * (ptrdiff_t)count, *last = middle + 9 * (ptrdiff_t)count;
    const double before = row_time * (row_time - 1) / 2, at = 1 - row_time * row_time,
                 after = row_time * (row_time + 1) / 2;
    for (int i = 0; i < 9; i++) matrix[i] = before * first[i] + at * middle[i] + after * last[i];
}

static double length(double u, double v) {
    const double square = u * u + v * v;
    return sqrt(square > MIN_SQUARE ? square : MIN_SQUARE);
}

/* Return the row of the table for edges with a normal (u, v): the nearest one in cos 4α = cos² 2α - sin² 2α. */
static int32_t direction_of(double u, double v, int32_t directions) {
    const double uu = u * u, vv = v * v, sum = uu + vv, difference = uu - vv;
    const double square = sum * sum > MIN_SQUARE ? sum * sum : MIN_SQUARE;
    const double cos_4_alpha = (difference * difference - 4 * uu * vv) / square;
    return (int32_t)clamped(rint((1 - cos_4_alpha) / 2 * (directions - 1)), 0, directions - 1);
}

/* Begin a run with the geometry of its first pixel without the lens. The matrix is already set. */
void begin_run(const Canvas *canvas, const EdgeSpread *spread, int32_t v, int32_t first_u, int32_t end_u, Run *run) {
    const double *m = run->matrix;
    const double w = m[6] * first_u + m[7] * v + m[8];
    const double x = (m[0] * first_u + m[1] * v + m[2]) / w, y = (m[3] * first_u + m[4] * v + m[5]) / w;
    const double slopes[4] = {m[0] - x * m[6], m[1] - x * m[7], m[3] - y * m[6], m[4] - y * m[7]};
    const double along_x = length(slopes[0], slopes[1]), along_y = length(slopes[2], slopes[3]);
    memcpy(run->slopes, slopes, sizeof slopes);
    run->v = v, run->first_u = first_u, run->end_u = end_u;
    run->x = x, run->y = y, run->step_x = m[0] / w, run->step_y = m[3] / w;
    run->sharp_x = w / (spread->sigma_px * along_x), run->sharp_y = w / (spread->sigma_px * along_y);
    run->cosine = (slopes[0] * slopes[2] + slopes[1] * slopes[3]) / (along_x * along_y);
    run->direction_x = direction_of(slopes[0], slopes[1], spread->directions);
    run->direction_y = direction_of(slopes[2], slopes[3], spread->directions);
    run->is_affine = !canvas->lens && fabs(m[6]) < AFFINE * w && fabs(m[7]) < AFFINE * w;
}

static void locate_affine(const Run *run, int32_t u, Places *restrict places) {
    for (int i = 0; i < LANES; i++) {
        const double along = u - run->first_u + i;
        places->x[i] = run->x + run->step_x * along;
        places->y[i] = run->y + run->step_y * along;
        places->sharp_x[i] = (float)run->sharp_x;
        places->sharp_y[i] = (float)run->sharp_y;
        places->cosine[i] = (float)run->cosine;
        places->is_seen[i] = u + i < run->end_u;
    }
}

/* Copy the lens fields of `count` pixels. The others, and all without a lens, get those of no distortion. */
static void read_lens(const Canvas *canvas, int32_t v, int32_t u, int32_t count, float fields[LENS_FIELDS][LANES]) {
    static const float NONE[LENS_FIELDS] = {0, 0, 1, 0, 0, 1};
    const ptrdiff_t pixels = (ptrdiff_t)canvas->width * canvas->height, at = (ptrdiff_t)v * canvas->width + u;
    for (int field = 0; field < LENS_FIELDS; field++) {
        for (int i = 0; i < LANES; i++) fields[field][i] = NONE[field];
        if (canvas->lens) memcpy(fields[field], canvas->lens + field * pixels + at, (size_t)count * sizeof(float));
    }
}

/* Compute the places of the pixels u..u+LANES-1 of a run. */
void locate(const Canvas *canvas, const EdgeSpread *spread, const Run *run, int32_t u, Places *restrict places) {
    if (run->is_affine) {
        locate_affine(run, u, places);
        return;
    }
    const int32_t count = run->end_u - u < LANES ? run->end_u - u : LANES;
    const double *restrict m = run->matrix, sigma_px = spread->sigma_px;
    float lens[LENS_FIELDS][LANES];
    read_lens(canvas, run->v, u, count, lens);
    for (int i = 0; i < LANES; i++) {
        const double column = u + i + lens[0][i], row = run->v + lens[1][i];
        const double w = m[6] * column + m[7] * row + m[8];
        const double x = (m[0] * column + m[1] * row + m[2]) / w, y = (m[3] * column + m[4] * row + m[5]) / w;
        const double a = m[0] - x * m[6], b = m[1] - x * m[7], c = m[3] - y * m[6], d = m[4] - y * m[7];
        const double uu = lens[2][i], uv = lens[3][i], vu = lens[4][i], vv = lens[5][i];
        const double x_u = a * uu + b * vu, x_v = a * uv + b * vv, y_u = c * uu + d * vu, y_v = c * uv + d * vv;
        const double along_x = length(x_u, x_v), along_y = length(y_u, y_v);
        places->x[i] = x;
        places->y[i] = y;
        places->sharp_x[i] = (float)(w / (sigma_px * along_x));
        places->sharp_y[i] = (float)(w / (sigma_px * along_y));
        places->cosine[i] = (float)((x_u * y_u + x_v * y_v) / (along_x * along_y));
        places->is_seen[i] = (w > 0) & (i < count);
    }
}
