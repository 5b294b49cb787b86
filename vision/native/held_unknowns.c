/* Least-squares solutions with one or two unknowns held, or expected at values (fitting/least_squares.py).
 *
 * With the inverse normal matrix C, unknowns h and the variances P about their values v, a solution x is drawn by
 * -C_xh B (x_h - v), with B = (C_hh + P)⁻¹. C becomes C - C_xh B C_hx, and the sum of squares grows by
 * (x_h - v)ᵀ B (x_h - v).
 */
#include "fit.h"

#include <math.h>

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
