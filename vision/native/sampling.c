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

/* Read quadrilaterals (count, 4, 2), px, on the grid of all pairs of places `at` (fine * side,) along the unit square.
 *
 * levels (count, side, side) are means over fine x fine neighbours. Returns 0 or an error. */
int32_t sample_squares(const uint8_t *image, int32_t width, int32_t height, const double *corners, int64_t count,
                       const double *at, int32_t side, int32_t fine, float *levels) {
    if (width <= 0 || height <= 0 || width > MAX_SIDE_PX || height > MAX_SIDE_PX || count < 0) return INVALID_SIZE;
    if (side <= 0 || fine <= 0 || side > MAX_PLACES / fine) return INVALID_PARAMETERS;
    for (int64_t k = 0; k < count; k++) {
        const ToImage to = to_quad(corners + 8 * k);
        for (int32_t cell = 0; cell < side * side; cell++) {
            const double *xs = at + cell % side * fine, *ys = at + cell / side * fine;
            float sum = 0;
            for (int32_t i = 0; i < fine * fine; i++) {
                const double x = xs[i % fine], y = ys[i / fine], per = 1 / away_from_zero(1 + to.g * x + to.h * y);
                const Place place = {(to.first.u + x * to.right.u + y * to.down.u) * per,
                                     (to.first.v + x * to.right.v + y * to.down.v) * per};
                sum += grey_at(image, width, height, place);
            }
            *levels++ = sum / (float)(fine * fine);
        }
    }
    return 0;
}
