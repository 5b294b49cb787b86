/* Least squares of markers from the products of their columns (fitting/fit.py).
 *
 * With the inverse normal matrix C, unknowns h and the variances P about their values v, a solution x is drawn by
 * -C_xh B (x_h - v), with B = (C_hh + P)⁻¹. C becomes C - C_xh B C_hx, and the sum of squares grows by
 * (x_h - v)ᵀ B (x_h - v). Variances of zero hold the unknowns.
 */
#include "fit.h"

#include <stdlib.h>
#include <string.h>

enum { SQUARE = UNKNOWNS * UNKNOWNS };

/* Return 0 or an error. The solutions are released by `release_solutions` in either case. */
int32_t allocate_solutions(Solutions *solutions, int64_t count) {
    double *memory = malloc((size_t)count * (UNKNOWNS + SQUARE + 2) * sizeof *memory);
    *solutions = (Solutions){memory, NULL, NULL, NULL, count, UNKNOWNS};
    if (!memory) return FIT_NO_MEMORY;
    solutions->inverse_normals = memory + count * UNKNOWNS;
    solutions->squares = solutions->inverse_normals + count * SQUARE;
    solutions->pixels = solutions->squares + count;
    return 0;
}

void release_solutions(Solutions *solutions) { free(solutions->values); }

void copy_solutions(const Solutions *from, Solutions *to) {
    memcpy(to->values, from->values, (size_t)from->count * (UNKNOWNS + SQUARE + 2) * sizeof *from->values);
    to->free = from->free;
}

/* Return the variance of a pixel about the model of marker k, grey levels squared. */
double noise_variance(const Solutions *solutions, int64_t k) {
    return solutions->squares[k] / fmax(solutions->pixels[k] - solutions->free, 1.0);
}

/* Return the contrast of marker k, grey levels, so large that it can divide. */
double contrast_of(const Solutions *solutions, int64_t k, const FitConstants *constants) {
    const double contrast = solutions->values[k * UNKNOWNS + CONTRAST];
    return contrast > constants->min_contrast ? contrast : constants->min_contrast;
}

/* Invert a matrix (15, 15) in place by Gauss-Jordan elimination with row pivots. */
static void invert(double a[UNKNOWNS][UNKNOWNS]) {
    int32_t pivots[UNKNOWNS];
    for (int32_t i = 0; i < UNKNOWNS; i++) {
        int32_t pivot = i;
        for (int32_t row = i + 1; row < UNKNOWNS; row++)
            if (fabs(a[row][i]) > fabs(a[pivot][i])) pivot = row;
        pivots[i] = pivot;
        for (int32_t j = 0; j < UNKNOWNS; j++) {
            const double swapped = a[pivot][j];
            a[pivot][j] = a[i][j];
            a[i][j] = swapped;
        }
        const double inverse = 1 / a[i][i];
        a[i][i] = 1;
        for (int32_t j = 0; j < UNKNOWNS; j++) a[i][j] *= inverse;
        for (int32_t row = 0; row < UNKNOWNS; row++) {
            if (row == i) continue;
            const double factor = a[row][i];
            a[row][i] = 0;
            for (int32_t j = 0; j < UNKNOWNS; j++) a[row][j] -= factor * a[i][j];
        }
    }
    for (int32_t i = UNKNOWNS - 1; i >= 0; i--)
        for (int32_t row = 0; row < UNKNOWNS; row++) {
            const double swapped = a[row][pivots[i]];
            a[row][pivots[i]] = a[row][i];
            a[row][i] = swapped;
        }
}

/* Solve for all unknowns of marker k, from the products (16, 16) of its columns. */
void solve(const float *gram, const FitConstants *constants, Solutions *solutions, int64_t k) {
    double normal[UNKNOWNS][UNKNOWNS], *values = solutions->values + k * UNKNOWNS;
    for (int32_t i = 0; i < UNKNOWNS; i++) {
        for (int32_t j = 0; j < UNKNOWNS; j++) normal[i][j] = (double)gram[i * COLUMNS + j];
        normal[i][i] += i == GROUND ? constants->ground_ridge : constants->ridge;
        normal[i][i] *= 1 + constants->single_precision;
    }
    invert(normal);
    double explained = 0;
    for (int32_t i = 0; i < UNKNOWNS; i++) {
        values[i] = 0;
        for (int32_t j = 0; j < UNKNOWNS; j++) values[i] += normal[i][j] * (double)gram[j * COLUMNS + PIXEL];
        explained += values[i] * (double)gram[i * COLUMNS + PIXEL];
    }
    memcpy(solutions->inverse_normals + k * SQUARE, normal, sizeof normal);
    solutions->squares[k] = fmax((double)gram[PIXEL * COLUMNS + PIXEL] - explained, constants->min_squares);
}

/* B of two unknowns, or of one: then the others are 0. */
typedef struct { double first, last, both; } Gain;

static Gain gain_of(const double *c, int32_t first, int32_t last, double variance) {
    const double top = c[first * UNKNOWNS + first] + variance, bottom = c[last * UNKNOWNS + last] + variance;
    const double across = c[first * UNKNOWNS + last];
    if (first == last) return (Gain){1 / top, 0, 0};
    const double determinant = top * bottom - across * c[last * UNKNOWNS + first];
    return (Gain){bottom / determinant, top / determinant, -across / determinant};
}

/* Hold or draw the unknowns `first` and `last`, which are equal if it is one, of `count` solutions, in place.
 *
 * values (count, 15), inverse_normals (count, 15, 15), squares (count,), at (count, 1 or 2),
 * variances (count,), 0 to hold. Rounding does not make a sum of squares smaller. */
int32_t hold_unknowns(double *values, double *inverse_normals, double *squares, int64_t count, int32_t first,
                      int32_t last, const double *at, const double *variances) {
    if (first < 0 || first >= UNKNOWNS || last < 0 || last >= UNKNOWNS) return FIT_INVALID_SIZE;
    const int both = first != last;
    for (int64_t k = 0; k < count; k++) {
        double *x = values + k * UNKNOWNS, *c = inverse_normals + k * UNKNOWNS * UNKNOWNS;
        const double *value = at + k * (both ? 2 : 1);
        const Gain b = gain_of(c, first, last, variances[k]);
        const double off_first = x[first] - value[0], off_last = both ? x[last] - value[1] : 0.0;
        const double pull_first = b.first * off_first + b.both * off_last;
        const double pull_last = b.both * off_first + b.last * off_last;
        squares[k] += fmax(off_first * pull_first + off_last * pull_last, 0.0);
        double of_first[UNKNOWNS], of_last[UNKNOWNS], row_first[UNKNOWNS], row_last[UNKNOWNS];
        for (int32_t i = 0; i < UNKNOWNS; i++) {
            of_first[i] = c[i * UNKNOWNS + first], of_last[i] = c[i * UNKNOWNS + last];
            row_first[i] = c[first * UNKNOWNS + i], row_last[i] = c[last * UNKNOWNS + i];
        }
        for (int32_t i = 0; i < UNKNOWNS; i++) {
            x[i] -= of_first[i] * pull_first + of_last[i] * pull_last;
            const double gain_first = of_first[i] * b.first + of_last[i] * b.both;
            const double gain_last = of_first[i] * b.both + of_last[i] * b.last;
            for (int32_t j = 0; j < UNKNOWNS; j++)
                c[i * UNKNOWNS + j] -= gain_first * row_first[j] + gain_last * row_last[j];
        }
    }
    return 0;
}

/* Hold two unknowns, or one twice, of all solutions at values (count, 1 or 2). */
void hold_at(Solutions *solutions, int32_t first, int32_t last, const double *at) {
    const double held = 0;
    const int64_t width = first == last ? 1 : 2;
    for (int64_t k = 0; k < solutions->count; k++)
        hold_unknowns(solutions->values + k * UNKNOWNS, solutions->inverse_normals + k * SQUARE, solutions->squares + k,
                      1, first, last, at + k * width, &held);
    solutions->free -= (int32_t)width;
}
