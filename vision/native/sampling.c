/* Grey levels of an image on a grid within quadrilaterals, as read for the cells of a marker. */
#include "sampling.h"
#include "search.h"

#include <math.h>

enum { MAX_PLACES = 1 << 15 }; /* along either axis: a grid's levels are counted in 32 bits */

static const double MIN_DIVISOR = 1e-9; /* smallest magnitude of a divisor: degenerate quadrilaterals read any pixel */

static inline double away_from_zero(double value) { return fabs(value) < MIN_DIVISOR ? MIN_DIVISOR : value; }
static inline Place less(Place a, Place b) { return (Place){a.u - b.u, a.v - b.v}; }
static inline double cross(Place a, Place b) { return a.u * b.v - a.v * b.u; }

/* Image of the unit square: (first + x right + y down) / (1 + g x + h y). */
typedef struct { Place first, right, down; double g, h; } ToImage;

static ToImage to_quad(const double *corners) {
    const Place first = {corners[0], corners[1]}, second = {corners[2], corners[3]};
    const Place third = {corners[4], corners[5]}, fourth = {corners[6], corners[7]};
    const Place a = less(second, third), b = less(fourth, third), bend = less(less(first, second), b);
    const double area = away_from_zero(cross(a, b)), g = cross(bend, b) / area, h = cross(a, bend) / area;
    const Place right = less(second, first), down = less(fourth, first);
    return (ToImage){first, {right.u + g * second.u, right.v + g * second.v},
                     {down.u + h * fourth.u, down.v + h * fourth.v}, g, h};
}

/* Add the grey levels at the places (x, y) of one line of a grid to sums (count,); x (count,) are `stride` apart. */
static void add_line(const uint8_t *image, int32_t width, int32_t height, const ToImage *to, const double *x, int32_t stride,
                     double y, int32_t count, float *sums) {
    double u[PLACES_AT_ONCE], v[PLACES_AT_ONCE];
    float grey[PLACES_AT_ONCE];
    for (int32_t i = 0; i < count; i++) {
        const double at = x[i * stride], per = 1 / away_from_zero(1 + to->g * at + to->h * y);
        u[i] = (to->first.u + at * to->right.u + y * to->down.u) * per;
        v[i] = (to->first.v + at * to->right.v + y * to->down.v) * per;
    }
    read_grey(image, width, height, u, v, count, grey);
    for (int32_t i = 0; i < count; i++) sums[i] += grey[i];
}

/* Read quadrilaterals (count, 4, 2), px, on the grid of all pairs of places `at` (fine * side,) along the unit square.
 *
 * levels (count, side, side) are means over fine x fine neighbours. Returns 0 or an error. */
int32_t sample_squares(const uint8_t *image, int32_t width, int32_t height, const double *corners, int64_t count,
                       const double *at, int32_t side, int32_t fine, float *levels) {
    if (width <= 0 || height <= 0 || width > MAX_SIDE_PX || height > MAX_SIDE_PX || count < 0) return INVALID_SIZE;
    if (side <= 0 || fine <= 0 || side > MAX_PLACES / fine) return INVALID_PARAMETERS;
    for (int64_t line = 0; line < count * side; line++) {
        const ToImage to = to_quad(corners + line / side * 8);
        const double *ys = at + line % side * fine;
        for (int32_t column = 0; column < side; column += PLACES_AT_ONCE) {
            const int32_t few = side - column < PLACES_AT_ONCE ? side - column : PLACES_AT_ONCE;
            float sums[PLACES_AT_ONCE] = {0};
            for (int32_t i = 0; i < fine * fine; i++) {
                const double *xs = at + column * fine + i % fine;
                add_line(image, width, height, &to, xs, fine, ys[i / fine], few, sums);
            }
            for (int32_t i = 0; i < few; i++) *levels++ = sums[i] / (float)(fine * fine);
        }
    }
    return 0;
}
